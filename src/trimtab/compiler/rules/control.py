"""Lowering rules for branches and loops."""

import math
from collections.abc import Callable, Sequence
from typing import Any

from trimtab.compiler import jaxprs
from trimtab.compiler.arrays import (
    Array,
    Index,
    build_array,
    copy_array,
    copy_into,
    element_list,
    is_small,
    read_element,
    read_flat,
    scalars,
    store_in_memory,
)
from trimtab.compiler.ir import Block, Builder, If
from trimtab.compiler.lower import Rule, Site
from trimtab.compiler.rules.reduce import accumulate
from trimtab.compiler.values import Buffer, Value


def _cond(site: Site) -> list[Array]:
    programs = jaxprs.cond_branches(site.equation)
    which = element_list(site.b, site.operands[0])[0]
    operands, dying = site.operands[1:], site.dying[1:]
    # `dying` is already right for operands that share a buffer: a branch sees each operand under its own name
    return _choose_branch(site, which, programs, operands, dying)


def _choose_branch(
    site: Site, which: Value, programs: list[Any], operands: list[Array], dying: list[bool]
) -> list[Array]:
    b = site.b
    if len(programs) == 1:
        return site.inline(programs[0], operands, dying)
    if which.op == "const":
        chosen = min(max(int(which.const), 0), len(programs) - 1)
        return site.inline(programs[chosen], operands, dying)
    test = b.op("le", which, b.const(0, which.dtype), dtype="bool") if len(programs) > 2 else _is_zero(b, which)

    def first() -> list[Array]:
        return site.inline(programs[0], operands, dying)

    def second() -> list[Array]:
        less = b.op("sub", which, b.const(1, which.dtype), dtype=which.dtype)
        return _choose_branch(site, less, programs[1:], operands, dying)

    return branch_arrays(b, test, first, second, _replaceable(operands, dying))


def _replaceable(operands: list[Array], dying: list[bool]) -> list[Buffer]:
    """Return the buffers that may be written and are not read after an equation."""
    pairs = zip(operands, dying, strict=True)
    return [a.buffer for a, dies in pairs if dies and a.buffer is not None and not a.buffer.is_read_only]


def _is_zero(b: Builder, which: Value) -> Value:
    """Return the condition for taking the first of two branches. No comparison is needed if the branch index was
    converted from a bool."""
    if which.op == "convert" and which.args[0].dtype == "bool":
        return b.op("not", which.args[0], dtype="bool")
    return b.op("le", which, b.const(0, which.dtype), dtype="bool")


def branch_arrays(
    b: Builder,
    test: Value,
    first: Callable[[], list[Array]],
    second: Callable[[], list[Array]],
    replaceable: Sequence[Buffer] = (),
) -> list[Array]:
    """Write a branch and return its results. Large results of both sides are put into the same buffer.

    Small results are joined value by value.
    replaceable: buffers that are not read after the branch. If one side returns such a buffer unchanged, the other side
    writes its result there, and the side without changes copies nothing.
    """
    made = If(test, Block(), Block())
    with b.write_into(made.first):
        xs = first()
    with b.write_into(made.second):
        ys = second()
    kept = [_choose_buffer(k, xs, ys, replaceable) for k in range(len(xs))]
    results = [_join_arrays(b, made, x, y, held) for x, y, held in zip(xs, ys, kept, strict=True)]
    b.block.items.append(made)
    return results


def _choose_buffer(k: int, xs: list[Array], ys: list[Array], replaceable: Sequence[Buffer]) -> Buffer | None:
    """Return the buffer that one side returns unchanged as result k and that no other result uses, else None."""
    for array in (xs[k], ys[k]):
        buffer = array.buffer
        users = [i for side in (xs, ys) for i, a in enumerate(side) if a.buffer is buffer]
        is_free = any(buffer is other for other in replaceable) and users == [k]
        if buffer is not None and is_free and array.offset is None and array.size == buffer.size:
            return buffer
    return None


