"""Analysis of a program before it is written as C: which values are needed, and which differ between the runs of a
batch. Values that are the same in all runs are computed once, and branches on such values stay branches.
"""

from typing import Any

from trimtab.compiler.ir import Block, Define, Emit, If, Local, Loop, Store
from trimtab.compiler.text import ELEMENTARY
from trimtab.compiler.values import Buffer, Value


class _NeededValues:
    """Values and buffers on which the results of a program depend, found by tracing the program backwards from its
    results."""

    def __init__(self) -> None:
        self.values: set[int] = set()
        self.buffers: set[int] = set()
        self.stores: dict[int, list[tuple[Store, list[Any]]]] = {}
        self.operands: dict[int, list[Value]] = {}
        self.todo: list[Value] = []

    def collect_uses(self, block: Block, around: list[Any]) -> None:
        """Record the statements that write each buffer, and the operands and tests that each value depends on."""
        for item in block.items:
            if isinstance(item, Define):
                self.operands[id(item.value)] = [*item.value.args, *_enclosing_tests(around)]
            elif isinstance(item, Store):
                self.stores.setdefault(id(item.buffer), []).append((item, around))
            elif isinstance(item, Emit):
                for value in [*item.values, *_enclosing_tests(around)]:
                    self.value(value)
            elif isinstance(item, If):
                for joined, x, y in item.joins:
                    self.operands[id(joined)] = [x, y, item.test, *_enclosing_tests(around)]
                inner = [*around, item]
                self.collect_uses(item.first, inner)
                self.collect_uses(item.second, inner)
            elif isinstance(item, Loop):
                inner = [*around, item]
                for variable, start, next_ in item.carries:
                    self.operands[id(variable)] = [start, next_, *_enclosing_tests(inner)]
                self.collect_uses(item.head, inner)
                self.collect_uses(item.body, inner)

    def value(self, value: Value) -> None:
        if id(value) not in self.values:
            self.values.add(id(value))
            self.todo.append(value)

    def buffer(self, buffer: Buffer) -> None:
        if id(buffer) in self.buffers:
            return
        self.buffers.add(id(buffer))
        for store, around in self.stores.get(id(buffer), []):
            for needed in (store.index, store.value, *_enclosing_tests(around)):
                self.value(needed)

    def follow_uses(self) -> None:
        while self.todo:
            value = self.todo.pop()
            for needed in self.operands.get(id(value), value.args):
                self.value(needed)
            if value.op == "load":
                self.buffer(value.attr)


def _enclosing_tests(around: list[Any]) -> list[Value]:
    return [value for item in around for value in (item.test, getattr(item, "count", None)) if isinstance(value, Value)]


def prune(blocks: list[Block], results: list[Value], buffers: list[Buffer]) -> set[int]:
    """Remove all statements that are not needed for the given results and buffers. Return the ids of the values and
    buffers that are kept."""
    needed = _NeededValues()
    for block in blocks:
        needed.collect_uses(block, [])
    for value in results:
        needed.value(value)
    for buffer in buffers:
        needed.buffer(buffer)
    needed.follow_uses()
    for block in blocks:
        _sweep(block, needed)
    return needed.values | needed.buffers


def _sweep(block: Block, needed: _NeededValues) -> None:
    items: list[Any] = []
    for item in block.items:
        if isinstance(item, Define):
            keep = id(item.value) in needed.values
        elif isinstance(item, Local):
            keep = id(item.buffer) in needed.buffers
        elif isinstance(item, Emit):
            keep = True
        elif isinstance(item, Store):
            keep = id(item.buffer) in needed.buffers
        elif isinstance(item, If):
            item.joins = [j for j in item.joins if id(j[0]) in needed.values]
            _sweep(item.first, needed)
            _sweep(item.second, needed)
            keep = bool(item.joins or item.first.items or item.second.items)
        else:
            item.carries = [c for c in item.carries if id(c[0]) in needed.values]
            _sweep(item.head, needed)
            _sweep(item.body, needed)
            keep = bool(item.carries or item.body.items)
        if keep:
            items.append(item)
    block.items = items


