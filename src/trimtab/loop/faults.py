"""Faults: what goes wrong with a part, from when on, for how long, how badly; and the wrapper that does it to a part.

One vocabulary for every part. What each word means for a sensor, a link and the actuators: docs page, Faults.
"""

import zlib
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.interfaces import optional_member
from trimtab.core.quantity import split_component
from trimtab.core.record import Scalar, option, part, period, quantity, record, replace, tree_where, with_leaf
from trimtab.core.rng import Key, normals, uniform2
from trimtab.core.signals import Sample, hold_sample, no_motion
from trimtab.core.time import FOREVER, ms, to_seconds
from trimtab.links.fifo import NEVER, empty_slots, read_slot, write_slot
from trimtab.loop.structure import cast_like

WORDS = ("none", "off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent")
NONE, OFF, STUCK, GARBAGE, WRONG, SLOW, DELAYED, INTERMITTENT = range(len(WORDS))
NAN_BEYOND = 1.5
"""Garbage is no number at all where the standard normal draw is larger than this: 13 % of the time."""
LINK_STREAM = zlib.crc32(b"fault of a channel")
"""All that goes over a link is hit at the same time: the draws don't depend on what is carried."""


@record
class Fault:
    """One fault of one part. All numbers can be set while a run goes on; the word too.

    It acts from `start` for `duration`; with a `watch`, from the first instant after `start` at which what it watches
    lies on the `side` of `level`. Until then, and after, the part is itself, bit for bit.

    Frames:  those of the part.
    Source:  docs page, Faults; the words are those of PX4's failure injection.
    """

    word: Scalar = quantity("1", "What goes wrong.", kind="mode", modes=WORDS, default=NONE, low=0, high=len(WORDS) - 1)
    start: Scalar = quantity("100 ns", "From when on.", kind="time", default=0)
    duration: Scalar = quantity("100 ns", "For how long.", kind="time", default=FOREVER, low=0)
    severity: Scalar = quantity("1", "How badly; what it means depends on the word.", default=1.0)
    bias: Scalar = quantity("1", "Wrong: added to every real number, in the unit of that number.", default=0.0)
    level: Scalar = quantity("1", "Threshold of what is watched, in its unit.", default=0.0)
    watch: str = option("Path of a number that the part sees; empty: time alone decides.", default="")
    side: str = option("On which side of the level it begins.", default="above", choices=("above", "below"))
    slot: int = period("Intermittent: how long it stays off, or on, at a time.", default=ms(100))
    field: str = option(
        "Of actuators: field or number of the input that it spoils, e.g. speed[1]; empty: all.", default=""
    )

    def check(self) -> None:
        """Refuse a severity that the word can't have."""
        word, severity = int(self.word), float(self.severity)
        rules = {
            GARBAGE: (severity > 0, "how many times the plausible size, above 0"),
            SLOW: (severity >= 1, "every how manieth comes, at least 1"),
            DELAYED: (severity >= 0, "seconds, not negative"),
            INTERMITTENT: (0 <= severity <= 1, "the share of the time that it is off, 0 to 1"),
        }
        good, meaning = rules.get(word, (True, ""))
        if not good:
            problem = f"{severity:g} is not possible for {WORDS[word]!r}, where it is {meaning}"
            raise InputError("severity", problem, fix="choose another, e.g. by 0.5, by 2")

    def begin_time(self, t: Any, begin: Any, signals: Any) -> Any:
        """When it began (100 ns), NEVER before; begin: the same so far; signals: what the part sees at time t."""
        if not self.watch:
            return jnp.where(t >= self.start, jnp.asarray(self.start, np.int64), NEVER)
        number = jnp.asarray(signal_value(signals, self.watch), np.float64)
        met = number > self.level if self.side == "above" else number < self.level
        waiting = begin == NEVER
        return jnp.where(t < self.start, NEVER, jnp.where(waiting & met, t, begin))

    def active_word(self, t: Any, begin: Any) -> Any:
        """The word that acts at integer time t."""
        acts = (begin != NEVER) & (t >= begin) & (t - begin < self.duration)
        return jnp.where(acts, self.word, NONE)

    def is_off(self, key: Key, t: Any) -> Any:
        """Intermittent: whether this slot of time is one of those without."""
        u, _ = uniform2(key, t // self.slot, 7)
        return u < self.severity

    def is_skipped(self, number: Any) -> Any:
        """Slow: whether the number-th of a row is left out."""
        n = jnp.maximum(jnp.round(self.severity), 1.0).astype(np.int32)
        return number % n != 0

    def delay_steps(self, step: int, capacity: int) -> Any:
        """Delayed: by how many steps of this length (100 ns), as far as a ring of this capacity reaches."""
        return jnp.clip(jnp.round(self.severity / to_seconds(step)), 0, capacity - 1).astype(np.int32)

    def check_ring(self, step: int, capacity: int) -> None:
        """Refuse a delay that is longer than what a ring of this capacity holds, one slot a step (100 ns)."""
        longest = to_seconds(step) * (capacity - 1)
        if int(self.word) == DELAYED and float(self.severity) > longest + 1e-9:
            needed = delay_slots(float(self.severity), step)
            problem = f"{float(self.severity):g} s is longer than the {longest:g} s that {capacity} slots hold"
            raise InputError("fault.severity", problem, fix=f"set capacity to {needed} or more")

    def distort_value(self, value: Any) -> Any:
        """The value with every real number scaled by 1 + severity, and biased."""

        def leaf(v: Any) -> Any:
            v = jnp.asarray(v)
            return v * (1 + self.severity) + self.bias if jnp.issubdtype(v.dtype, jnp.floating) else v

        return jax.tree.map(leaf, value)

    def garbage_value(self, key: Key, index: Any, value: Any) -> Any:
        """Random numbers, `severity` times as large as the value or as 1, or NaN; random flags and integers."""

        def garbage(v: Any, z: Any) -> Any:
            if v.dtype == np.bool_:
                return z > 0
            if jnp.issubdtype(v.dtype, jnp.floating):
                return jnp.where(abs(z) > NAN_BEYOND, jnp.nan, self.severity * jnp.maximum(abs(v), 1.0) * z)
            return jnp.round(abs(z) * 1000).astype(v.dtype)

        return _replace_by_draws(garbage, key, index, value)

    def random_input(self, key: Key, index: Any, u: Any) -> Any:
        """An input of the vehicle that changes at random, finite: `severity` is its standard deviation."""
        return _replace_by_draws(lambda v, z: (self.severity * z).astype(v.dtype), key, index, u)


def _replace_by_draws(function: Callable[[Any, Any], Any], key: Key, index: Any, tree: Any) -> Any:
    """function(number or array, as many standard normals) for each of a tree."""
    leaves, structure = jax.tree.flatten(tree)
    sizes = [int(np.prod(np.shape(v))) for v in leaves]
    draws, out, k = normals(key, index, sum(sizes)), [], 0
    for v, size in zip(leaves, sizes, strict=True):
        out.append(function(jnp.asarray(v), jnp.reshape(draws[k : k + size], np.shape(v))))
        k += size
    return jax.tree.unflatten(structure, out)


def delay_slots(delay: float, step: int) -> int:
    """How many slots of a ring, one a step (100 ns), hold what is `delay` (s) old."""
    return 1 + int(np.ceil(delay / to_seconds(step) - 1e-9))


def signal_value(tree: Any, path: str) -> Any:
    """The number at a dotted path of a tree of records and arrays, e.g. "p_WB.0"."""
    for name in path.split("."):
        if name.isdigit():
            tree = jnp.asarray(tree)[int(name)]
        else:
            tree = tree[name] if isinstance(tree, dict) else getattr(tree, name)
    return tree


def replace_number(tree: Any, path: str, other: Any) -> Any:
    """A tree of records in which what is at a path, e.g. "speed" or "speed[1]", is that of another tree like it."""
    name, index = split_component(path)

    def change(old: Any, _: Any) -> Any:
        new = signal_value(other, name)
        return new if index is None else jnp.asarray(old).at[index].set(jnp.asarray(new)[index])

    return with_leaf(tree, name, change)


@record
class FaultMemory:
    """What a fault remembers of its part's outputs. Frames: theirs. Source: docs page, Faults."""

    key: Any = part("Of the numbers that are drawn.")
    begin: Scalar = quantity("100 ns", "When the fault began.", kind="time")
    output: Any = part("The last output, with the fault.")
    lost: Scalar = quantity("100 ns", "When the newest sample that the fault took had been measured.", kind="time")
    number: Scalar = quantity("1", "How many outputs have come.", kind="count")
    ring: Any = part("The outputs of the last steps, without the fault; a leading axis of slots on every number.")


@record
class FaultyState:
    """State of a part, and what its fault remembers. Frames: theirs. Source: docs page, Faults."""

    inner: Any = part("State of the part.")
    memory: FaultMemory = part("What the fault remembers.")


def _initial_memory(key: Any, output: Any, ring: Any) -> FaultMemory:
    """Nothing has begun; output: the one before the first, ring: the outputs before it."""
    return FaultMemory(
        key=key, begin=np.int64(NEVER), output=output, lost=np.int64(NEVER), number=np.int32(0), ring=ring
    )


def apply_to_sample(
    t: Any, s: FaultMemory, fault: Fault, sample: Sample, signals: Any, *, step: int, has_checksum: bool
) -> tuple[FaultMemory, Sample]:
    """One instant: the sample that comes out instead.

    Args:
        t: now, integer time.
        s: what is remembered.
        fault: which.
        sample: what the part gives.
        signals: what the fault may watch.
        step: time since this was last called (100 ns).
        has_checksum: what a fault distorts is refused, as on a wire; and stuck repeats the whole sample.
    """
    sample = replace(sample, fresh=jnp.asarray(sample.fresh), valid=jnp.asarray(sample.valid))
    begin = fault.begin_time(t, s.begin, signals)
    word = fault.active_word(t, begin)
    came = sample.fresh & sample.valid
    number = (s.number + came).astype(np.int32)
    k = t // step
    capacity = s.ring.t.shape[0]
    ring = write_slot(s.ring, k % capacity, sample)
    repeats = (word == STUCK) & has_checksum
    taken = (
        (word == OFF)
        | repeats
        | ((word == GARBAGE) & has_checksum)
        | ((word == INTERMITTENT) & fault.is_off(s.key, t))
        | ((word == SLOW) & fault.is_skipped(number))
    )
    lost = jnp.where((taken | (word == DELAYED)) & sample.valid, sample.t, s.lost)
    absent = taken | (sample.valid & (sample.t == lost))
    late = read_slot(ring, (k - fault.delay_steps(step, capacity)) % capacity)
    comes = (word == DELAYED) & late.valid & (late.t > jnp.where(s.output.valid, s.output.t, NEVER))
    silent = hold_sample(t, s.output, fresh=repeats & came & s.output.valid)
    out = _select(absent, silent, replace(sample, value=_faulty_value(word, fault, s, sample, k, has_checksum)))
    out = _select(comes, hold_sample(t, late, fresh=True), out)
    return FaultMemory(key=s.key, begin=begin, output=out, lost=lost, number=number, ring=ring), out


def _faulty_value(word: Any, fault: Fault, s: FaultMemory, sample: Sample, k: Any, has_checksum: bool) -> Any:
    value = _select(word == WRONG, fault.distort_value(sample.value), sample.value)
    if has_checksum:
        return value
    value = _select((word == STUCK) & s.output.valid, s.output.value, value)
    return _select(word == GARBAGE, fault.garbage_value(s.key, k, sample.value), value)


def _select(condition: Any, a: Any, b: Any) -> Any:
    """a where the condition holds, else b, in the types of b."""
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y).astype(jnp.result_type(y)), a, b)


