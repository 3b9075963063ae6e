"""Width of the numbers in lanes: a program of 32-bit numbers is computed in twice as many lanes as one of doubles."""

from collections.abc import Iterable
from typing import Any

from trimtab.compiler.analysis import VaryingValues
from trimtab.compiler.ir import Block, Define, If, Local, Loop, is_float
from trimtab.compiler.text import COMPARE, HALF
from trimtab.compiler.values import Value

SIMPLE = {*COMPARE, "add", "sub", "mul", "neg", "select", "convert"}
"""Operations on 64-bit numbers that a program of 32-bit numbers may contain."""
RARE = 0.03
"""Largest fraction of operations on 64-bit numbers in a program that counts as one of 32-bit numbers."""


def has_half_width(blocks: list[Block], varying: VaryingValues, inputs: Iterable[Any]) -> bool:
    """Return True if nearly all numbers that differ between lanes have 32 bits. inputs: values and buffers."""
    kept = [thing.dtype for thing in inputs if varying(thing)]
    count = wide = 0
    for item in _items(blocks):
        if isinstance(item, If):
            kept += [joined.dtype for joined, _, _ in item.joins if varying(joined)]
        elif isinstance(item, Loop):
            kept += [variable.dtype for variable, _, _ in item.carries if varying(variable)]
        elif isinstance(item, Local) and varying(item.buffer):
            kept.append(item.buffer.dtype)
        elif isinstance(item, Define) and varying(item.value):
            count += 1
            if not _is_half(item.value):
                wide += 1
                if not _is_simple(item.value):
                    return False
    return all(t in HALF or t == "bool" for t in kept) and wide <= RARE * count


def _items(blocks: Iterable[Block]) -> Iterable[Any]:
    """Yield all statements of these blocks, nested blocks included."""
    for item in (item for block in blocks for item in block.items):
        yield item
        if isinstance(item, If):
            yield from _items([item.first, item.second])
        elif isinstance(item, Loop):
            yield from _items([item.head, item.body])


def _is_half(value: Value) -> bool:
    return all(t in HALF or t == "bool" for t in (value.dtype, *(a.dtype for a in value.args)))


def _is_simple(value: Value) -> bool:
    if value.op == "convert" and is_float(value.args[0].dtype) and not is_float(value.dtype):
        return False
    return value.op in SIMPLE
