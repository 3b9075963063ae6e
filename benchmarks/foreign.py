"""Time functions of other libraries, compiled by trimtab.compile, jax.jit and CasADi, and compare the results.

    python benchmarks/foreign.py                      all of tests/compiler/foreign: a line for each, then the means
    python benchmarks/foreign.py --library jaxlie     one library
    python benchmarks/foreign.py --quick              two rounds: only checks that they compile and agree
    python benchmarks/foreign.py --write              put the table into docs/benchmarks.md

Each round has a random order of the programs and another input. The smallest time of all rounds is reported, because
XLA runs even small programs in other threads, whose median time depends on the load of the machine. jax.jit gets arrays
on its device, and the time includes the wait for its results. trimtab.compile gets numpy arrays. CasADi's function is
the C that it generates, compiled with -O3 -march=native, and called by the fastest way that CasADi offers,
FunctionBuffer.
Packages: pip install "trimtab[foreign,bench]". A library that is not installed is left out.

Exits with 1 if a function does not compile or agree as stated in its list, with --strict also if a target is missed.
"""

import argparse
import importlib
import math
import random
import sys
import time
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(Path(__file__).parent), str(ROOT / "tests")]
import jax
from paired import Ratio, load, machine, row

import trimtab
from compiler.foreign.agreement import (
    CLOSE,
    compute_leaves,
    difference,
    draw_runs,
    measure_agreement,
    measure_sensitivity,
)
from compiler.foreign.case import Case

LIBRARIES = ("jaxlie", "brax", "equinox", "jaxopt", "blackjax", "diffrax", "optimistix", "jax_scipy", "own")
COMMAND, OTHERS = "python benchmarks/foreign.py", "functions of other libraries"
PAGE, BEGIN, END = ROOT / "docs" / "benchmarks.md", "<!-- made by benchmarks/foreign.py -->", "<!-- end of foreign -->"
TARGET, AGREE, TURN = 5.0, 65, 1e-3
"""Target speed relative to jax.jit, target number of functions that agree, and duration of one measurement (s)."""


class Figure(NamedTuple):
    """Results for one function.

    apart: relative difference of the results.  verdict: text.  times: program -> smallest time of a call (s).
    """

    library: str
    name: str
    verdict: str
    apart: float = math.nan
    times: dict[str, float] = {}
    good: bool = True

    def ratio(self, program: str) -> float | None:
        """Return a program's time divided by trimtab's, or None if it was not measured."""
        return self.times[program] / self.times["trimtab"] if program in self.times else None


