"""A receiver of satellite navigation that gives fixes: position and velocity of its antenna, now and then, and late."""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, imperfection, part, period, quantity, record, replace
from trimtab.core.rng import Key, normals
from trimtab.core.rotation import from_euler
from trimtab.core.signals import Motion, Sample
from trimtab.core.time import ms, seconds, to_seconds
from trimtab.sensors.late_fix import LateFix, LateState

ARM = (0.2, 0.0, -0.1)
"""Of the antenna, where nothing else is given: in front of the centre of mass and above it (m)."""
FIVE_HERTZ = LateFix(latency=0.12, interval=ms(200))
"""Times of a common receiver: five fixes a second, each 120 ms old when it comes out."""


@record
class Outages:
    """When the sky is hidden: for `length` from `start` on, and again each `interval`. Source: docs page, Gnss."""

    start: Scalar = quantity("100 ns", "Of the first.", default=seconds(10), low=0, kind="time")
    length: Scalar = quantity(
        "100 ns", "Of each; 0: there are none.", default=0, low=0, kind="time", off={"gnss-outages": 0}
    )
    interval: Scalar = quantity(
        "100 ns",
        "From the start of one to that of the next; 0: there is one only.",
        default=0,
        low=0,
        kind="time",
    )

    def is_blocked(self, t: Any) -> Any:
        """Whether nothing is received at integer time t."""
        since = t - self.start
        within = jnp.where(self.interval > 0, since % jnp.maximum(self.interval, 1), since)
        return (since >= 0) & (within < self.length)


@record
class GnssReading:
    """Where the antenna was and how it moved. Source: docs page, Gnss."""

    position: Any = quantity("m", "North, east, down of the antenna.", frame="W", shape=(3,))
    velocity: Any = quantity("m/s", "North, east, down of the antenna.", frame="W", shape=(3,))


@record
class GnssState:
    """What the receiver remembers. Source: this module."""

    key: Key = part("Of the noise.")
    late: LateState = part("What is on its way.")
    correlated: Any = quantity("m", "The error that hangs together in time.", frame="W", shape=(3,))


def antenna(motion: Motion, arm_B: Any) -> tuple[Any, Any]:
    """Position and velocity (3,) in W of a point of the body at arm_B (3,) (m)."""
    R_WB, arm = from_euler(*motion.attitude), jnp.asarray(arm_B)
    return motion.p_WB + R_WB @ arm, R_WB @ (motion.v_WB_B + jnp.cross(motion.w_WB_B, arm))


@record
class Gnss:
    """Fixes of position and velocity in the local frame W.

        z_p = p + R_WB l + e + w_p,    z_v = R_WB (v + w × l) + w_v,    e: first-order Gauss–Markov process

    white noise w with one deviation level and another one down, as satellites stand above only. A fix describes the
    antenna at the sample's time, and comes out after the latency. A geodetic place is `TangentPlane.from_ned` of it.

    Frames:  lever arm l in B from the centre of mass; position and velocity in W.
    Not modelled: steps of e when satellites come and go; multipath as such; the filter within the receiver.
    Source:  Groves, "Principles of GNSS, inertial, and multisensor integrated navigation systems", 2nd ed., sections
             9.3, 9.4.2 and 14.3; orders of magnitude of a single-frequency receiver with corrections, chosen here.
    """

    noise: Scalar = imperfection("m", "White: standard deviation north and east.", "gnss-noise", default=0.4)
    noise_down: Scalar = imperfection("m", "The same of down.", "gnss-noise", default=0.7)
    velocity_noise: Scalar = imperfection("m/s", "White: north and east.", "gnss-noise", default=0.05)
    velocity_noise_down: Scalar = imperfection("m/s", "The same of down.", "gnss-noise", default=0.08)
    correlated: Scalar = imperfection(
        "m", "Standard deviation of e in each direction.", "gnss-correlated-error", default=0.0
    )
    correlation_time: Scalar = quantity("s", "Of e.", default=100.0, above=0)
    lever_arm: Any = quantity("m", "The antenna's place.", frame="B", default=ARM, shape=(3,))
    timing: LateFix = part(
        "When it is measured and comes out.",
        default=FIVE_HERTZ,
        off={"gnss-latency": lambda sensor: replace(sensor.timing, latency=0.0)},
    )
    outages: Outages = part("When nothing is received.", default=Outages())
    period: int = period("How often it is looked whether a fix has come out.", default=ms(10))

    LATE: ClassVar[bool] = True

    def check(self) -> None:
        """Refuse a period at which fixes would be missed."""
        self.timing.check_period(self.period)

    def init(self, key: Key) -> GnssState:
        """Nothing measured; e as it is after a long time."""
        three = np.zeros(3)
        late = self.timing.initial_state(GnssReading(three, three))
        return GnssState(key.at("white"), late, self.correlated * normals(key.at("first"), 0, 3))

    def measure(self, motion: Motion) -> GnssReading:
        """The measurement h(x) of a motion, without error."""
        return GnssReading(*antenna(motion, self.lever_arm))

    def step(self, t: Any, state: GnssState, motion: Motion) -> tuple[GnssState, Sample]:
        """The newest fix that is out at integer time t."""
        true, w = self.measure(motion), normals(state.key, self.timing.measurement_number(t), 9)
        of_position = jnp.stack([self.noise, self.noise, self.noise_down])
        of_velocity = jnp.stack([self.velocity_noise, self.velocity_noise, self.velocity_noise_down])
        reading = GnssReading(
            position=true.position + state.correlated + of_position * w[:3],
            velocity=true.velocity + of_velocity * w[3:6],
        )
        late, sample = self.timing.deliver(t, state.late, reading, received=~self.outages.is_blocked(t))
        wander = wander_error(self.timing, t, state.correlated, self.correlated, self.correlation_time, w[6:])
        return GnssState(state.key, late, wander), sample


def wander_error(timing: LateFix, t: Any, error: Any, sigma: Any, correlation_time: Any, white: Any) -> Any:
    """A first-order Gauss–Markov error (n,) after integer time t: one step on where a measurement is made.

    Args:     sigma: its standard deviation.    correlation_time: s.    white: standard normals (n,).
    Source:   Groves, 2nd ed., section 3.2.4: e+ = a e + sigma sqrt(1 - a²) w, a = exp(-interval/correlation time).
    """
    a = jnp.exp(-to_seconds(timing.interval) / correlation_time)
    stepped = a * error + sigma * jnp.sqrt(1 - a * a) * white
    return jnp.where(timing.is_made(t), stepped, error)
