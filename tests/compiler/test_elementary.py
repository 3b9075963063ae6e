"""Elementary functions of generated code: accuracy, special values, and the same bits alone and in vectors."""

import ctypes
import shutil
import subprocess
from ctypes.util import find_library
from functools import cache

import numpy as np
import pytest

from trimtab.compiler.elementary import (
    EXACT_FUNCTIONS,
    FUNCTIONS,
    OWN_FUNCTIONS,
    SINGLE_PRECISION_NAMES,
    elementary_text,
)
from trimtab.core.errors import InputError

GCC, GXX = shutil.which("gcc"), shutil.which("g++")
needs_compiler = pytest.mark.skipif(not (GCC and GXX), reason="no gcc and g++ here")
FLAGS = ("-O2", "-ffp-contract=off", "-fno-math-errno", "-fwrapv", "-Wall", "-Wextra", "-Werror")
TWO = ("pow", "fmod", "atan2")
ONE = tuple(name for name in FUNCTIONS if name not in (*TWO, "sincos"))
NATIVE, PORTABLE = ("-march=native",), ("-DTT_FMA=0",)
VECTOR = ("-std=c++17", "-Wno-psabi")
VARIANTS = {
    "scalar": (0, "gcc", ("-std=c99", *NATIVE)),
    "4 lanes": (4, "g++", (*VECTOR, "-O3", *NATIVE)),
    "8 lanes": (8, "g++", (*VECTOR, "-O3", *NATIVE)),
    "scalar, plainest processor": (0, "gcc", ("-std=c99", "-pedantic")),
    "4 lanes, plainest processor": (4, "g++", VECTOR),
    "scalar, no FMA": (0, "gcc", ("-std=c99", "-pedantic", *PORTABLE)),
    "8 lanes, no FMA": (8, "g++", (*VECTOR, *NATIVE, *PORTABLE)),
}
"""Lanes, compiler and flags; all give the same bits, and apart from them those that round products and sums twice."""
SCALAR = {name: "scalar, no FMA" if PORTABLE[0] in flags else "scalar" for name, (_, _, flags) in VARIANTS.items()}
RARE = ("8 lanes", "scalar, plainest processor", "4 lanes, plainest processor")
"""Variants of the thorough tests: the others have both numbers of lanes, both languages and both kinds of FMA."""
LONG = np.longdouble


def driver(lanes: int) -> str:
    """C text: the functions over whole arrays, whose length is a multiple of 8."""
    number, prefix, step = ("vf64", "ttv", lanes) if lanes else ("double", "tt", 1)
    loop = f"for (long i = 0; i < n; i += {step})"
    get = f"{number} a, b, r; memcpy(&a, x + i, sizeof a); memcpy(&b, z + i, sizeof b); (void)b;"
    text = [elementary_text(lanes), '#ifdef __cplusplus\nextern "C" {\n#endif']
    signature = "(long n, const double *x, const double *z, double *y, double *w)"
    for name in (*ONE, *TWO):
        call = f"{prefix}_{name}({'a, b' if name in TWO else 'a'})"
        body = f"(void)w; {loop} {{ {get} r = {call}; memcpy(y + i, &r, sizeof r); }}"
        text.append(f"void do_{name}{signature};\nvoid do_{name}{signature} {{ {body} }}")
    body = f"{loop} {{ {get} {prefix}_sincos(a, &r, &b); memcpy(y + i, &r, sizeof r); memcpy(w + i, &b, sizeof b); }}"
    text.append(f"void do_sincos{signature};\nvoid do_sincos{signature} {{ {body} }}")
    return "\n".join([*text, "#ifdef __cplusplus\n}\n#endif\n"])


