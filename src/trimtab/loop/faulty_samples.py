"""What a fault does to a row of samples: what a faulty sensor and a faulty channel share."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.signals import Sample, hold_sample
from trimtab.links.fifo import NEVER, empty_slots, read_slot, write_slot
from trimtab.loop.fault import DELAYED, GARBAGE, INTERMITTENT, OFF, SLOW, STUCK, WRONG, Fault


@record
class FaultySamples:
    """What is remembered of the samples so far. Frames: theirs. Source: docs page, Faults."""

    key: Any = part("Of the numbers that are drawn.")
    begun: Scalar = quantity("100 ns", "When the fault began.", kind="time")
    given: Sample = part("The last sample handed out.")
    lost: Scalar = quantity("100 ns", "When the newest sample that the fault took had been measured.", kind="time")
    number: Scalar = quantity("1", "How many samples have come.", kind="count")
    ring: Sample = part("The samples of the last steps; a leading axis of slots on every number.")


def initial_fault_memory(key: Any, like: Sample, capacity: int) -> FaultySamples:
    """Nothing seen yet, for samples of the structure of `like`."""
    none = jax.tree.map(lambda v: jnp.zeros(jnp.shape(v), jnp.result_type(v)), like)
    return FaultySamples(
        key=key,
        begun=np.int64(NEVER),
        given=none,
        lost=np.int64(NEVER),
        number=np.int32(0),
        ring=empty_slots(none, capacity),
    )


def apply_fault(
    t: Any, s: FaultySamples, fault: Fault, sample: Sample, seen: Any, *, step: int, checked: bool
) -> tuple[FaultySamples, Sample]:
    """One instant: the sample that comes out instead.

    Args:
        t: now, integer time.
        s: what is remembered.
        fault: which.
        sample: what the part gives.
        seen: what the fault may watch.
        step: time since this was last called (100 ns).
        checked: what is spoilt is told by a checksum and refused, as on a wire; and stuck repeats the whole sample.
    """
    sample = replace(sample, fresh=jnp.asarray(sample.fresh), valid=jnp.asarray(sample.valid))
    begun = fault.begin_time(t, s.begun, seen)
    word = fault.active_word(t, begun)
    came = sample.fresh & sample.valid
    number = (s.number + came).astype(np.int32)
    k = t // step
    capacity = s.ring.t.shape[0]
    ring = write_slot(s.ring, k % capacity, sample)
    repeats = (word == STUCK) & checked
    taken = (
        (word == OFF)
        | repeats
        | ((word == GARBAGE) & checked)
        | ((word == INTERMITTENT) & fault.is_off(s.key, t))
        | ((word == SLOW) & fault.is_skipped(number))
    )
    lost = jnp.where((taken | (word == DELAYED)) & sample.valid, sample.t, s.lost)
    absent = taken | (sample.valid & (sample.t == lost))
    late = read_slot(ring, (k - fault.delay_steps(step, capacity)) % capacity)
    comes = (word == DELAYED) & late.valid & (late.t > jnp.where(s.given.valid, s.given.t, NEVER))
    silent = hold_sample(t, s.given, fresh=repeats & came & s.given.valid)
    out = _tree_where_typed(absent, silent, replace(sample, value=_faulty_value(word, fault, s, sample, k, checked)))
    out = _tree_where_typed(comes, hold_sample(t, late, fresh=True), out)
    return FaultySamples(key=s.key, begun=begun, given=out, lost=lost, number=number, ring=ring), out


def _faulty_value(word: Any, fault: Fault, s: FaultySamples, sample: Sample, k: Any, checked: bool) -> Any:
    value = _tree_where_typed(word == WRONG, fault.distort_value(sample.value), sample.value)
    if checked:
        return value
    value = _tree_where_typed((word == STUCK) & s.given.valid, s.given.value, value)
    return _tree_where_typed(word == GARBAGE, fault.garbage_value(s.key, k, sample.value), value)


def _tree_where_typed(condition: Any, a: Any, b: Any) -> Any:
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y).astype(jnp.result_type(y)), a, b)
