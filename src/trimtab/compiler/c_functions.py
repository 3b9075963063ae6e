"""Small C functions for operations in which plain C differs from JAX: division, shifts, conversion, maximum, minimum.

Each helper is named tt_NAME for one number, and tv_NAME for lanes (vectors with one run in each lane).
"""

import contextlib
import re
from collections.abc import Mapping

from trimtab.compiler.ir import is_float
from trimtab.compiler.text import C_TYPES, ELEMENTARY, LIMITS, float_suffix, vector_type

INLINED = 24
"""Maximum number of calls of a helper that is inlined. A helper with more calls stays a function."""
EXCHANGES = ("tv_gather", "tv_scatter")
_TWO_OPERANDS = {
    "div": "return b == 0 ? (T)-1 : SIGNED b == (T)-1 ? (T)(0u - (U)a) : ELSE (T)(a / b);",
    "rem": "return b == 0 ? a : SIGNED b == (T)-1 ? (T)0 : ELSE (T)(a % b);",
    "shl": "return (U)b < BITS ? (T)((W)a << b) : (T)0;",
    "shr": "return (U)b < BITS ? (T)((U)a >> b) : (T)0;",
    "sar": "return (T)((S)a >> ((U)b < BITS ? b : (T)(BITS - 1)));",
    "nextafter": "U u = 1; T y; if (a != a || b != b) return a + b; if (a == b) return b; "
    "if (a == 0) u |= (U)(b < 0) << (BITS - 1); else memcpy(&u, &a, sizeof u), u += (a < b) == (a > 0) ? 1 : -1; "
    "memcpy(&y, &u, sizeof y); return y;",
}
_ONE_OPERAND = {
    "sign": "return (T)(a > 0 ? 1 : a < 0 ? -1 : ZERO);",
    "clz": "int n = BITS; U x = (U)a; while (x) { x = (U)(x >> 1); n--; } return (T)n;",
    "popcount": "int n = 0; U x = (U)a; while (x) { x = (U)(x & (x - 1)); n++; } return (T)n;",
}


def helper_text(name: str) -> str:
    """Return the C text of one helper, e.g. tt_div_i32 or tv_max_f64. Raise KeyError for an unknown name."""
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
        return _function_text(T, name, f"{T} a, {T} b", _extreme_body(op, t))
    bits = str(int(t[1:]))
    words = {
        "T": T,
        "S": T.removeprefix("u"),
        "U": C_TYPES[f"u{bits}"],
        "W": C_TYPES[f"u{max(int(bits), 32)}"],
        "BITS": bits,
        "ZERO": "a" if t[0] == "f" else "0",
    }
    body = _TWO_OPERANDS.get(op) or _ONE_OPERAND[op]
    body = re.sub(r"SIGNED (.*?) : ELSE", r"\1 :" if t[0] == "i" else "", body)
    body = re.sub(r"\b(T|S|U|W|BITS|ZERO)\b", lambda m: words[m[1]], body)
    if t[0] == "u":
        body = body.replace(" : a < 0 ? -1", "")
    return _function_text(T, name, f"{T} a, {T} b" if op in _TWO_OPERANDS else f"{T} a", body)


def _saturation(to: str, source: str) -> str:
    """Return the C body that converts a float to an integer: rounded towards zero, saturated, and 0 for NaN."""
    low, high = LIMITS[to] if to[0] == "i" else ("0", LIMITS[to][1])
    power, suffix = int(to[1:]) - (to[0] == "i"), float_suffix(source)
    below = f"x <= -0x1p{power}{suffix}" if to[0] == "i" else f"x <= 0.0{suffix}"
    return f"return x != x ? 0 : {below} ? {low} : x >= 0x1p{power}{suffix} ? {high} : ({C_TYPES[to]})x;"


