"""Faults of sensors, links and actuators: kind, start, duration and severity, and the records that apply a fault.

The kinds of faults are the same for all of them. The docs page Faults describes the effect of each kind.
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

KINDS = ("none", "off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent")
NONE, OFF, STUCK, GARBAGE, WRONG, SLOW, DELAYED, INTERMITTENT = range(len(KINDS))
NAN_BEYOND = 1.5
"""Magnitude of a standard normal draw above which a garbage value is NaN. This happens in 13 % of the draws."""
LINK_STREAM = zlib.crc32(b"fault of a channel")
"""Number of the random stream of a link's faults. All values of a message use it, so a fault affects all of them."""


@record
class Fault:
    """Fault of one part. Its kind and parameters can be changed during a run.

    The fault acts from `start` for `duration`. If `watch` names a signal, the fault begins at the first instant after
    `start` at which the value of this signal is above (or below, see `side`) `level`. Before and after the fault, the
    part behaves as without a fault, bit for bit.

    Frames:  those of the faulty part.
    Source:  docs page, Faults; the kinds are those of PX4's failure injection.
    """

    kind: Scalar = quantity("1", "Kind of fault.", kind="mode", modes=KINDS, default=NONE, low=0, high=len(KINDS) - 1)
    start: Scalar = quantity("100 ns", "Start of the fault.", kind="time", default=0)
    duration: Scalar = quantity("100 ns", "Duration of the fault.", kind="time", default=FOREVER, low=0)
    severity: Scalar = quantity("1", "Severity of the fault. Its meaning depends on the kind of fault.", default=1.0)
    bias: Scalar = quantity(
        "1", "Bias that a fault of kind `wrong` adds to every real number, in the number's unit.", default=0.0
    )
    level: Scalar = quantity("1", "Value of the watched signal at which the fault begins, in its unit.", default=0.0)
    watch: str = option("Path of the signal that triggers the fault. Empty: the fault begins at `start`.", default="")
    side: str = option(
        "Side of `level` on which the signal triggers the fault.", default="above", choices=("above", "below")
    )
    slot: int = period("Length of each on or off interval of a fault of kind `intermittent`.", default=ms(100))
    field: str = option("Affected field or element of the actuators' output, e.g. speed[1]. Empty: all.", default="")

    def check(self) -> None:
        """Raise InputError for a severity that is invalid for the kind of fault."""
        kind, severity = int(self.kind), float(self.severity)
        rules = {
            GARBAGE: (severity > 0, "a multiple of the plausible size, above 0"),
            SLOW: (severity >= 1, "a number N of at least 1: only every Nth sample arrives"),
            DELAYED: (severity >= 0, "a delay in seconds, not negative"),
            INTERMITTENT: (0 <= severity <= 1, "the fraction of time in which the part is off, 0 to 1"),
        }
        good, meaning = rules.get(kind, (True, ""))
        if not good:
            problem = f"{severity:g} is not valid: for {KINDS[kind]!r}, the severity is {meaning}"
            raise InputError("severity", problem, fix="choose another severity, e.g. by 0.5, by 2")

    def begin_time(self, t: Any, begin: Any, signals: Any) -> Any:
        """Return the time at which the fault began (100 ns), or NEVER. begin: result of the previous call."""
        if not self.watch:
            return jnp.where(t >= self.start, jnp.asarray(self.start, np.int64), NEVER)
        number = jnp.asarray(signal_value(signals, self.watch), np.float64)
        met = number > self.level if self.side == "above" else number < self.level
        waiting = begin == NEVER
        return jnp.where(t < self.start, NEVER, jnp.where(waiting & met, t, begin))

    def active_kind(self, t: Any, begin: Any) -> Any:
        """Return the kind of fault that acts at integer time t, as an index in KINDS. begin: result of begin_time()."""
        acts = (begin != NEVER) & (t >= begin) & (t - begin < self.duration)
        return jnp.where(acts, self.kind, NONE)

    def is_off(self, key: Key, t: Any) -> Any:
        """Return True if an intermittent fault switches the part off in the on-off interval that contains time t."""
        u, _ = uniform2(key, t // self.slot, 7)
        return u < self.severity

    def is_skipped(self, number: Any) -> Any:
        """Return True if a fault of kind `slow` drops output number `number` of the part."""
        n = jnp.maximum(jnp.round(self.severity), 1.0).astype(np.int32)
        return number % n != 0

    def delay_steps(self, step: int, capacity: int) -> Any:
        """Return the delay as a number of time steps `step` (100 ns), limited to the ring buffer's capacity."""
        return jnp.clip(jnp.round(self.severity / to_seconds(step)), 0, capacity - 1).astype(np.int32)

    def check_ring(self, step: int, capacity: int) -> None:
        """Raise InputError for a delay too long for a ring buffer with `capacity` slots, one per `step` (100 ns)."""
        longest = to_seconds(step) * (capacity - 1)
        if int(self.kind) == DELAYED and float(self.severity) > longest + 1e-9:
            needed = delay_slots(float(self.severity), step)
            problem = f"the delay must be at most {longest:g} s for capacity {capacity}, got {float(self.severity):g} s"
            raise InputError("fault.severity", problem, fix=f"set capacity to {needed} or more")

    def distort_value(self, value: Any) -> Any:
        """Return a record or number in which every real number x is replaced by (1 + severity) x + bias."""

        def leaf(v: Any) -> Any:
            v = jnp.asarray(v)
            return v * (1 + self.severity) + self.bias if jnp.issubdtype(v.dtype, jnp.floating) else v

        return jax.tree.map(leaf, value)

    def garbage_value(self, key: Key, index: Any, value: Any) -> Any:
        """Return NaN or random numbers, with standard deviation severity max(1, |value|), instead of each value."""

        def garbage(v: Any, z: Any) -> Any:
            if v.dtype == np.bool_:
                return z > 0
            if jnp.issubdtype(v.dtype, jnp.floating):
                return jnp.where(abs(z) > NAN_BEYOND, jnp.nan, self.severity * jnp.maximum(abs(v), 1.0) * z)
            return jnp.round(abs(z) * 1000).astype(v.dtype)

        return _replace_by_draws(garbage, key, index, value)

    def random_input(self, key: Key, index: Any, u: Any) -> Any:
        """Return a random input of the vehicle, normally distributed with standard deviation `severity`."""
        return _replace_by_draws(lambda v, z: (self.severity * z).astype(v.dtype), key, index, u)


def _replace_by_draws(function: Callable[[Any, Any], Any], key: Key, index: Any, tree: Any) -> Any:
    """Return the tree with each leaf replaced by function(leaf, standard normal draws of the leaf's shape)."""
    leaves, structure = jax.tree.flatten(tree)
    sizes = [int(np.prod(np.shape(v))) for v in leaves]
    draws, out, k = normals(key, index, sum(sizes)), [], 0
    for v, size in zip(leaves, sizes, strict=True):
        out.append(function(jnp.asarray(v), jnp.reshape(draws[k : k + size], np.shape(v))))
        k += size
    return jax.tree.unflatten(structure, out)


def delay_slots(delay: float, step: int) -> int:
    """Return the number of slots that a ring buffer needs for a delay (s). step: time from slot to slot (100 ns)."""
    return 1 + int(np.ceil(delay / to_seconds(step) - 1e-9))


def signal_value(tree: Any, path: str) -> Any:
    """Return the number at a path in a tree of records and arrays, e.g. "p_WB.0" for the first element of p_WB."""
    for name in path.split("."):
        if name.isdigit():
            tree = jnp.asarray(tree)[int(name)]
        else:
            tree = tree[name] if isinstance(tree, dict) else getattr(tree, name)
    return tree


def replace_number(tree: Any, path: str, other: Any) -> Any:
    """Return a tree of records with the value at one path, e.g. "speed[1]", replaced by that of another tree."""
    name, index = split_component(path)

    def change(old: Any, _: Any) -> Any:
        new = signal_value(other, name)
        return new if index is None else jnp.asarray(old).at[index].set(jnp.asarray(new)[index])

    return with_leaf(tree, name, change)


@record
class FaultMemory:
    """Memory of a fault, with past outputs of the part. Frames: those of the part. Source: docs page, Faults."""

    key: Any = part("Random key of the fault's random draws.")
    begin: Scalar = quantity("100 ns", "Time at which the fault began.", kind="time")
    output: Any = part("Last output of the part, after the effect of the fault.")
    lost: Scalar = quantity("100 ns", "Measurement time of the newest sample that the fault dropped.", kind="time")
    number: Scalar = quantity("1", "Number of outputs of the part since the start of the run.", kind="count")
    ring: Any = part("Ring buffer of the part's last outputs, without the fault. The first array axis is the slot.")


@record
class FaultyState:
    """State of a faulty part, and memory of the part's fault. Frames: those of the part. Source: docs page, Faults."""

    inner: Any = part("State of the part that has the fault.")
    memory: FaultMemory = part("Memory of the fault.")


def _initial_memory(key: Any, output: Any, ring: Any) -> FaultMemory:
    """Return the initial memory of a fault. output: part's output before the first step. ring: initial ring buffer."""
    return FaultMemory(
        key=key, begin=np.int64(NEVER), output=output, lost=np.int64(NEVER), number=np.int32(0), ring=ring
    )


def apply_to_sample(
    t: Any, s: FaultMemory, fault: Fault, sample: Sample, signals: Any, *, step: int, has_checksum: bool
) -> tuple[FaultMemory, Sample]:
    """Return the new memory of a fault, and a sample after the effect of the fault, at one instant.

    Args:
        t: present time (100 ns).
        s: memory of the fault.
        fault: the fault.
        sample: sensor's or link's output without the fault.
        signals: signals that can trigger the fault.
        step: time between two calls (100 ns).
        has_checksum: True for a link: a garbage sample is dropped, and `stuck` repeats the last sample.
    """
    sample = replace(sample, fresh=jnp.asarray(sample.fresh), valid=jnp.asarray(sample.valid))
    begin = fault.begin_time(t, s.begin, signals)
    kind = fault.active_kind(t, begin)
    came = sample.fresh & sample.valid
    number = (s.number + came).astype(np.int32)
    k = t // step
    capacity = s.ring.t.shape[0]
    ring = write_slot(s.ring, k % capacity, sample)
    repeats = (kind == STUCK) & has_checksum
    taken = (
        (kind == OFF)
        | repeats
        | ((kind == GARBAGE) & has_checksum)
        | ((kind == INTERMITTENT) & fault.is_off(s.key, t))
        | ((kind == SLOW) & fault.is_skipped(number))
    )
    lost = jnp.where((taken | (kind == DELAYED)) & sample.valid, sample.t, s.lost)
    absent = taken | (sample.valid & (sample.t == lost))
    late = read_slot(ring, (k - fault.delay_steps(step, capacity)) % capacity)
    comes = (kind == DELAYED) & late.valid & (late.t > jnp.where(s.output.valid, s.output.t, NEVER))
    silent = hold_sample(t, s.output, fresh=repeats & came & s.output.valid)
    out = _select(absent, silent, replace(sample, value=_faulty_value(kind, fault, s, sample, k, has_checksum)))
    out = _select(comes, hold_sample(t, late, fresh=True), out)
    return FaultMemory(key=s.key, begin=begin, output=out, lost=lost, number=number, ring=ring), out


def _faulty_value(kind: Any, fault: Fault, s: FaultMemory, sample: Sample, k: Any, has_checksum: bool) -> Any:
    value = _select(kind == WRONG, fault.distort_value(sample.value), sample.value)
    if has_checksum:
        return value
    value = _select((kind == STUCK) & s.output.valid, s.output.value, value)
    return _select(kind == GARBAGE, fault.garbage_value(s.key, k, sample.value), value)


def _select(condition: Any, a: Any, b: Any) -> Any:
    """Return the tree `a` if the condition is true, else `b`. The result has the data types of `b`."""
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y).astype(jnp.result_type(y)), a, b)


