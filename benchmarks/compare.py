"""Time trimtab, C and SIMD C++ written by hand, JAX and numpy on the same closed loop, and check every result.

    python benchmarks/compare.py               minutes: tables of single runs, logs and campaigns, then the targets
    python benchmarks/compare.py --quick       seconds: only checks the results
    python benchmarks/compare.py --markdown    the rows of docs/benchmarks.md

Exits with 1 if a result is wrong, with --strict also if a target is missed. benchmarks/README.md defines the loop.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE / "reference")]
import compiled
import hover_jax
import hover_np
import jax
import jax.numpy as jnp
import references
import spec
import workload
from figures import CAMPAIGN, NUMPY, SCAN, TITLES, TRIMTAB, VMAP, WALK, figures, markdown, report
from paired import Program, Timed, difference, load, machine, ratio, rounds, several, show
from references import HAND_C, HAND_SLP, KNOWN, truth


def singles(libraries: dict[str, Any], lanes: int) -> dict[str, Program]:
    """Return the fast programs, five runs each. A round takes milliseconds, so all see the same load of the machine."""
    made = {name: several(references.single(lib), 5, truth) for name, lib in libraries.items() if "SIMD" not in name}
    simd = references.hand_simd(lanes)
    if simd in libraries:
        made[simd] = several(references.block(libraries[simd], lanes), 5, truth)._replace(runs=5 * lanes)
    return {**made, TRIMTAB: several(compiled.single, 5)}


def slower(libraries: dict[str, Any]) -> dict[str, Program]:
    """Return the programs that take tens to hundreds of milliseconds, and ten runs each of two fast programs."""
    return {
        HAND_C: several(references.single(libraries[HAND_C]), 10, truth),
        TRIMTAB: several(compiled.single, 10),
        SCAN: Program(hover_jax.single, result=truth),
        WALK: Program(workload.single, result=truth),
        NUMPY: Program(hover_np.single, result=truth),
    }


def logs(libraries: dict[str, Any]) -> dict[str, Program]:
    """Return programs of the same loop with a log of 11 numbers per step, which is compared row by row."""
    walk = workload.logged(workload.LOGGED)
    return {
        HAND_C: several(references.logged(libraries[HAND_C]), 10, after),
        TRIMTAB: several(compiled.logged, 10, before),
        SCAN: Program(scan_with_log(), result=after),
        WALK: Program(lambda gains, key: walk(gains, key)[1], result=before),
    }


def after(log: Any) -> Any:
    """Return log rows with the true state after the step of each tick."""
    return np.asarray(log)[:-1]


def before(log: Any) -> Any:
    """Convert rows with velocities and the true state before each step to the form of `after`."""
    rows = np.asarray(log)
    return np.hstack([rows[1:, :6] * compiled.SCALE[:6], rows[:-1, 6:]])


def scan_with_log() -> Callable[..., Any]:
    """Return the plain lax.scan with its own log."""
    flown = jax.jit(lambda gains, key: hover_jax.simulate(gains, key)[1])
    return lambda gains, key: jax.block_until_ready(flown(jnp.asarray(gains), jnp.asarray(key)))


def campaigns(libraries: dict[str, Any], lanes: int, runs: int) -> dict[str, Program]:
    """Return programs of many runs with the given number of threads. JAX chooses its own number."""
    made = {n: Program(references.campaign(lib), runs, truth) for n, lib in libraries.items() if n != HAND_SLP}
    return {**made, CAMPAIGN: Program(compiled.campaign, runs), VMAP: Program(hover_jax.campaign, runs, truth)}


def measured(a: argparse.Namespace, libraries: dict[str, Any], lanes: int) -> dict[str, Timed]:
    """Measure and print all tables, and return them."""
    gains, key = np.array(spec.GAINS), np.array([spec.KEY0, 0], np.uint32)

    def inputs(count: int) -> list[tuple[Any, ...]]:
        return [(gains + 0.01 * i, key + np.array([0, i], np.uint32)) for i in range(count + 1)]

    few = max(1, a.rounds // 3)
    jobs = {
        "single": (a.rounds, partial(singles, libraries, lanes), inputs(a.rounds)),
        "python": (few, partial(slower, libraries), inputs(few)),
        "log": (few, partial(logs, libraries), inputs(few)),
        "campaign": (
            a.campaign_rounds,
            partial(campaigns, libraries, lanes, a.runs),
            [(a.runs, a.threads)] * (a.campaign_rounds + 1),
        ),
    }
    tables: dict[str, Timed] = {}
    for name, (count, programs, given) in jobs.items():
        tables[name] = rounds(programs(), given, HAND_C)
        base = HAND_C if name != "campaign" else next((n for n in tables[name].times if "SIMD" in n), HAND_C)
        of = f"{a.runs} runs on {a.threads} threads, times per run" if name == "campaign" else "15 s, 15000 steps"
        show(f"{TITLES[name].capitalize()}: {of}, {count} rounds", tables[name], base, spec.N)
    return tables


def options() -> argparse.Namespace:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument(
        "--rounds", type=int, default=31, help="rounds of single runs; slow programs get a third (%(default)s)"
    )
    p.add_argument("--campaign-rounds", type=int, default=7, help="rounds of campaigns (%(default)s)")
    p.add_argument("--runs", type=int, default=512, help="runs of a campaign (%(default)s)")
    p.add_argument("--threads", type=int, default=2, help="threads of a campaign (%(default)s)")
    p.add_argument(
        "--tol", type=float, default=1e-9, help="largest accepted difference from hand-written C (%(default)s)"
    )
    p.add_argument("--quick", action="store_true", help="2 rounds, 16 runs: checks results, but gives no useful times")
    p.add_argument("--strict", action="store_true", help="exit with 1 also if a target is missed")
    p.add_argument("--markdown", action="store_true", help="print rows for the documentation's table at the end")
    p.add_argument("--json", metavar="FILE", help="write settings, times, ratios to FILE")
    a = p.parse_args()
    if a.quick:
        a.rounds, a.campaign_rounds, a.runs = 2, 1, 16
    if min(a.rounds, a.campaign_rounds, a.runs, a.threads) < 1:
        p.error("rounds, runs and threads must be at least 1")
    return a


def wrong(tables: dict[str, Timed], libraries: dict[str, Any], tol: float) -> list[str]:
    """Return the programs that differ from hand-written C, and hand-written C if it differs from printed numbers."""
    bad = [f"{n} ({TITLES[t]})" for t, timed in tables.items() for n, d in timed.worst.items() if not d <= tol]
    hand = references.single(libraries[HAND_C])(np.array(spec.GAINS), np.array([spec.KEY0, 0], np.uint32))
    return bad if difference(hand, KNOWN) <= tol else [HAND_C, *bad]


def main() -> int:
    a = options()
    began = load()
    print(f"{machine('jax')}\n{began}")
    with tempfile.TemporaryDirectory() as folder:
        lanes = references.widest("native")
        libraries = references.hand(folder, "native") | references.simd(folder, "native", lanes)
        tables = measured(a, libraries, lanes)
        bad = wrong(tables, libraries, a.tol)
    found = {f: ratio(tables[f.table], f.over, f.under, f.cpu) for f in figures(references.hand_simd(lanes))}
    met = report(found)
    if a.markdown:
        markdown(found, tables)
    if a.quick:
        print("these ratios mean nothing: --quick takes too few rounds")
    print(f"\nat the start {began}\nat the end {load()}")
    if a.json:
        about = {
            "machine": machine("jax"),
            "options": vars(a),
            "load": began,
            "lanes": lanes,
            "trimtab lanes": compiled.width(),
        }
        ratios = {f.name: {"ratio": x, "target": f.target, "verdict": f.verdict(x)} for f, x in found.items()}
        content = {**about, "ratios": ratios, "tables": {n: t._asdict() for n, t in tables.items()}}
        Path(a.json).write_text(json.dumps(content, indent=1))
    print(f"WRONG by more than {a.tol:g}: {', '.join(bad)}" if bad else f"all results agree to {a.tol:g}")
    return int(bool(bad) or (a.strict and not met))


if __name__ == "__main__":
    sys.exit(main())
