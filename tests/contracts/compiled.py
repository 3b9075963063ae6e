"""Runs JAX functions as JAX, as scalar C and as C++ over lanes that hold different inputs, and compares the results."""

import ctypes
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from xla_settings import choose_emitters

from trimtab.compiler.function import lower_function
from trimtab.compiler.jaxprs import primitive_name
from trimtab.compiler.native.build import build_library, load_library

jax.config.update("jax_enable_x64", True)

CPU = Path("/proc/cpuinfo")
LANES = 8 if CPU.exists() and "avx512dq" in CPU.read_text() else 4
"""Runs side by side: what this CPU carries."""


class Case(NamedTuple):
    """A function and what it is tried on.

    sets: arguments, one tuple for each lane.  ulp: units in the last place by which floats may differ; 0: not a bit.
    close: relative to the largest number, where sums come in another order.  lanes: whether C++ carries its types.
    """

    name: str
    function: Callable[..., Any]
    sets: list[tuple[Any, ...]]
    ulp: int = 0
    close: float = 0.0
    lanes: bool = True


def primitives(function: Callable[..., Any], arguments: Sequence[Any]) -> set[str]:
    """Names of all primitives in a function's jaxpr, inner ones included."""
    found: set[str] = set()

    def walk(jaxpr: Any) -> None:
        for equation in jaxpr.eqns:
            found.add(primitive_name(equation.primitive))
            for value in equation.params.values():
                for inner in value if isinstance(value, tuple | list) else [value]:
                    inner = getattr(inner, "jaxpr", inner)
                    if hasattr(inner, "eqns"):
                        walk(inner)

    walk(jax.make_jaxpr(function)(*arguments).jaxpr)
    return found


def compiled(cases: list[Case], lanes: int, *flags: str, halves: bool = False) -> list[list[Any]]:
    """Results of the compiled functions, for each set the leaves of all cases; lanes 0 for scalar C.

    halves: the elementary functions compute half of the lanes at a time, as in programs of 32-bit numbers.
    """
    if lanes:
        lowered = [lower_function(c.function, c.sets[0]) for c in cases]
        made = [f.program_text(f"go{k}", lanes, halves=halves) for k, f in enumerate(lowered)]
        texts = [_spaced(m.text, k) for k, m in enumerate(made)]
        library = load_library(build_library(INCLUDES + "\n".join(texts), "c++", extra=("-O1", "-w", *flags)))
        run = _run_both_halves if halves else _run
        parts = [run(getattr(library, f"go{k}"), c, lanes, made[k].workspace) for k, c in enumerate(cases)]
        return [[leaf for part in row for leaf in part] for row in zip(*parts, strict=True)]
    function, sets = together(cases)
    one = lower_function(function, sets[0]).program_text("go")
    library = load_library(build_library(one.text, "c", extra=("-O1", "-w", *flags)))
    return _run(library.go, Case("all", function, sets), 1, one.workspace)


INCLUDES = "#include <math.h>\n#include <stdbool.h>\n#include <stdint.h>\n#include <string.h>\n"
INCLUDES += "#if defined __x86_64__\n#include <immintrin.h>\n#endif\n"


def _spaced(text: str, k: int) -> str:
    """C++ text in a space of names of its own: several programs in one file, which has included all before."""
    return f"namespace program{k} {{\n{text}\n}}\n"


def _run(go: Any, case: Case, runs: int, workspace: int) -> list[list[Any]]:
    """The leaves of the results for each set, `runs` sets in one call."""
    like = jax.tree.leaves(jax.eval_shape(case.function, *case.sets[0]))
    flat = [[np.ascontiguousarray(a) for a in jax.tree.leaves(s)] for s in case.sets]
    found = []
    for first in range(0, len(flat), runs):
        some = flat[first : first + runs]
        together = [np.stack(arrays) for arrays in zip(*some, strict=True)]
        outs = [np.zeros((len(some), *a.shape), a.dtype) for a in like]
        given = (ctypes.c_void_p * (len(together) + 1))(*[a.ctypes.data for a in together], None)
        memory = np.empty(workspace + 64, np.uint8)
        at = memory.ctypes.data
        go(
            given,
            (ctypes.c_void_p * (len(outs) + 1))(*[a.ctypes.data for a in outs], None),
            ctypes.c_void_p(at + -at % 64),
            len(some),
        )
        found += [[o[i] for o in outs] for i in range(len(some))]
    return found


