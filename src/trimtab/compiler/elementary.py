"""Text of the elementary functions that generated code calls: the same bits in scalar C99 and in vectors of C++.

`runtime/elementary.h` holds each function once, over the tokens F64 (number), U64 (its bits), M64 (truth value),
INLINE, COLD and FN(name). Here they become plain C: `double` and `tt_name` for one number, `vf64` and `ttv_name` for
TT_LANES of them.

What stands before generated functions: includes, lane types, and the helpers that they use.
"""

import re
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.resources import files

from trimtab.compiler.c_functions import helper_texts
from trimtab.compiler.writer import Writer
from trimtab.core.errors import InputError

LANES = (0, 4, 8)
LIBM = {"cbrt": 1, "pow": 2, "asinh": 1, "acosh": 1, "atanh": 1, "erf": 1, "erfc": 1, "fmod": 2}
"""Functions left to the C library, one number at a time, and how many arguments each takes."""
OWN_FUNCTIONS = (
    *("sin", "cos", "sincos", "tan", "asin", "acos", "atan", "atan2", "exp", "exp2", "expm1", "log", "log1p"),
    *("sinh", "cosh", "tanh", "logistic", "sqrt", "rsqrt", "floor", "ceil", "trunc", "round_even", "round_away"),
)
HELPER_FUNCTIONS = ("abs", "copysign", "is_finite", "splat", "all", "any")
"""Small parts that generated vector code needs as well; `any` only in vectors."""
SINGLE_PRECISION_NAMES = {
    **{
        name: f"{name}f"
        for name in (*OWN_FUNCTIONS[:13], *LIBM, "sinh", "cosh", "tanh", "sqrt", "floor", "ceil", "trunc")
    },
    **{"round_even": "rintf", "round_away": "roundf", "rsqrt": "", "logistic": "", "sincos": ""},
}
"""Functions for float by what the C library calls them ("": written out); asked for with an f behind the name."""
FUNCTIONS = (*OWN_FUNCTIONS, *LIBM)

_LINE = "{inline}{type} {name}({parameters})\n{{\n{body}}}"


def elementary_text(lanes: int = 0, names: Iterable[str] | None = None) -> str:
    """C text that defines the elementary functions: `tt_sin` for double, `tt_sinf` for float, `ttv_sin` for vectors.

    lanes: 0 for C99 (also valid C++), 4 or 8 for C++ that has the vectors `vf64`, `vi64`, `vu64` in addition; the text
    defines TT_LANES itself. names: those wanted ("sin", "sinf", ...), all by default; what they need comes with them.
    """
    if lanes not in LANES:
        raise InputError("elementary", f"lanes = {lanes}", choices=map(str, LANES))
    single = [f"{name}f" for name in SINGLE_PRECISION_NAMES]
    known = dict.fromkeys([*FUNCTIONS, *HELPER_FUNCTIONS, *single])
    wanted = list(known) if names is None else list(dict.fromkeys(names))
    if unknown := [name for name in wanted if name not in known]:
        raise InputError("elementary", f"no function {', '.join(unknown)}", choices=known)
    double = [name for name in wanted if name not in single and name != "any"]
    text = [
        _blocks("scalar")[0],
        *_with_dependencies(double, "tt"),
        *(_single_precision(n[:-1]) for n in wanted if n in single),
    ]
    if lanes:
        double += [n for n in ("splat", "abs", "copysign", "is_finite", "all", "any") if n not in double]
        text += [f"#define TT_LANES {lanes}", _blocks("vector")[0], *_with_dependencies(double, "ttv")]
    return "\n\n".join(text) + "\n"


@cache
def _blocks(name: str) -> list[str]:
    """Blocks of this runtime text, parted by blank lines: first what stands before the functions, then each of them."""
    return files("trimtab.compiler").joinpath("runtime", f"{name}.h").read_text("utf-8").strip().split("\n\n")


@cache
def _functions(prefix: str) -> dict[str, str]:
    """C text of each function by name, for prefix tt (one number) or ttv (vectors)."""
    vector = prefix == "ttv"
    blocks = [
        *_blocks("vector" if vector else "scalar")[1:],
        *(_replace_tokens(b, vector) for b in _blocks("elementary")[1:]),
    ]
    found = {
        name: block
        for block in blocks
        for name in re.findall(rf"^(?:TT|template).* {prefix}_(\w+)\(", block, flags=re.M)
    }
    found |= {name: _lane_by_lane(name, arity, vector, far=False) for name, arity in LIBM.items()}
    far = {"sin": 1, "cos": 1, "tan": 1, "log": 1, "log1p": 1, "atan2": 2}
    return found | {f"far_{name}": _lane_by_lane(name, arity, vector, far=True) for name, arity in far.items()}