def apply_to_output(
    t: Any, s: FaultMemory, fault: Fault, output: Any, neutral: Any, signals: Any, *, step: int
) -> tuple[FaultMemory, Any]:
    """Return the fault's new memory, and the actuators' output with the fault. neutral: actuators' output at rest."""
    k, capacity = t // step, jax.tree.leaves(s.ring)[0].shape[0]
    output = cast_like(output, s.output)
    begin = fault.begin_time(t, s.begin, signals)
    kind = fault.active_kind(t, begin)
    ring = write_slot(s.ring, k % capacity, output)
    late = read_slot(ring, (k - fault.delay_steps(step, capacity)) % capacity)
    dead = (kind == OFF) | ((kind == INTERMITTENT) & fault.is_off(s.key, t))
    holds = (kind == STUCK) | ((kind == SLOW) & fault.is_skipped(s.number))
    u = tree_where(kind == WRONG, fault.distort_value(output.u), output.u)
    out = replace(output, u=tree_where(kind == GARBAGE, fault.random_input(s.key, k, output.u), u))
    out = tree_where(kind == DELAYED, late, out)
    out = tree_where(holds, s.output, out)
    out = tree_where(dead, cast_like(neutral, output), out)
    if fault.field:
        whole = cast_like(output, out)
        out = replace(whole, u=replace_number(whole.u, fault.field, out.u))
    number = (s.number + 1) % 2**30
    return FaultMemory(key=s.key, begin=begin, output=out, lost=s.lost, number=number, ring=ring), out


