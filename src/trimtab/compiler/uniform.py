"""Replacement of selects by branches, if the test is the same in all lanes. The case not taken is then not computed.

JAX computes both cases of `jnp.where`. In lanes, a test that depends only on time is true in all runs or in none. A
branch on such a test skips, for example, the random draws of a link at instants at which nothing is received. No other
operations are added and no operands change, so the results stay the same, bit for bit.
"""

from bisect import bisect_right
from collections.abc import Iterable
from heapq import heappop, heappush
from typing import Any, NamedTuple

from trimtab.compiler.analysis import CALL, CHEAP, VaryingValues
from trimtab.compiler.ir import Block, Define, Emit, If, Local, Loop, Store
from trimtab.compiler.text import ELEMENTARY
from trimtab.compiler.values import Value

BRANCH_COST_MIN = 12
"""Minimum cost of the operations that a branch must save, in vector operations."""
GATHER, DIVISION = 8, 4
"""Assumed cost of a read at a different index in each lane, and of a division or square root, in vector operations."""
AHEAD_MAX = 200
"""Maximum number of statements between the selects that share one branch."""
TEST, YES, NO = 0, 1, 2
"""Positions of the operands of a select: the test, the value if true, the value if false."""
_OUTSIDE = (0, -1)
"""Marker of a use by a store, a loop or a result. A value with such a use is not moved into a branch."""


def branch_uniform_selects(blocks: list[Block], varying: VaryingValues, results: Iterable[Any]) -> list[Block]:
    """Return the blocks with branches in place of selects where that saves enough. The given blocks do not change.

    varying: values and buffers that differ between lanes. results: values that are read after the blocks.
    """
    uses = _Uses()
    for value in results:
        if isinstance(value, Value):
            uses.add(value, _OUTSIDE)
    for block in blocks:
        uses.collect(block)
    return [_rewrite_block(block, varying, uses) for block in blocks]


class _Uses:
    """Uses of each value, by id: (id of the value computed from it, number of the operand), or _OUTSIDE."""

    def __init__(self) -> None:
        self.users: dict[int, list[tuple[int, int]]] = {}

    def add(self, value: Any, user: tuple[int, int]) -> None:
        if isinstance(value, Value):
            self.users.setdefault(id(value), []).append(user)

    def collect(self, block: Block) -> None:
        for item in block.items:
            if isinstance(item, Define):
                for k, operand in enumerate(item.value.args):
                    self.add(operand, (id(item.value), k))
                continue
            for value in _direct_uses(item):
                self.add(value, _OUTSIDE)
            for inner in inner_blocks(item):
                self.collect(inner)


def _direct_uses(item: Any) -> list[Any]:
    """Return the values that a statement uses itself, if it is not a definition. Nested statements are left out."""
    if isinstance(item, Store):
        return [item.index, item.value]
    if isinstance(item, Emit):
        return item.values
    if isinstance(item, If):
        return [item.test, *(v for join in item.joins for v in join[1:])]
    if isinstance(item, Loop):
        return [item.test, item.count, *(v for carry in item.carries for v in carry[1:])]
    return []


def inner_blocks(item: Any) -> list[Block]:
    """Return the blocks of a branch or loop; an empty list for another statement."""
    if isinstance(item, If):
        return [item.first, item.second]
    return [item.head, item.body] if isinstance(item, Loop) else []


def _written_buffers(item: Any) -> set[int]:
    """Return the ids of the buffers that a statement, or a statement nested in it, writes or declares."""
    if isinstance(item, Store | Local):
        return {id(item.buffer)}
    return set().union(*(_written_buffers(i) for block in inner_blocks(item) for i in block.items))


def _rewrite_block(block: Block, varying: VaryingValues, uses: _Uses) -> Block:
    made = Block()
    made.items = _Rewriting([_rewrite_inner(item, varying, uses) for item in block.items], varying, uses).run()
    return made


def _rewrite_inner(item: Any, varying: VaryingValues, uses: _Uses) -> Any:
    """Return a branch or loop with its blocks rewritten; return another statement unchanged."""
    if isinstance(item, If):
        made = If(item.test, *(_rewrite_block(block, varying, uses) for block in (item.first, item.second)))
        made.joins = item.joins
        return made
    if isinstance(item, Loop):
        loop = Loop(item.count, item.index, _rewrite_block(item.body, varying, uses))
        loop.head, loop.test, loop.carries = _rewrite_block(item.head, varying, uses), item.test, item.carries
        return loop
    return item


class _Select(NamedTuple):
    """Select statement. test: without a leading `not`. yes, no: positions of the operands for test true and false."""

    value: Value
    test: Value
    yes: int
    no: int


