"""C text of the elementary functions that generated code calls. Scalar C99 and C++ vectors give the same bits.

`runtime/elementary.h` and `special.h` contain each function once, with the tokens F64 (number), U64 (its bits), M64
(truth value), INLINE, COLD and FN(name). This module replaces the tokens: by `double` and `tt_name` for one number, by
`vf64` and `ttv_name` for vectors of TT_LANES numbers. `far.h` contains functions that are always computed for one
number at a time.

The module also writes the text that precedes generated functions: includes, lane types, and helpers.
"""

import re
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.resources import files

from trimtab.compiler.c_functions import INLINED, helper_texts
from trimtab.compiler.writer import Writer
from trimtab.core.errors import InputError

LANES = (0, 4, 8)
OWN_FUNCTIONS = (
    *("sin", "cos", "sincos", "tan", "asin", "acos", "atan", "atan2", "exp", "exp2", "expm1", "log", "log1p"),
    *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "logistic", "cbrt", "pow", "erf", "erfc"),
    *("sqrt", "rsqrt", "floor", "ceil", "trunc", "round_even", "round_away"),
)
HELPER_FUNCTIONS = ("abs", "copysign", "is_finite", "splat", "all", "any")
"""Further small functions that generated code calls. `any` exists only for vectors."""
EXACT_FUNCTIONS = {
    **{name: f"{name}f" for name in ("sqrt", "floor", "ceil", "trunc", "fmod")},
    **{"round_even": "rintf", "round_away": "roundf"},
}
"""Functions whose results are correctly rounded in every C library -> their names for float."""
FUNCTIONS = (*OWN_FUNCTIONS, "fmod")
SINGLE_PRECISION_NAMES = {name: EXACT_FUNCTIONS.get(name, f"{name}f") for name in FUNCTIONS}
"""Name of each function in double -> name of the C library's function for float, e.g. sinf."""
FAR = {"sin": 1, "cos": 1, "tan": 1, "log": 1, "log1p": 1, "atan2": 2, "pow": 2}
"""Functions with a slow path for arguments outside the usual range -> number of arguments of the function."""

_LINE = "{inline}{type} {name}({parameters})\n{{\n{body}}}"


def elementary_text(lanes: int = 0, names: Iterable[str] | None = None, called: Iterable[str] = ()) -> str:
    """Return C text with the elementary functions: `tt_sin` for double, `tt_sinf` for float, `ttv_sin` for vectors.

    lanes: 0 for C99 (also valid C++); 4 or 8 for C++ with the vectors `vf64`, `vi64`, `vu64` in addition. The text
    defines TT_LANES itself.
    names: functions to define ("sin", "sinf", ...); by default all. Functions that they call are defined, too.
    called: functions that must not be inlined, e.g. "tt_sin" or "ttv_sin".
    """
    if lanes not in LANES:
        raise InputError(
            "elementary", f"lanes must be one of the choices, got {lanes}", choices=map(str, LANES), fix="lanes=0"
        )
    single = [f"{name}f" for name in SINGLE_PRECISION_NAMES]
    known = dict.fromkeys([*FUNCTIONS, *HELPER_FUNCTIONS, *single])
    wanted = list(known) if names is None else list(dict.fromkeys(names))
    if unknown := [name for name in wanted if name not in known]:
        raise InputError("elementary", f"unknown function {', '.join(unknown)}", choices=known)
    double = [name for name in wanted if name not in single and name != "any"]
    need = [name[:-1] for name in wanted if name in single and name[:-1] not in EXACT_FUNCTIONS]
    text = [
        _blocks("scalar")[0],
        *_with_dependencies([*double, *need], "tt"),
        *(_single_precision(n[:-1]) for n in wanted if n in single),
    ]
    if lanes:
        double += [n for n in ("splat", "abs", "copysign", "is_finite", "all", "any", "within") if n not in double]
        text += [f"#define TT_LANES {lanes}", _blocks("vector")[0], *_with_dependencies(double, "ttv")]
    return _forbid_inlining("\n\n".join(text) + "\n", called)


def _forbid_inlining(text: str, functions: Iterable[str]) -> str:
    for name in functions:
        text = re.sub(rf"^TTV?_INLINE (?=\w+ {name}\()", "TT_CALLED ", text, flags=re.M)
    return text


@cache
def _blocks(name: str) -> list[str]:
    """Return the blocks of a file in `runtime`, which blank lines separate: first the prelude, then each function."""
    return files("trimtab.compiler").joinpath("runtime", f"{name}.h").read_text("utf-8").strip().split("\n\n")


@cache
def _functions(prefix: str) -> dict[str, str]:
    """Return the C text of each function by name, for prefix tt (one number) or ttv (vectors)."""
    vector = prefix == "ttv"
    blocks = [
        *_blocks("vector" if vector else "scalar")[1:],
        *(_replace_tokens(b, vector) for name in ("elementary", "special") for b in _blocks(name)[1:]),
        *([] if vector else _blocks("far")[1:]),
    ]
    found = {
        name: block
        for block in blocks
        for name in re.findall(rf"^(?:TT|template).* {prefix}_(\w+)\(", block, flags=re.M)
    }
    if vector:
        found |= {f"far_{name}": _lane_by_lane(f"far_{name}", arity, "near") for name, arity in FAR.items()}
        return found | {"fmod": _lane_by_lane("fmod", 2)}
    return found | {"fmod": "TT_INLINE double tt_fmod(double x, double z)\n{\n    return fmod(x, z);\n}"}


