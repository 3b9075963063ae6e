"""Servo frame: a servo receives one command pulse per frame, and holds the command until the next pulse.

A servo frame is a stage of an ActuatorBank.

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
"""Name of the imperfection that switches the servo frame off."""


@record
class ServoFrameState:
    """State of a servo frame: the command of the last pulse.

    Frames: those of the actuated value. Source: this module.
    """

    held: Any = quantity("1", "Command of the last pulse, held until the next pulse.")
    t: Scalar = quantity("100 ns", "Time since the start of the present servo frame.", kind="time", default=np.int64(0))


@record
class ServoFrame:
    """Sample and hold of the command, once per frame: 20 ms for an analogue servo, 2.5 ms for a digital one.

        y(t) = u(phase + k frame)    for phase + k frame <= t < phase + (k + 1) frame

    u is the command and y the output. The mean delay is half a frame. Before the first pulse the servo is at rest.

    Frames:  those of the actuated value.    Not modelled: the duration of the pulse itself; drift of the frame.
    Source:  [1]; frames of radio control servos.
    """

    frame: int = period(
        "Time between two pulses; 0 switches the sample and hold off.", default=ms(20), low=0, off={SERVO_FRAME: 0}
    )
    phase: int = period("Time from the start of a frame to its pulse.", default=0, low=0)

    def check_period(self, period: int) -> None:
        """Raise InputError unless frame and phase are multiples of the actuators' period."""
        for name, own in (("frame", self.frame), ("phase", self.phase)):
            if int(own) % int(period):
                problem = (
                    f"the time of {format_time(int(own))} must be a multiple of the actuators' period of "
                    f"{format_time(int(period))}"
                )
                raise InputError(name, problem, fix="choose a multiple of the actuators' period")
        if self.frame and int(self.phase) >= int(self.frame):
            problem = (
                f"the phase of {format_time(int(self.phase))} must be shorter than the frame of "
                f"{format_time(int(self.frame))}"
            )
            raise InputError("phase", problem, fix="choose a phase within the frame")

    def init(self, rest: Any) -> ServoFrameState:
        """Return the initial state: at rest, at the start of a frame."""
        return ServoFrameState(held=jnp.asarray(rest, float))

    def step(self, state: ServoFrameState, value: Any, dt: Any) -> tuple[ServoFrameState, StageOutput]:
        """Return the new state and the held command. dt: the actuators' period (s)."""
        frame = jnp.asarray(self.frame, np.int64)
        due = (frame == 0) | (state.t == self.phase)
        held = jnp.where(due, value, state.held)
        later = state.t + jnp.rint(dt / SECONDS_PER_UNIT).astype(np.int64)
        new = ServoFrameState(held=held, t=jnp.where(later >= frame, 0, later))
        return new, StageOutput(value=held, limited=np.bool_(False))