def _uniform_select(item: Any, varying: VaryingValues) -> _Select | None:
    """Return the select of a statement that selects vectors by a test equal in all lanes; None for other statements."""
    if not isinstance(item, Define) or item.value.op != "select" or not varying(item.value):
        return None
    test = item.value.args[TEST]
    if test.op == "const" or varying(test):
        return None
    if test.op == "not":
        return _Select(item.value, test.args[0], NO, YES)
    return _Select(item.value, test, YES, NO)


class _Rewriting:
    """Rewriting of one block. at: position of each computed value. writes: positions at which each buffer changes."""

    def __init__(self, items: list[Any], varying: VaryingValues, uses: _Uses) -> None:
        self.items, self.varying, self.uses = items, varying, uses
        self.at = {id(item.value): k for k, item in enumerate(items) if isinstance(item, Define)}
        self.writes: dict[int, list[int]] = {}
        for k, item in enumerate(items):
            for buffer in _written_buffers(item):
                self.writes.setdefault(buffer, []).append(k)

    def run(self) -> list[Any]:
        """Return the statements with branches in place of selects."""
        for k, item in enumerate(self.items):
            first = _uniform_select(item, self.varying)
            if first is not None:
                self.try_branch(k, first)
        return [item for item in self.items if item is not None]

    def try_branch(self, start: int, first: _Select) -> None:
        """Replace a select and later selects with the same test by one branch, if that saves enough."""
        group, end = self.find_group(start, first)
        sides = [self.find_exclusive({(id(s.value), operand[side]) for s, operand in group}, end) for side in range(2)]
        if sum(self.cost(v) for side in sides for v in side.values()) < BRANCH_COST_MIN:
            return
        made = If(first.test, *(self.take(side) for side in sides))
        made.joins = [(s.value, s.value.args[operand[0]], s.value.args[operand[1]]) for s, operand in group]
        self.take({self.at[id(s.value)]: s.value for s, _ in group})
        self.items[end] = made

    def find_group(self, start: int, first: _Select) -> tuple[list[tuple[_Select, tuple[int, int]]], int]:
        """Return the selects that one branch can replace, with their operands, and the position of the last one."""
        group, members, end = [(first, (first.yes, first.no))], {id(first.value)}, start
        for k in range(start + 1, min(start + AHEAD_MAX, len(self.items))):
            item = self.items[k]
            if item is None:
                continue
            if not isinstance(item, Define) or any(id(a) in members for a in item.value.args):
                break
            other = _uniform_select(item, self.varying)
            if other is not None and other.test is first.test:
                group.append((other, (other.yes, other.no)))
                members.add(id(other.value))
                end = k
        return group, end

    def find_exclusive(self, users: set[tuple[int, int]], end: int) -> dict[int, Value]:
        """Return, by position, values that are used only by these operands and can be computed at position `end`."""
        found: dict[int, Value] = {}
        inside: set[int] = set()
        todo: list[int] = []
        queued: set[int] = set()

        def push(values: Iterable[Value]) -> None:
            for value in values:
                k = self.at.get(id(value))
                if k is not None and k not in queued:
                    queued.add(k)
                    heappush(todo, -k)

        for k in {self.at[user] for user, _ in users}:
            push(self.items[k].value.args)
        while todo:  # from the last to the first, so that all users of a value are known before it
            k = -heappop(todo)
            value = self.items[k].value
            known = all(user in users or user[0] in inside for user in self.uses.users.get(id(value), [_OUTSIDE]))
            if known and self.may_move(value, k, end):
                found[k] = value
                inside.add(id(value))
                push(value.args)
        return found

    def may_move(self, value: Value, start: int, end: int) -> bool:
        """Return True if a value can be computed at the later position `end`, because its buffer does not change until
        then."""
        if value.op != "load" or value.attr.is_read_only:
            return True
        writes = self.writes.get(id(value.attr), [])
        next_write = bisect_right(writes, start)
        return next_write == len(writes) or writes[next_write] > end

    def cost(self, value: Value) -> int:
        """Return the assumed cost of a value in vector operations; 0 for a cheap value that is equal in all lanes."""
        if value.op in ELEMENTARY and value.op not in CHEAP:
            return CALL
        if not self.varying(value):
            return 0
        if value.op == "load":
            return GATHER if self.varying(value.args[0]) else 1
        return DIVISION if value.op in ("div", "rem", "sqrt") else 1

    def take(self, values: dict[int, Value]) -> Block:
        """Remove these values from the statements and return them as a block, whose selects are replaced, too."""
        items = []
        for k in sorted(values):
            items.append(self.items[k])
            self.items[k] = None
            del self.at[id(values[k])]
        made = Block()
        made.items = _Rewriting(items, self.varying, self.uses).run()
        return made
