"""Speed regulator of the thrust fan, a block of the firmware. It converts encoder counts to the duty of the motor.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, period, quantity, record
from trimtab.core.time import ms, to_seconds


@record
class SpeedRegulatorInput:
    """Input of the speed regulator in one period. Frames: positive pushes the vehicle forward. Source: docs page, Speed
    regulator."""

    rpm_command: Scalar = quantity("rpm", "Commanded speed of the fan, negative in reverse.")
    count: Scalar = quantity("1", "Counter of the encoder; only the low 16 bits are used.", kind="count")


@record
class SpeedRegulatorState:
    """State of the speed regulator. Frames: as for its input. Source: docs page, Speed regulator."""

    count: Scalar = quantity("1", "Encoder counter at the previous tick.", kind="count", default=np.int32(0))
    integral: Scalar = quantity("1", "Integral term of the duty.", default=np.float64(0.0))
    still: Scalar = quantity(
        "1",
        "Number of consecutive ticks on which the fan was driven but did not turn in the driven direction.",
        kind="count",
        default=np.int32(0),
    )
    fault: Scalar = quantity(
        "1",
        "True if the encoder is faulty. The duty is then 0 until speed 0 is requested.",
        kind="flag",
        default=np.bool_(False),
    )
    started: Scalar = quantity(
        "1", "True once the counter has been read for the first time.", kind="flag", default=np.bool_(False)
    )


@record
class SpeedRegulatorOutput:
    """Output of the speed regulator. Frames: as for its input. Source: docs page, Speed regulator."""

    duty: Scalar = quantity("1", "Duty of the motor, -1 to 1, negative in reverse.")
    speed_rpm: Scalar = quantity("rpm", "Fan speed measured over the last period of the regulator.")
    saturated: Scalar = quantity("1", "True if the duty is at its limit.", kind="flag")
    fault: Scalar = quantity("1", "True if the encoder is faulty.", kind="flag")


@record
class SpeedRegulator:
    """PI regulator of the fan's speed. The integral is held while the duty is at its limit.

        n = rpm_per_count (count − count before)      e = wanted − n
        duty = clip(kp e + I) between 0 and the limit with the sign of the wanted speed;   I ← I + ki e dt

    At a wanted speed of 0 the fan coasts: the duty and the integral are 0. A change of direction also resets the
    integral. If the fan is driven but the counter does not count in the driven direction for the time `stall`, the
    duty is 0 until a stop is requested, because a broken encoder must not lead to full thrust.

    Frames:  positive pushes the vehicle forward.
    Valid:   |speed| below 32 768 counts per tick.    Not modelled: the speed controller's brake.
    Source:  [1] chapter 4 (PI in the firmware, encoder of 100 cycles a turn). Gains, tick and fault are
             our own choice.
    """

    kp: Scalar = quantity("1/krpm", "Proportional gain: duty per speed error.", default=0.08, low=0)
    ki: Scalar = quantity("1/(krpm s)", "Integral gain: rate of the duty per speed error.", default=0.6, low=0)
    rpm_per_count: Scalar = quantity(
        "rpm",
        "Fan speed at which the encoder counts once per tick, for 400 counts per turn.",
        default=15.0,
        above=0,
    )
    limit: Scalar = quantity("1", "Maximum magnitude of the duty.", default=1.0, above=0, high=1)
    stall: Scalar = quantity(
        "s",
        "Time for which the fan may be driven without turning. After this time the encoder counts as broken.",
        default=0.5,
        above=0,
    )
    stall_duty: Scalar = quantity("1", "Duty above which the fan counts as driven.", default=0.1, above=0)
    period: int = period("Period of the speed regulator.", default=ms(10))

    def init(self) -> SpeedRegulatorState:
        """Return the initial state, at rest."""
        return SpeedRegulatorState()

    def step(
        self, t: Any, state: SpeedRegulatorState, input: SpeedRegulatorInput
    ) -> tuple[SpeedRegulatorState, SpeedRegulatorOutput]:
        """Return the new state, and the duty that acts from integer time t on. Must be called once per period."""
        dt = to_seconds(self.period)
        counts = (input.count - state.count + 32768) % 65536 - 32768
        speed = jnp.where(state.started, counts * self.rpm_per_count, 0.0)
        wanted = jnp.where(jnp.isfinite(input.rpm_command), input.rpm_command, 0.0)
        sign = jnp.sign(wanted)
        error = (wanted - speed) * 1e-3
        integral = jnp.where(state.integral * sign > 0, state.integral, 0.0)
        wish = self.kp * error + integral
        low, high = jnp.minimum(sign, 0.0) * self.limit, jnp.maximum(sign, 0.0) * self.limit
        winds = ((wish > high) & (error > 0)) | ((wish < low) & (error < 0))
        stands = (wish * sign > self.stall_duty) & (speed * sign <= 0)
        still = jnp.where(stands, state.still + 1, 0)
        fault = (state.fault | (still * dt >= self.stall)) & (sign != 0)
        duty = jnp.where(fault, 0.0, jnp.clip(wish, low, high))
        new = SpeedRegulatorState(
            count=jnp.asarray(input.count, np.int32),
            integral=jnp.where(winds | fault, integral, integral + self.ki * error * dt),
            still=jnp.where(fault, 0, still).astype(np.int32),
            fault=fault,
            started=jnp.asarray(True),
        )
        saturated = ((wish > high) | (wish < low)) & (sign != 0) & ~fault
        return new, SpeedRegulatorOutput(duty=duty, speed_rpm=speed, saturated=saturated, fault=fault)