def _replace_tokens(block: str, vector: bool) -> str:
    """The block with its tokens replaced."""
    tokens = {"F64": "vf64", "U64": "vu64", "M64": "vi64", "INLINE": "TTV_INLINE", "COLD": "TTV_COLD"}
    if not vector:
        tokens = {"F64": "double", "U64": "uint64_t", "M64": "int", "INLINE": "TT_INLINE", "COLD": "TT_COLD"}
    block = re.sub(r"\bFN\((\w+)\)", r"ttv_\1" if vector else r"tt_\1", block)
    return re.sub(r"\b(F64|U64|M64|INLINE|COLD)\b", lambda m: tokens[m[0]], block)


def _lane_by_lane(name: str, arity: int, vector: bool, *, far: bool) -> str:
    """A call of the C library; `far`: only where the own function doesn't hold, and y where it does (`near`)."""
    number, mask = ("vf64", "vi64") if vector else ("double", "int")
    arguments = ("x",) if arity == 1 else ("x", "z")
    parameters = ", ".join(f"{number} {a}" for a in arguments)
    if far:
        parameters = f"{mask} near, {parameters}, {number} y"
    if vector:
        call = f"{name}({', '.join(f'{a}[i]' for a in arguments)})"
        value = f"near[i] ? y[i] : {call}" if far else call
        body = f"    vf64 r;\n    for (int i = 0; i < TT_LANES; i++) r[i] = {value};\n    return r;\n"
    else:
        call = f"{name}({', '.join(arguments)})"
        body = f"    return near ? y : {call};\n" if far else f"    return {call};\n"
    full = f"{'ttv' if vector else 'tt'}_{'far_' if far else ''}{name}"
    inline = ("TTV_COLD " if vector else "TT_COLD ") if far else ("TTV_INLINE " if vector else "TT_INLINE ")
    return _LINE.format(inline=inline, type=number, name=full, parameters=parameters, body=body)


def _with_dependencies(names: Iterable[str], prefix: str) -> Iterator[str]:
    """Blocks of these functions, each after those that it calls."""
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
    """The function of this name for float: the C library's."""
    if name == "sincos":
        body = "    *sine = sinf(x);\n    *cosine = cosf(x);\n"
        parameters = "float x, float *sine, float *cosine"
        return _LINE.format(inline="TT_INLINE ", type="void", name="tt_sincosf", parameters=parameters, body=body)
    two = name in ("pow", "fmod", "atan2")
    value = {"rsqrt": "1.0f / sqrtf(x)", "logistic": "1.0f / (1.0f + expf(-x))"}.get(name, "")
    value = value or f"{SINGLE_PRECISION_NAMES[name]}({'x, z' if two else 'x'})"
    parameters, body = "float x, float z" if two else "float x", f"    return {value};\n"
    return _LINE.format(inline="TT_INLINE ", type="float", name=f"tt_{name}f", parameters=parameters, body=body)


LICENCE_NOTE = """\
/* Generated by trimtab. This text may be used, changed and passed on for any purpose, under any licence or
 * none, without notice; it comes without warranty. */
"""
INCLUDES = "#include <math.h>\n#include <stdbool.h>\n#include <stdint.h>\n#include <string.h>\n"
LANE_TYPES = """#define LANES TT_LANES
#define EACH_LANE for (int l = 0; l < LANES; l++)
typedef int32_t vi32 __attribute__((vector_size(4 * LANES)));
typedef uint32_t vu32 __attribute__((vector_size(4 * LANES)));
typedef float vf32 __attribute__((vector_size(4 * LANES)));
"""


def preamble_text(writer: Writer, lanes: int = 0) -> str:
    """Text that goes before functions written by this writer; lanes 0 for scalar C."""
    parts = [LICENCE_NOTE, INCLUDES, elementary_text(lanes, elementary_names(writer))]
    if lanes:
        parts.append(LANE_TYPES)
    parts.append(helper_texts(writer.used))
    parts += writer.tables
    return "\n".join(parts)


def elementary_names(writer: Writer) -> list[str]:
    """The elementary functions that were used, e.g. "sincos" for tt_sincos and ttv_sincos."""
    known = {*FUNCTIONS, *(f"{name}f" for name in SINGLE_PRECISION_NAMES)}
    names = [n.split("_", 1)[1] for n in writer.used if n.startswith(("tt_", "ttv_"))]
    return [n for n in dict.fromkeys(names) if n in known]
