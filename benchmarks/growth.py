"""Measure compile time and text size of a program over its number of signals, with trimtab, jax.jit and CasADi.

The program has n signals, each with a sine, a hyperbolic tangent and an exponential. Each is coupled to its neighbours.
The program has no loops. trimtab compiles it for one run and for lanes.

    python benchmarks/growth.py                                  some minutes
    python benchmarks/growth.py --sizes 100 200 400 --peers 400  quicker
    python benchmarks/growth.py --plot docs/growth.svg   also writes the plot for the docs page

Times are CPU seconds, so that other programs have little influence. They cover everything from the function to the
loaded library: tracing, and the C compiler. CasADi (extra `bench`) writes C, which the same compiler builds with
trimtab's flags.
"""

import argparse
import ctypes
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE / "reference")]
from paired import machine, row
from references import CC, sh

from trimtab.compiler.function import lower_function
from trimtab.compiler.native.build import FLAGS, build_library, load_library
from trimtab.compiler.native.compiler import find_compiler, lane_count

jax.config.update("jax_enable_x64", True)

SIZES = (100, 200, 400, 800, 1600, 3000)
TARGET = 15.0
"""Largest accepted time (s) for the largest program."""
SLOPE = 1.15
"""Largest exponent of n that counts as linear, fitted over the upper half of the sizes."""
TRIMTAB, LANES, JAX, CASADI = "trimtab, one run", "trimtab, lanes", "jax.jit", "CasADi, C by gcc"


class Measured(NamedTuple):
    """CPU time (s), and size of the text in bytes (0 if no text is written)."""

    seconds: float
    text: int


def signals(x: Any, m: Any = jnp) -> list[Any]:
    """Return the rates of n signals, each coupled to its neighbours in a ring. m: jax.numpy or casadi."""
    n = x.shape[0]
    v = [x[k] for k in range(n)]
    return [-0.5 * v[k] + m.sin(v[k - 1]) * m.tanh(v[(k + 1) % n]) + 0.1 * m.exp(-v[k] * v[k]) for k in range(n)]


def rates(x: Any) -> Any:
    """Return the rates of the signals as an array."""
    return jnp.stack(signals(x))


def cpu() -> float:
    """Return the CPU time (s) of this process and of the processes that it waited for."""
    return sum(os.times()[:4])


def pointer(a: Any) -> Any:
    """Return the address of an array."""
    return a.ctypes.data_as(ctypes.c_void_p)


