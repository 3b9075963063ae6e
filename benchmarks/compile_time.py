"""What the C compiler takes for a scenario's text, scalar and over lanes: its own CPU seconds, so that others' load
counts little. With --whole each text is also compiled as one function, in the same round.

    python benchmarks/compile_time.py                                           a minute: three scenarios
    python benchmarks/compile_time.py --whole --rounds 3                        in pieces beside one function
    python benchmarks/compile_time.py navigation/platform-ranging hovercraft/forward:ins
"""

import argparse
import os
import sys
import tempfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE / "reference")]
from paired import machine, row
from references import CC, CXX, sh

from trimtab.compiler import pieces
from trimtab.core.time import ms
from trimtab.native.build import FLAGS
from trimtab.run.inputs import own_inputs, run_inputs
from trimtab.run.runner import prepare_run
from trimtab.run.walk_program import WalkProgram, lower_structure, walk_structure
from trimtab.scenarios.catalogue import load_scenario

SCENARIOS = ("hovercraft/zero-velocity", "hypersonic/climb-large", "hovercraft/forward:ins")
TARGETS = {0: 4.0, 8: 8.0}
"""Seconds at most, by lanes."""


def program(name: str) -> tuple[WalkProgram, frozenset[int]]:
    """The program of a scenario, `name` or `name:navigation`, and the inputs in which runs of a batch differ."""
    name, _, navigation = name.partition(":")
    scenario, _ = load_scenario(name, {"navigation": navigation} if navigation else {})
    scenario, table, _ = prepare_run(scenario, [0], None, ms(1))
    inputs = run_inputs(scenario)
    return lower_structure(walk_structure(inputs, table.always, ())), frozenset(own_inputs(inputs, [0, 1]))


def seconds(text: str, lanes: int, extra: tuple[str, ...]) -> float:
    """CPU time of compiling a text to a library."""
    language = "c++" if lanes else "c"
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / ("text.cpp" if lanes else "text.c")
        file.write_text(text)
        before = os.times()
        command = [*FLAGS[language], *extra, "-shared", "-fPIC", "-o", f"{folder}/text.so", str(file), "-lm"]
        sh(CXX if lanes else CC, *command)
        after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def main() -> int:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("scenarios", nargs="*", default=SCENARIOS, help="name, or name:navigation")
    p.add_argument("--whole", action="store_true", help="also as one function: minutes")
    p.add_argument("--rounds", type=int, default=1, help="the least of so many is printed")
    p.add_argument("--markdown", action="store_true", help="print rows for the documentation's table at the end")
    a = p.parse_args()
    print(machine("jax"))
    rows, met, limit = [], True, pieces.WHOLE
    print(f"\n{'':34}{'lanes':>6}{'lines':>8}{'s':>8}{'target':>8}{'one function':>15}")
    for name in a.scenarios:
        flight, own = program(name)
        for lanes, target in TARGETS.items():
            found: dict[int, list[float]] = {}
            lines = 0
            for _ in range(a.rounds):
                for pieces.WHOLE in (limit, sys.maxsize) if a.whole else (limit,):
                    text = flight.text(lanes, own if lanes else frozenset())
                    lines = text.count("\n") if limit == pieces.WHOLE else lines
                    found.setdefault(pieces.WHOLE, []).append(seconds(text, lanes, flight.extra_flags()))
            pieces.WHOLE = limit
            best, whole = min(found[limit]), min(found.get(sys.maxsize, [np.nan]))
            met &= best <= target
            print(f"{name:34}{lanes or 1:6}{lines:8}{best:8.1f}{target:8.0f}{whole:15.1f}", flush=True)
            what = f"compiling {name}, {f'{lanes} lanes' if lanes else 'one run'}"
            rows.append(row(what, f"{best:.1f} s", f"≤ {target:g} s", "python benchmarks/compile_time.py"))
    print("\n".join(rows) if a.markdown else f"targets {'met' if met else 'MISSED'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
