"""Measure the time to build a scenario's program, scalar and over lanes: tracing, lowering, and the C compiler.

Times are CPU seconds, so that other programs have little influence. With --whole, each text is also compiled as one
function, in the same round.

    python benchmarks/compile_time.py                                  half a minute: the three largest of their kind
    python benchmarks/compile_time.py --all                            every scenario, each of its choices: minutes
    python benchmarks/compile_time.py --whole --rounds 3               in pieces beside one function
    python benchmarks/compile_time.py navigation/platform-ranging hovercraft/forward:navigation=ins
"""

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE / "reference")]
from paired import machine, row
from references import CC, CXX, sh

from trimtab.compiler import pieces
from trimtab.compiler.native.build import compiler_flags
from trimtab.compiler.native.compiler import find_compiler
from trimtab.compiler.pieces import build_level
from trimtab.compiler.walk_program import WalkProgram
from trimtab.core.errors import InputError
from trimtab.core.time import ms
from trimtab.run.inputs import own_inputs, run_inputs
from trimtab.run.runner import prepare_run
from trimtab.run.walk_structure import lower_structure, walk_structure
from trimtab.scenarios.catalogue import load_scenario, scenario_choices, scenario_names

SCENARIOS = (
    "hovercraft/zero-velocity",
    "hypersonic/climb-large:internal=preview",
    "hovercraft/heading-bang-bang:navigation=ins-magnetometer",
)
TARGETS = {0: 4.0, 8: 8.0}
"""Number of lanes (0: scalar code) -> largest accepted time (s)."""


class Prepared(NamedTuple):
    """Program of a scenario. own: inputs that differ between runs. seconds: time of tracing and lowering."""

    program: WalkProgram
    own: frozenset[int]
    seconds: float


def prepare(name: str) -> Prepared:
    """Return the program of a scenario, given as `name` or `name:choice=value,choice=value`."""
    name, _, choices = name.partition(":")
    scenario, _ = load_scenario(name, dict(pair.split("=") for pair in choices.split(",")) if choices else {})
    scenario, table, _ = prepare_run(scenario, [0], None, ms(1))
    inputs = run_inputs(scenario)
    start = time.process_time()
    program = lower_structure(walk_structure(inputs, table.always, ()))
    return Prepared(program, frozenset(own_inputs(inputs, [0, 1])), time.process_time() - start)


def all_scenarios() -> list[str]:
    """Return every scenario of the catalogue, and each one with a single choice changed."""
    names = []
    for name in scenario_names():
        choices = [f"{choice}={value}" for choice, values in scenario_choices(name).items() for value in values[1:]]
        names += [name, *(f"{name}:{choice}" for choice in choices)]
    return names


def seconds(text: str, lanes: int, extra: tuple[str, ...]) -> float:
    """Return the CPU time (s) of compiling a text to a library."""
    language = "c++" if lanes else "c"
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / ("text.cpp" if lanes else "text.c")
        file.write_text(text)
        before = os.times()
        compiler = find_compiler(language)
        usual = compiler_flags(language, compiler.kind if compiler else "gcc")
        command = [*usual, *extra, "-shared", "-fPIC", "-o", f"{folder}/text.so", str(file), "-lm"]
        sh(CXX if lanes else CC, *command)
        after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def compare(text: str, whole: str, lanes: int, flags: tuple[str, ...], rounds: int) -> tuple[float, float]:
    """Return the smallest time (s) of all rounds for a text, and for its form as one function if given."""
    found = [(seconds(text, lanes, flags), seconds(whole, lanes, flags) if whole else np.nan) for _ in range(rounds)]
    return min(a for a, _ in found), min(b for _, b in found)


def whole_text(flight: Prepared, lanes: int) -> str:
    """Return the text of the program as one function."""
    limit, pieces.FUNCTION_STATEMENTS_MAX = pieces.FUNCTION_STATEMENTS_MAX, sys.maxsize
    text = flight.program.text(lanes, flight.own if lanes else frozenset())
    pieces.FUNCTION_STATEMENTS_MAX = limit
    return text


def main() -> int:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("scenarios", nargs="*", default=SCENARIOS, help="name, or name:choice=value")
    p.add_argument("--all", action="store_true", help="all scenarios of the catalogue, with each of their choices")
    p.add_argument("--whole", action="store_true", help="compile each text also as one function (takes minutes)")
    p.add_argument("--rounds", type=int, default=1, help="number of measurements; the smallest time is printed")
    p.add_argument("--markdown", action="store_true", help="print rows for the documentation's table at the end")
    a = p.parse_args()
    print(machine("jax"))
    rows, missed, texts = [], list[str](), set[str]()
    print(f"\n{'':57}{'lanes':>6}{'lines':>7}{'trace':>7}{'cc':>6}{'sum':>6}{'target':>7}{'one function':>14}")
    for name in all_scenarios() if a.all else a.scenarios:
        try:
            flight = prepare(name)
        except InputError as reason:  # this choice is allowed only with another one
            print(f"{name:57} {reason.problem[:60]}")
            continue
        for lanes, target in TARGETS.items():
            text = flight.program.text(lanes, flight.own if lanes else frozenset())
            if text in texts:
                continue  # the choice changes only numbers
            texts.add(text)
            other = whole_text(flight, lanes) if a.whole else ""
            compiler, whole = compare(text, other, lanes, build_level(flight.program.blocks, lanes), a.rounds)
            total = flight.seconds + compiler
            if total > target:
                missed.append(f"{name}, {lanes or 1} lanes")
            times = f"{flight.seconds:7.1f}{compiler:6.1f}{total:6.1f}{target:7.0f}{whole:14.1f}"
            print(f"{name:57}{lanes or 1:6}{text.count(chr(10)):7}{times}", flush=True)
            what = f"cold {name}, {f'{lanes} lanes' if lanes else 'one run'}"
            rows.append(row(what, f"{total:.1f} s", f"≤ {target:g} s", "python benchmarks/compile_time.py"))
    print("\n".join(rows) if a.markdown else f"targets MISSED: {'; '.join(missed)}" if missed else "targets met")
    return 0


if __name__ == "__main__":
    sys.exit(main())
