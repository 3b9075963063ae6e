"""Text of each operation, stated once for one number in C and for lanes in C++, and of the helpers that it calls.

Lanes are GCC vector extensions: one run in each, truth values as masks of 64 bits. A helper is there where plain C
differs from JAX: division, shifts, conversion, extremes. It is named tt_NAME for one number and tv_NAME over lanes.
"""

import math
import re
from collections.abc import Callable
from typing import Any, NamedTuple

from trimtab.compiler.ir import TYPES, Buffer, Value, is_float
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
"""Types whose lanes are half as wide as those of a mask."""
LIMITS = {t: (f"{C_TYPES[t][:-2].upper()}_MIN", f"{C_TYPES[t][:-2].upper()}_MAX") for t in C_TYPES if t[0] in "iu"}

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


def vector_type(t: str) -> str:
    """Type of a value over lanes; truth values are masks of 64-bit lanes."""
    return "vi64" if t == "bool" else f"v{t}"


def check_lane_type(dtype: str) -> None:
    """Refuse numbers that lanes don't carry; the caller falls back to scalar code."""
    if dtype not in LANE_TYPES:
        raise InputError(
            "lanes", f"numbers of type {dtype} are not carried in lanes", choices=LANE_TYPES, fix="lanes=1"
        )


def lane_mask(mask: str, dtype: str) -> str:
    """A mask as wide as the numbers that it selects."""
    return f"__builtin_convertvector({mask}, vi32)" if dtype in HALF else mask


class _Operation(NamedTuple):
    """A value to be computed, and the texts of its operands. use: notes that a helper is called, and gives its name."""

    value: Value
    operands: list[str]
    use: Use
    lanes: bool

    @property
    def t(self) -> str:
        """Type of the operands."""
        return self.value.args[0].dtype if self.value.args else self.value.dtype

    def type(self, t: str) -> str:
        """Type of a number, or of such numbers over lanes."""
        return vector_type(t) if self.lanes else C_TYPES[t]

    def call(self, name: str, *operands: str) -> str:
        """A call of a helper."""
        return f"{self.use(('tv_' if self.lanes else 'tt_') + name)}({', '.join(operands or self.operands)})"

    def narrow(self, text: str) -> str:
        """A cast back from int, in which C computes narrower types."""
        return f"({C_TYPES[self.t]})({text})" if self.t in ("i8", "i16", "u8", "u16") else text


def expression(v: Value, name: Name, use: Use, varies: Callable[[Any], bool] | None = None) -> str:
    """The right-hand side that computes a value.

    Args:
        v: the value.
        name: text of an operand; over lanes as a vector, except of an index.
        use: notes that a helper is called, and gives its name.
        varies: over lanes, whether something differs between them; None for one number.
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
    """A comparison over lanes as a mask of 64 bits."""
    return f"__builtin_convertvector({text}, vi64)" if o.t in HALF else f"(vi64)({text})"


def _infix(o: _Operation) -> str:
    first, second = o.operands
    return o.narrow(f"{first} {INFIX[o.value.op]} {second}")


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
    own = "i" if helper == "sar" else "u"  # in JAX the top bit is a sign, of unsigned numbers too
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
        return f"({C_TYPES[to]}){a}"
    if o.t == "bool":
        return f"{lane_mask(a, to)} ? {o.call(f'splat_{to}', '1')} : (v{to}){{}}"
    return f"__builtin_convertvector({a}, v{to})"


def _bitcast(o: _Operation) -> str:
    return f"({vector_type(o.value.dtype)}){o.operands[0]}" if o.lanes else o.call(f"bits_{o.value.dtype}_of_{o.t}")


def _negation(o: _Operation) -> str:
    (a,) = o.operands
    if o.t in ("i32", "i64") and not o.lanes:  # of the least number too, without -fwrapv
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
        return f"(vf64)((vu64){a} & {o.call('splat_u64', '0x7fffffffffffffffULL')})"
    return f"fabs{_suffix(o.t)}({a})"


def _extreme(o: _Operation) -> str:
    op, (a, b) = o.value.op, o.operands
    if o.t == "bool":
        return f"{a} {'|' if op == 'max' else '&'} {b}"
    if not is_float(o.t):
        return f"{a} {'>' if op == 'max' else '<'} {b} ? {a} : {b}"
    for x, y, other in ((a, b, o.value.args[1]), (b, a, o.value.args[0])):
        if other.op == "const" and other.const == other.const:  # known and not NaN: one comparison is enough
            return f"{x} {'<' if op == 'max' else '>'} {y} ? {y} : {x}"
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


def _nextafter(o: _Operation) -> str:
    return o.call(f"nextafter_{o.t}") if o.lanes else f"nextafter{_suffix(o.t)}({', '.join(o.operands)})"


def _elementary(o: _Operation) -> str:
    name = {"rem": "fmod"}.get(o.value.op, o.value.op)
    if o.lanes and o.t == "f32":
        return single_precision_lanes(name, o.operands, o.use)
    return f"{o.use(f'ttv_{name}' if o.lanes else f'tt_{name}{_suffix(o.t)}')}({', '.join(o.operands)})"


def single_precision_lanes(name: str, operands: list[str], use: Use) -> str:
    """A call of the C library's function for float, one lane after the other: the bits are those of one number."""
    use(f"tt_{name}f")
    return f"{use(f'tv_{name}_f32')}({', '.join(operands)})"


