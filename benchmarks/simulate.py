"""Measure the time that Python adds to a run: `simulate` compared with the compiled function alone.

python benchmarks/simulate.py

The programs simulate the same scenario alternately, each time with another seed, with all signals logged every
millisecond. A third program also reads the true state from each log. Times are CPU times of this process, so other
programs have little influence. The log rows of both must be bit-identical.
"""

import argparse
import ctypes
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE / "reference")]
import spec
import workload
from paired import Ratio, load, machine, row

from trimtab.compiler.native.build import load_library
from trimtab.core.time import ms, timetable
from trimtab.loop.scenario import Scenario
from trimtab.run.program import FlightJob, row_numbers, row_width
from trimtab.run.simulate import compile_scenario, simulate
from trimtab.scenarios import catalogue

COMMAND = "python benchmarks/simulate.py"
CALLS = 10
"""Number of calls of each program in a round."""


def scenarios() -> dict[str, Scenario]:
    """Return the scenarios: one of the catalogue, and the loop of README.md."""
    world, autopilot, x = workload.loop(np.array(spec.GAINS))
    loop = Scenario(world=world, autopilot=autopilot, initial=x, duration=ms(spec.N), name="benchmark loop")
    name = "hovercraft/zero-velocity"
    return {f"scenario {name}": catalogue.load_scenario(name)[0], "benchmark loop": loop}


def flight(scenario: Scenario) -> tuple[Callable[[int], None], Any]:
    """Return a function of the seed that calls the C function on existing arrays, and the rows that it writes."""
    program = compile_scenario(scenario)
    table = timetable(program.periods, program.duration, program.max_step)
    row = row_numbers(table.t % ms(1) == 0)
    rows, final = (
        np.empty((int((row < len(row)).sum()), row_width(program.columns))),
        np.empty(row_width(program.final)),
    )
    shared = program.shared_inputs.copy()
    at = [a.ctypes.data for a in (table.t, table.h, row)]
    call = load_library(program.library).trimtab_fly
    call.argtypes, call.restype = [ctypes.POINTER(FlightJob), ctypes.c_int32], ctypes.c_int32

    def fly(seed: int) -> None:
        shared[list(program.words)] = seed, 0
        job = FlightJob(
            shared.ctypes.data, None, 0, 1, len(row), len(rows), *at, rows.ctypes.data, None, final.ctypes.data
        )
        call(ctypes.byref(job), 1)

    return fly, rows


def check(scenario: Scenario, fly: Callable[[int], None], rows: Any) -> None:
    log = simulate(scenario, seed=3)
    fly(3)
    columns = np.hstack([np.asarray(log[p], np.float64).reshape(len(log), -1) for p in log.paths])
    if not np.array_equal(columns, rows):
        sys.exit(f"WRONG: the rows of {scenario.name} differ")


def seconds_of(call: Callable[[int], Any], first: int) -> float:
    """Return the CPU time of one call (s). Seeds increase from the first."""
    began = time.process_time()
    for seed in range(first, first + CALLS):
        call(seed)
    return (time.process_time() - began) / CALLS


def compare(name: str, scenario: Scenario, count: int) -> list[tuple[str, Ratio]]:
    """Return the ratio of each program's time to that of the compiled function alone."""
    fly, rows = flight(scenario)
    check(scenario, fly, rows)
    truth = [p for p in simulate(scenario).paths if p.startswith("truth.")]

    def read(seed: int) -> None:
        log = simulate(scenario, seed=seed)
        for path in truth:
            log[path]

    programs = {
        "C function": fly,
        "simulate": lambda seed: simulate(scenario, seed=seed),
        "simulate with the true state read": read,
    }
    times: dict[str, list[float]] = {program: [] for program in programs}
    for i in range(count):
        for program, call in programs.items():
            times[program].append(seconds_of(call, 100 + i * CALLS))
    for program, t in times.items():
        print(f"{name + ': ' + program:70} {1e3 * np.median(t):7.3f} ms ({1e3 * min(t):.3f}..{1e3 * max(t):.3f})")
    ratios = {p: np.divide(times[p], times["C function"]) for p in programs if p != "C function"}
    return [
        (f"{name}: time of {p} / time of its C function", Ratio(*map(float, (np.median(x), x.min(), x.max()))))
        for p, x in ratios.items()
    ]


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--rounds", type=int, default=31, help=f"number of rounds, of {CALLS} calls each (%(default)s)")
    p.add_argument("--markdown", action="store_true", help="print the rows for the documentation's table at the end")
    a = p.parse_args()
    print(f"{machine('jax')}\n{load()}")
    found = [pair for name, scenario in scenarios().items() for pair in compare(name, scenario, a.rounds)]
    for what, x in found:
        target = "" if "read" in what else "≤ 1.3"
        print(row(what, x, target, COMMAND) if a.markdown else f"{what}: {x} {target}")
    print(load())


if __name__ == "__main__":
    main()