def apply_to_output(
    t: Any, s: FaultMemory, fault: Fault, output: Any, neutral: Any, signals: Any, *, step: int
) -> tuple[FaultMemory, Any]:
    """One step of actuators: the output that comes out instead; arguments as of apply_to_sample."""
    k, capacity = t // step, jax.tree.leaves(s.ring)[0].shape[0]
    output = cast_like(output, s.output)
    begin = fault.begin_time(t, s.begin, signals)
    word = fault.active_word(t, begin)
    ring = write_slot(s.ring, k % capacity, output)
    late = read_slot(ring, (k - fault.delay_steps(step, capacity)) % capacity)
    dead = (word == OFF) | ((word == INTERMITTENT) & fault.is_off(s.key, t))
    holds = (word == STUCK) | ((word == SLOW) & fault.is_skipped(s.number))
    u = tree_where(word == WRONG, fault.distort_value(output.u), output.u)
    out = replace(output, u=tree_where(word == GARBAGE, fault.random_input(s.key, k, output.u), u))
    out = tree_where(word == DELAYED, late, out)
    out = tree_where(holds, s.output, out)
    out = tree_where(dead, cast_like(neutral, output), out)
    if fault.field:
        whole = cast_like(output, out)
        out = replace(whole, u=replace_number(whole.u, fault.field, out.u))
    number = (s.number + 1) % 2**30
    return FaultMemory(key=s.key, begin=begin, output=out, lost=s.lost, number=number, ring=ring), out


