"""Arithmetic on known numbers, and identities that are exact for every input: NaN, infinities, signed zeros.

A product with zero is not folded: it is NaN where the other factor is not finite.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from trimtab.compiler.ir import TYPES, Builder, Value, is_float

COMPARE: dict[str, Callable[[Any, Any], Any]] = {
    "eq": np.equal,
    "ne": np.not_equal,
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
}
PLAIN: dict[str, Callable[..., Any]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "neg": np.negative,
    "abs": np.abs,
    "max": np.maximum,
    "min": np.minimum,
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "xor": np.bitwise_xor,
    "not": np.invert,
    "floor": np.floor,
    "ceil": np.ceil,
    "sqrt": np.sqrt,
}


def fold(b: Builder, op: str, args: tuple[Value, ...], dtype: str, attr: Any) -> Value | None:
    """The value that an operation is known to have, or None."""
    if op == "select":
        return _fold_select(b, args)
    if args and all(a.op == "const" for a in args):
        return _fold_constants(b, op, [a.const for a in args], dtype)
    if op in ("eq", "ne", "le", "ge") and args[0].dtype == "bool" and args[1].op == "const":
        return _fold_comparison(b, op, args[0], bool(args[1].const))
    if op == "convert" and args[0].dtype == dtype:
        return args[0]
    if op == "not" and args[0].op == "not":
        return args[0].args[0]
    if len(args) == 2:
        return _fold_identity(b, op, args[0], args[1], dtype)
    return None


def _fold_constants(b: Builder, op: str, numbers: list[Any], dtype: str) -> Value | None:
    with np.errstate(all="ignore"):
        if op in COMPARE:
            return b.const(COMPARE[op](*numbers), "bool")
        if op in PLAIN and not (op in ("floor", "ceil", "sqrt") and not is_float(dtype)):
            return b.const(PLAIN[op](*numbers), dtype)
        if op == "div" and is_float(dtype):
            return b.const(np.divide(*numbers), dtype)
        if op in ("div", "rem") and not is_float(dtype) and int(numbers[1]) > 0 and int(numbers[0]) >= 0:
            found = divmod(int(numbers[0]), int(numbers[1]))
            return b.const(found[op == "rem"], dtype)
        if op == "convert":
            return _convert_constant(b, numbers[0], dtype)
    return None


def _convert_constant(b: Builder, number: Any, dtype: str) -> Value | None:
    if np.issubdtype(type(number), np.floating) and not is_float(dtype) and dtype != "bool":
        limits = np.iinfo(TYPES[dtype])
        if np.isnan(number):
            return b.const(0, dtype)
        number = int(min(max(float(number), float(limits.min)), float(limits.max)))
        number = min(max(number, int(limits.min)), int(limits.max))
        return b.const(np.asarray(number, TYPES[dtype]), dtype)
    return b.const(number, dtype)


def _fold_select(b: Builder, args: tuple[Value, ...]) -> Value | None:
    test, yes, no = args
    if test.op == "const":
        return yes if test.const else no
    if yes is no:
        return yes
    if yes.dtype == "bool" and yes.op == no.op == "const":
        return test if yes.const else b.op("not", test, dtype="bool")
    return None


def _fold_comparison(b: Builder, op: str, value: Value, wanted: bool) -> Value | None:
    if op in ("eq", "ne"):
        return value if (op == "eq") == wanted else b.op("not", value, dtype="bool")
    if op == "ge" and wanted:
        return value
    if op == "le" and not wanted:
        return b.op("not", value, dtype="bool")
    return None


def _is_number(value: Value, number: float) -> bool:
    """Whether a value is exactly this number, the sign of a zero included."""
    if value.op != "const" or value.const != number:
        return False
    return not is_float(value.dtype) or np.signbit(value.const) == np.signbit(np.float64(number))


def _fold_identity(b: Builder, op: str, x: Value, y: Value, dtype: str) -> Value | None:
    float_ = is_float(dtype)
    zero = -0.0 if float_ else 0
    if op == "add":
        return y if _is_number(x, zero) else x if _is_number(y, zero) else None
    if op == "mul":
        if not float_ and (_is_number(x, 0) or _is_number(y, 0)):
            return b.const(0, dtype)
        return y if _is_number(x, 1) else x if _is_number(y, 1) else None
    if (op == "sub" and _is_number(y, 0)) or (op == "div" and _is_number(y, 1)):
        return x
    if op == "rem" and not float_ and _is_number(y, 1):
        return b.const(0, dtype)
    if op in ("shift_left", "shift_right_logical", "shift_right_arithmetic") and _is_number(y, 0):
        return x
    if dtype == "bool" and op in ("and", "or"):
        for one, other in ((x, y), (y, x)):
            if one.op == "const":
                return other if bool(one.const) == (op == "and") else one
        return x if x is y else None
    of_truth = x.op == "convert" and x.args[0].dtype == "bool" and not is_float(x.dtype)
    if op in ("eq", "ne") and of_truth and y.op == "const" and int(y.const) in (0, 1):
        return _fold_comparison(b, op, x.args[0], bool(y.const))
    return None
