"""Transport delay of an actuator: the output is the input, delayed by whole periods and a fraction of a period.

A transport delay is a stage of an ActuatorBank.

Source: [1] Åström, Wittenmark, "Computer-controlled systems", 3rd ed., section 2.3: systems with time delay.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.errors import InputError
from trimtab.core.interfaces import StageOutput
from trimtab.core.record import Scalar, option, quantity, record
from trimtab.core.time import format_time, to_seconds


@record
class TransportDelayState:
    """State of a transport delay: the values in transit. Frames: those of the actuated value. Source: this module."""

    ring: Any = quantity("1", "Input values of the last periods. The leading axis is the slot of the ring buffer.")
    slot: Scalar = quantity("1", "Slot of the ring buffer to which the next value is written.", kind="count")


@record
class TransportDelay:
    """Delay of a command, as in a pipe or on a serial bus.

        delay = (n + f) period:    y[k] = (1 - f) u[k - n] + f u[k - n - 1]

    u is the input, y the output, n the number of complete periods and f the remaining fraction. The output of a period
    is the mean of the delayed command over that period, so the integral of the command is conserved. The output is
    exact for a command that changes at a constant rate.

    Frames:  those of the actuated value.    Source:  [1].
    """

    delay: Scalar = quantity("s", "Delay from input to output.", default=0.01, low=0, off={"actuator-delay": 0.0})
    capacity: int = option("Number of slots of the ring buffer, one per period.", default=64)

    def check_period(self, period: int) -> None:
        """Raise InputError if the ring buffer has too few slots for the delay."""
        needed = int(np.floor(float(self.delay) / to_seconds(period))) + 2
        if needed > self.capacity:
            problem = (
                f"a delay of {float(self.delay):g} s needs {needed} periods of {format_time(period)}, but "
                f"capacity is {self.capacity}"
            )
            raise InputError("capacity", problem, fix=f"set capacity to {needed} or more")

    def init(self, rest: Any) -> TransportDelayState:
        """Return the initial state, with the rest value in all slots."""
        rest = jnp.asarray(rest, float)
        ring = jnp.broadcast_to(rest, (self.capacity, *rest.shape))
        return TransportDelayState(ring=ring, slot=np.int32(0))

    def step(self, state: TransportDelayState, value: Any, dt: Any) -> tuple[TransportDelayState, StageOutput]:
        """Return the new state and the delayed value. dt: the period (s)."""
        n = self.capacity
        ring = lax.dynamic_update_index_in_dim(state.ring, jnp.asarray(value, float), state.slot, 0)
        late = jnp.clip(self.delay / dt, 0.0, n - 2.0)
        whole = jnp.floor(late + 1e-9)
        part = jnp.maximum(late - whole, 0.0)
        back = state.slot - whole.astype(np.int32)
        newer = lax.dynamic_index_in_dim(ring, back % n, keepdims=False)
        older = lax.dynamic_index_in_dim(ring, (back - 1) % n, keepdims=False)
        y = newer + part * (older - newer)
        state = TransportDelayState(ring=ring, slot=((state.slot + 1) % n).astype(np.int32))
        return state, StageOutput(value=y, limited=np.bool_(False))