def by_trimtab(x: Any, lanes: int) -> tuple[Any, int]:
    """Return the result of trimtab's program, and the size of its text in bytes."""
    made = lower_function(rates, (x,)).program_text("growth", lanes)
    library = build_library(made.text, "c++" if lanes else "c", extra=made.flags)
    out, memory = np.empty(x.size), np.empty(made.workspace // 8 + 8)
    space = ctypes.c_void_p(memory.ctypes.data + -memory.ctypes.data % 64)
    load_library(library).growth((ctypes.c_void_p * 1)(x.ctypes.data), (ctypes.c_void_p * 1)(out.ctypes.data), space, 1)
    return out, len(made.text)


def by_jax(x: Any) -> tuple[Any, int]:
    """Return the result of jax.jit, and the size of XLA's text in bytes."""
    lowered = jax.jit(rates).lower(x)
    return np.asarray(lowered.compile()(x)), len(lowered.as_text())


def by_casadi(x: Any) -> tuple[Any, int]:
    """Return the result of CasADi's C, built with trimtab's flags, and the size of its text in bytes."""
    import casadi

    state = casadi.SX.sym("x", x.size)
    function = casadi.Function("growth", [state], [casadi.vertcat(*signals(state, casadi))])
    with tempfile.TemporaryDirectory() as folder:
        here = os.getcwd()
        os.chdir(folder)  # CasADi writes files only to the current folder
        try:
            function.generate("growth.c")
        finally:
            os.chdir(here)
        sh(CC, *FLAGS["c"], "-shared", "-fPIC", "-o", f"{folder}/growth.so", f"{folder}/growth.c", "-lm")
        library, size = ctypes.CDLL(f"{folder}/growth.so"), Path(folder, "growth.c").stat().st_size
        out, work = np.empty(x.size), np.empty(max(function.sz_w(), 1))
        library.growth(
            (ctypes.c_void_p * 1)(x.ctypes.data), (ctypes.c_void_p * 1)(out.ctypes.data), None, pointer(work)
        )
    return out, size


def measure(program: Callable[[Any], tuple[Any, int]], x: Any) -> Measured:
    """Return compile time and text size of a program, after a comparison of its results with numpy's."""
    before = cpu()
    given, text = program(x)
    seconds = cpu() - before
    expected = np.array(signals(x, np))
    worst = float(np.max(np.abs(given - expected)))
    if not worst <= 1e-13:
        sys.exit(f"{x.size} signals: {worst:.1e} from numpy")
    return Measured(seconds, text)


def slope(found: dict[int, float]) -> float:
    """Return the exponent of n, fitted over the upper half of the sizes."""
    sizes = sorted(found)[len(found) // 2 - 1 :]
    return float(np.polyfit(np.log(sizes), np.log([found[n] for n in sizes]), 1)[0])


def draw(found: dict[str, dict[int, Measured]], path: Path) -> None:
    """Plot compile time and text size over n."""
    import matplotlib

    matplotlib.use("agg")
    matplotlib.rcParams["svg.fonttype"] = "none"  # text is not converted to outlines
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for name, marker in ((TRIMTAB, "o"), (LANES, "s"), (JAX, "^"), (CASADI, "v")):
        sizes = list(found.get(name, ()))
        if sizes:
            axes[0].loglog(sizes, [found[name][n].seconds for n in sizes], marker=marker, label=name)
            axes[1].loglog(sizes, [found[name][n].text / 1e3 for n in sizes], marker=marker, label=name)
    for axis, label in zip(axes, ("compile time (CPU s)", "text (kB)"), strict=True):
        ticks = sorted({n for sizes in found.values() for n in sizes})
        axis.set(xlabel="signals", ylabel=label)
        axis.set_xticks(ticks, [str(n) for n in ticks])
        axis.minorticks_off()
        axis.grid(True, which="both", alpha=0.3)
    axes[0].legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)
    print(f"wrote {path}")


def programs(peers: bool) -> dict[str, Callable[[Any], tuple[Any, int]]]:
    """Return the programs to measure, by name."""
    compiler = find_compiler("c++")
    lanes = lane_count(compiler) if compiler else 1
    found: dict[str, Callable[[Any], tuple[Any, int]]] = {TRIMTAB: lambda x: by_trimtab(x, 0)}
    if lanes > 1:
        found[LANES] = lambda x: by_trimtab(x, lanes)
    if not peers:
        return found
    found[JAX] = by_jax
    try:
        import casadi  # noqa: F401
    except ImportError:
        print("CasADi is not installed: it is in the extra `bench`")
    else:
        found[CASADI] = by_casadi
    return found


def main() -> int:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="numbers of signals")
    p.add_argument("--peers", type=int, default=3000, help="largest size for jax.jit and CasADi; 0: none")
    p.add_argument("--plot", type=Path, help="write the picture to this file")
    p.add_argument("--markdown", action="store_true", help="print rows for the documentation's table at the end")
    a = p.parse_args()
    jax.config.update("jax_enable_compilation_cache", False)
    print(machine("jax"))
    found: dict[str, dict[int, Measured]] = {}
    print(f"\n{'signals':>8}  {'':20}{'CPU s':>8}{'kB':>9}")
    for n in a.sizes:
        with tempfile.TemporaryDirectory() as empty:
            os.environ["TRIMTAB_CACHE"] = empty
            for name, program in programs(n <= a.peers).items():
                m = measure(program, np.linspace(-1.0, 1.0, n))
                found.setdefault(name, {})[n] = m
                print(f"{n:8}  {name:20}{m.seconds:8.2f}{m.text / 1e3:9.0f}", flush=True)
    most, met, lines = max(a.sizes), True, []
    print()
    for name, sizes in found.items():
        time, text = (slope({n: float(m[k]) for n, m in sizes.items()}) for k in (0, 1))
        print(f"{name:20} time grows as n^{time:.2f}, text as n^{text:.2f}")
        own, last = name in (TRIMTAB, LANES), max(sizes)
        met &= not own or (sizes[most].seconds <= TARGET and max(time, text) <= SLOPE)
        target = f"≤ {TARGET:g} s" if own else ""
        figure = f"{sizes[last].seconds:.1f} s, as n^{time:.2f}"
        lines.append(row(f"compiling {last} signals: {name}", figure, target, "python benchmarks/growth.py"))
    if a.plot:
        draw(found, a.plot)
    print("\n".join(lines) if a.markdown else f"targets {'met' if met else 'MISSED'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
