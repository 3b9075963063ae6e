"""Transport delay: what goes in comes out later, by whole periods and fractions of one. A stage of an ActuatorBank.

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
    """What is under way. Frames: the field's. Source: this module."""

    ring: Any = quantity("1", "What went in at the last periods, a leading axis of slots.")
    slot: Scalar = quantity("1", "Where the next goes.", kind="count")


@record
class TransportDelay:
    """Delays its command, as a pipe or a serial bus does.

        delay = (n + f) period:    y[k] = (1 - f) u[k - n] + f u[k - n - 1]

    Which is the mean over a period of the held command so much later, so that no push is lost or gained; for a
    command that changes steadily it is exact.

    Frames:  its field's.    Source:  [1].
    """

    delay: Scalar = quantity("s", "From in to out.", default=0.01, low=0, off={"actuator-delay": 0.0})
    capacity: int = option("Periods that are kept.", default=64)

    def check_period(self, period: int) -> None:
        """Refuse a delay that is not kept."""
        needed = int(np.floor(float(self.delay) / to_seconds(period))) + 2
        if needed > self.capacity:
            problem = (
                f"{float(self.delay):g} s takes {needed} periods of {format_time(period)}; {self.capacity} are kept"
            )
            raise InputError("capacity", problem, fix=f"set capacity to {needed} or more")

    def init(self, rest: Any) -> TransportDelayState:
        """Nothing but the value at rest under way."""
        rest = jnp.asarray(rest, float)
        ring = jnp.broadcast_to(rest, (self.capacity, *rest.shape))
        return TransportDelayState(ring=ring, slot=np.int32(0))

    def step(self, state: TransportDelayState, value: Any, dt: Any) -> tuple[TransportDelayState, StageOutput]:
        """What comes out; dt: the period (s)."""
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