class FaultyPart:
    """A part in which a fault acts; before and after it is the part itself, bit for bit.

    Its path gets `.inner`. What it is: one of the three below.
    """

    inner: Any
    fault: Fault
    capacity: int

    @property
    def period(self) -> int:
        """The part's."""
        return self.inner.period

    def check(self) -> None:
        """Refuse a delay that can't be held."""
        self.fault.check_ring(self.period, self.capacity)

    def initial_state(self, inner: Any, input: Any, key: Key) -> FaultyState:
        """Nothing seen yet of a part that gives samples. inner: its own state; input: of the structure it reads."""
        try:
            sample = jax.eval_shape(lambda s, x: self.inner.step(np.int64(0), s, x)[1], inner, input)
        except AttributeError as error:
            problem = (
                f"it feels more than a {type(input).__name__} ({error}): no fault, and no real line, can carry that"
            )
            fix = "fly it in virtual time, without a fault in it:  trimtab run SCENARIO"
            raise InputError(f"fault in {type(self.inner).__name__}", problem, fix=fix) from error
        none = jax.tree.map(lambda v: jnp.zeros(jnp.shape(v), jnp.result_type(v)), sample)
        return FaultyState(inner=inner, memory=_initial_memory(key, none, empty_slots(none, self.capacity)))


