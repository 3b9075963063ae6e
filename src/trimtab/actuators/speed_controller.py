"""Speed controller of a brushed motor: it brakes before it turns the fan from reverse to forward.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, period, quantity, record
from trimtab.core.time import ms

MODES = ("forward", "reverse", "braking")
FORWARD, REVERSE, BRAKING = range(3)


@record
class SpeedControllerState:
    """Direction of the last non-zero speed, and the brake. Frames: none. Source: [1] section 6.1."""

    mode: Scalar = quantity("1", "What the controller does.", kind="mode", modes=MODES, default=np.int32(FORWARD))
    brake_until: Scalar = quantity("100 ns", "When the last brake ends or ended.", kind="time", default=np.int64(0))
    brakings: Scalar = quantity("1", "Brakes so far.", kind="count", default=np.int32(0))


@record
class SpeedController:
    """Passes the commanded speed on, except for a brake of fixed length when it turns from negative to positive.

        forward  --negative-->  reverse        at once
        reverse  --positive-->  braking        output 0 until t + brake
        braking  --negative-->  reverse        at once: the brake is cancelled
        braking  --brake over-> forward

    A zero command changes nothing: the controller remembers which way the fan turned last, so that a pause at zero
    between reverse and forward does not save the brake (reconstructed; the source says nothing about pauses).

    Frames:  positive speed pushes the vehicle forward.
    Source:  [1] chapter 4 and section 6.1: 150 ms, wired so that the delay falls on reverse to forward.
    """

    brake: int = period("Length of the brake; 0 switches it off.", default=ms(150), low=0)

    def init(self) -> SpeedControllerState:
        """At rest, forward."""
        return SpeedControllerState()

    def step(self, t: Any, state: SpeedControllerState, speed_rpm: Any) -> tuple[SpeedControllerState, Any]:
        """New state and speed passed on (rpm) at integer time t; may be called at any times that don't fall."""
        negative, positive = speed_rpm < 0, speed_rpm > 0
        was_reverse = state.mode == REVERSE
        turns = was_reverse & positive
        until = jnp.where(turns, t + self.brake, state.brake_until)
        braking = (turns | (state.mode == BRAKING)) & ~negative & (t < until)
        reverse = negative | (was_reverse & ~positive)
        mode = jnp.where(braking, BRAKING, jnp.where(reverse, REVERSE, FORWARD)).astype(np.int32)
        brakings = state.brakings + (turns & braking)
        new = SpeedControllerState(mode=mode, brake_until=until, brakings=brakings)
        return new, jnp.where(braking, 0.0, speed_rpm)