@pytest.fixture(scope="module")
def call(tmp_path_factory):
    """call(variant, name, x, z) -> values; a library is built at its first call."""
    folder = tmp_path_factory.mktemp("elementary")

    @cache
    def build(variant):
        (lanes, compiler, flags), k = VARIANTS[variant], list(VARIANTS).index(variant)
        source, library = folder / f"v{k}.{'cpp' if lanes else 'c'}", folder / f"v{k}.so"
        source.write_text(driver(lanes))
        command = [compiler, *FLAGS, *flags, "-shared", "-fPIC", str(source), "-o", str(library), "-lm"]
        done = subprocess.run(command, stderr=subprocess.PIPE, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return ctypes.CDLL(str(library))

    def run(variant, name, x, z=None):
        n = -(-x.size // 8) * 8
        x, z = (np.resize(np.asarray(v, float), n) for v in (x, x if z is None else z))
        y, w = np.empty(n), np.empty(n)
        getattr(build(variant), f"do_{name}")(ctypes.c_long(n), *(ctypes.c_void_p(a.ctypes.data) for a in (x, z, y, w)))
        return np.stack([y, w]) if name == "sincos" else y

    return run


def spread(rng, low, high, n):
    """Numbers whose logarithm is even between those of low and high, either sign."""
    return np.exp(rng.uniform(np.log(low), np.log(high), n)) * rng.choice([-1.0, 1.0], n)


@cache
def values():
    """Special values, neighbours of critical ones, and numbers from many ranges; the length is a multiple of 8."""
    rng = np.random.default_rng(7)
    quarter = np.arange(-40, 41) * np.pi / 4
    far = np.rint(rng.uniform(0, 6.3e5, 300)) * (np.pi / 2)
    edge = [
        0.0,
        5e-324,
        1e-310,
        2.2250738585072014e-308,
        1e-300,
        1e-160,
        1e-20,
        2.0**-54,
        2.0**-28,
        2.0**-27,
        0.25,
        0.5,
    ]
    edge += [
        1.0,
        np.sqrt(0.5),
        np.sqrt(2),
        1.5,
        2.5,
        22.0,
        40.0,
        300.0,
        709.0,
        709.78,
        710.0,
        710.47,
        711.0,
        745.0,
        746.0,
    ]
    edge += [1023.5, 1024.0, 1074.0, 1075.0, 1e6, 1e6 + 1, 1e15, 2.0**52 - 0.5, 2.0**52, 2.0**53, 1e22, 1e100, 1.7e308]
    edge = np.concatenate([edge, quarter, far, np.log(2) * np.arange(1, 30) / 2])
    near = np.concatenate([edge, np.nextafter(edge, 0), np.nextafter(edge, np.inf), [np.inf, np.nan]])
    ranges = ((1e-9, 1.0), (0.1, 4.0), (1.0, 100.0), (10.0, 800.0), (100.0, 1e6), (1e-320, 1e-290), (1e5, 1e300))
    wide = [spread(rng, low, high, 3000) for low, high in ranges]
    even = [
        rng.uniform(-1, 1, 20000),
        rng.uniform(-10, 10, 20000),
        rng.uniform(-750, 750, 4000),
        rng.uniform(0.5, 2, 9000),
    ]
    x = np.concatenate([near, -near, *wide, *even])
    return x[: x.size // 8 * 8]


REFERENCE = {
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan,
    "exp": np.exp, "exp2": np.exp2, "expm1": np.expm1, "log": np.log, "log1p": np.log1p, "sinh": np.sinh,
    "cosh": np.cosh, "tanh": np.tanh, "logistic": lambda x: 1 / (1 + np.exp(-x)), "sqrt": np.sqrt,
    "rsqrt": lambda x: 1 / np.sqrt(x), "cbrt": np.cbrt, "asinh": np.arcsinh, "acosh": np.arccosh, "atanh": np.arctanh,
}  # fmt: skip
BOUND = dict.fromkeys(REFERENCE, 0.8) | {
    "tan": 1.0,
    "expm1": 0.85,
    "log": 0.9,
    "log1p": 0.9,
    "sqrt": 0.501,
    "rsqrt": 1.5,
}
BOUND |= {"cbrt": 0.7, "asinh": 1.6, "acosh": 2.2, "atanh": 1.9}


def ulps(y, exact):
    """|y - exact| in units in the last place of the exact value; infinite where only one of them is a number."""
    exact = np.asarray(exact, LONG)
    with np.errstate(all="ignore"):
        rounded = exact.astype(float)
        unit = np.spacing(np.abs(np.where(np.isfinite(rounded), rounded, 1.0)))
        error = np.abs((y - exact) / unit).astype(float)
        same = (np.isnan(y) & np.isnan(rounded)) | (y == rounded)
    return np.where(np.isfinite(y) & np.isfinite(rounded), error, np.where(same, 0.0, np.inf))


@pytest.mark.thorough
@needs_compiler
@pytest.mark.parametrize("name", REFERENCE)
def test_accuracy_is_within_ulp_bounds(call, name):
    x = values()
    with np.errstate(all="ignore"):
        exact = REFERENCE[name](x.astype(LONG))
        for variant in ("scalar", "scalar, no FMA"):
            error = ulps(call(variant, name, x), exact)
            worst = int(np.argmax(error))
            assert error[worst] <= BOUND[name], f"{variant}: {error[worst]:.3f} ulp at {x[worst]!r}"


@pytest.mark.thorough
@needs_compiler
@pytest.mark.parametrize("variant", ["scalar", "scalar, no FMA"])
def test_accuracy_of_atan2(call, variant):
    rng = np.random.default_rng(3)
    x = values()
    pairs = [(rng.permutation(x), x), (spread(rng, 1e-3, 1e3, 40000), spread(rng, 1e-3, 1e3, 40000))]
    for y, x in pairs:
        assert ulps(call(variant, "atan2", y, x), np.arctan2(y.astype(LONG), x.astype(LONG))).max() <= 0.8


@needs_compiler
@pytest.mark.parametrize("variant", ["scalar", "scalar, no FMA"])
def test_accuracy_of_pow(call, variant):
    """Bases and results of all sizes, including exact powers and integer exponents."""
    rng = np.random.default_rng(5)
    x = np.concatenate(
        [np.abs(spread(rng, *r, 20000)) for r in ((1e-320, 1e308), (1e-3, 1e3), (0.5, 2), (0.999, 1.001))]
    )
    y = rng.uniform(-1, 1, x.size) * 750 / np.abs(np.log(x))
    y[::3] = rng.uniform(-4, 4, y[::3].size)
    y[::7] = rng.integers(-9, 10, y[::7].size) / 2
    x[::2] *= np.where(y[::2] == np.rint(y[::2]), -1, 1)
    with np.errstate(all="ignore"):
        exact = np.power(x.astype(LONG), y.astype(LONG))
    error = ulps(call(variant, "pow", x, y), exact)
    worst = int(np.argmax(error))
    assert error[worst] <= 1.7, f"{error[worst]:.3f} ulp at {x[worst]!r}, {y[worst]!r}"


@needs_compiler
@pytest.mark.parametrize("variant", ["scalar", "scalar, no FMA"])
def test_accuracy_of_the_error_function(call, variant):
    """Against the C library's for long double; SciPy's is off by hundreds of units where erfc is small."""
    libm = ctypes.CDLL(find_library("m"))
    rng = np.random.default_rng(2)
    x = np.concatenate([np.linspace(-6, 28, 9000), np.linspace(0.7, 1.1, 2000), spread(rng, 1e-320, 6, 2000)])
    x = np.concatenate([x, [0.0, -0.0, 0.75, 1.0, 26.5, 28.0, 1e300, np.inf, -np.inf, np.nan]])
    for name, bound in (("erf", 1.8), ("erfc", 2.1)):  # half a unit of each is the rounding of what it is held against
        exact = getattr(libm, f"{name}l")
        exact.restype, exact.argtypes = ctypes.c_longdouble, [ctypes.c_longdouble]
        error = ulps(call(variant, name, x)[: x.size], np.array([exact(v) for v in x]))
        worst = int(np.argmax(error))
        assert error[worst] <= bound, f"{name}: {error[worst]:.3f} ulp at {x[worst]!r}"
    assert np.array_equal(np.signbit(call(variant, "erf", x)[: x.size]), np.signbit(x))


POW = (
    (0.0, 2.0, 0.0), (-0.0, 3.0, -0.0), (-0.0, 2.0, 0.0), (0.0, -1.0, np.inf), (-0.0, -1.0, -np.inf),
    (-0.0, -2.0, np.inf), (1.0, np.nan, 1.0), (np.nan, 0.0, 1.0), (np.nan, 1.0, np.nan), (2.0, np.nan, np.nan),
    (-1.0, np.inf, 1.0),
    (-1.0, -np.inf, 1.0), (0.5, np.inf, 0.0), (0.5, -np.inf, np.inf), (2.0, np.inf, np.inf), (-2.0, -np.inf, 0.0),
    (np.inf, 2.0, np.inf), (np.inf, -0.5, 0.0), (-np.inf, 3.0, -np.inf), (-np.inf, 2.0, np.inf), (-np.inf, -3.0, -0.0),
    (-np.inf, 0.5, np.inf), (-2.0, 3.0, -8.0), (-2.0, 0.5, np.nan), (-8.0, 1 / 3, np.nan), (2.0, -1074.0, 5e-324),
    (2.0, 1024.0, np.inf), (-2.0, 1025.0, -np.inf), (10.0, 22.0, 1e22), (5e-324, 1.0, 5e-324), (3.0, 2.0**53, np.inf),
    (-1.0, 2.0**53 + 2, 1.0), (-1.0, 2.0**52 + 1, -1.0), (1.7e308, 1e300, np.inf), (1.0, 1.7e308, 1.0),
)  # fmt: skip
"""Base, exponent and power, as C99's annex F has them."""


@needs_compiler
@pytest.mark.thorough(*RARE)
@pytest.mark.parametrize("variant", VARIANTS)
def test_special_values_of_pow(call, variant):
    x, y, wanted = np.array(POW).T
    assert np.array_equal(bits(call(variant, "pow", x, y)[: x.size]), bits(wanted))


@needs_compiler
def test_fused_multiply_add_without_the_instruction_is_exact(tmp_path):
    """Against the C library's, which takes the instruction where the CPU has it: ordinary numbers, subnormal ones,
    sums that cancel, ties, and any bits at all."""
    count = "long count(long n, const double *a, const double *b, const double *c)"
    loop = "double x = fma(a[i], b[i], c[i]), y = tt_fused(a[i], b[i], c[i]), z = tt_fused_any(a[i], b[i], c[i]);"
    same = "(tt_bits(x) == tt_bits(y) && tt_bits(x) == tt_bits(z)) || (x != x && y != y && z != z)"
    body = f"long apart = 0; for (long i = 0; i < n; i++) {{ {loop} apart += !({same}); }} return apart;"
    (tmp_path / "f.c").write_text(f"{elementary_text(names=['sin'])}{count};\n{count} {{ {body} }}\n")
    library = str(tmp_path / "f.so")
    subprocess.run(["gcc", "-std=c99", *FLAGS, "-shared", "-fPIC", tmp_path / "f.c", "-o", library, "-lm"], check=True)
    rng = np.random.default_rng(3)
    n = 300_000
    any_bits = rng.integers(0, 2**64, (3, n), np.uint64, endpoint=False).view(float)
    plain, tiny = rng.normal(0, 1, (3, n)) * 2.0 ** rng.integers(-40, 40, (3, n)), any_bits.copy()
    tiny.view(np.uint64)[...] &= np.uint64(0x83FFFFFFFFFFFFFF)
    coarse = (plain.view(np.uint64) & np.uint64(0xFFFFFFE000000000)).view(float)
    edge = rng.choice([0.0, -0.0, 1.0, 5e-324, 2.0**-1022, 1.79e308, np.inf, np.nan, 1e-310, -0.5, -3.0], (3, n))
    with np.errstate(all="ignore"):
        near = [
            np.array([a, b, -(a * b) * (1 + rng.integers(-2, 3, n) * 2.0**-52)]) for a, b, _ in (plain, tiny, any_bits)
        ]
    run = ctypes.CDLL(library).count
    run.restype = ctypes.c_long
    for rows in (any_bits, plain, tiny, coarse, edge, *near):
        rows = np.ascontiguousarray(rows)
        assert run(ctypes.c_long(n), *(ctypes.c_void_p(r.ctypes.data) for r in rows)) == 0


@needs_compiler
@pytest.mark.thorough(*RARE)
@pytest.mark.parametrize("variant", VARIANTS)
def test_sincos_matches_sin_and_cos(call, variant):
    x = values()
    s, c = call(variant, "sincos", x)
    assert np.array_equal(bits(s), bits(call(variant, "sin", x)))
    assert np.array_equal(bits(c), bits(call(variant, "cos", x)))


EXACT = {
    "floor": np.floor, "ceil": np.ceil, "trunc": np.trunc, "round_even": np.rint, "sqrt": np.sqrt,
    "round_away": lambda x: np.copysign(np.floor(np.abs(x).astype(LONG) + LONG(0.5)), x).astype(float),
}  # fmt: skip


@needs_compiler
@pytest.mark.thorough(*RARE)
@pytest.mark.parametrize("variant", VARIANTS)
def test_rounding_and_remainder_are_exact(call, variant):
    x = np.concatenate([values(), np.arange(-8, 8) / 2])
    z = np.random.default_rng(5).permutation(x)
    with np.errstate(all="ignore"):
        for name, exact in EXACT.items():
            assert np.array_equal(bits(call(variant, name, x)[: x.size]), bits(exact(x))), name
        assert np.array_equal(bits(call(variant, "fmod", x, z)[: x.size]), bits(np.fmod(x, z)))


INF, NAN, TINY, HALF_PI, PI = np.inf, np.nan, 5e-324, np.pi / 2, np.pi
SPECIAL = {
    "sin": ((0.0, 0.0), (-0.0, -0.0), (TINY, TINY), (-TINY, -TINY), (INF, NAN), (-INF, NAN), (NAN, NAN)),
    "cos": ((0.0, 1.0), (-0.0, 1.0), (INF, NAN), (NAN, NAN)),
    "tan": ((0.0, 0.0), (-0.0, -0.0), (TINY, TINY), (INF, NAN), (NAN, NAN)),
    "asin": ((0.0, 0.0), (-0.0, -0.0), (1.0, HALF_PI), (-1.0, -HALF_PI), (1.0000001, NAN), (-INF, NAN), (NAN, NAN)),
    "acos": ((1.0, 0.0), (-1.0, PI), (0.0, HALF_PI), (-0.0, HALF_PI), (-1.5, NAN), (INF, NAN), (NAN, NAN)),
    "atan": ((0.0, 0.0), (-0.0, -0.0), (TINY, TINY), (INF, HALF_PI), (-INF, -HALF_PI), (1e300, HALF_PI), (NAN, NAN)),
    "exp": ((0.0, 1.0), (-0.0, 1.0), (INF, INF), (-INF, 0.0), (710.0, INF), (-746.0, 0.0), (-745.0, TINY), (NAN, NAN)),
    "exp2": (
        (0.0, 1.0),
        (10.0, 1024.0),
        (-1074.0, TINY),
        (1024.0, INF),
        (-1076.0, 0.0),
        (INF, INF),
        (-INF, 0.0),
        (NAN, NAN),
    ),
    "expm1": (
        (0.0, 0.0),
        (-0.0, -0.0),
        (-TINY, -TINY),
        (INF, INF),
        (-INF, -1.0),
        (710.0, INF),
        (-50.0, -1.0),
        (NAN, NAN),
    ),
    "log": (
        (1.0, 0.0),
        (0.0, -INF),
        (-0.0, -INF),
        (INF, INF),
        (-1.0, NAN),
        (-INF, NAN),
        (TINY, -744.4400719213812),
        (NAN, NAN),
    ),
    "log1p": ((0.0, 0.0), (-0.0, -0.0), (TINY, TINY), (-1.0, -INF), (INF, INF), (-2.0, NAN), (-INF, NAN), (NAN, NAN)),
    "sinh": (
        (0.0, 0.0),
        (-0.0, -0.0),
        (-TINY, -TINY),
        (INF, INF),
        (-INF, -INF),
        (711.0, INF),
        (-711.0, -INF),
        (NAN, NAN),
    ),
    "cosh": ((0.0, 1.0), (-0.0, 1.0), (INF, INF), (-INF, INF), (-711.0, INF), (NAN, NAN)),
    "tanh": ((0.0, 0.0), (-0.0, -0.0), (TINY, TINY), (INF, 1.0), (-INF, -1.0), (30.0, 1.0), (NAN, NAN)),
    "logistic": ((0.0, 0.5), (-0.0, 0.5), (INF, 1.0), (-INF, 0.0), (40.0, 1.0), (-750.0, 0.0), (NAN, NAN)),
    "sqrt": ((0.0, 0.0), (-0.0, -0.0), (INF, INF), (-1.0, NAN), (NAN, NAN)),
    "rsqrt": ((0.0, INF), (-0.0, -INF), (INF, 0.0), (-1.0, NAN), (NAN, NAN)),
}
SPECIAL_TWO = (
    (0.0, 1.0, 0.0), (-0.0, 1.0, -0.0), (0.0, -1.0, PI), (-0.0, -1.0, -PI), (0.0, 0.0, 0.0), (-0.0, 0.0, -0.0),
    (0.0, -0.0, PI), (-0.0, -0.0, -PI), (1.0, 0.0, HALF_PI), (1.0, -0.0, HALF_PI), (-1.0, 0.0, -HALF_PI),
    (INF, INF, PI / 4), (INF, -INF, 3 * PI / 4), (-INF, INF, -PI / 4), (-INF, -INF, -3 * PI / 4), (1.0, INF, 0.0),
    (-1.0, INF, -0.0), (1.0, -INF, PI), (INF, 1.0, HALF_PI), (-INF, -1.0, -HALF_PI), (NAN, 1.0, NAN), (1.0, NAN, NAN),
    (1e-310, 1e300, 0.0), (TINY, 1.0, TINY), (1e300, 1e-300, HALF_PI),
)  # fmt: skip


@needs_compiler
@pytest.mark.thorough(*RARE)
@pytest.mark.parametrize("variant", VARIANTS)
def test_special_values_match_c99_annex_f(call, variant):
    """Values that C99, annex F, prescribes, signs of zero included."""
    for name, table in SPECIAL.items():
        x, wanted = np.array(table).T
        assert np.array_equal(bits(call(variant, name, x)[: x.size]), bits(wanted)), name
    y, x, wanted = np.array(SPECIAL_TWO).T
    assert np.array_equal(bits(call(variant, "atan2", y, x)[: x.size]), bits(wanted))


def bits(y):
    """Bits, with one pattern for all NaN."""
    return np.where(np.isnan(y), np.uint64(0x7FF8 << 48), np.asarray(y).view(np.uint64))


@needs_compiler
@pytest.mark.thorough(*(name for name in RARE if "lanes" in name))
@pytest.mark.parametrize("variant", [name for name in VARIANTS if "lanes" in name])
def test_vectors_give_the_same_bits(call, variant):
    x = values()
    z = np.random.default_rng(5).permutation(x)
    for name in FUNCTIONS:
        alone, together = (bits(call(v, name, x, z)) for v in (SCALAR[variant], variant))
        differ = np.argwhere(alone != together)
        assert not differ.size, f"{name}: {differ.size} differ, first at {x[differ[0][-1]]!r}"


@pytest.mark.thorough
@needs_compiler
@pytest.mark.sanitizer
@pytest.mark.parametrize("lanes", [0, 4])
def test_no_undefined_behaviour(tmp_path, lanes):
    """A sanitized program calls every function over all values; the first fault would end it."""
    x = values()
    x.tofile(tmp_path / "x")
    calls = "".join(f"do_{name}(n, x, x + 1, y, w); " for name in FUNCTIONS)
    head = f"enum {{ n = {x.size - 8} }}; static double x[n + 8], y[n], w[n];\n"
    read = 'FILE *f = fopen("x", "rb"); if (!f || fread(x, 8, n + 8, f) != n + 8) return 2;'
    source = tmp_path / ("main.cpp" if lanes else "main.c")
    source.write_text(f"#include <stdio.h>\n{driver(lanes)}{head}int main(void)\n{{\n{read} {calls}\nreturn 0;\n}}\n")
    flags = [*FLAGS, "-O1", *(VECTOR if lanes else ("-std=c99",)), "-fsanitize=undefined", "-fno-sanitize-recover=all"]
    command = ["g++" if lanes else "gcc", *flags, str(source), "-o", str(tmp_path / "main"), "-lm"]
    subprocess.run(command, check=True)
    subprocess.run([str(tmp_path / "main")], check=True, cwd=tmp_path)


@needs_compiler
@pytest.mark.skipif(not shutil.which("clang++"), reason="no clang++ here")
@pytest.mark.parametrize("lanes", [4, 8])
def test_clang_compiles_all_vector_functions(tmp_path, lanes):
    """Comparisons of clang's vectors do not give numbers as gcc's do."""
    source = tmp_path / "all.cpp"
    source.write_text(driver(lanes))
    subprocess.run(["clang++", *VECTOR, "-fsyntax-only", str(source)], check=True)


@pytest.mark.thorough
def test_text_contains_only_requested_functions(tmp_path):
    """Every function compiles alone and brings no other with it but what it needs."""
    text = elementary_text(names=["atan"])
    assert "tt_atan(" in text
    assert not [name for name in ("sin", "exp", "log", "atan2", "floor", "sinf") if f"tt_{name}(" in text]
    lines = []
    for k, name in enumerate((*OWN_FUNCTIONS, "fmod", "atanhf", "sincosf", "is_finite")):
        source = tmp_path / f"one{k}.c"
        source.write_text(elementary_text(names=[name]))
        lines.append(str(source))
    subprocess.run(["gcc", "-std=c99", "-pedantic", *FLAGS, "-fsyntax-only", *lines], check=True)
    (tmp_path / "one.cpp").write_text(elementary_text(8, names=["sincos"]))
    subprocess.run(["g++", *VECTOR, *FLAGS, "-fsyntax-only", str(tmp_path / "one.cpp")], check=True)


@pytest.mark.thorough
@needs_compiler
def test_single_precision_is_double_rounded(tmp_path):
    """Correctly rounded but for about one number in 10^8; where TT_SINGLE is 0, the C library is used."""
    names = [name for name in SINGLE_PRECISION_NAMES if name != "sincos"]
    calls = "".join(
        f"void do_{n}(float x, float *y) {{ *y = tt_{n}f({'x, 2.0f' if n in TWO else 'x'}); }}\n" for n in names
    )
    (tmp_path / "f.c").write_text(elementary_text(names=[f"{n}f" for n in names]) + calls)
    x = np.random.default_rng(1).uniform(0.1, 0.9, 200).astype(np.float32)
    for single, bound in ((1, 0.5001), (0, 4.0)):
        library, y = str(tmp_path / f"f{single}.so"), ctypes.c_float()
        command = ["gcc", "-std=c99", *FLAGS, f"-DTT_SINGLE={single}", "-shared", "-fPIC", str(tmp_path / "f.c")]
        subprocess.run([*command, "-o", library, "-lm"], check=True)
        loaded = ctypes.CDLL(library)
        for name, exact in REFERENCE.items():
            if name in ("acosh", *EXACT_FUNCTIONS):
                continue
            for value, wanted in zip(x, exact(x.astype(float)), strict=True):
                getattr(loaded, f"do_{name}")(ctypes.c_float(value), ctypes.byref(y))
                assert abs(y.value - wanted) <= bound * np.spacing(np.float32(abs(wanted))), (name, value)


def test_rejects_invalid_lane_count_and_function_name():
    with pytest.raises(InputError, match="3"):
        elementary_text(3)
    with pytest.raises(InputError, match="sinus"):
        elementary_text(names=["sinus"])
