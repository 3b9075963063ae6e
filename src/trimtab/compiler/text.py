"""C text of each operation, for one number in C and for lanes in C++.

Lanes are vectors (GCC vector extensions) with one run in each lane; truth values are masks. Helpers do the operations
in which plain C differs from JAX: division, shifts, conversion, maximum, minimum. A helper is named tt_NAME for one
number and tv_NAME for lanes.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from trimtab.compiler.ir import TYPES, is_float
from trimtab.compiler.ranges import never_wraps
from trimtab.compiler.values import Buffer, Value
from trimtab.core.errors import InputError

C_TYPES = {
    "bool": "bool",
    "i8": "int8_t",
    "i16": "int16_t",
    "i32": "int32_t",
    "i64": "int64_t",
    "u8": "uint8_t",
    "u16": "uint16_t",
    "u32": "uint32_t",
    "u64": "uint64_t",
    "f32": "float",
    "f64": "double",
}
assert set(C_TYPES) == set(TYPES)
LANE_TYPES = ("bool", "i32", "i64", "u32", "u64", "f32", "f64")
HALF = ("i32", "u32", "f32")
"""Types of 32 bits."""
LIMITS = {t: (f"{C_TYPES[t][:-2].upper()}_MIN", f"{C_TYPES[t][:-2].upper()}_MAX") for t in C_TYPES if t[0] in "iu"}

Name = Callable[[Value], str]
Use = Callable[[str], str]


def number_literal(number: Any, dtype: str) -> str:
    """Return the C literal of a number. A compiler reads it as exactly the same bits."""
    if dtype == "bool":
        return "true" if number else "false"
    if is_float(dtype):
        x, suffix = float(number), "f" if dtype == "f32" else ""
        if math.isnan(x):
            return "(-NAN)" if math.copysign(1.0, x) < 0 else "NAN"
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


def vector_type(t: str) -> str:
    """Return the vector type of a value in lanes, as `runtime/lanes.h` defines it. Truth values are masks."""
    return "vmask" if t == "bool" else f"v{t}" if t in HALF else f"w{t}"


def check_lane_type(dtype: str) -> None:
    """Raise InputError for a type that lanes do not support. The caller may then write scalar code."""
    if dtype not in LANE_TYPES:
        raise InputError(
            "lanes", f"numbers of type {dtype} are not supported in lanes", choices=LANE_TYPES, fix="lanes=1"
        )


def lane_mask(mask: str, dtype: str) -> str:
    """Return a mask converted to the width of the numbers that it selects."""
    return mask if dtype == "bool" else f"MASK_{32 if dtype in HALF else 64}({mask})"


class _Operation(NamedTuple):
    """Operation: the value to compute and the texts of its operands. use: records that a helper is called."""

    value: Value
    operands: list[str]
    use: Use
    lanes: bool

    @property
    def t(self) -> str:
        """Return the type of the operands."""
        return self.value.args[0].dtype if self.value.args else self.value.dtype

    def type(self, t: str) -> str:
        """Return the C type of a number or, in lanes, of a vector."""
        return vector_type(t) if self.lanes else C_TYPES[t]

    def call(self, name: str, *operands: str) -> str:
        """Return the C text that calls a helper."""
        return f"{self.use(('tv_' if self.lanes else 'tt_') + name)}({', '.join(operands or self.operands)})"

    def narrow(self, text: str) -> str:
        """Return the text, cast to the operands' type if that type is narrower than int. C computes in int or wider."""
        return f"({C_TYPES[self.t]})({text})" if self.t in ("i8", "i16", "u8", "u16") else text


def expression(v: Value, name: Name, use: Use, varies: Callable[[Any], bool] | None = None) -> str:
    """Return the C expression that computes a value.

    Args:
        v: value to compute.
        name: returns the text of an operand; in lanes a vector, except for an index.
        use: records that a helper is called, and returns its name.
        varies: returns True if a value or buffer differs between lanes; None for scalar code.
    """
    if varies is not None:
        check_lane_type(v.dtype)
    if v.op == "load":
        return _load(v, name, use, varies)
    return OPERATIONS[v.op](_Operation(v, [name(x) for x in v.args], use, varies is not None))


