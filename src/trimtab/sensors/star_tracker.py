"""Star tracker: measures the attitude with latency, and only while the body turns slowly enough."""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from trimtab.core import quaternion
from trimtab.core.record import Scalar, imperfection, part, period, quantity, record, replace, tree_where
from trimtab.core.rng import Key, normals
from trimtab.core.rotation import DEG, from_euler
from trimtab.core.signals import Motion, Sample
from trimtab.core.time import ms
from trimtab.sensors.late_fix import LateFix, LateState

ZERO = (0.0, 0.0, 0.0)
ARC_SECOND = DEG / 3600


@record
class AttitudeReading:
    """Sample of a measured attitude. Source: docs page, Sensors for three dimensions."""

    attitude: Any = quantity(
        "1", "Measured quaternion q_WB, scalar first. The sign of the quaternion is arbitrary.", frame="WB", shape=(4,)
    )
    tracking: Scalar = quantity(
        "1", "True if stars were recognised. If False, the attitude is the last one measured.", kind="flag"
    )


@record
class StarTrackerState:
    """State of a star tracker. Source: docs page, Sensors for three dimensions."""

    key: Key = part("Key of the random number generator for the noise.")
    alignment: Any = quantity(
        "rad", "Mounting error of the star tracker in this run, in its camera frame S.", kind="angle", shape=(3,)
    )
    last: AttitudeReading = part("Last measured attitude.")
    late: LateState = part("Measurement that has been made but has not arrived yet.")


@record
class StarTracker:
    """Star tracker with small noise about the axes across its boresight and large noise about the boresight.

        q_WS = q_WB q_BS retract(misalignment) retract(w),  w ~ (cross, cross, roll);     q_WB = q_WS conj(q_BS)

    retract(w) is the rotation by the small vector w. Stars are not recognised while the body turns faster than
    `rate_limit`, or the sun is within `exclusion` of the boresight.

    Frames:  W, B and the camera frame S, whose z axis is the boresight. `mounting`: roll, pitch, yaw of S in B.
    Not modelled: rotation of W relative to the stars, distortion, radiation, aberration, exposure time.
    Source:  Liebe, "Accuracy performance of star trackers: a tutorial", IEEE Trans. AES 38 (2002): the roll error is
             about 6 to 16 times the cross-boresight error. The sizes of the errors are our own choice.
    """

    cross_noise: Scalar = imperfection(
        "rad",
        "Standard deviation of the attitude noise about each axis across the boresight.",
        "star-tracker-noise",
        default=5 * ARC_SECOND,
    )
    roll_noise: Scalar = imperfection(
        "rad",
        "Standard deviation of the attitude noise about the boresight.",
        "star-tracker-roll-noise",
        default=50 * ARC_SECOND,
    )
    misalignment: Scalar = imperfection(
        "rad",
        "Standard deviation of the mounting error, drawn for each run.",
        "star-tracker-misalignment",
        default=20 * ARC_SECOND,
    )
    rate_limit: Scalar = quantity(
        "rad/s",
        "Largest angular rate at which stars are recognised.",
        default=2 * DEG,
        above=0,
        off={"star-tracker-rate-limit": 1e9},
    )
    exclusion: Scalar = imperfection(
        "rad",
        "Half angle of the cone in which the sun blinds the camera.",
        "star-tracker-blinding",
        default=30 * DEG,
        high=np.pi,
    )
    sun: Any = quantity(
        "1", "Vector towards the sun in W, of any length.", frame="W", default=(1.0, 0.0, 0.0), shape=(3,)
    )
    mounting: Any = quantity(
        "rad",
        "Orientation of the camera frame in B: roll, pitch, yaw.",
        default=(np.pi, 0.0, 0.0),
        kind="angle",
        shape=(3,),
    )
    timing: LateFix = part(
        "Timing of the measurements: interval, latency and time stamp.",
        default=LateFix(latency=0.1, interval=ms(200)),
        off={"star-tracker-latency": lambda sensor: replace(sensor.timing, latency=0.0)},
    )
    period: int = period("Time between checks for a new measurement.", default=ms(10))

    LATE: ClassVar[bool] = True

    def check(self) -> None:
        """Raise InputError if the period is too long to catch every measurement."""
        self.timing.check_period(self.period)

    def init(self, key: Key) -> StarTrackerState:
        """Return the initial state, before any measurement, with the mounting error drawn for this run."""
        none = AttitudeReading(jnp.array([1.0, 0.0, 0.0, 0.0]), jnp.zeros((), np.bool_))
        alignment = self.misalignment * normals(key.at("unit"), 0, 3)
        return StarTrackerState(key.at("noise"), alignment, none, self.timing.initial_state(none))

    def measure(self, motion: Motion) -> AttitudeReading:
        """Return the measurement h(x) for the vehicle's motion, without error."""
        return AttitudeReading(quaternion.from_euler(*motion.attitude), self.sees(motion))

    def sees(self, motion: Motion) -> Any:
        """Return True if stars are recognised: the body turns slowly enough, and the sun is far from the boresight."""
        w = motion.w_WB_B
        boresight = from_euler(*motion.attitude) @ from_euler(*jnp.asarray(self.mounting))[:, 2]
        sun = jnp.asarray(self.sun)
        from_sun = (boresight @ sun) < jnp.cos(self.exclusion) * jnp.sqrt(sun @ sun)
        return (w @ w <= self.rate_limit * self.rate_limit) & (from_sun | (self.exclusion == 0))

    def step(self, t: Any, state: StarTrackerState, motion: Motion) -> tuple[StarTrackerState, Sample]:
        """Return the newest attitude that has arrived at time t (unit: 100 ns)."""
        true, z = self.measure(motion), normals(state.key, self.timing.measurement_number(t), 3)
        q_BS = quaternion.from_euler(*jnp.asarray(self.mounting))
        noise = jnp.stack([self.cross_noise, self.cross_noise, self.roll_noise]) * z
        q_WS = quaternion.multiply(true.attitude, q_BS)
        q_WS = quaternion.retract(quaternion.retract(q_WS, state.alignment), noise)
        seen = AttitudeReading(quaternion.multiply(q_WS, quaternion.conjugate(q_BS)), true.tracking)
        value = tree_where(true.tracking, seen, replace(state.last, tracking=jnp.zeros((), np.bool_)))
        makes = (jnp.asarray(t, np.int64) % self.timing.interval) == self.timing.offset
        last = tree_where(makes & true.tracking, seen, state.last)
        late, sample = self.timing.deliver(t, state.late, value)
        return StarTrackerState(state.key, state.alignment, last, late), sample