def _suffix(t: str) -> str:
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
    "nextafter": _nextafter,
}
"""Operation -> its text; a load is written apart, for its operand is a buffer."""

_TWO_OPERANDS = {
    "div": "return b == 0 ? (T)-1 : SIGNED b == (T)-1 ? (T)(0u - (U)a) : ELSE (T)(a / b);",
    "rem": "return b == 0 ? a : SIGNED b == (T)-1 ? (T)0 : ELSE (T)(a % b);",
    "shl": "return (U)b < BITS ? (T)((U)a << b) : (T)0;",
    "shr": "return (U)b < BITS ? (T)((U)a >> b) : (T)0;",
    "sar": "return (T)((S)a >> ((U)b < BITS ? b : (T)(BITS - 1)));",
}
_ONE_OPERAND = {
    "sign": "return (T)(a > 0 ? 1 : a < 0 ? -1 : ZERO);",
    "clz": "int n = BITS; U x = (U)a; while (x) { x = (U)(x >> 1); n--; } return (T)n;",
    "popcount": "int n = 0; U x = (U)a; while (x) { x = (U)(x & (x - 1)); n++; } return (T)n;",
}


def helper_text(name: str) -> str:
    """The text of one helper, e.g. tt_div_i32, tv_max_f64; KeyError where there is none of that name."""
    return _lane_helper(name) if name.startswith("tv_") else _scalar_helper(name)


def _scalar_helper(name: str) -> str:
    if match := re.fullmatch(r"tt_(bits_)?(\w+)_of_(\w+)", name):
        bits, to, source = match.groups()
        T, S = C_TYPES[to], C_TYPES[source]
        body = "T y; memcpy(&y, &x, sizeof y); return y;".replace("T", T) if bits else _saturation(to, source)
        return _function_text(T, name, f"{S} x", body)
    match = re.fullmatch(r"tt_([a-z]+)_([iuf]\d+)", name)
    if not match:
        raise KeyError(name)
    op, t = match.groups()
    T = C_TYPES[t]
    if op in ("max", "min"):
        sign = ">" if op == "max" else "<"
        test = f"a {sign} b || a != a" if is_float(t) else f"a {sign} b"
        return _function_text(T, name, f"{T} a, {T} b", f"return {test} ? a : b;")
    bits = str(int(t[1:]))
    words = {
        "T": T,
        "S": T.removeprefix("u"),
        "U": C_TYPES[f"u{bits}"] if t[0] != "f" else T,
        "BITS": bits,
        "ZERO": "a" if t[0] == "f" else "0",
    }
    body = _TWO_OPERANDS.get(op) or _ONE_OPERAND[op]
    body = re.sub(r"SIGNED (.*?) : ELSE", r"\1 :" if t[0] == "i" else "", body)
    body = re.sub(r"\b(T|S|U|BITS|ZERO)\b", lambda m: words[m[1]], body)
    if t[0] == "u":
        body = body.replace(" : a < 0 ? -1", "")
    return _function_text(T, name, f"{T} a, {T} b" if op in _TWO_OPERANDS else f"{T} a", body)


