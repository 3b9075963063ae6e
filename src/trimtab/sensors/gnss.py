"""Satellite receiver that outputs fixes: position and velocity of its antenna, at intervals and with latency."""

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
"""Default position (m) of the antenna in B: in front of the centre of mass and above it."""
FIVE_HERTZ = LateFix(latency=0.12, interval=ms(200))
"""Default timing of a satellite receiver: five fixes a second, each 120 ms old on arrival."""


@record
class Outages:
    """Outages of satellite reception of duration `length`, repeated every `interval` from `start` on.

    Source:  docs page, Gnss.
    """

    start: Scalar = quantity("100 ns", "Start of the first outage.", default=seconds(10), low=0, kind="time")
    length: Scalar = quantity(
        "100 ns", "Length of each outage; 0: no outages.", default=0, low=0, kind="time", off={"gnss-outages": 0}
    )
    interval: Scalar = quantity(
        "100 ns",
        "Time from the start of one outage to the start of the next; 0: only one outage.",
        default=0,
        low=0,
        kind="time",
    )

    def is_blocked(self, t: Any) -> Any:
        """Return True if nothing is received at time t (unit: 100 ns)."""
        since = t - self.start
        within = jnp.where(self.interval > 0, since % jnp.maximum(self.interval, 1), since)
        return (since >= 0) & (within < self.length)


@record
class GnssReading:
    """Fix of a satellite receiver: position and velocity of the antenna. Source: docs page, Gnss."""

    position: Any = quantity("m", "Position of the antenna: north, east, down.", frame="W", shape=(3,))
    velocity: Any = quantity("m/s", "Velocity of the antenna: north, east, down.", frame="W", shape=(3,))


@record
class GnssState:
    """State of the satellite receiver. Source: this module."""

    key: Key = part("Key of the random number generator for the noise.")
    late: LateState = part("Fix that has been measured but has not arrived yet.")
    correlated: Any = quantity("m", "Time-correlated position error.", frame="W", shape=(3,))


def antenna(motion: Motion, arm_B: Any) -> tuple[Any, Any]:
    """Return the position (3,) and velocity (3,) in W of a point on the body at arm_B (3,) (m)."""
    R_WB, arm = from_euler(*motion.attitude), jnp.asarray(arm_B)
    return motion.p_WB + R_WB @ arm, R_WB @ (motion.v_WB_B + jnp.cross(motion.w_WB_B, arm))


@record
class Gnss:
    """Satellite receiver that measures position and velocity in the local frame W.

        z_p = p + R_WB l + e + w_p,    z_v = R_WB (v + w × l) + w_v,    e: first-order Gauss–Markov process

    The white noise w has one standard deviation horizontally and another one vertically, because all satellites are
    above the receiver. A fix describes the antenna at the time of measurement and arrives after the latency.
    `TangentPlane.from_ned` converts the position of a fix to geodetic coordinates.

    Frames:  lever arm l in B from the centre of mass; position and velocity in W.
    Not modelled: steps of e when satellites rise or set; multipath as a separate error; the receiver's own filter.
    Source:  Groves, "Principles of GNSS, inertial, and multisensor integrated navigation systems", 2nd ed., sections
             9.3, 9.4.2 and 14.3. The sizes of the errors are our own choice, typical of a single-frequency receiver
             with corrections.
    """

    noise: Scalar = imperfection(
        "m",
        "Standard deviation of the white position noise in the north and east directions.",
        "gnss-noise",
        default=0.4,
    )
    noise_down: Scalar = imperfection(
        "m", "Standard deviation of the white position noise in the down direction.", "gnss-noise", default=0.7
    )
    velocity_noise: Scalar = imperfection(
        "m/s",
        "Standard deviation of the white velocity noise in the north and east directions.",
        "gnss-noise",
        default=0.05,
    )
    velocity_noise_down: Scalar = imperfection(
        "m/s", "Standard deviation of the white velocity noise in the down direction.", "gnss-noise", default=0.08
    )
    correlated: Scalar = imperfection(
        "m",
        "Standard deviation of the time-correlated position error along each axis.",
        "gnss-correlated-error",
        default=0.0,
    )
    correlation_time: Scalar = quantity(
        "s", "Correlation time of the time-correlated position error.", default=100.0, above=0
    )
    lever_arm: Any = quantity(
        "m", "Position of the antenna in B, relative to the centre of mass.", frame="B", default=ARM, shape=(3,)
    )
    timing: LateFix = part(
        "Timing of the fixes: interval, latency and time stamp.",
        default=FIVE_HERTZ,
        off={"gnss-latency": lambda sensor: replace(sensor.timing, latency=0.0)},
    )
    outages: Outages = part("Outages of satellite reception.", default=Outages())
    period: int = period("Time between checks for a new fix.", default=ms(10))

    LATE: ClassVar[bool] = True

    def check(self) -> None:
        """Raise InputError if the period is too long to catch every fix."""
        self.timing.check_period(self.period)

    def init(self, key: Key) -> GnssState:
        """Return the initial state. The time-correlated error is drawn from its stationary distribution."""
        three = np.zeros(3)
        late = self.timing.initial_state(GnssReading(three, three))
        return GnssState(key.at("white"), late, self.correlated * normals(key.at("first"), 0, 3))

    def measure(self, motion: Motion) -> GnssReading:
        """Return the measurement h(x) for the vehicle's motion, without error."""
        return GnssReading(*antenna(motion, self.lever_arm))

    def step(self, t: Any, state: GnssState, motion: Motion) -> tuple[GnssState, Sample]:
        """Return the newest fix that has arrived at time t (unit: 100 ns)."""
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
    """Return a first-order Gauss-Markov error (n,) after integer time t. It changes only if a measurement is made at t.

    Args:     error: current error (n,).    sigma: standard deviation of the error.    correlation_time: in s.
              white: standard normals (n,).
    Source:   Groves, 2nd ed., section 3.2.4: e+ = a e + sigma sqrt(1 - a²) w, a = exp(-interval/correlation time).
    """
    a = jnp.exp(-to_seconds(timing.interval) / correlation_time)
    stepped = a * error + sigma * jnp.sqrt(1 - a * a) * white
    return jnp.where(timing.is_made(t), stepped, error)