class VaryingValues:
    """Set of the values and buffers, by id, that differ between the runs of a batch."""

    def __init__(self, values: set[int], buffers: set[int]) -> None:
        self.values, self.buffers = values, buffers
        self.changed = False

    def __call__(self, thing: Any) -> bool:
        """Return True if a value or buffer differs between runs."""
        return id(thing) in self.values or id(thing) in self.buffers

    def add(self, thing: Any, to: set[int]) -> None:
        """Mark a value or buffer as differing between runs."""
        if id(thing) not in to:
            to.add(id(thing))
            self.changed = True

    def value(self, value: Value) -> None:
        """Mark a computed value if its operands, or the buffer that it is loaded from, differ between runs."""
        if any(self(a) for a in value.args) or (value.op == "load" and self(value.attr)):
            self.add(value, self.values)


def find_varying(blocks: list[Block], inputs: list[Any], feedback: list[tuple[Any, Any]]) -> VaryingValues:
    """Return the values and buffers that differ between runs if the given inputs differ.

    feedback: pairs (state before a call, state after it) of the states that the caller carries from call to call.
    """
    varying = VaryingValues(set(), set())
    for thing in inputs:
        varying.add(thing, varying.values if isinstance(thing, Value) else varying.buffers)
    varying.changed = True
    while varying.changed:
        varying.changed = False
        for block in blocks:
            _mark_block(block, varying, False)
        for before, after in feedback:
            if varying(after):
                varying.add(before, varying.values if isinstance(before, Value) else varying.buffers)
    return varying


def _mark_block(block: Block, varying: VaryingValues, masked: bool) -> None:
    """Mark the values and buffers of a block that differ between runs. masked: True if only some of the runs execute
    the block."""
    for item in block.items:
        if isinstance(item, Define):
            varying.value(item.value)
        elif isinstance(item, Store):
            if masked or varying(item.value) or varying(item.index):
                varying.add(item.buffer, varying.buffers)
        elif isinstance(item, If):
            apart = varying(item.test)
            _mark_block(item.first, varying, masked or apart)
            _mark_block(item.second, varying, masked or apart)
            for joined, x, y in item.joins:
                if apart or varying(x) or varying(y):
                    varying.add(joined, varying.values)
        elif isinstance(item, Loop):
            _mark_block(item.head, varying, masked)
            apart = item.test is not None and varying(item.test)
            _mark_block(item.body, varying, masked or apart)
            for variable, start, next_ in item.carries:
                if apart or varying(start) or varying(next_):
                    varying.add(variable, varying.values)
        elif not isinstance(item, Local | Emit):
            raise TypeError(item)


CHEAP = ("sqrt", "floor", "ceil", "round_even", "round_away")
"""Elementary functions that compile to one or two instructions."""
CALL, TURNS = 40, 16
"""Assumed cost of an elementary function (operations), and assumed number of iterations of a loop whose end depends on
data."""


def vector_share(blocks: list[Block]) -> float:
    """Return the fraction of a single run's operations that are in loops which a C compiler vectorises.

    Such a loop contains no other loop, carries no value from one iteration to the next, and calls no function.
    """
    work, vectors = _count_operations(blocks)
    return vectors / max(work, 1)


def _count_operations(blocks: list[Block]) -> tuple[float, float]:
    """Return the number of operations of these blocks, and the number of those in vectorised loops."""
    work = vectors = 0.0
    for item in (item for block in blocks for item in block.items):
        if isinstance(item, Define):
            work += CALL if item.value.op in ELEMENTARY and item.value.op not in CHEAP else 1
        elif isinstance(item, If):
            inner = _count_operations([item.first, item.second])
            work, vectors = work + inner[0], vectors + inner[1]
        elif isinstance(item, Loop):
            turns = item.count if isinstance(item.count, int) else TURNS
            inner = _count_operations([item.head, item.body])
            plain = item.count is not None and not item.carries
            plain &= all(isinstance(i, Store) or _is_cheap(i) for i in item.body.items)
            work, vectors = work + turns * inner[0], vectors + turns * (inner[0] if plain else inner[1])
    return work, vectors


def _is_cheap(item: Any) -> bool:
    return isinstance(item, Define) and (item.value.op not in ELEMENTARY or item.value.op in CHEAP)


def defined_values(blocks: list[Block]) -> list[Value]:
    """Return all values that are computed in these blocks, nested blocks included."""
    values: list[Value] = []
    for block in blocks:
        for item in block.items:
            if isinstance(item, Define):
                values.append(item.value)
            elif isinstance(item, If):
                values += defined_values([item.first, item.second])
            elif isinstance(item, Loop):
                values += defined_values([item.head, item.body])
    return values