class FaultyPart:
    """Part with a fault. Base class of `FaultySensor`, `FaultyChannel` and `FaultyActuators`.

    Before and after the fault, the output equals the output of the part without a fault, bit for bit. In paths of
    settings, the part without the fault has the name `inner`.
    """

    inner: Any
    fault: Fault
    capacity: int

    @property
    def period(self) -> int:
        """Return the period of the faulty part."""
        return self.inner.period

    def check(self) -> None:
        """Raise InputError for a delay that exceeds the capacity of the ring buffer."""
        self.fault.check_ring(self.period, self.capacity)

    def initial_state(self, inner: Any, input: Any, key: Key) -> FaultyState:
        """Return the initial state of a faulty sensor or channel. inner: state of the part. input: example of input."""
        try:
            sample = jax.eval_shape(lambda s, x: self.inner.step(np.int64(0), s, x)[1], inner, input)
        except AttributeError as error:
            problem = f"with a fault or a real link, a sensor gets only a {type(input).__name__}, but: {error}"
            fix = "fly in virtual time, without a fault in this sensor:  trimtab run SCENARIO"
            raise InputError(f"fault in {type(self.inner).__name__}", problem, fix=fix) from error
        none = jax.tree.map(lambda v: jnp.zeros(jnp.shape(v), jnp.result_type(v)), sample)
        return FaultyState(inner=inner, memory=_initial_memory(key, none, empty_slots(none, self.capacity)))