def _extreme_body(op: str, t: str) -> str:
    """Return the C body that computes the maximum or minimum of a and b.

    The result is NaN if a or b is NaN, and -0 is less than +0 (IEEE 754-2019). If a and b are equal, x is b and y is a.
    So x and y differ only for zeros and NaN. The bitwise OR of x and y is then -0 or NaN. For the maximum, their
    bitwise XOR is subtracted as a number, because -0 - -0 is +0.
    """
    sign = ">" if op == "max" else "<"
    if not is_float(t):
        return f"return a {sign} b ? a : b;"
    T, U = C_TYPES[t], C_TYPES[f"u{t[1:]}"]
    lines = [f"{T} x = a {sign} b ? a : b, y = b {sign} a ? b : a;", f"{U} p, q, r;"]
    lines += ["memcpy(&p, &x, sizeof p); memcpy(&q, &y, sizeof q);", "r = p | q; memcpy(&x, &r, sizeof x);"]
    lines += ["r = p ^ q; memcpy(&y, &r, sizeof y);"] if op == "max" else []
    return "\n    ".join([*lines, "return x - y;" if op == "max" else "return x;"])


_SATURATION_OVER_LANES = """\
if (ttv_within(ttv_abs(x), 2147483647.0)) return __builtin_convertvector(x, vi32); /* false for NaN */
    x = x == x ? x : (vf64){}; vf64 low = tv_splat_f64(-2147483648.0), high = tv_splat_f64(2147483647.0);
    x = x < low ? low : x; x = x > high ? high : x; return __builtin_convertvector(x, vi32);"""


_SINCOS_OVER_LANES = """
#if TT_HALVES
    vf64 s, c, t, d;
    ttv_sincos(tt_part(a, 0), &s, &c);
    ttv_sincos(tt_part(a, 1), &t, &d);
    *sine = tt_join(s, t);
    *cosine = tt_join(c, d);
#else
    vf64 s, c;
    ttv_sincos(__builtin_convertvector(a, vf64), &s, &c);
    *sine = __builtin_convertvector(s, vf32);
    *cosine = __builtin_convertvector(c, vf32);
#endif"""
_SQRT_OVER_LANES = """
#if defined(__AVX512F__) && LANES == 16 && !defined(__clang__)
    return __builtin_ia32_sqrtps512_mask(a, (vf32){}, -1, 4);
#elif defined(__AVX__) && LANES == 8
    return __builtin_ia32_sqrtps256(a);
#elif defined(__SSE__) && LANES == 4
    return __builtin_ia32_sqrtps(a);
#else
    vf32 r;
    EACH_LANE r[l] = __builtin_sqrtf(a[l]);
    return r;
#endif"""