def load_cases(library: str) -> list[Case]:
    """Return the functions of a library; an empty list if it is not installed."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return importlib.import_module(f"compiler.foreign.{library}_cases").CASES
    except ModuleNotFoundError as missing:
        print(f"{library} is left out: {missing}")
        return []


def programs(library: str, case: Case) -> dict[str, Any]:
    """Return program name -> function that computes a run, given by its number, and waits for the results."""
    runs = draw_runs(case)
    compiled, jitted = trimtab.compile(case.function, *runs[0]), jax.jit(lambda *arguments: case.function(*arguments))
    on_device = [jax.tree.map(jax.numpy.asarray, r) for r in runs]

    def by_jit(k: int) -> Any:
        found = jitted(*on_device[k])
        return found.block_until_ready() if isinstance(found, jax.Array) else jax.block_until_ready(found)

    made = {"trimtab": lambda k: compiled(*runs[k]), "jax.jit": by_jit}
    try:
        from foreign_casadi import twin
    except ModuleNotFoundError:
        return made
    call = twin(library, case.name, runs)
    if call is not None:
        found = [[call(k).copy()] for k in range(len(runs))]
        wanted = [[np.concatenate([x.ravel() for x in leaves])] for leaves in compute_leaves(compiled, runs)]
        if not difference(found, wanted) < 1e-9:
            sys.exit(f"CasADi's {case.name!r} of {library} is another function: {difference(found, wanted):.1e} apart")
        made["casadi"] = call
    return made


def measure_times(calls: dict[str, Any], rounds: int, runs: int) -> dict[str, float]:
    """Return program -> smallest time of a call (s) in rounds of random order."""
    counts = {name: _calls_per_turn(call) for name, call in calls.items()}
    times = dict.fromkeys(calls, math.inf)
    rng = random.Random(0)
    for i in range(rounds):
        for name in rng.sample(list(calls), len(calls)):
            call, k = calls[name], i % runs
            start = time.perf_counter()
            for _ in range(counts[name]):
                call(k)
            times[name] = min(times[name], (time.perf_counter() - start) / counts[name])
    return times


def _calls_per_turn(call: Any) -> int:
    call(0)
    start = time.perf_counter()
    call(0)
    return max(1, min(1000, int(TURN / (time.perf_counter() - start))))


def measure(library: str, case: Case, rounds: int) -> Figure:
    """Compile, compare and time one function."""
    try:
        found = measure_agreement(case)
    except trimtab.InputError:
        verdict = f"not supported: {case.refused or 'NOT IN THE LIST'}"
        return Figure(library, case.name, verdict, good=bool(case.refused))
    own = measure_sensitivity(case) if case.sensitive else 0.0
    good = found.apart <= max(CLOSE, 10 * own) and found.same_in_lanes and not case.refused
    verdict = "agrees" if found.apart <= CLOSE else f"as sensitive as jax.jit ({own:.0e})" if good else "WRONG"
    times = measure_times(programs(library, case), rounds, len(draw_runs(case)))
    return Figure(library, case.name, verdict, found.apart, times, good)


def geometric_mean(figures: list[Figure], program: str) -> Ratio:
    """Return the geometric mean, smallest and largest ratio of a program's time to trimtab's."""
    ratios = [r for r in (f.ratio(program) for f in figures) if r is not None]
    return Ratio(math.exp(np.mean(np.log(ratios))), min(ratios), max(ratios)) if ratios else Ratio(*[math.nan] * 3)


def summary(figures: list[Figure]) -> list[str]:
    """Return the rows for the first table of the docs page."""
    timed = [f for f in figures if f.times]
    agree = sum(f.apart <= CLOSE for f in figures)
    jit, twins = geometric_mean(figures, "jax.jit"), sum("casadi" in f.times for f in figures)
    rows = [
        row(f"{OTHERS}: compiled", f"{len(timed)} of {len(figures)}", "", COMMAND),
        row(f"{OTHERS}: agree with jax.jit to {CLOSE:g}", f"{agree} of {len(figures)}", f"≥ {AGREE}", COMMAND),
        row(f"{OTHERS}: time of jax.jit / time of trimtab.compile, geometric mean", jit, f"≥ {TARGET:g}", COMMAND),
    ]
    if twins:
        what = f"{twins} {OTHERS}: time of CasADi's C / time of trimtab.compile, geometric mean"
        rows.append(row(what, geometric_mean(figures, "casadi"), "", COMMAND))
    return rows


def table(figures: list[Figure]) -> str:
    """Return the table in Markdown, with a row for each function."""
    heads = "time of trimtab (us) | time of jax.jit / trimtab | time of CasADi / trimtab | largest relative difference"
    lines = [f"| library | function | {heads} | verdict |", "|---" * 7 + "|"]
    for f in figures:
        took = f"{1e6 * f.times['trimtab']:.2f}" if f.times else "-"
        jit, casadi = (f"{f.ratio(n):.2f}" if n in f.times else "-" for n in ("jax.jit", "casadi"))
        apart = f"{f.apart:.0e}" if f.times else "-"
        library = "written for this test" if f.library == "own" else f.library
        lines.append(f"| {library} | {f.name} | {took} | {jit} | {casadi} | {apart} | {f.verdict} |")
    return "\n".join(lines)


def main() -> int:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--library", choices=LIBRARIES, action="append", help="time only this library; may be repeated")
    p.add_argument("--rounds", type=int, default=15, help="number of rounds (%(default)s)")
    p.add_argument("--quick", action="store_true", help="2 rounds: checks agreement, but gives no useful times")
    p.add_argument("--strict", action="store_true", help="exit with 1 also if a target is missed")
    p.add_argument("--markdown", action="store_true", help="print rows for the documentation's table at the end")
    p.add_argument("--write", action="store_true", help="put the table into docs/benchmarks.md")
    a = p.parse_args()
    if a.write and (a.library or a.quick):
        p.error("--write needs all libraries and full rounds: leave out --library and --quick")
    began, figures = load(), []
    print(f"{machine('jax')}\n{began}")
    for library in a.library or LIBRARIES:
        for case in load_cases(library):
            f = measure(library, case, 2 if a.quick else max(1, a.rounds))
            figures.append(f)
            ratios = "  ".join(f"{n} x {f.ratio(n):.2f}" for n in f.times if n != "trimtab")
            took = f"{1e6 * f.times['trimtab']:10.2f} us" if f.times else " " * 13
            print(f"{library:10} {case.name:46} {took}  {ratios:35} {f.apart:.0e} {f.verdict}", flush=True)
    rows = summary(figures)
    print("\n".join(["", *(r.replace("|", " ") for r in rows), began, load()]))
    if a.markdown:
        print("\n".join(rows))
    if a.write:
        before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
        about = f"Measured on {machine('jax')}; {began.split('   ')[0]} at the start."
        text = "\n\n".join([before + BEGIN, about, table(figures), END])
        PAGE.write_text(text + rest.partition(END)[2], encoding="utf-8")
    bad = [f"{f.library}: {f.name}" for f in figures if not f.good]
    print(f"NOT as listed: {', '.join(bad)}" if bad else "all as listed")
    met = geometric_mean(figures, "jax.jit").median >= TARGET and sum(f.apart <= CLOSE for f in figures) >= AGREE
    return int(bool(bad) or (a.strict and not met))


if __name__ == "__main__":
    sys.exit(main())
