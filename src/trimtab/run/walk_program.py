"""A whole closed loop as C: World and Autopilot traced once, every instant of a run in one compiled function."""

from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.compiler import jaxprs
from trimtab.compiler.arrays import Array, element_list, scalar
from trimtab.compiler.dead_code import prune
from trimtab.compiler.fold import fold
from trimtab.compiler.function import parameter_array
from trimtab.compiler.ir import Block, Buffer, Builder, Emit, If, Loop, Value
from trimtab.compiler.lower import Lowering
from trimtab.compiler.rules import RULES
from trimtab.compiler.rules.control import LoopCarries
from trimtab.core.time import Clock
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.structure import cast_like
from trimtab.loop.walk import instant, logged_signals, signals, start
from trimtab.loop.world import World
from trimtab.run.walk_text import walk_source


class WalkProgram(NamedTuple):
    """A lowered walk over instants.

    blocks: what is computed once, and the start with the loop.  inputs: parameters, first state and key, flat.
    loop: over the instants.  final: the first parts of the state at the end.  width: numbers in a row of the log.
    signals: structure of what is logged.  end: structure of the last values.  live: what is needed.
    """

    blocks: list[Block]
    inputs: list[Array]
    loop: Loop
    final: list[Value]
    width: int
    signals: Any
    final_structure: Any
    live: set[int]

    def text(self, lanes: int = 0, varying: frozenset[int] = frozenset()) -> str:
        """C, or C++ over lanes in which the inputs at these positions differ from run to run."""
        return walk_source(self, lanes, varying)


def lower_closed_loop(
    world: World, autopilot: Autopilot, x: Any, key: Any, always: frozenset[int], wanted: tuple[str, ...] = ()
) -> WalkProgram:
    """Trace and lower a closed loop; only structure and types of the arguments matter."""
    begin, step, seen, end = _trace_closed_loop((world, autopilot, x, key), always, wanted)
    return lower_walk(begin, step, len(jax.tree.leaves(end)), end)._replace(signals=seen)


def lower_walk(begin: Any, step: Any, kept: int, end: Any = None) -> WalkProgram:
    """Lower a walk.

    Args:
        begin: jaxpr, inputs -> state.
        step: jaxpr, (inputs, state, t, h) -> (state, row of float64).
        kept: how many leaves of the state, from the first, are its last values.
        end: their structure.
    """
    b = Builder(fold, hoist=True)
    lowering = Lowering(b, RULES)
    avals = [v.aval for v in begin.jaxpr.invars]
    indexed = jaxprs.indexed_inputs(step.jaxpr)
    inputs = [parameter_array(v.shape, lowering.type_name(v.dtype), i in indexed) for i, v in enumerate(avals)]
    for array in inputs:
        for v in [] if array.items is None else array.items.ravel():
            v.invariant = True
    n = len(inputs)
    first = lowering.lower_program(begin, inputs, [False] * n)
    carried = LoopCarries(b, first, [True] * len(first), jaxprs.indexed_inputs(step.jaxpr, n))
    loop = Loop("n", Value("index", (), "i32"), Block())
    variables = [Value("carry", (), v.dtype) for v in carried.values]
    with b.write_into(loop.body):
        now = [scalar(b.load(Buffer("i64", 0, "input", name), loop.index)) for name in ("t", "h")]
        arrays = [*inputs, *carried.arrays(variables), *now]
        dying = [False] * n + [True] * len(first) + [False] * 2
        found = lowering.lower_program(step, arrays, dying)
        row = [v for a in found[len(first) :] for v in element_list(b, a)]
        if row:
            _record_row(b, loop.index, row)
        nexts = carried.close_iteration(found[: len(first)])
    loop.carries = list(zip(variables, carried.values, nexts, strict=True))
    b.block.items.append(loop)
    final = [v for a in carried.arrays(variables)[:kept] for v in element_list(b, a)]
    live = prune([b.prologue, b.top], final, [])
    return WalkProgram([b.prologue, b.top], inputs, loop, final, len(row), None, end, live)


def _trace_closed_loop(fly: Any, always: frozenset[int], wanted: tuple[str, ...]) -> tuple[Any, Any, Any, Any]:
    """Programs of the start and of one instant, and the structures of what is logged and of the end.

    The state is flattened with the truth and the sensors first.
    """

    def flat(world: World, autopilot: Autopilot, s: Any, a: Any) -> Any:
        return (s.x, s.sensors), world.drop_derived_outputs(s, always), autopilot.drop_derived_outputs(a, always)

    def begin(fly: Any) -> Any:
        world, autopilot, x, key = fly
        return flat(world, autopilot, *start(world, autopilot, x, key))

    def step(fly: Any, state: Any, t: Any, h: Any) -> Any:
        world, autopilot, _, _ = fly
        _, s, a = state
        new_s, new_a, seen = instant(world, autopilot, Clock(t, always), h, s, a)
        row = [value.astype(np.float64) for _, value, _ in logged_signals(convert_signals(seen), wanted)]
        lean = flat(world, autopilot, new_s, new_a)
        return cast_like(lean, state), row

    t = np.int64(0)
    program, shape = jax.make_jaxpr(begin, return_shape=True)(fly)
    each = jax.make_jaxpr(step)(fly, shape, t, t)
    seen = jax.eval_shape(lambda fly: signals(*start(*fly)), fly)
    return program, each, seen, shape[0]


def convert_signals(seen: Any) -> Any:
    """Signals as arrays."""
    return jax.tree.map(jax.numpy.asarray, seen)


def _record_row(b: Builder, index: Value, row: list[Value]) -> None:
    """The row is written where the timetable says so."""
    where = b.load(Buffer("i32", 0, "input", "row"), index)
    rows = b.load(Buffer("i32", 0, "input", "rows"), b.index(0))
    branch = If(b.op("lt", where, rows, dtype="bool"), Block(), Block())
    branch.first.items.append(Emit([where, *row]))
    b.block.items.append(branch)
