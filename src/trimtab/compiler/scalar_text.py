"""C text of one operation on scalars."""

import math
from collections.abc import Callable
from typing import Any

from trimtab.compiler.c_functions import C_TYPES, LIMITS
from trimtab.compiler.ir import Value, is_float

INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/", "and": "&", "or": "|", "xor": "^"}
COMPARE = {"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}
ELEMENTARY = {"sqrt", "rsqrt", "cbrt", "exp", "exp2", "expm1", "log", "log1p", "tan", "asin", "acos", "atan"}
ELEMENTARY |= {"sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "erf", "erfc", "logistic", "floor", "ceil"}
ELEMENTARY |= {"pow", "atan2", "round_even", "round_away", "sin", "cos", "sincos"}
C_NAMES = {"rem": "fmod"}
SHORT_NAMES = {"population_count": "popcount"}
SHIFTS = {"shift_left": "shl", "shift_right_logical": "shr", "shift_right_arithmetic": "sar"}

Name = Callable[[Value], str]
Use = Callable[[str], str]


def number_literal(number: Any, dtype: str) -> str:
    """A number as C text that reads back to the same bits."""
    if dtype == "bool":
        return "true" if number else "false"
    if is_float(dtype):
        x, suffix = float(number), "f" if dtype == "f32" else ""
        if math.isnan(x):
            return "NAN"
        if math.isinf(x):
            return "INFINITY" if x > 0 else "(-INFINITY)"
        text = repr(x) if dtype == "f64" else repr(number).split("(")[-1].rstrip(")")
        text = text if any(c in text for c in ".en") else text + ".0"
        return f"({text}{suffix})" if text[0] == "-" else text + suffix
    n = int(number)
    if dtype in LIMITS and dtype[0] == "i" and n == -(2 ** (int(dtype[1:]) - 1)):
        return LIMITS[dtype][0]
    suffix = {"i64": "LL", "u64": "ULL", "u32": "U"}.get(dtype, "")
    return f"({n}{suffix})" if n < 0 else f"{n}{suffix}"


def cast_from_int(text: str, dtype: str) -> str:
    """A cast back from int where C computes narrower types in int."""
    return f"({C_TYPES[dtype]})({text})" if dtype in ("i8", "i16", "u8", "u16") else text


def is_safe_divisor(value: Value) -> bool:
    """Whether a known divisor needs no guard."""
    return value.op == "const" and int(value.const) > 0


def elementary_name(op: str, dtype: str) -> str:
    """Name of an elementary function of the runtime header."""
    return f"tt_{C_NAMES.get(op, op)}" + ("f" if dtype == "f32" else "")


def scalar_expression(v: Value, name: Name, use: Use) -> str:
    """The right-hand side that computes a value. use: notes that a helper is called and gives its name."""
    op, a = v.op, [name(x) for x in v.args]
    t = v.args[0].dtype if v.args else v.dtype
    if op in COMPARE:
        return f"{a[0]} {COMPARE[op]} {a[1]}"
    if op == "select":
        return f"{a[0]} ? {a[1]} : {a[2]}"
    if op == "load":
        return f"{name(v.attr)}[{a[0]}]"
    if op == "convert":
        return _scalar_conversion(v, a[0], t, use)
    if op == "bitcast":
        return f"{use(f'tt_bits_{v.dtype}_of_{t}')}({a[0]})"
    if op in ("div", "rem") and not is_float(t):
        if is_safe_divisor(v.args[1]):
            return cast_from_int(f"{a[0]} {'/' if op == 'div' else '%'} {a[1]}", t)
        return f"{use(f'tt_{op}_{t}')}({a[0]}, {a[1]})"
    if op in INFIX:
        return cast_from_int(f"{a[0]} {INFIX[op]} {a[1]}", t)
    if op in SHIFTS:
        return _scalar_shift(v, a, t, use)
    return _scalar_other(v, a, t, use)


def _scalar_other(v: Value, a: list[str], t: str, use: Use) -> str:
    op, single = v.op, "f" if t == "f32" else ""
    if op == "neg":
        return cast_from_int(f"-{a[0]}", t)
    if op == "not":
        return f"!{a[0]}" if t == "bool" else cast_from_int(f"~{a[0]}", t)
    if op == "abs":
        if is_float(t):
            return f"fabs{single}({a[0]})"
        return a[0] if t[0] == "u" else cast_from_int(f"{a[0]} < 0 ? -{a[0]} : {a[0]}", t)
    if op in ("max", "min"):
        return _scalar_extreme(v, a, t, use)
    if op == "is_finite":
        return f"{a[0]} - {a[0]} == 0"
    if op in ("sign", "clz", "population_count"):
        return f"{use(f'tt_{SHORT_NAMES.get(op, op)}_{t}')}({a[0]})"
    if op == "nextafter":
        return f"nextafter{single}({a[0]}, {a[1]})"
    if op in ELEMENTARY or op == "rem":
        return f"{use(elementary_name(op, t))}({', '.join(a)})"
    raise KeyError(op)


def is_known_number(value: Value) -> bool:
    """Whether a value is a known number other than NaN: its extreme with anything needs one comparison."""
    return value.op == "const" and bool(value.const == value.const)


def _scalar_extreme(v: Value, a: list[str], t: str, use: Use) -> str:
    if t == "bool":
        return f"{a[0]} {'|' if v.op == 'max' else '&'} {a[1]}"
    if not is_float(t):
        return f"{a[0]} {'>' if v.op == 'max' else '<'} {a[1]} ? {a[0]} : {a[1]}"
    for x, y, known in ((a[0], a[1], v.args[1]), (a[1], a[0], v.args[0])):
        if is_known_number(known):
            return f"{x} {'<' if v.op == 'max' else '>'} {y} ? {y} : {x}"
    return f"{use(f'tt_{v.op}_{t}')}({a[0]}, {a[1]})"


def _scalar_shift(v: Value, a: list[str], t: str, use: Use) -> str:
    by = v.args[1]
    bits = int(t[1:])
    if by.op != "const" or not 0 <= int(by.const) < bits:
        return f"{use(f'tt_{SHIFTS[v.op]}_{t}')}({a[0]}, {a[1]})"
    if v.op == "shift_right_arithmetic":  # in JAX the top bit is a sign, of unsigned numbers too
        signed = a[0] if t[0] == "i" else f"({C_TYPES['i' + str(bits)]}){a[0]}"
        return (
            f"({C_TYPES[t]})({signed} >> {int(by.const)})"
            if t[0] == "u"
            else cast_from_int(f"{signed} >> {int(by.const)}", t)
        )
    sign = "<<" if v.op == "shift_left" else ">>"
    unsigned = a[0] if t[0] == "u" else f"({C_TYPES['u' + str(bits)]}){a[0]}"
    shifted = f"{unsigned} {sign} {int(by.const)}"
    return f"({C_TYPES[t]})({shifted})" if t[0] == "i" or bits < 32 else shifted


def _scalar_conversion(v: Value, a: str, source: str, use: Use) -> str:
    if is_float(source) and not is_float(v.dtype):
        return f"{use(f'tt_{v.dtype}_of_{source}')}({a})"
    return f"({C_TYPES[v.dtype]}){a}"