@record
class FaultySensor(FaultyPart):
    """Sensor whose samples are distorted or dropped while a fault acts.

    The fault can be triggered by a signal of the sensor's input, e.g. `p_WB.0` or `v_WB_B.1` of the motion.

    Frames:  the sensor's.    Source:  docs page, Faults.
    """

    inner: Any = part("Sensor.")
    fault: Fault = part("Fault of the part `inner`.", default=Fault())
    example: Any = part("Example of the sensor's input, if the sensor does not measure the motion.", default=None)
    capacity: int = option("Capacity of the ring buffer: samples in the longest delay, plus 1.", default=2)

    @property
    def FEELS(self) -> str:
        """Return the input of the wrapped sensor's `step`: "motion", "input" or "state" of the vehicle."""
        return optional_member(self.inner, "FEELS")

    def init(self, key: Key) -> FaultyState:
        """Return the initial state, with no sample measured yet."""
        example = no_motion() if self.example is None else self.example
        return self.initial_state(self.inner.init(key), example, key.at("fault"))

    def measure(self, motion: Any) -> Any:
        """Return the sensor's measurement, without noise or fault."""
        return self.inner.measure(motion)

    def step(self, t: Any, state: FaultyState, motion: Any) -> tuple[FaultyState, Sample]:
        """Return the state and the sample, after the effect of the fault, at integer time t."""
        inner, sample = self.inner.step(t, state.inner, motion)
        memory, out = apply_to_sample(t, state.memory, self.fault, sample, motion, step=self.period, has_checksum=False)
        return FaultyState(inner=inner, memory=memory), out