def _saturation(to: str, source: str) -> str:
    """A number of floating point as a whole one: towards zero, the nearest there is, 0 for NaN."""
    low, high = LIMITS[to] if to[0] == "i" else ("0", LIMITS[to][1])
    power, suffix = int(to[1:]) - (to[0] == "i"), _suffix(source)
    below = f"x <= -0x1p{power}{suffix}" if to[0] == "i" else f"x <= 0.0{suffix}"
    return f"return x != x ? 0 : {below} ? {low} : x >= 0x1p{power}{suffix} ? {high} : ({C_TYPES[to]})x;"


_SATURATION_OVER_LANES = """\
x = x == x ? x : (vf64){}; vf64 low = tv_splat_f64(-2147483648.0), high = tv_splat_f64(2147483647.0);
    x = x < low ? low : x; x = x > high ? high : x; return __builtin_convertvector(x, vi32);"""


def _lane_helper(name: str) -> str:
    """What only lanes need; else a comparison of vectors, or the scalar helper for each lane."""
    if name == "tv_any":
        return _function_text("bool", name, "vi64 m", "return ttv_any(m);")
    if match := re.fullmatch(r"tv_(splat|take|pick|put)_(\w+)", name):
        kind, t = match.groups()
        v, T, sign = vector_type(t), C_TYPES[t], "-(int64_t)" if t == "bool" else ""
        splat = f"return x {'-' if is_float(t) else '+'} (v{t}){{}};"  # not x + 0, which loses the sign of -0
        splat = "return (vi64){} - (int64_t)x;" if t == "bool" else splat
        result, parameters, body = {
            "splat": (v, f"{T} x", splat),
            "take": (v, f"const {T} *p, vi32 i", _all_lanes(v, f"{sign}p[i[l]]")),  # of one table
            "pick": (v, f"const {v} *p, vi32 i", _all_lanes(v, "p[i[l]][l]")),
            "put": ("void", f"{v} *p, vi32 i, {v} x, vi64 m", "EACH_LANE if (m[l]) p[i[l]][l] = x[l];"),
        }[kind]
        return _function_text(result, name, parameters, body)
    if match := re.fullmatch(r"tv_([iu]\d+)_of_(f\d+)", name):
        v, source = vector_type(match[1]), match[2]
        body = f"{v} r; EACH_LANE r[l] = tt_{match[1]}_of_{source}(x[l]); return r;"
        return _function_text(v, name, f"v{source} x", _SATURATION_OVER_LANES if name == "tv_i32_of_f64" else body)
    match = re.fullmatch(r"tv_([a-z0-9_]+)_([iuf]\d+)", name)
    if not match:
        raise KeyError(name)
    op, t = match.groups()
    v = vector_type(t)
    if op in ("max", "min") and is_float(t):
        test = f"(a {'>' if op == 'max' else '<'} b) | (a != a)"
        return _function_text(v, name, f"{v} a, {v} b", f"return ({test}) ? a : b;")
    two = op in (*_TWO_OPERANDS, "nextafter", "pow", "atan2", "fmod")
    scalar = f"nextafter{_suffix(t)}" if op == "nextafter" else f"tt_{op}_{t}"
    if t == "f32" and op in (*ELEMENTARY, "fmod"):
        scalar = f"tt_{op}f"
    body = f"{v} r; EACH_LANE r[l] = {scalar}({'a[l], b[l]' if two else 'a[l]'}); return r;"
    return _function_text(v, name, f"{v} a, {v} b" if two else f"{v} a", body)


def _all_lanes(vector: str, number: str) -> str:
    """Return a vector of a number for each lane l, put together at once: one lane after the other waits for memory."""
    each = {n: ", ".join(number.replace("[l]", f"[{k}]") for k in range(n)) for n in (4, 8)}
    return f"\n#if LANES == 8\n    return ({vector}){{{each[8]}}};\n#else\n    return ({vector}){{{each[4]}}};\n#endif"


def helper_dependencies(name: str) -> list[str]:
    """Helpers that a helper over lanes calls itself."""
    if not name.startswith("tv_") or re.match(r"tv_(splat|any|take|pick|put)", name):
        return []
    if name == "tv_i32_of_f64":
        return ["tv_splat_f64"]
    scalar = "tt_" + name.removeprefix("tv_")
    try:
        text = helper_text(name)
    except KeyError:
        return []
    return [scalar] if scalar + "(" in text else []


def _function_text(result: str, name: str, parameters: str, body: str) -> str:
    return f"static inline {result} {name}({parameters})\n{{\n    {body}\n}}\n"
