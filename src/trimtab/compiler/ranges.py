"""Integer bounds of values, derived from their operations. They show which tests have a constant result."""

import numpy as np

from trimtab.compiler.values import Value

OPERATIONS = ("lt", "le", "gt", "ge", "eq", "ne", "max", "min", "and")
DEPTH = 6
"""Maximum depth of operations from which a bound is derived."""
LONGEST_TABLE = 4096
"""Maximum number of elements of a table that is examined, or computed, while a program is lowered."""


def certain_result(op: str, args: tuple[Value, ...]) -> bool | int | None:
    """Return the result of an integer operation if the bounds of its operands decide it, else None.

    The result is a bool for a comparison. For max, min and "and" it is the index of the operand that is the result.
    """
    if len(args) != 2 or op not in OPERATIONS:
        return None
    x, y = (integer_bounds(a) for a in args)
    if x is None or y is None:
        return None
    below, above = x[1] < y[0], x[0] > y[1]
    at_most, at_least = x[1] <= y[0], x[0] >= y[1]
    if op == "and":
        mask = y[1]
        return 0 if y[0] == mask and mask & (mask + 1) == 0 and x[0] >= 0 and x[1] <= mask else None
    if op in ("max", "min"):
        first, second = (at_least, at_most) if op == "max" else (at_most, at_least)
        return 0 if first else 1 if second else None
    yes, no = {
        "lt": (below, at_least),
        "le": (at_most, above),
        "gt": (above, at_most),
        "ge": (at_least, below),
        "eq": (False, below or above),
        "ne": (below or above, False),
    }[op]
    return True if yes else False if no else None


def integer_bounds(v: Value, depth: int = DEPTH) -> tuple[int, int] | None:
    """Return the smallest and the largest possible value of an integer; None if the value is not an integer."""
    if v.dtype[0] not in "iu":
        return None
    if v.op == "const":
        return int(v.const), int(v.const)
    if v.op == "load" and v.attr.data is not None and 0 < v.attr.size <= LONGEST_TABLE:
        return int(np.min(v.attr.data)), int(np.max(v.attr.data))
    if v.op == "index":
        return 0, max(v.attr - 1, 0) if isinstance(v.attr, int) else 2**31 - 1
    found = _bounds_of_operation(v, depth - 1) if depth and v.args else None
    return _type_bounds(v.dtype) if found is None else found


def never_wraps(v: Value) -> bool:
    """Return True if v is a sum, difference or product of integers that cannot exceed the range of its type."""
    return v.op in ("add", "sub", "mul") and _bounds_of_operation(v, DEPTH - 1) is not None


def _type_bounds(dtype: str) -> tuple[int, int]:
    bits = int(dtype[1:])
    return (0, 2**bits - 1) if dtype[0] == "u" else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


def _bounds_of_operation(v: Value, depth: int) -> tuple[int, int] | None:
    if v.op == "convert" and v.args[0].dtype == "bool":
        return 0, 1
    if v.op == "select":
        return _join(integer_bounds(v.args[1], depth), integer_bounds(v.args[2], depth))
    bounds = [integer_bounds(a, depth) for a in v.args]
    if v.op == "and":
        masks = [high for low, high in filter(None, bounds) if low >= 0]
        return (0, min(masks)) if masks else None
    if v.op in ("min", "max"):
        return _bounds_of_extreme(v.op, bounds)
    if v.op == "rem" and bounds[1] and bounds[1][0] == bounds[1][1] > 0:
        most = bounds[1][1] - 1
        return (0 if bounds[0] and bounds[0][0] >= 0 else -most), most
    if None in bounds:
        return None
    (low, high), *others = (b for b in bounds if b)
    if v.op == "convert":
        return _inside(v, low, high)
    if v.op == "add":
        return _inside(v, low + others[0][0], high + others[0][1])
    if v.op == "sub":
        return _inside(v, low - others[0][1], high - others[0][0])
    if v.op == "mul":
        ends = [x * y for x in (low, high) for y in others[0]]
        return _inside(v, min(ends), max(ends))
    return None


def _bounds_of_extreme(op: str, bounds: list[tuple[int, int] | None]) -> tuple[int, int] | None:
    """Return the bounds of a minimum or maximum from the bounds of its operands."""
    if None in bounds:
        return None
    first, second = (b for b in bounds if b)
    choose = min if op == "min" else max
    return choose(first[0], second[0]), choose(first[1], second[1])


def _join(x: tuple[int, int] | None, y: tuple[int, int] | None) -> tuple[int, int] | None:
    return (min(x[0], y[0]), max(x[1], y[1])) if x and y else None


def _inside(v: Value, low: int, high: int) -> tuple[int, int] | None:
    """Return these bounds if they are within the range of v's type, else None."""
    least, most = _type_bounds(v.dtype)
    return (low, high) if least <= low and high <= most else None
