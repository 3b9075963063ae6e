"""Measure the CPU time of every scenario over lanes, and compare it with libraries built by another version.

    python benchmarks/lanes.py --save FOLDER               with the old version: keep its libraries
    python benchmarks/lanes.py --against FOLDER            with the new version: time both, alternately
    python benchmarks/lanes.py hovercraft/spin             one scenario, only this version

Eight runs are simulated in one thread, with statistics as in a campaign. The smallest CPU time of the thread in many
rounds is reported, so that other programs have little influence. Results of both versions are compared. With --strict,
the program exits with 1 if results differ or the new version is slower.
"""

import argparse
import random
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path[:0] = [str(Path(__file__).parent)]
from paired import load, machine

from trimtab.compiler.native.compiler import find_compiler, lane_count
from trimtab.core.errors import InputError
from trimtab.core.time import ms
from trimtab.run.inputs import flat_inputs, own_inputs, own_rows, run_inputs
from trimtab.run.program import fly_runs, row_numbers, row_width
from trimtab.run.runner import prepare_run
from trimtab.run.walk_structure import build_walk_library, final_columns, row_columns, walk_structure
from trimtab.scenarios.catalogue import load_scenario, scenario_names

RUNS = 8
SEEDS = list(range(RUNS))
SLOWER = 1.02
"""Largest ratio of the new time to the old time that counts as noise."""


def flight(name: str, duration: int, lanes: int) -> tuple[Path, Callable[[Path], list[Any]]]:
    """Return the library of a scenario over lanes, and a function that simulates its runs with a library."""
    scenario, _ = load_scenario(name)
    scenario, table, written = prepare_run(scenario, SEEDS, min(duration, scenario.duration), ms(10))
    inputs = run_inputs(scenario)
    own = own_inputs(inputs, SEEDS)
    of = walk_structure(inputs, table.always, ())
    widths = row_width(row_columns(of)), row_width(final_columns(of))
    given = flat_inputs(inputs, frozenset(own)), own_rows(own, RUNS)

    def fly(library: Path) -> list[Any]:
        found = fly_runs(library, *given, table, row_numbers(written), widths, log=False, stats=True)
        return [found.stats, found.final]

    return build_walk_library(of, lanes, frozenset(own)), fly


def least_times(fly: Callable[[Path], list[Any]], libraries: list[Path], rounds: int) -> tuple[list[float], bool]:
    """Return the smallest CPU time per run of each library (s), and True if their results are bit-identical."""
    results = [fly(path) for path in libraries]
    same = all(a.tobytes() == b.tobytes() for other in results for a, b in zip(results[0], other, strict=True))
    times: list[list[float]] = [[] for _ in libraries]
    for _ in range(rounds):
        for k in random.sample(range(len(libraries)), len(libraries)):
            start = time.thread_time()
            fly(libraries[k])
            times[k].append((time.thread_time() - start) / RUNS)
    return [min(t) for t in times], same


def main() -> int:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("scenarios", nargs="*", help="names; every scenario of the catalogue by default")
    p.add_argument("--rounds", type=int, default=25, help="number of rounds (%(default)s)")
    p.add_argument("--milliseconds", type=int, default=1000, help="duration of each run (%(default)s)")
    p.add_argument("--save", metavar="FOLDER", help="keep the libraries in FOLDER")
    p.add_argument("--against", metavar="FOLDER", help="compare with the libraries in FOLDER")
    p.add_argument("--strict", action="store_true", help="exit with 1 if results differ or the new time is longer")
    a = p.parse_args()
    compiler = find_compiler("c++")
    lanes = lane_count(compiler) if compiler else 1
    if lanes == 1:
        sys.exit("this CPU or compiler does not support lanes")
    print(f"{machine('jax')}\n{load()}\n\n{'':40}{'us/run':>10}{'before':>10}{'ratio':>8}  ({lanes} lanes)")
    bad = []
    for name in a.scenarios or scenario_names():
        file = f"{name.replace('/', '-')}.so"
        try:
            library, fly = flight(name, ms(a.milliseconds), lanes)
        except InputError as reason:
            print(f"{name:40} {reason.problem[:80]}")
            continue
        if a.save:
            Path(a.save).mkdir(parents=True, exist_ok=True)
            shutil.copy(library, Path(a.save) / file)
        old = Path(a.against) / file if a.against else None
        both = [library, *([old] if old is not None and old.exists() else [])]
        times, same = least_times(fly, both, a.rounds)
        line = f"{name:40}{1e6 * times[0]:10.1f}"
        if len(both) == 2:
            ratio = times[0] / times[1]
            line += f"{1e6 * times[1]:10.1f}{ratio:8.3f}{'' if same else '  DIFFERENT RESULTS'}"
            bad += [] if same and ratio <= SLOWER else [name]
        print(line, flush=True)
    print(f"slower or different: {', '.join(bad)}" if bad else "")
    return int(bool(bad) and a.strict)


if __name__ == "__main__":
    sys.exit(main())