def _load(v: Value, name: Any, use: Use, varies: Callable[[Any], bool] | None) -> str:
    buffer, index = v.attr, v.args[0]
    assert isinstance(buffer, Buffer)
    if varies is None or not varies(index):
        return f"{name(buffer)}[{name(index)}]"
    kind = "pick" if varies(buffer) else "take"
    return f"{use(f'tv_{kind}_{v.dtype}')}({name(buffer)}, {name(index)})"


COMPARE = {"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}
INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/", "and": "&", "or": "|", "xor": "^", "rem": "%"}
SHIFTS = {"shift_left": ("shl", "<<"), "shift_right_logical": ("shr", ">>"), "shift_right_arithmetic": ("sar", ">>")}


def _comparison(o: _Operation) -> str:
    first, second = o.operands
    if o.lanes and o.t == "bool":  # true is -1 in a mask
        first, second = second, first
    text = f"{first} {COMPARE[o.value.op]} {second}"
    if not o.lanes:
        return text
    return _full_mask(o, text)


def _full_mask(o: _Operation, text: str) -> str:
    """Return a comparison of vectors as a mask."""
    return f"(vmask)({text})" if o.t == "bool" else f"MASK_OF_{32 if o.t in HALF else 64}({text})"


def _infix(o: _Operation) -> str:
    first, second = o.operands
    sign, wraps = INFIX[o.value.op], o.value.op in ("add", "sub", "mul")
    if wraps and not o.lanes and o.t in ("i32", "i64", "u16") and not never_wraps(o.value):
        # computed unsigned, so that it wraps without -fwrapv, also for uint16_t, which C multiplies as int
        wide = "uint64_t" if o.t == "i64" else "uint32_t"
        return f"({C_TYPES[o.t]})(({wide}){first} {sign} ({wide}){second})"
    return o.narrow(f"{first} {sign} {second}")


def _division(o: _Operation) -> str:
    op, by = o.value.op, o.value.args[1]
    if is_float(o.t):
        return _infix(o) if op == "div" else _elementary(o)
    return _infix(o) if by.op == "const" and int(by.const) > 0 else o.call(f"{op}_{o.t}")


def _shift(o: _Operation) -> str:
    by, bits = o.value.args[1], int(o.t[1:])
    helper, sign = SHIFTS[o.value.op]
    if by.op != "const" or not 0 <= int(by.const) < bits:
        return o.call(f"{helper}_{o.t}")
    own = "i" if helper == "sar" else "u"  # JAX treats the top bit as a sign, also of unsigned numbers
    if helper == "shl" and bits < 32 and not o.lanes:  # the result may not fit int, to which C converts
        return f"({C_TYPES[o.t]})((uint32_t){o.operands[0]} {sign} {int(by.const)})"
    if o.t[0] == own:
        return o.narrow(f"{o.operands[0]} {sign} {int(by.const)}")
    return f"({o.type(o.t)})(({o.type(f'{own}{bits}')}){o.operands[0]} {sign} {int(by.const)})"


def _select(o: _Operation) -> str:
    test, yes, no = o.operands
    return f"{lane_mask(test, o.value.dtype) if o.lanes else test} ? {yes} : {no}"


def _conversion(o: _Operation) -> str:
    to, (a,) = o.value.dtype, o.operands
    if o.lanes:
        check_lane_type(o.t)
    if is_float(o.t) and not is_float(to):
        return o.call(f"{to}_of_{o.t}")
    if not o.lanes:
        return f"tt_single({a})" if (o.t, to) == ("f64", "f32") else f"({C_TYPES[to]}){a}"
    if o.t == "bool":
        return f"{lane_mask(a, to)} ? {o.call(f'splat_{to}', '1')} : ({vector_type(to)}){{}}"
    return f"__builtin_convertvector({a}, {vector_type(to)})"


def _bitcast(o: _Operation) -> str:
    return f"({vector_type(o.value.dtype)}){o.operands[0]}" if o.lanes else o.call(f"bits_{o.value.dtype}_of_{o.t}")


def _negation(o: _Operation) -> str:
    (a,) = o.operands
    if o.t in ("i32", "i64") and not o.lanes:  # so that INT_MIN wraps without -fwrapv
        return f"({C_TYPES[o.t]})(0 - (u{C_TYPES[o.t]}){a})"
    return o.narrow(f"-{a}")


def _inversion(o: _Operation) -> str:
    return f"!{o.operands[0]}" if o.t == "bool" and not o.lanes else o.narrow(f"~{o.operands[0]}")


def _absolute(o: _Operation) -> str:
    (a,) = o.operands
    if not is_float(o.t):
        return a if o.t[0] == "u" else o.narrow(f"{a} < 0 ? {_negation(o)} : {a}")
    if o.lanes and o.t == "f32":
        return f"(vf32)((vu32){a} & {o.call('splat_u32', '0x7fffffffU')})"
    if o.lanes:
        return f"(wf64)((wu64){a} & {o.call('splat_u64', '0x7fffffffffffffffULL')})"
    return f"fabs{float_suffix(o.t)}({a})"


def _extreme(o: _Operation) -> str:
    op, (a, b) = o.value.op, o.operands
    if o.t == "bool":
        return f"{a} {'|' if op == 'max' else '&'} {b}"
    if not is_float(o.t):
        return f"{a} {'>' if op == 'max' else '<'} {b} ? {a} : {b}"
    for x, y, other in ((a, b, o.value.args[1]), (b, a, o.value.args[0])):
        if other.op == "const" and other.const == other.const:  # known and not NaN: one comparison is enough
            replaced = other.const == 0 and np.signbit(other.const) == (op == "min")  # replace the other zero, too
            return f"{x} {'<' if op == 'max' else '>'}{'=' if replaced else ''} {y} ? {y} : {x}"
    return o.call(f"{op}_{o.t}")


def _is_finite(o: _Operation) -> str:
    text = f"{o.operands[0]} - {o.operands[0]} == 0"
    return _full_mask(o, text) if o.lanes else text


def _sign(o: _Operation) -> str:
    if not o.lanes:
        return o.call(f"sign_{o.t}")
    (a,) = o.operands
    one = o.call(f"splat_{o.t}", "1")
    below = a if o.t[0] == "u" else f"({a} < 0 ? {o.call(f'splat_{o.t}', '-1')} : {a})"
    return f"{a} > 0 ? {one} : {below}"


def _elementary(o: _Operation) -> str:
    name = {"rem": "fmod"}.get(o.value.op, o.value.op)
    if o.lanes and o.t == "f32":
        return single_precision_lanes(name, o.operands, o.use)
    return f"{o.use(f'ttv_{name}' if o.lanes else f'tt_{name}{float_suffix(o.t)}')}({', '.join(o.operands)})"


def single_precision_lanes(name: str, operands: list[str], use: Use) -> str:
    """Return the C text that calls a function for vectors of float. Results have the same bits as in scalar code."""
    use(f"ttv_{name}")
    return f"{use(f'tv_{name}_f32')}({', '.join(operands)})"


def float_suffix(t: str) -> str:
    """Return the suffix of C numbers and C functions of this type: "f" for float, else empty."""
    return "f" if t == "f32" else ""


ELEMENTARY = ("sqrt", "rsqrt", "cbrt", "exp", "exp2", "expm1", "log", "log1p", "tan", "asin", "acos", "atan", "sinh")
ELEMENTARY += ("cosh", "tanh", "asinh", "acosh", "atanh", "erf", "erfc", "logistic", "floor", "ceil", "pow", "atan2")
ELEMENTARY += ("round_even", "round_away", "sin", "cos", "sincos")
OPERATIONS: dict[str, Callable[[_Operation], str]] = {
    **dict.fromkeys(COMPARE, _comparison),
    **dict.fromkeys(INFIX, _infix),
    **dict.fromkeys(("div", "rem"), _division),
    **dict.fromkeys(SHIFTS, _shift),
    **dict.fromkeys(("max", "min"), _extreme),
    **dict.fromkeys(ELEMENTARY, _elementary),
    "select": _select,
    "convert": _conversion,
    "bitcast": _bitcast,
    "neg": _negation,
    "not": _inversion,
    "abs": _absolute,
    "is_finite": _is_finite,
    "sign": _sign,
    "clz": lambda o: o.call(f"clz_{o.t}"),
    "population_count": lambda o: o.call(f"popcount_{o.t}"),
    "nextafter": lambda o: o.call(f"nextafter_{o.t}"),
}
"""Operation -> function that returns its C text. A load is written separately, as its operand is a buffer."""
