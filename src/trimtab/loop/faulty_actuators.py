"""Actuators with a fault."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, option, part, quantity, record, replace
from trimtab.core.rng import Key, normals
from trimtab.core.signals import Sample
from trimtab.links.fifo import NEVER, empty_slots, read_slot, write_slot
from trimtab.loop.fault import DELAYED, GARBAGE, INTERMITTENT, OFF, SLOW, STUCK, WRONG, Fault


@record
class FaultyActuatorsState:
    """State of the actuators, and what their fault remembers. Frames: theirs. Source: docs page, Faults."""

    inner: Any = part("State of the actuators.")
    key: Any = part("Of the numbers that are drawn.")
    begun: Scalar = quantity("100 ns", "When the fault began.", kind="time")
    given: Any = part("The last output.")
    number: Scalar = quantity("1", "How many steps there have been.", kind="count")
    ring: Any = part("The outputs of the last steps; a leading axis of slots on every number.")


@record
class FaultyActuators:
    """Actuators whose output is spoilt while a fault acts; before and after they are themselves, bit for bit.

    The fault may watch the command, e.g. `value.speed_rpm`.

    Frames:  the actuators'.    Source:  docs page, Faults.
    """

    inner: Any = part("The actuators.")
    fault: Fault = part("What goes wrong.", default=Fault())
    capacity: int = option("How many steps a delay may lie back, and one.", default=2)

    @property
    def period(self) -> int:
        """The actuators'."""
        return self.inner.period

    def check(self) -> None:
        """Refuse a delay that can't be held."""
        self.fault.check_ring(self.period, self.capacity)

    def neutral(self) -> Any:
        """The actuators'."""
        return self.inner.neutral()

    def init(self, key: Key) -> FaultyActuatorsState:
        """At rest."""
        neutral = jax.tree.map(jnp.asarray, self.inner.neutral())
        rest = empty_slots(neutral, self.capacity)
        return FaultyActuatorsState(
            inner=self.inner.init(key),
            key=key.at("fault"),
            begun=np.int64(NEVER),
            given=neutral,
            number=np.int32(0),
            ring=jax.tree.map(lambda r, v: jnp.broadcast_to(v, r.shape), rest, neutral),
        )

    def step(self, t: Any, state: FaultyActuatorsState, command: Sample) -> tuple[FaultyActuatorsState, Any]:
        """What the actuators do from integer time t on."""
        fault, k = self.fault, t // self.period
        inner, output = self.inner.step(t, state.inner, command)
        output = jax.tree.map(lambda v, n: jnp.asarray(v, jnp.result_type(n)), output, state.given)
        begun = fault.begin_time(t, state.begun, command)
        word = fault.active_word(t, begun)
        ring = write_slot(state.ring, k % self.capacity, output)
        late = read_slot(ring, (k - fault.delay_steps(self.period, self.capacity)) % self.capacity)
        dead = (word == OFF) | ((word == INTERMITTENT) & fault.is_off(state.key, t))
        holds = (word == STUCK) | ((word == SLOW) & fault.is_skipped(state.number))
        u = _tree_where(word == WRONG, fault.distort_value(output.u), output.u)
        out = replace(output, u=_tree_where(word == GARBAGE, self._random_input(state.key, k, output.u), u))
        out = _tree_where(word == DELAYED, late, out)
        out = _tree_where(holds, state.given, out)
        out = _tree_where(dead, jax.tree.map(lambda v, o: jnp.asarray(v, o.dtype), self.inner.neutral(), output), out)
        new = FaultyActuatorsState(
            inner=inner, key=state.key, begun=begun, given=out, number=(state.number + 1) % 2**30, ring=ring
        )
        return new, out

    def _random_input(self, key: Key, index: Any, u: Any) -> Any:
        """An input of the vehicle that changes at random, finite: `severity` is its standard deviation."""
        flat, tree = jax.tree.flatten(u)
        draws, made, k = normals(key, index, sum(int(np.size(v)) for v in flat)), [], 0
        for v in flat:
            size = int(np.size(v))
            made.append(jnp.reshape(self.fault.severity * draws[k : k + size], np.shape(v)).astype(v.dtype))
            k += size
        return jax.tree.unflatten(tree, made)


def _tree_where(condition: Any, a: Any, b: Any) -> Any:
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y), a, b)
