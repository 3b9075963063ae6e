"""Small C functions where plain C differs from JAX: division, shifts, conversion, extremes; and what lanes need."""

import re

from trimtab.compiler.ir import TYPES, is_float

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
LIMITS = {t: (f"{C_TYPES[t][:-2].upper()}_MIN", f"{C_TYPES[t][:-2].upper()}_MAX") for t in C_TYPES if t[0] in "iu"}

_INTEGER = {
    "div": "return b == 0 ? (T)-1 : SIGNED b == (T)-1 ? (T)(0u - (U)a) : ELSE (T)(a / b);",
    "rem": "return b == 0 ? a : SIGNED b == (T)-1 ? (T)0 : ELSE (T)(a % b);",
    "shl": "return (U)b < BITS ? (T)((U)a << b) : (T)0;",
    "shr": "return (U)b < BITS ? (T)((U)a >> b) : (T)0;",
    "sar": "return (T)((S)a >> ((U)b < BITS ? b : (T)(BITS - 1)));",
}
_UNARY = {
    "sign": "return (T)(a > 0 ? 1 : a < 0 ? -1 : ZERO);",
    "clz": "int n = BITS; U x = (U)a; while (x) { x = (U)(x >> 1); n--; } return (T)n;",
    "popcount": "int n = 0; U x = (U)a; while (x) { x = (U)(x & (x - 1)); n++; } return (T)n;",
}


def scalar_helper(name: str) -> str:
    """The text of one scalar helper, e.g. "tt_div_i32", "tt_i32_of_f64", "tt_bits_u32_of_f32"."""
    if found := re.fullmatch(r"tt_(\w+)_of_(\w+)", name):
        to, source = found[1], found[2]
        if to.startswith("bits_"):
            return _bit_copy(name, to.removeprefix("bits_"), source)
        return _saturating_conversion(name, to, source)
    found = re.fullmatch(r"tt_([a-z]+)_([iuf]\d+)", name)
    if not found:
        raise KeyError(name)
    op, t = found[1], found[2]
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
    signed = t[0] == "i"
    body = _INTEGER.get(op) or _UNARY[op]
    body = re.sub(r"SIGNED (.*?) : ELSE", r"\1 :" if signed else "", body)
    body = re.sub(r"\b(T|S|U|BITS|ZERO)\b", lambda m: words[m[1]], body)
    if t[0] == "u":
        body = body.replace(" : a < 0 ? -1", "")
    return _function_text(T, name, f"{T} a, {T} b" if op in _INTEGER else f"{T} a", body)


def _function_text(result: str, name: str, arguments: str, body: str) -> str:
    return f"static inline {result} {name}({arguments})\n{{\n    {body}\n}}\n"


def _saturating_conversion(name: str, to: str, source: str) -> str:
    low, high = LIMITS[to] if to[0] == "i" else ("0", LIMITS[to][1])
    T, S = C_TYPES[to], C_TYPES[source]
    power = int(to[1:]) - (to[0] == "i")
    suffix = "f" if source == "f32" else ""
    below = f"x <= -0x1p{power}{suffix}" if to[0] == "i" else f"x <= 0.0{suffix}"
    body = f"return x != x ? 0 : {below} ? {low} : x >= 0x1p{power}{suffix} ? {high} : ({T})x;"
    return _function_text(T, name, f"{S} x", body)


def _bit_copy(name: str, to: str, source: str) -> str:
    T, S = C_TYPES[to], C_TYPES[source]
    return _function_text(T, name, f"{S} x", f"{T} y; memcpy(&y, &x, sizeof y); return y;")


def lane_helper(name: str) -> str:
    """The text of one helper over lanes: named as by `scalar_helper`, tv_ in place of tt_; gathers, splats."""
    if found := re.fullmatch(r"tv_splat_(\w+)", name):
        t = found[1]
        T = "bool" if t == "bool" else C_TYPES[t]
        body = "return (vi64){} - (int64_t)x;" if t == "bool" else f"v{t} r; EACH_LANE r[l] = x; return r;"
        return _function_text(vector_type(t), name, f"{T} x", body)
    if name == "tv_any":
        return _any_lane()
    if found := re.fullmatch(r"tv_(take|pick)_(\w+)", name):
        t = found[2]
        v = vector_type(t)
        if found[1] == "take":  # one table for all lanes
            T = C_TYPES[t]
            zero = "-(int64_t)" if t == "bool" else ""
            return _function_text(v, name, f"const {T} *p, vi32 i", f"{v} r; EACH_LANE r[l] = {zero}p[i[l]]; return r;")
        return _function_text(v, name, f"const {v} *p, vi32 i", f"{v} r; EACH_LANE r[l] = p[i[l]][l]; return r;")
    if found := re.fullmatch(r"tv_put_(\w+)", name):
        v = vector_type(found[1])
        body = "EACH_LANE if (m[l]) p[i[l]][l] = x[l];"
        return _function_text("void", name, f"{v} *p, vi32 i, {v} x, vi64 m", body)
    return _lane_by_lane_helper(name)


def vector_type(t: str) -> str:
    """Type of a value over lanes; truth values are masks of 64-bit lanes."""
    return "vi64" if t == "bool" else f"v{t}"


def _any_lane() -> str:
    return "static inline bool tv_any(vi64 m)\n{\n    return ttv_any(m);\n}\n"


def _lane_by_lane_helper(name: str) -> str:
    scalar = "tt_" + name.removeprefix("tv_")
    if found := re.fullmatch(r"tv_([iu]\d+)_of_f64", name):
        return _saturating_lane_conversion(name, found[1])
    found = re.fullmatch(r"tv_([a-z0-9]+)_([iuf]\d+)", name)
    if not found:
        raise KeyError(name)
    op, t = found[1], found[2]
    v = vector_type(t)
    if op in ("max", "min") and is_float(t):
        sign = ">" if op == "max" else "<"
        return _function_text(v, name, f"{v} a, {v} b", f"return ((a {sign} b) | (a != a)) ? a : b;")
    two = op in _INTEGER or op in ("nextafter",)
    arguments = f"{v} a, {v} b" if two else f"{v} a"
    scalar = "nextafter" if op == "nextafter" else scalar
    call = f"{scalar}(a[l], b[l])" if two else f"{scalar}(a[l])"
    return _function_text(v, name, arguments, f"{v} r; EACH_LANE r[l] = {call}; return r;")


def _saturating_lane_conversion(name: str, to: str) -> str:
    if to != "i32":
        body = f"v{to} r; EACH_LANE r[l] = tt_{to}_of_f64(x[l]); return r;"
        return _function_text(f"v{to}", name, "vf64 x", body)
    body = "x = x == x ? x : (vf64){}; vf64 low = tv_splat_f64(-2147483648.0), high = tv_splat_f64(2147483647.0);"
    body += "\n    x = x < low ? low : x; x = x > high ? high : x; return __builtin_convertvector(x, vi32);"
    return _function_text("vi32", name, "vf64 x", body)


def helper_dependencies(name: str) -> list[str]:
    """Helpers that a helper over lanes calls itself."""
    if not name.startswith("tv_") or re.match(r"tv_(splat|any|take|pick|put)", name):
        return []
    if name == "tv_i32_of_f64":
        return ["tv_splat_f64"]
    scalar = "tt_" + name.removeprefix("tv_")
    try:
        text = lane_helper(name)
    except KeyError:
        return []
    return [scalar] if scalar + "(" in text else []


assert set(C_TYPES) == set(TYPES)