def _join_arrays(b: Builder, made: If, x: Array, y: Array, held: Buffer | None) -> Array:
    if x.items is None and x.buffer is y.buffer and x.offset is y.offset:
        return x
    if is_small(x.shape) and (x.items is not None or y.items is not None):
        with b.write_into(made.first):
            a = element_list(b, x)
        with b.write_into(made.second):
            c = element_list(b, y)
        return scalars([made.join(v, w) for v, w in zip(a, c, strict=True)], x.shape, x.dtype)
    buffer = held or b.local_buffer(x.dtype, x.size)
    for block, array in ((made.first, x), (made.second, y)):
        if array.buffer is buffer:
            continue
        with b.write_into(block):
            copy_into(b, buffer, array)
    return Array(x.shape, x.dtype, buffer=buffer)


class LoopCarries:
    """Arrays that a loop carries from one iteration to the next: as values or, if large or indexed, in a buffer."""

    def __init__(
        self, b: Builder, starts: list[Array], dying: list[bool], indexed: set[int], others: Sequence[Array] = ()
    ) -> None:
        """Prepare the carried arrays. others: further arrays that the loop reads, whose buffers the loop must not
        change."""
        self.b, self.like = b, starts
        self.buffers: list[Array | None] = []
        taken: list[Any] = [a.buffer for a in others]
        for i, (a, dies) in enumerate(zip(starts, dying, strict=True)):
            own = (
                a.buffer is not None
                and dies
                and not a.buffer.is_read_only
                and a.offset is None
                and a.buffer not in taken
            )
            in_memory = a.items is None or i in indexed
            held = a if own else copy_array(b, a) if in_memory else None
            self.buffers.append(held)
            taken.append(held.buffer if held else None)
        free = zip(starts, self.buffers, strict=True)
        self.values = [v for a, held in free if held is None for v in element_list(b, a)]

    def arrays(self, flat: list[Value]) -> list[Array]:
        """Return the arrays that the loop carries. flat: elements of the carried arrays without a buffer, in order."""
        rest = iter(flat)
        found = []
        for a, buffer in zip(self.like, self.buffers, strict=True):
            found.append(buffer or scalars([next(rest) for _ in range(a.size)], a.shape, a.dtype))
        return found

    def close_iteration(self, nexts: list[Array]) -> list[Value]:
        """End an iteration: write the results to the buffers, and return the elements of results without a buffer."""
        b = self.b
        flat = [v for a, held in zip(nexts, self.buffers, strict=True) if held is None for v in element_list(b, a)]
        moves = []
        for a, held in zip(nexts, self.buffers, strict=True):
            if held is None or a.buffer is held.buffer:
                continue
            crossing = any(a.buffer is other.buffer for other in self.buffers if other is not None)
            moves.append((held.buffer, copy_array(b, a) if crossing else a))
        for target, source in moves:
            copy_into(b, target, source)  # pyright: ignore[reportArgumentType]
        return flat


def _scan(site: Site) -> list[Array]:
    b, s = site.b, jaxprs.scan_parameters(site.equation)
    first = s.constants + s.carries
    constants, slices = site.operands[: s.constants], [store_in_memory(b, a) for a in site.operands[first:]]
    carried = LoopCarries(
        b,
        site.operands[s.constants : first],
        site.dying[s.constants : first],
        jaxprs.indexed_inputs(s.body.jaxpr, s.constants),
        [*constants, *slices],
    )
    _store_constants(b, constants, s.body)
    outs = [site.lowering.new_array(v.aval) for v in site.equation.outvars[s.carries :]]

    def turn(i: Value, flat: list[Value]) -> list[Value]:
        k = b.op("sub", b.index(s.length - 1), i, dtype="i32") if s.reverse else i
        now = [array_row(b, a, k) for a in slices]
        operands = [*constants, *carried.arrays(flat), *now]
        dying = [False] * s.constants + [True] * s.carries + [False] * len(now)
        found = site.inline(s.body, operands, dying)
        for made, row in zip(outs, found[s.carries :], strict=True):
            _write_row(b, made, k, row)
        return carried.close_iteration(found[: s.carries])

    end = b.loop(s.length, carried.values, turn)
    return [*carried.arrays(end), *outs]


