"""Memory for large arrays of a program: not the stack, but a workspace that the caller provides.

Generated code allocates nothing. What a small program needs lies on the stack; where its arrays together are too much
for that, the large ones get places in a workspace, whose size is known when the text is written. Two arrays share a
place where one is no longer needed when the other begins.
"""

from collections.abc import Collection, Iterable
from typing import Any, NamedTuple

from trimtab.compiler.analysis import VaryingValues
from trimtab.compiler.ir import TYPES, Block, Define, If, Local, Loop, Store
from trimtab.compiler.values import Buffer

STACK = 1 << 17
"""Maximum bytes of arrays that an exported block or a loop keeps on the stack."""
CALL_STACK = 1 << 15
"""Maximum bytes of arrays on the stack of a function that Python calls, perhaps from a thread with a small stack."""
ALIGNMENT = 64
"""Alignment of a workspace and of every array in it, bytes."""


class Workspace(NamedTuple):
    """Places of large arrays: first byte by id of a buffer, and the total number of bytes."""

    places: dict[int, int]
    size: int

    def __contains__(self, buffer: object) -> bool:
        """Return True if a buffer has a place here."""
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
        blocks: of the program, one after the other.
        operands: buffers that are filled before the first block and last to the end, such as inputs over lanes.
        results: buffers that are read after the last block.
        lanes: how many runs there are side by side; 0 for one.
        varying: what differs between them.
        elsewhere: ids of buffers that begin in the blocks, but lie where the caller keeps them.
        stack: bytes of arrays that stay on the stack at most; STACK when None.
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
    """Return all buffers that begin in these statements, nested ones included."""
    names: list[Buffer] = []
    for item in items:
        names += [item.buffer] if isinstance(item, Local) else _local_buffers(_inner_items(item))
    return names


def _uses(item: Any) -> set[int]:
    """Return ids of the buffers that a statement reads or writes, nested ones included."""
    if isinstance(item, Store | Local):
        return {id(item.buffer)}
    if isinstance(item, Define):
        return {id(item.value.attr)} if item.value.op == "load" else set()
    return set().union(*map(_uses, _inner_items(item)))


class _Plan:
    """Gives each large buffer the lowest place that is free from its beginning to its last use."""

    def __init__(self, large: dict[int, int], lasting: set[int]) -> None:
        self.large, self.lasting = large, lasting
        self.places: dict[int, int] = {}
        self.size = 0

    def place(self, buffer: Buffer, taken: list[tuple[int, int]]) -> tuple[int, int]:
        """Place a buffer, if it is large, clear of all these; return its first byte and the one after it."""
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
        """Place all that begins in these statements."""
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
