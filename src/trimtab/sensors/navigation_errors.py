"""Navigation systems of planar vehicles: one without errors, and one whose errors grow between corrections.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import math
from typing import Any

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, imperfection, option, period, record, replace
from trimtab.core.rng import Key, normal2
from trimtab.core.rotation import DEG, wrap_positive
from trimtab.core.signals import Motion, PlanarState, Sample, new_sample
from trimtab.core.time import ms, seconds, to_seconds


@record
class PlanarNavigation:
    """Ideal sensor of body velocity, yaw rate and heading, sampled every `period`.

        z = (surge velocity, sway velocity, yaw rate, heading)

    Frames:  velocity and yaw rate in B; heading of B in W, unwrapped.    Not modelled: any error.
    Source:  [1] section 6.1: the ideal model closes the loop on the true state.
    """

    period: int = period("Time between samples.", default=ms(1))

    def init(self, key: Key) -> tuple[()]:
        """Return an empty record, because this sensor has no state."""
        return ()

    def measure(self, motion: Motion) -> PlanarState:
        """Return the measurement h(x) for the vehicle's motion."""
        return planar_state(motion)

    def step(self, t: Any, state: tuple[()], motion: Motion) -> tuple[tuple[()], Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        return state, new_sample(t, self.measure(motion))


def planar_state(motion: Motion) -> PlanarState:
    """Return the planar velocity, yaw rate and unwrapped heading of a motion in space."""
    return PlanarState(
        surge_velocity=motion.v_WB_B[0],
        sway_velocity=motion.v_WB_B[1],
        yaw_rate=motion.w_WB_B[2],
        heading=motion.attitude[2],
    )


CM = 0.01
READINGS: dict[str, tuple[float, float, float]] = {
    "A": (2.5 * CM, 1.0 * DEG, 0.5 * DEG),
    "B": (math.sqrt(2.5) * CM, 1.0 * DEG, math.sqrt(0.5) * DEG),
    "C": (math.sqrt(0.025), math.sqrt(0.01745), math.sqrt(0.00873)),
}
"""Standard deviations of accelerometer bias (m/s^2), gyro bias and gyro noise (rad/s), for each interpretation of the
units printed in [1]."""


@record
class NavigationErrors:
    """Planar navigation system: the true state plus sensor biases integrated since the last reset.

        tau = t mod redraw;   du = bX tau,  dv = bY tau,  dr = bg + w,  dpsi = bg tau

    du, dv, dr and dpsi are the errors of surge velocity, sway velocity, yaw rate and heading. The biases bX, bY, bg are
    drawn again every `redraw`, when the integrals restart from zero. The noise w is drawn for every sample. All draws
    are zero-mean, normal and independent, and depend only on the time and the random key.

    Frames:  velocity errors are added in B.    Not modelled: position, and the navigation filter that causes these
             errors.
    Source:  [1] section 6.1 and fig. 6.2. Units of the printed numbers: reconstructed (reading C), see docs Errata.
    """

    accelerometer_bias: Scalar = imperfection(
        "m/s^2",
        "Standard deviation of the accelerometer bias of each axis.",
        "navigation-error",
        default=READINGS["C"][0],
        source="[1] section 6.1",
    )
    gyro_bias: Scalar = imperfection(
        "rad/s",
        "Standard deviation of the gyro bias.",
        "navigation-error",
        default=READINGS["C"][1],
        source="[1] section 6.1",
    )
    gyro_noise: Scalar = imperfection(
        "rad/s",
        "Standard deviation of the gyro noise of each sample.",
        "navigation-error",
        default=READINGS["C"][2],
        source="[1] section 6.1",
    )
    redraw: int = period(
        "Time between resets. A reset restarts the integrals from zero and draws new biases.", default=seconds(1)
    )
    period: int = period("Time between samples.", default=ms(6))
    heading_range: str = option(
        'Heading reported as "unwrapped" (counts full turns) or "positive" (in [0, 2 pi)).',
        default="unwrapped",
        choices=("unwrapped", "positive"),
    )

    @classmethod
    def reading(cls, name: str, **settings: Any) -> "NavigationErrors":
        """Return the sensor for one interpretation of the units printed in [1].

        Args:
            name: interpretation. "A": the printed numbers are standard deviations. "B": they are variances in cm and
                degrees. "C": they are variances in SI units, which agrees with the published figures.
            settings: values of the other fields, e.g. ``heading_range="positive"``.
        """
        if name not in READINGS:
            raise InputError(
                "NavigationErrors", f"unknown interpretation {name!r} of the printed units", choices=READINGS
            )
        accelerometer_bias, gyro_bias, gyro_noise = READINGS[name]
        return cls(accelerometer_bias=accelerometer_bias, gyro_bias=gyro_bias, gyro_noise=gyro_noise, **settings)

    def init(self, key: Key) -> Key:
        """Return the initial state: the key of the random number generator."""
        return key

    def measure(self, motion: Motion) -> PlanarState:
        """Return the measurement h(x) for the vehicle's motion, without error."""
        return self._express_heading(planar_state(motion))

    def step(self, t: Any, state: Key, motion: Motion) -> tuple[Key, Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        truth, tau = planar_state(motion), to_seconds(t % self.redraw)
        bX, bY = normal2(state, t // self.redraw, 0)
        bg, _ = normal2(state, t // self.redraw, 1)
        w, _ = normal2(state, t // self.period, 2)
        bias = self.gyro_bias * bg
        state_with_errors = PlanarState(
            surge_velocity=truth.surge_velocity + self.accelerometer_bias * bX * tau,
            sway_velocity=truth.sway_velocity + self.accelerometer_bias * bY * tau,
            yaw_rate=truth.yaw_rate + bias + self.gyro_noise * w,
            heading=truth.heading + bias * tau,
        )
        return state, new_sample(t, self._express_heading(state_with_errors))

    def _express_heading(self, x: PlanarState) -> PlanarState:
        return replace(x, heading=wrap_positive(x.heading)) if self.heading_range == "positive" else x
