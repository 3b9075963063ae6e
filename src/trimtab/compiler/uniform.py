"""Which values are the same in every run of a batch: those are computed once, and branches on them stay branches."""

from typing import Any

from trimtab.compiler.ir import Block, Define, Emit, If, Local, Loop, Store, Value


class VaryingValues:
    """Ids of the values, buffers, branches and loops that differ between the runs of a batch."""

    def __init__(self, values: set[int], buffers: set[int]) -> None:
        self.values, self.buffers = values, buffers
        self.changed = False

    def __call__(self, thing: Any) -> bool:
        """Whether a value or buffer differs between runs."""
        return id(thing) in self.values or id(thing) in self.buffers

    def add(self, thing: Any, to: set[int]) -> None:
        """This differs between runs."""
        if id(thing) not in to:
            to.add(id(thing))
            self.changed = True

    def value(self, value: Value) -> None:
        """Mark a computed value where its operands differ, or the buffer that it is loaded from does."""
        if any(self(a) for a in value.args) or (value.op == "load" and self(value.attr)):
            self.add(value, self.values)


def find_varying(blocks: list[Block], inputs: list[Any], feedback: list[tuple[Any, Any]]) -> VaryingValues:
    """What differs between runs when these inputs do.

    feedback: (state as it comes in, state as it goes out) of what the caller carries from call to call.
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
    """masked: whether only some of the runs execute this block."""
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