@record
class FaultyChannel(FaultyPart):
    """Channel with a fault at the channel's receiving end.

    A checksum rejects distorted messages, so no sample arrives during a fault of kind `garbage`. The fault can be
    triggered by a value of the received sample, e.g. `value.surge_velocity` or `age`.

    Frames:  those of the transmitted values.    Source:  docs page, Faults.
    """

    inner: Any = part("Channel.")
    fault: Fault = part("Fault of the part `inner`.", default=Fault())
    capacity: int = option("Capacity of the ring buffer: steps in the longest delay, plus 1.", default=2)

    def init(self, key: Key, like: Sample) -> FaultyState:
        """Return the initial state, with no sample received yet."""
        return self.initial_state(self.inner.init(key, like), like, Key(key.seed, key.run, LINK_STREAM))

    def step(self, t: Any, state: FaultyState, sample: Sample) -> tuple[FaultyState, Sample]:
        """Return the state, and the newest sample at the receiving end at integer time t."""
        inner, arrived = self.inner.step(t, state.inner, sample)
        memory, out = apply_to_sample(
            t, state.memory, self.fault, arrived, arrived, step=self.period, has_checksum=True
        )
        return FaultyState(inner=inner, memory=memory), out


@record
class FaultyActuators(FaultyPart):
    """Actuators with a fault that distorts the vehicle's input, or one field or element of the input.

    The fault can be triggered by a value of the command, e.g. `value.speed_rpm`.

    Frames:  the actuators'.    Source:  docs page, Faults.
    """

    inner: Any = part("Actuators.")
    fault: Fault = part("Fault of the part `inner`.", default=Fault())
    capacity: int = option("Capacity of the ring buffer: steps in the longest delay, plus 1.", default=2)

    def neutral(self) -> Any:
        """Return the neutral output of the actuators, which they have without a valid command."""
        return self.inner.neutral()

    def init(self, key: Key) -> FaultyState:
        """Return the initial state, with the actuators at rest."""
        neutral = jax.tree.map(jnp.asarray, self.inner.neutral())
        slots = empty_slots(neutral, self.capacity)
        rest = jax.tree.map(lambda slot, v: jnp.broadcast_to(v, slot.shape), slots, neutral)
        return FaultyState(inner=self.inner.init(key), memory=_initial_memory(key.at("fault"), neutral, rest))

    def step(self, t: Any, state: FaultyState, command: Sample) -> tuple[FaultyState, Any]:
        """Return the state and the actuators' output, after the effect of the fault, from integer time t on."""
        inner, output = self.inner.step(t, state.inner, command)
        neutral = self.inner.neutral()
        memory, out = apply_to_output(t, state.memory, self.fault, output, neutral, command, step=self.period)
        return FaultyState(inner=inner, memory=memory), out
