"""A navigation system without error, for vehicles that move in the plane."""

from typing import Any, ClassVar

from trimtab.core.record import period, record
from trimtab.core.rng import Key
from trimtab.core.signals import Motion, PlanarState, Sample, measured
from trimtab.core.time import ms


@record
class PlanarNavigation:
    """Velocity in the body, yaw rate and heading as they are, each `period`: the ideal model's sensor.

        z = (surge velocity, sway velocity, yaw rate, heading)

    Frames:  velocity and yaw rate in B; heading of B in W, unwrapped.    Not modelled: any error.
    Source:  [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006,
             section 6.1: the ideal model closes the loop on the true state.
    """

    period: int = period("Time between samples.", default=ms(1))

    IMPERFECTIONS: ClassVar[tuple[str, ...]] = ()

    def init(self, key: Key) -> tuple[()]:
        """No state."""
        return ()

    def measure(self, motion: Motion) -> PlanarState:
        """The measurement h(x) of a motion."""
        return planar_state(motion)

    def step(self, t: Any, state: tuple[()], motion: Motion) -> tuple[tuple[()], Sample]:
        """The sample at integer time t."""
        return state, measured(t, self.measure(motion))


def planar_state(motion: Motion) -> PlanarState:
    """Velocity and heading in the plane, out of a motion in space; heading unwrapped."""
    return PlanarState(
        surge_velocity=motion.v_WB_B[0],
        sway_velocity=motion.v_WB_B[1],
        yaw_rate=motion.w_WB_B[2],
        heading=motion.attitude[2],
    )
