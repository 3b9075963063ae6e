"""Measure the cost of bit-identical results on all machines: elementary functions and flights by policy.

A policy is a set of compiler flags, with or without fused multiply-add (FMA).

    python benchmarks/one_result.py               two minutes
    python benchmarks/one_result.py --markdown    prints the tables of docs/compiler/generator.md

Functions: smallest CPU time of a call in many rounds. Flights: CPU time of one run, and of 64 runs over lanes in one
thread, in alternating processes; smallest time of the rounds, as a ratio to the default. Needs gcc and g++.
"""

import argparse
import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path

from paired import load, machine

from trimtab.compiler.elementary import elementary_text

CALLS = {
    "sin": "tt_sin(x)", "exp": "tt_exp(x)", "log": "tt_log(x)", "atan2": "tt_atan2(x, 1.3)", "pow": "tt_pow(x, 1.7)",
    "erf": "tt_erf(x)", "cbrt": "tt_cbrt(x)", "sinf": "tt_sinf((float)x)", "expf": "tt_expf((float)x)",
}  # fmt: skip
LIBRARY = {name: text.replace("tt_", "", 1) for name, text in CALLS.items()}
FLAGS = ("-std=gnu99", "-O2", "-ffp-contract=off", "-fwrapv", "-fno-math-errno", "-fno-tree-slp-vectorize")
BUILDS = {
    "default": ("-march=native",),
    "-DTT_FMA=0": ("-march=native", "-DTT_FMA=0"),
    "default, CPU without FMA": ("-mno-avx512f", "-mno-fma", "-mno-avx2"),
    "-DTT_FMA=0, CPU without FMA": ("-mno-avx512f", "-mno-fma", "-mno-avx2", "-DTT_FMA=0"),
    "-DTT_SINGLE=0": ("-march=native", "-DTT_SINGLE=0"),
}
CLOCK = """
static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}
"""
FLIGHTS = ("hovercraft/forward", "hypersonic/noise")
POLICIES = {"default": "", "-DTT_FMA=0": " -DTT_FMA=0", "-ffp-contract=fast": " -DCONTRACTED"}
FLY = """
import os, sys, time
import trimtab
import trimtab.compiler.native.build as build
from trimtab.run.simulate import simulate_batch

if "CONTRACTED" in os.environ["CC"]:
    build.FLAGS = {k: tuple(f.replace("contract=off", "contract=fast") for f in v) for k, v in build.FLAGS.items()}
scenario, span = trimtab.build(sys.argv[1]), trimtab.seconds(float(sys.argv[2]))

def least(call, times):
    spent = []
    for _ in range(times):
        start = time.process_time()
        call()
        spent.append(time.process_time() - start)
    return min(spent)

def one():
    trimtab.simulate(scenario, seed=0, duration=span, log_period=span, backend="c")

def many():
    simulate_batch(scenario, seeds=range(64), duration=span, log_period=span, backend="c", threads=1)

one(), many()
print("ready", flush=True)
for _ in sys.stdin:
    print(least(one, 7), least(many, 3), flush=True)
"""


def time_functions(flags: tuple[str, ...], calls: dict[str, str]) -> dict[str, float]:
    """Return the time of a call (ns), by name."""
    lines = "".join(
        f"{{ double least = 1e9; for (int r = 0; r < 100; r++) {{ double sum = 0, start = now(); "
        f"for (int i = 0; i < 4096; i++) {{ double x = 0.1 + (i & 4095) * 7e-4; sum += {call}; }} "
        f'double took = now() - start; if (took < least) least = took; if (sum == 1.25) puts(""); }} '
        f'printf("{name} %.17g\\n", least / 4096 * 1e9); }}\n'
        for name, call in calls.items()
    )
    with tempfile.TemporaryDirectory() as scratch:
        source = Path(scratch) / "time.c"
        head = f"#include <stdio.h>\n#include <time.h>\n{elementary_text()}\n{CLOCK}"
        source.write_text(f"{head}\nint main(void)\n{{\n{lines}return 0;\n}}\n")
        subprocess.run(["gcc", *FLAGS, *flags, str(source), "-o", f"{scratch}/time", "-lm"], check=True)
        said = subprocess.run([f"{scratch}/time"], check=True, capture_output=True, text=True).stdout
    return {name: float(ns) for name, ns in (line.split() for line in said.splitlines())}


def time_flights(name: str, span: float, rounds: int) -> dict[str, tuple[float, float]]:
    """Return policy -> times (s) of one run, and of 64 runs over lanes."""
    children = {}
    for policy, options in POLICIES.items():
        own = {**os.environ, "CC": "gcc" + options, "CXX": "g++" + options}
        command = [sys.executable, "-c", FLY, name, str(span)]
        child = subprocess.Popen(command, env=own, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)
        children[policy] = child
        assert child.stdout is not None
        if child.stdout.readline().strip() != "ready":
            sys.exit(f"{name} does not fly with {policy}")
    best = dict.fromkeys(POLICIES, (float("inf"), float("inf")))
    for _ in range(rounds):
        for policy, child in children.items():
            assert child.stdin is not None
            assert child.stdout is not None
            child.stdin.write("again\n")
            one, many = map(float, child.stdout.readline().split())
            best[policy] = min(best[policy][0], one), min(best[policy][1], many)
    for child in children.values():
        assert child.stdin is not None
        child.stdin.close()
        child.wait()
    return best


def main() -> int:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--markdown", action="store_true", help="print the documentation's tables")
    p.add_argument("--rounds", type=int, default=5, help="number of rounds of alternating flights")
    a = p.parse_args()
    print(machine("jax"), load(), sep="\n")
    builds = {k: v for k, v in BUILDS.items() if "CPU" not in k or platform.machine() == "x86_64"}
    table = {name: time_functions(flags, CALLS) for name, flags in builds.items()}
    table["functions of the C library"] = time_functions(BUILDS["default"], LIBRARY)
    form = "| {} | " + " | ".join(["{}"] * len(CALLS)) + " |" if a.markdown else "{:32}" + "{:>8}" * len(CALLS)
    print(form.format("ns a call", *CALLS))
    if a.markdown:
        print("|---" * (1 + len(CALLS)) + "|")
    for name, row in table.items():
        print(form.format(name, *(f"{row[c]:.1f}" for c in CALLS)))
    for name in FLIGHTS:
        best = time_flights(name, 20.0, a.rounds)
        for policy, (one, many) in best.items():
            ratios = f"{one / best['default'][0]:.2f}", f"{many / best['default'][1]:.2f}"
            cells = name, policy, f"{1e3 * one:.2f} ms", f"{1e3 * many:.1f} ms", *ratios
            print("| " + " | ".join(cells) + " |" if a.markdown else "{:22}{:22}{:>12}{:>12}{:>8}{:>8}".format(*cells))
    print(load())
    return 0


if __name__ == "__main__":
    sys.exit(main())