def _run_both_halves(go: Any, case: Case, runs: int, workspace: int) -> list[list[Any]]:
    """The results of _run, computed in both halves of the lanes, which must give the same bits."""
    assert len(case.sets) <= runs // 2
    sets = (case.sets * runs)[: runs // 2]
    found = _run(go, case._replace(sets=2 * sets), runs, workspace)
    for first, second in zip(found[: len(sets)], found[len(sets) :], strict=True):
        assert all(a.tobytes() == b.tobytes() for a, b in zip(first, second, strict=True)), case.name
    return found[: len(case.sets)]


def reference(function: Callable[..., Any], sets: list[tuple[Any, ...]]) -> list[list[Any]]:
    """Results for each set of arguments, of JAX."""
    # The reference is XLA as it comes, whatever the environment says: its older way computes cbrt to 13 digits only.
    jitted = jax.jit(function, compiler_options=choose_emitters(newer=True))
    return [[np.asarray(o) for o in jax.tree.leaves(jitted(*s))] for s in sets]


def together(cases: list[Case]) -> tuple[Callable[..., Any], list[tuple[Any, ...]]]:
    """All cases as one function with one compilation: it takes and gives a tuple for each case."""
    count = min(len(c.sets) for c in cases)
    sets = [tuple(c.sets[i] for c in cases) for i in range(count)]
    return lambda *given: tuple(c.function(*a) for c, a in zip(cases, given, strict=True)), sets


def differences(cases: list[Case]) -> list[str]:
    """A line for each case that differs from JAX, in either shape; empty when all agree."""
    with ThreadPoolExecutor() as pool:  # compilers run beside JAX's own
        wanted = pool.submit(reference, *together(cases))
        wide = [c for c in cases if c.lanes]
        tries = [(0, cases, pool.submit(compiled, cases, 0))]
        if wide:
            tries.append((LANES, wide, pool.submit(compiled, wide, LANES)))
        half = [c for c in wide if lower_function(c.function, c.sets[0]).has_half_width()]
        if half:
            tries.append((2 * LANES, half, pool.submit(compiled, half, 2 * LANES, halves=True)))
        return [
            line for lanes, some, got in tries for line in _lines(cases, some, lanes, wanted.result(), got.result())
        ]


def _lines(cases: list[Case], some: list[Case], lanes: int, wanted: list[Any], got: list[Any]) -> list[str]:
    found = []
    of_case = [c for c in cases for _ in jax.tree.leaves(jax.eval_shape(c.function, *c.sets[0]))]
    chosen = {id(c) for c in some}
    here = [k for k, c in enumerate(of_case) if id(c) in chosen]
    first = {id(c): k for k, c in reversed(list(enumerate(of_case)))}
    for j, k in enumerate(here):
        for lane, (w, g) in enumerate(zip(wanted, got, strict=True)):
            wrong = disagreement(of_case[k], w[k], g[j])
            if wrong is not None:
                place = tuple(int(a[0]) for a in np.nonzero(np.atleast_1d(wrong)))[: wrong.ndim]
                shape = f"lane {lane} of {lanes}" if lanes else f"set {lane}"
                line = f"{of_case[k].name}, result {k - first[id(of_case[k])]}{place}, {shape}: {g[j][place]!r}"
                found.append(f"{line}, not {w[k][place]!r}; {int(wrong.sum())} such")
                break
    return found


def disagreement(case: Case, wanted: Any, got: Any) -> Any:
    """Where two arrays differ by more than the case allows, or None."""
    if wanted.dtype.kind != "f":
        wrong = wanted != got
    else:
        with np.errstate(all="ignore"):
            same = (wanted == got) | (np.isnan(wanted) & np.isnan(got))
            finite = np.isfinite(wanted)
            largest = np.max(np.abs(wanted[finite]), initial=0.0) if case.close else 0.0
            allowed = case.ulp * np.spacing(np.abs(wanted)) + case.close * largest
            near = finite & (np.abs(wanted - got) <= allowed)
        wrong = ~(same | near)
    return wrong if wrong.any() else None
