"""Removes what no result needs."""

from typing import Any

from trimtab.compiler.ir import Block, Buffer, Define, Emit, If, Local, Loop, Store, Value


class _NeededValues:
    """Values and buffers that results need, found by following uses backwards."""

    def __init__(self) -> None:
        self.values: set[int] = set()
        self.buffers: set[int] = set()
        self.stores: dict[int, list[tuple[Store, list[Any]]]] = {}
        self.made: dict[int, list[Value]] = {}
        self.todo: list[Value] = []

    def collect_uses(self, block: Block, around: list[Any]) -> None:
        """Note who writes which buffer, and what each value needs besides its operands."""
        for item in block.items:
            if isinstance(item, Define):
                self.made[id(item.value)] = [*item.value.args, *_enclosing_tests(around)]
            elif isinstance(item, Store):
                self.stores.setdefault(id(item.buffer), []).append((item, around))
            elif isinstance(item, Emit):
                for value in [*item.values, *_enclosing_tests(around)]:
                    self.value(value)
            elif isinstance(item, If):
                for joined, x, y in item.joins:
                    self.made[id(joined)] = [x, y, item.test, *_enclosing_tests(around)]
                inner = [*around, item]
                self.collect_uses(item.first, inner)
                self.collect_uses(item.second, inner)
            elif isinstance(item, Loop):
                inner = [*around, item]
                for variable, start, next_ in item.carries:
                    self.made[id(variable)] = [start, next_, *_enclosing_tests(inner)]
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
            for needed in self.made.get(id(value), value.args):
                self.value(needed)
            if value.op == "load":
                self.buffer(value.attr)


def _enclosing_tests(around: list[Any]) -> list[Value]:
    return [item.test for item in around if item.test is not None]


def prune(blocks: list[Block], results: list[Value], buffers: list[Buffer]) -> set[int]:
    """Keep in the blocks only what the results and these buffers need; returns ids of the values and buffers kept."""
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
    kept: list[Any] = []
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
            kept.append(item)
    block.items = kept