def _replace_tokens(block: str, vector: bool) -> str:
    """Return the text of a function with tokens such as F64 and FN(name) replaced, for vectors or for one number."""
    tokens = {"F64": "vf64", "U64": "vu64", "M64": "vi64", "INLINE": "TTV_INLINE", "COLD": "TTV_COLD"}
    if not vector:
        tokens = {"F64": "double", "U64": "uint64_t", "M64": "int", "INLINE": "TT_INLINE", "COLD": "TT_COLD"}
    block = re.sub(r"\bFN\((\w+)\)", r"ttv_\1" if vector else r"tt_\1", block)
    return re.sub(r"\b(F64|U64|M64|INLINE|COLD)\b", lambda m: tokens[m[0]], block)


def _lane_by_lane(name: str, arity: int, near: str = "") -> str:
    """Return the text of a vector function that calls the scalar function lane by lane.

    near: name of a mask parameter; lanes where the mask is true keep the value of the parameter y.
    """
    arguments = ("x", "z")[:arity]
    parameters = [*(["vi64 near"] if near else []), *(f"vf64 {a}" for a in arguments), *(["vf64 y"] if near else [])]
    each = [*(["near[i] != 0"] if near else []), *(f"{a}[i]" for a in arguments), *(["y[i]"] if near else [])]
    value = f"tt_{name}({', '.join(each)})"
    body = f"    vf64 r;\n    for (int i = 0; i < TT_LANES; i++) r[i] = {value};\n    return r;\n"
    inline, own = "TTV_COLD " if near else "TTV_INLINE ", f"ttv_{name}"
    return _LINE.format(inline=inline, type="vf64", name=own, parameters=", ".join(parameters), body=body)


def _with_dependencies(names: Iterable[str], prefix: str) -> Iterator[str]:
    """Return the C text of these functions, each after the functions that it calls."""
    functions, done = _functions(prefix), set[str]()

    def visit(name: str) -> Iterator[str]:
        if name in done:
            return
        done.add(name)
        block = functions[name]
        for need in re.findall(rf"\b{prefix}_(\w+)\(", block):
            yield from visit(need)
        yield block

    for name in names:
        yield from visit(name)


def _single_precision(name: str) -> str:
    """Return the text of a function for float. It calls the function for double, or the C library's (TT_SINGLE)."""
    two = name in ("pow", "fmod", "atan2")
    parameters, arguments = ("float x, float z", "x, z") if two else ("float x", "x")
    library = {"rsqrt": "1.0f / sqrtf(x)", "logistic": "1.0f / (1.0f + expf(-x))"}
    value = library.get(name, f"{SINGLE_PRECISION_NAMES[name]}({arguments})")
    own = f"    return tt_single(tt_{name}({arguments}));\n"
    result, body = "float", f"    return {value};\n"
    if name == "sincos":
        result, parameters = "void", "float x, float *sine, float *cosine"
        body = "    *sine = sinf(x);\n    *cosine = cosf(x);\n"
        own = "    double s, c;\n    tt_sincos(x, &s, &c);\n    *sine = tt_single(s);\n    *cosine = tt_single(c);\n"
    if name not in EXACT_FUNCTIONS:
        body = f"#if TT_SINGLE\n{own}#else\n{body}#endif\n"
    return _LINE.format(inline="TT_INLINE ", type=result, name=f"tt_{name}f", parameters=parameters, body=body)


LICENCE_NOTE = """\
/* Generated by trimtab. This text may be used, changed and passed on for any purpose, under any licence or
 * none, without notice; it comes without warranty. */
"""
INCLUDES = "#include <math.h>\n#include <stdbool.h>\n#include <stdint.h>\n#include <string.h>\n"


def preamble_text(writer: Writer, lanes: int = 0, halves: bool = False) -> str:
    """Return the text that precedes the functions written by this writer.

    lanes: 0 for scalar C.  halves: the lanes hold numbers of 32 bits, and the elementary functions compute half of the
    lanes at a time.
    """
    parts = [LICENCE_NOTE, INCLUDES, used_elementary_text(writer, lanes // 2 if halves else lanes)]
    if lanes:
        parts += [f"#define TT_HALVES {int(halves)}", "\n\n".join(_blocks("lanes"))]
    parts.append(helper_texts(writer.used))
    parts += writer.tables
    return "\n".join(parts)


def used_elementary_text(writer: Writer, lanes: int = 0) -> str:
    """Return the elementary functions that this writer used, e.g. sincos for tt_sincos and ttv_sincos."""
    known = {*FUNCTIONS, *(f"{name}f" for name in SINGLE_PRECISION_NAMES)}
    names = [n.split("_", 1)[1] for n in writer.used if n.startswith(("tt_", "ttv_"))]
    called = [n for n, count in writer.used.items() if count > INLINED]
    return elementary_text(lanes, [n for n in dict.fromkeys(names) if n in known], called)