def _lane_helper(name: str) -> str:
    """Return the C text of a helper for lanes: vector code if available, else a call of the scalar helper per lane."""
    if name == "tv_any":
        return _function_text("bool", name, "vmask m", "return tt_any(m);")
    if match := re.fullmatch(r"tv_(splat|take|pick|put|gather|scatter)_(\w+)", name):
        kind, t = match.groups()
        v, T, each = vector_type(t), C_TYPES[t], "int64_t step, int32_t runs"  # step from run to run, number of runs
        sign, truth = ("-(tt_mask)", " != 0") if t == "bool" else ("", "")
        run = f"{sign}p[(l < runs ? l : 0) * step]"
        splat = f"return x {'-' if is_float(t) else '+'} ({v}){{}};"  # not x + 0, which loses the sign of -0
        splat = "return (vmask){} - (tt_mask)x;" if t == "bool" else splat
        result, parameters, body = {
            "splat": (v, f"{T} x", splat),
            "take": (v, f"const {T} *p, vi32 i", _all_lanes(v, f"{sign}p[i[l]]")),  # from one table
            "pick": (v, f"const {v} *p, vi32 i", _all_lanes(v, "p[i[l]][l]")),
            "put": ("void", f"{v} *p, vi32 i, {v} x, vmask m", "EACH_LANE if (m[l]) p[i[l]][l] = x[l];"),
            "gather": (v, f"const {T} *p, {each}", f"{v} r; EACH_LANE r[l] = {run}; return r;"),
            "scatter": ("void", f"{T} *p, {each}, {v} x", f"EACH_LANE if (l < runs) p[l * step] = x[l]{truth};"),
        }[kind]
        return _function_text(result, name, parameters, body)
    if match := re.fullmatch(r"tv_([iu]\d+)_of_(f\d+)", name):
        v, source = vector_type(match[1]), match[2]
        body = f"{v} r; EACH_LANE r[l] = tt_{match[1]}_of_{source}(x[l]); return r;"
        if name == "tv_i32_of_f32":
            whole = "return tv_i32_of_f64(__builtin_convertvector(x, wf64));"
            body = f"\n#if TT_HALVES\n    {body}\n#else\n    {whole}\n#endif"
        if name == "tv_i32_of_f64":  # which programs of 32-bit numbers do not call
            text = _function_text(v, name, f"{vector_type(source)} x", _SATURATION_OVER_LANES)
            return f"#if !TT_HALVES\n{text}#endif\n"
        return _function_text(v, name, f"{vector_type(source)} x", body)
    match = re.fullmatch(r"tv_([a-z0-9_]+)_([iuf]\d+)", name)
    if not match:
        raise KeyError(name)
    op, t = match.groups()
    v = vector_type(t)
    if op in ("max", "min") and is_float(t):
        sign, u = ">" if op == "max" else "<", vector_type(f"u{t[1:]}")
        either, other = f"({v})(({u})x | ({u})y)", f" - ({v})(({u})x ^ ({u})y)" if op == "max" else ""
        body = f"{v} x = a {sign} b ? a : b, y = b {sign} a ? b : a; return {either}{other};"
        return _function_text(v, name, f"{v} a, {v} b", body)
    two = op in (*_TWO_OPERANDS, "pow", "atan2", "fmod")
    body = f"{v} r; EACH_LANE r[l] = tt_{op}_{t}({'a[l], b[l]' if two else 'a[l]'}); return r;"
    if name == "tv_sincos_f32":
        return _function_text("void", name, "vf32 a, vf32 *sine, vf32 *cosine", _SINCOS_OVER_LANES)
    if name == "tv_sqrt_f32":
        return _function_text(v, name, f"{v} a", _SQRT_OVER_LANES)
    if t == "f32" and op in (*ELEMENTARY, "fmod"):  # the function for double, rounded to float, as in scalar code
        body = f"return {'OF_DOUBLES' if two else 'OF_DOUBLE'}(ttv_{op}, {'a, b' if two else 'a'});"
    return _function_text(v, name, f"{v} a, {v} b" if two else f"{v} a", body)


def _all_lanes(vector: str, number: str) -> str:
    """Return C text that builds a vector in one expression, with `number` for each lane l.

    Code that sets the lanes one after the other would wait for memory at each lane.
    """
    each = {n: ", ".join(number.replace("[l]", f"[{k}]") for k in range(n)) for n in (4, 8, 16)}
    choices = [f"LANES == {n}\n    return ({vector}){{{each[n]}}};" for n in (4, 8, 16)]
    return "\n#if " + "\n#elif ".join(choices) + "\n#endif"


def helper_dependencies(name: str) -> list[str]:
    """Return the helpers that a helper for lanes calls."""
    if not name.startswith("tv_") or re.match(r"tv_(splat|any|take|pick|put|gather|scatter)", name):
        return []
    if name in ("tv_i32_of_f64", "tv_i32_of_f32"):
        return ["tv_splat_f64", *(["tt_i32_of_f32", "tv_i32_of_f64"] if name == "tv_i32_of_f32" else [])]
    scalar = "tt_" + name.removeprefix("tv_")
    try:
        text = helper_text(name)
    except KeyError:
        return []
    return [scalar] if scalar + "(" in text else []


def _function_text(result: str, name: str, parameters: str, body: str) -> str:
    return f"static inline {result} {name}({parameters})\n{{\n    {body}\n}}\n"


def helper_texts(used: Mapping[str, int]) -> str:
    """Return the text of all helpers among these names, in an order that compiles, without elementary functions.

    used: name -> number of calls.
    """
    ordered: dict[str, None] = {}
    for name in used:
        for needed in [*helper_dependencies(name), name]:
            ordered[needed] = None
    scalar = [n for n in ordered if n.startswith("tt_")]
    lanes = sorted((n for n in ordered if n.startswith("tv_")), key=lambda n: "splat" not in n)
    texts = []
    for name in [*scalar, *lanes]:
        with contextlib.suppress(KeyError):
            text, many = helper_text(name), used.get(name, 0) > INLINED and name.startswith(EXCHANGES)
            texts.append(text.replace("static inline", "TT_CALLED", 1) if many else text)
    return "\n".join(texts)
