"""Servo frame: a servo told by pulses hears of its command once a frame, and holds it. A stage of an ActuatorBank.

Source: [1] Åström, Wittenmark, "Computer-controlled systems", 3rd ed., section 2.3: sample and hold of order zero.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.interfaces import StageOutput
from trimtab.core.record import Scalar, period, quantity, record
from trimtab.core.time import SECONDS_PER_UNIT, format_time, ms

SERVO_FRAME = "servo-frame"
"""The imperfection's name."""


@record
class ServoFrameState:
    """What the last pulse said. Frames: the field's. Source: this module."""

    held: Any = quantity("1", "The command at the last pulse.")
    t: Scalar = quantity("100 ns", "Time since the frame began.", kind="time", default=np.int64(0))


@record
class ServoFrame:
    """Samples its command once a frame and holds it: 20 ms of an analogue servo, 2.5 ms of a digital one.

        y(t) = u(phase + k frame)    from there up to phase + (k + 1) frame

    Which is half a frame late in the mean. Before the first pulse the servo stands at rest.

    Frames:  its field's.    Not modelled: the time that the pulse itself takes; a frame that drifts.
    Source:  [1]; the frames of radio control.
    """

    frame: int = period("Between two pulses; 0 switches it off.", default=ms(20), low=0, off={SERVO_FRAME: 0})
    phase: int = period("When in the frame its pulse is.", default=0, low=0)

    def check_period(self, period: int) -> None:
        """Refuse frames and phases that fall between the times at which the actuators act."""
        for name, own in (("frame", self.frame), ("phase", self.phase)):
            if int(own) % int(period):
                problem = (
                    f"{format_time(int(own))} is no multiple of the actuators' period of {format_time(int(period))}"
                )
                raise InputError(name, problem, fix="make it one, or frames are missed")
        if self.frame and int(self.phase) >= int(self.frame):
            problem = f"{format_time(int(self.phase))} is not within the frame of {format_time(int(self.frame))}"
            raise InputError("phase", problem, fix="make it shorter than the frame")

    def init(self, rest: Any) -> ServoFrameState:
        """At rest, a frame begins."""
        return ServoFrameState(held=jnp.asarray(rest, float))

    def step(self, state: ServoFrameState, value: Any, dt: Any) -> tuple[ServoFrameState, StageOutput]:
        """What the servo holds; dt: the period (s)."""
        frame = jnp.asarray(self.frame, np.int64)
        due = (frame == 0) | (state.t == self.phase)
        held = jnp.where(due, value, state.held)
        later = state.t + jnp.rint(dt / SECONDS_PER_UNIT).astype(np.int64)
        new = ServoFrameState(held=held, t=jnp.where(later >= frame, 0, later))
        return new, StageOutput(value=held, limited=np.bool_(False))
