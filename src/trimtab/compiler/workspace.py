"""Memory for large arrays of a program: a workspace that the caller provides, in place of the stack.

Generated code allocates no memory. The arrays of a small program are on the stack. If all arrays together are too large
for the stack, the largest are placed in the workspace, whose size is known when the C text is written. Two arrays share
memory if the first is no longer needed when the second is declared.
"""

from collections.abc import Collection, Iterable
from typing import Any, NamedTuple

from trimtab.compiler.analysis import VaryingValues
from trimtab.compiler.ir import TYPES, Block, Define, If, Local, Loop, Store
from trimtab.compiler.values import Buffer

STACK = 1 << 17
"""Maximum bytes of arrays that an exported block or a loop keeps on the stack."""
CALL_STACK = 1 << 15
"""Maximum bytes of arrays on the stack of a function that Python calls, as its thread may have a small stack."""
ALIGNMENT = 64
"""Alignment of a workspace and of every array in it, bytes."""


class Workspace(NamedTuple):
    """Places of large arrays in the workspace. places: id of a buffer -> offset of its first byte. size: total
    bytes."""

    places: dict[int, int]
    size: int

    def __contains__(self, buffer: object) -> bool:
        """Return True if a buffer has a place in the workspace."""
        return id(buffer) in self.places


NO_WORKSPACE = Workspace({}, 0)


def plan_workspace(
    blocks: list[Block],
    operands: Iterable[Buffer] = (),
    results: Iterable[Buffer] = (),
    lanes: int = 0,
    varying: VaryingValues | None = None,
    elsewhere: Collection[int] = (),
    stack: int | None = None,
) -> Workspace:
    """Return the places of a program's large arrays.

    Args:
        blocks: blocks of the program, in order.
        operands: buffers that are filled before the first block and needed until the end, such as inputs in lanes.
        results: buffers that are read after the last block.
        lanes: number of runs computed side by side; 0 for scalar code.
        varying: values and buffers that differ between lanes.
        elsewhere: ids of buffers that the blocks declare, but that are in the caller's memory.
        stack: maximum bytes of arrays that stay on the stack; STACK if None.
    """
    items, first = [item for block in blocks for item in block.items], list(operands)
    sizes: dict[int, int] = {}
    for buffer in [*first, *_local_buffers(items)]:
        if id(buffer) in elsewhere:
            continue
        sizes[id(buffer)] = _byte_count(buffer, lanes if varying is not None and varying(buffer) else 0)
    total, large = sum(sizes.values()), dict[int, int]()
    for key, size in sorted(sizes.items(), key=lambda pair: -pair[1]):
        if total <= (STACK if stack is None else stack):
            break
        large[key] = -(-size // ALIGNMENT) * ALIGNMENT
        total -= size
    plan = _Plan(large, {id(b) for b in results})
    for buffer in first:
        plan.place(buffer, [(0, plan.size)])
    plan.visit(items, [(0, plan.size)])
    return Workspace(plan.places, plan.size)


def _byte_count(buffer: Buffer, lanes: int) -> int:
    each = 8 if buffer.dtype == "bool" and lanes else TYPES[buffer.dtype]().itemsize
    return max(buffer.size, 1) * each * max(lanes, 1)


def _inner_items(item: Any) -> list[Any]:
    if isinstance(item, If):
        return [*item.first.items, *item.second.items]
    return [*item.head.items, *item.body.items] if isinstance(item, Loop) else []


def _local_buffers(items: list[Any]) -> list[Buffer]:
    """Return all buffers that these statements, or statements nested in them, declare."""
    names: list[Buffer] = []
    for item in items:
        names += [item.buffer] if isinstance(item, Local) else _local_buffers(_inner_items(item))
    return names


def _uses(item: Any) -> set[int]:
    """Return the ids of the buffers that a statement, or a statement nested in it, uses."""
    if isinstance(item, Store | Local):
        return {id(item.buffer)}
    if isinstance(item, Define):
        return {id(item.value.attr)} if item.value.op == "load" else set()
    return set().union(*map(_uses, _inner_items(item)))


class _Plan:
    """Placement of large buffers. Each buffer gets the lowest place that is free from its declaration to its last
    use."""

    def __init__(self, large: dict[int, int], lasting: set[int]) -> None:
        self.large, self.lasting = large, lasting
        self.places: dict[int, int] = {}
        self.size = 0

    def place(self, buffer: Buffer, taken: list[tuple[int, int]]) -> tuple[int, int]:
        """Place a large buffer outside the `taken` ranges. Return its first byte and the byte after its end."""
        size, start = self.large.get(id(buffer), 0), 0
        for low, high in sorted(taken):
            if start + size <= low:
                break
            start = max(start, high)
        if size:
            self.places[id(buffer)] = start
            self.size = max(self.size, start + size)
        return start, start + size

    def visit(self, items: list[Any], taken: list[tuple[int, int]]) -> None:
        """Place all large buffers that these statements, and statements nested in them, declare."""
        if not self.large:
            return
        last = {key: k for k, item in enumerate(items) for key in _uses(item) if key in self.large}
        alive: dict[int, tuple[int, int]] = {}
        for k, item in enumerate(items):
            if isinstance(item, Local) and id(item.buffer) in self.large:
                alive[id(item.buffer)] = self.place(item.buffer, [*taken, *alive.values()])
            for inner in (item.first, item.second) if isinstance(item, If) else ():
                self.visit(inner.items, [*taken, *alive.values()])
            if isinstance(item, Loop):
                self.visit([*item.head.items, *item.body.items], [*taken, *alive.values()])
            for key in [key for key in alive if last[key] <= k and key not in self.lasting]:
                del alive[key]
