"""Replacement of 64-bit integer operations by 32-bit operations, where only the low 32 bits of the result are read.

An example is the position in a ring buffer, (instant - delay) & 63, whose instant has 64 bits. The low bits of a sum,
difference, product or bitwise operation depend only on the low bits of its operands.
"""

from typing import TYPE_CHECKING

import numpy as np

from trimtab.compiler.values import Value

if TYPE_CHECKING:
    from trimtab.compiler.ir import Builder

OPERATIONS = ("add", "sub", "mul", "and", "or", "xor", "not", "neg")
"""Operations whose low bits depend only on the low bits of their operands."""
NARROW, WIDE = ("i32", "u32"), ("i64", "u64")
LARGEST = 8
"""Maximum number of operations behind one result that are changed from 64 to 32 bits."""


def narrow_integer(b: "Builder", x: Value, dtype: str) -> Value | None:
    """Return x computed in 32 bits, or None if that is not possible or not cheaper.

    The computation in 32 bits counts as cheaper if at least as many operands were widened to 64 bits as must now be cut
    to 32 bits.
    """
    if dtype not in NARROW or x.dtype not in WIDE or x.op not in OPERATIONS:
        return None
    seen: dict[int, Value] = {}
    todo = [x]
    while todo:
        value = todo.pop()
        if id(value) in seen:
            continue
        seen[id(value)] = value
        todo += value.args if _is_transparent(value) else ()
        if sum(map(_is_transparent, seen.values())) > LARGEST:
            return None
    leaves = [v for v in seen.values() if v.op != "const" and not _is_transparent(v)]
    widened = sum(map(_is_widened, leaves))
    return _low_bits(b, x, dtype) if 0 < widened >= len(leaves) - widened else None


def _is_transparent(value: Value) -> bool:
    """Return True if the low bits of a value depend only on the low bits of its operands."""
    same_width = value.op == "convert" and value.args[0].dtype in WIDE
    return value.dtype in WIDE and (value.op in OPERATIONS or same_width)


def _is_widened(value: Value) -> bool:
    """Return True if a value is an integer or truth value of at most 32 bits, converted to 64."""
    return value.op == "convert" and value.args[0].dtype[0] in "biu" and value.args[0].dtype not in WIDE


def _low_bits(b: "Builder", value: Value, dtype: str) -> Value:
    if value.op == "const":
        return b.const(np.asarray(value.const).astype(np.uint32), dtype)
    if value.op == "convert" and _is_transparent(value):
        return _low_bits(b, value.args[0], dtype)
    if _is_transparent(value):
        return b.op(value.op, *[_low_bits(b, a, dtype) for a in value.args], dtype=dtype)
    return b.op("convert", value.args[0] if _is_widened(value) else value, dtype=dtype)