@record
class FaultySensor(FaultyPart):
    """A sensor whose samples are spoilt while a fault acts.

    The fault may watch what the sensor feels, e.g. `p_WB.0` or `v_WB_B.1` of a motion.

    Frames:  the sensor's.    Source:  docs page, Faults.
    """

    inner: Any = part("The sensor.")
    fault: Fault = part("What goes wrong.", default=Fault())
    felt: Any = part("What it feels, of any numbers, where that is not a motion.", default=None)
    capacity: int = option("How many samples a delay may lie back, and one.", default=2)

    @property
    def FEELS(self) -> str:
        """The sensor's."""
        return optional_member(self.inner, "FEELS")

    def init(self, key: Key) -> FaultyState:
        """Nothing measured."""
        felt = no_motion() if self.felt is None else self.felt
        return self.initial_state(self.inner.init(key), felt, key.at("fault"))

    def measure(self, motion: Any) -> Any:
        """The sensor's, without noise or fault."""
        return self.inner.measure(motion)

    def step(self, t: Any, state: FaultyState, motion: Any) -> tuple[FaultyState, Sample]:
        """One sample at integer time t."""
        inner, sample = self.inner.step(t, state.inner, motion)
        memory, out = apply_to_sample(t, state.memory, self.fault, sample, motion, step=self.period, has_checksum=False)
        return FaultyState(inner=inner, memory=memory), out


@record
class FaultyChannel(FaultyPart):
    """A channel at whose receiving end a fault acts.

    What a wire spoils is refused by its checksum, so garbage is silence here. The fault may watch what is carried, e.g.
    `value.surge_velocity` or `age`.

    Frames:  those of the values carried.    Source:  docs page, Faults.
    """

    inner: Any = part("The channel.")
    fault: Fault = part("What goes wrong.", default=Fault())
    capacity: int = option("How many steps a delay may lie back, and one.", default=2)

    def init(self, key: Key, like: Sample) -> FaultyState:
        """Nothing received."""
        return self.initial_state(self.inner.init(key, like), like, Key(key.seed, key.run, LINK_STREAM))

    def step(self, t: Any, state: FaultyState, sample: Sample) -> tuple[FaultyState, Sample]:
        """What the receiving end holds at integer time t."""
        inner, arrived = self.inner.step(t, state.inner, sample)
        memory, out = apply_to_sample(
            t, state.memory, self.fault, arrived, arrived, step=self.period, has_checksum=True
        )
        return FaultyState(inner=inner, memory=memory), out


@record
class FaultyActuators(FaultyPart):
    """Actuators whose output is spoilt while a fault acts: all that acts on the vehicle, or one field or number of it.

    The fault may watch the command, e.g. `value.speed_rpm`.

    Frames:  the actuators'.    Source:  docs page, Faults.
    """

    inner: Any = part("The actuators.")
    fault: Fault = part("What goes wrong.", default=Fault())
    capacity: int = option("How many steps a delay may lie back, and one.", default=2)

    def neutral(self) -> Any:
        """The actuators'."""
        return self.inner.neutral()

    def init(self, key: Key) -> FaultyState:
        """At rest."""
        neutral = jax.tree.map(jnp.asarray, self.inner.neutral())
        slots = empty_slots(neutral, self.capacity)
        rest = jax.tree.map(lambda slot, v: jnp.broadcast_to(v, slot.shape), slots, neutral)
        return FaultyState(inner=self.inner.init(key), memory=_initial_memory(key.at("fault"), neutral, rest))

    def step(self, t: Any, state: FaultyState, command: Sample) -> tuple[FaultyState, Any]:
        """What the actuators do from integer time t on."""
        inner, output = self.inner.step(t, state.inner, command)
        neutral = self.inner.neutral()
        memory, out = apply_to_output(t, state.memory, self.fault, output, neutral, command, step=self.period)
        return FaultyState(inner=inner, memory=memory), out
