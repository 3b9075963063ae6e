"""Elementary functions of generated code: accuracy, special values, and the same bits alone and in vectors."""

import ctypes
import shutil
import subprocess
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.export.elementary import FUNCTIONS, SINGLE, elementary

GCC, GXX = shutil.which("gcc"), shutil.which("g++")
needs_compiler = pytest.mark.skipif(not (GCC and GXX), reason="no gcc and g++ here")
FLAGS = ("-O2", "-ffp-contract=off", "-fno-math-errno", "-fwrapv", "-Wall", "-Wextra", "-Werror")
TWO = ("pow", "fmod", "atan2")
ONE = tuple(name for name in FUNCTIONS if name not in (*TWO, "sincos"))
HAS_AVX512 = "avx512dq" in (Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else "")
VARIANTS = {
    "scalar": (0, "gcc", ("-std=c99", "-x", "c")),
    "4 lanes": (4, "g++", ("-std=c++17", "-march=native", "-Wno-psabi", "-O3")),
    "8 lanes": (8, "g++", ("-std=c++17", "-march=native", "-Wno-psabi", "-O3")),
    "4 lanes, no AVX": (4, "g++", ("-std=c++17", "-Wno-psabi")),
}
LONG = np.longdouble


def driver(lanes: int) -> str:
    """C text: the functions over whole arrays, whose length is a multiple of 8."""
    number, prefix, step = ("vf64", "ttv", lanes) if lanes else ("double", "tt", 1)
    loop = f"for (long i = 0; i < n; i += {step})"
    get = f"{number} a, b, r; memcpy(&a, x + i, sizeof a); memcpy(&b, z + i, sizeof b); (void)b;"
    text = [elementary(lanes), '#ifdef __cplusplus\nextern "C" {\n#endif']
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
    """call(variant, name, x, z) -> values; the libraries are built side by side, once."""
    folder = tmp_path_factory.mktemp("elementary")
    started = []
    for k, (lanes, compiler, flags) in enumerate(VARIANTS.values()):
        source = folder / f"v{k}.{'cpp' if lanes else 'c'}"
        source.write_text(driver(lanes))
        command = [compiler, *FLAGS, *flags, "-shared", "-fPIC", str(source), "-o", str(folder / f"v{k}.so"), "-lm"]
        started.append(subprocess.Popen(command, stderr=subprocess.PIPE, text=True))
    for process in started:
        _, errors = process.communicate()
        assert process.returncode == 0, errors
    libraries = {name: ctypes.CDLL(str(folder / f"v{k}.so")) for k, name in enumerate(VARIANTS)}

    def run(variant, name, x, z=None):
        n = -(-x.size // 8) * 8
        x, z = (np.resize(np.asarray(v, float), n) for v in (x, x if z is None else z))
        y, w = np.empty(n), np.empty(n)
        getattr(libraries[variant], f"do_{name}")(ctypes.c_long(n), *(ctypes.c_void_p(a.ctypes.data) for a in (x, z, y, w)))
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
    edge = [0.0, 5e-324, 1e-310, 2.2250738585072014e-308, 1e-300, 1e-160, 1e-20, 2.0**-54, 2.0**-28, 2.0**-27, 0.25, 0.5]
    edge += [1.0, np.sqrt(0.5), np.sqrt(2), 1.5, 2.5, 22.0, 40.0, 300.0, 709.0, 709.78, 710.0, 710.47, 711.0, 745.0, 746.0]
    edge += [1023.5, 1024.0, 1074.0, 1075.0, 1e6, 1e6 + 1, 1e15, 2.0**52 - 0.5, 2.0**52, 2.0**53, 1e22, 1e100, 1.7e308]
    edge = np.concatenate([edge, quarter, far, np.log(2) * np.arange(1, 30) / 2])
    near = np.concatenate([edge, np.nextafter(edge, 0), np.nextafter(edge, np.inf), [np.inf, np.nan]])
    ranges = ((1e-9, 1.0), (0.1, 4.0), (1.0, 100.0), (10.0, 800.0), (100.0, 1e6), (1e-320, 1e-290), (1e5, 1e300))
    wide = [spread(rng, low, high, 3000) for low, high in ranges]
    even = [rng.uniform(-1, 1, 20000), rng.uniform(-10, 10, 20000), rng.uniform(-750, 750, 4000), rng.uniform(0.5, 2, 9000)]
    x = np.concatenate([near, -near, *wide, *even])
    return x[: x.size // 8 * 8]


REFERENCE = {
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan,
    "exp": np.exp, "exp2": np.exp2, "expm1": np.expm1, "log": np.log, "log1p": np.log1p, "sinh": np.sinh,
    "cosh": np.cosh, "tanh": np.tanh, "logistic": lambda x: 1 / (1 + np.exp(-x)), "sqrt": np.sqrt,
    "rsqrt": lambda x: 1 / np.sqrt(x), "cbrt": np.cbrt, "asinh": np.arcsinh, "acosh": np.arccosh, "atanh": np.arctanh,
}  # fmt: skip
BOUND = {name: 0.8 for name in REFERENCE} | {"sqrt": 0.51, "rsqrt": 1.5, "cbrt": 1.0, "asinh": 2, "acosh": 2, "atanh": 2}


def ulps(y, exact):
    """|y - exact| in units in the last place of the exact value; infinite where one is NaN or Inf and the other isn't."""
    exact = np.asarray(exact, LONG)
    with np.errstate(all="ignore"):
        rounded = exact.astype(float)
        unit = np.spacing(np.abs(np.where(np.isfinite(rounded), rounded, 1.0)))
        error = np.abs((y - exact) / unit).astype(float)
        same = (np.isnan(y) & np.isnan(rounded)) | (y == rounded)
    return np.where(np.isfinite(y) & np.isfinite(rounded), error, np.where(same, 0.0, np.inf))


@needs_compiler
@pytest.mark.parametrize("name", REFERENCE)
def test_accuracy(call, name):
    x = values()
    with np.errstate(all="ignore"):
        error = ulps(call("scalar", name, x), REFERENCE[name](x.astype(LONG)))
    worst = int(np.argmax(error))
    assert error[worst] <= BOUND[name], f"{error[worst]:.3f} ulp at {x[worst]!r}"


@needs_compiler
def test_accuracy_sincos_atan2(call):
    x = values()
    rng = np.random.default_rng(3)
    near = x[np.abs(x) <= 1e6]
    with np.errstate(all="ignore"):
        error = ulps(call("scalar", "sincos", near)[:, : near.size], np.stack([np.sin(near.astype(LONG)), np.cos(near.astype(LONG))]))
        assert error.max() <= 0.8
        y = rng.permutation(x)
        error = ulps(call("scalar", "atan2", y, x), np.arctan2(y.astype(LONG), x.astype(LONG)))
        assert error.max() <= 0.8
        near = spread(rng, 1e-3, 1e3, 40000), spread(rng, 1e-3, 1e3, 40000)
        assert ulps(call("scalar", "atan2", *near), np.arctan2(*(a.astype(LONG) for a in near))).max() <= 0.8


def bits(y):
    """Bits, with one pattern for all NaN."""
    return np.where(np.isnan(y), np.uint64(0x7FF8 << 48), np.asarray(y).view(np.uint64))


@needs_compiler
@pytest.mark.parametrize("variant", [name for name in VARIANTS if name != "scalar"])
def test_vectors_give_the_same_bits(call, variant):
    x = values()
    z = np.random.default_rng(5).permutation(x)
    for name in FUNCTIONS:
        alone, together = (bits(call(v, name, x, z)) for v in ("scalar", variant))
        differ = np.argwhere(alone != together)
        assert not differ.size, f"{name}: {differ.size} differ, first at {x[differ[0][-1]]!r}"