def array_row(b: Builder, array: Array, k: Value) -> Array:
    """Return array[k] for k in range: as values if it is small, else as a view of the buffer."""
    shape = array.shape[1:]
    size = math.prod(shape)
    offset = b.op("mul", k, b.index(size), dtype="i32")
    if is_small(shape):
        found = [read_flat(b, array, b.op("add", offset, b.index(j), dtype="i32")) for j in range(size)]
        return scalars(found, shape, array.dtype)
    if array.offset is not None:
        offset = b.op("add", offset, array.offset, dtype="i32")
    return Array(shape, array.dtype, buffer=array.buffer, offset=offset)


def _write_row(b: Builder, made: Array, k: Value, row: Array) -> None:
    buffer = made.buffer
    assert buffer is not None
    offset = b.op("mul", k, b.index(row.size), dtype="i32")
    if is_small(row.shape):
        for j, v in enumerate(element_list(b, row)):
            b.store(buffer, b.op("add", offset, b.index(j), dtype="i32"), v)
    else:
        b.repeat(row.size, lambda j: b.store(buffer, b.op("add", offset, j, dtype="i32"), read_flat(b, row, j)))


def _select_arrays(b: Builder, holds: Array, new: Array, old: Array) -> Array:
    """Return `new` for the members of the batch whose test holds, else `old`. The batch axes come first."""

    def one(index: Index) -> Value:
        test = read_element(b, holds, index[: len(holds.shape)])
        return b.op("select", test, read_element(b, new, index), read_element(b, old, index), dtype=new.dtype)

    return build_array(b, new.shape, new.dtype, one)


def _store_constants(b: Builder, constants: list[Array], program: Any) -> None:
    """Put small arrays that a loop reads at computed indices into memory before the loop, not in each iteration."""
    for i in jaxprs.indexed_inputs(program.jaxpr):
        if i < len(constants):
            store_in_memory(b, constants[i])


def _while(site: Site) -> list[Array]:
    b, w = site.b, jaxprs.while_parameters(site.equation)
    first = w.test_constants + w.body_constants
    of_test, of_body = site.operands[: w.test_constants], site.operands[w.test_constants : first]
    indexed = jaxprs.indexed_inputs(w.body.jaxpr, w.body_constants)
    carried = LoopCarries(b, site.operands[first:], site.dying[first:], indexed, site.operands[:first])
    _store_constants(b, of_test, w.test)
    _store_constants(b, of_body, w.body)

    def test(flat: list[Value]) -> Value:
        [holds] = site.inline(w.test, [*of_test, *carried.arrays(flat)])

        def either(index: Index, so_far: list[Value]) -> list[Value]:
            return [b.op("or", so_far[0], read_element(b, holds, index), dtype="bool")]

        return accumulate(b, holds.shape, [b.const(0, "bool")], either)[0]

    def turn(flat: list[Value]) -> list[Value]:
        now = carried.arrays(flat)
        if not w.test.out_avals[0].shape:
            dying = [False] * len(of_body) + [True] * len(now)
            return carried.close_iteration(site.inline(w.body, [*of_body, *now], dying))
        # under vmap the test is an array: members of the batch whose test is false keep their values
        [holds] = site.inline(w.test, [*of_test, *now])
        nexts = site.inline(w.body, [*of_body, *now])
        return carried.close_iteration(
            [_select_arrays(b, holds, new, old) for new, old in zip(nexts, now, strict=True)]
        )

    return carried.arrays(b.loop_while(carried.values, test, turn))


RULES: dict[str, Rule] = {"cond": _cond, "scan": _scan, "while": _while}
