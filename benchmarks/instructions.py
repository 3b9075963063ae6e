"""Count instructions per tick with callgrind. The load of the machine does not change the count.

    python benchmarks/instructions.py               half a minute
    python benchmarks/instructions.py --markdown    also prints the rows of docs/benchmarks.md

The programs are hand-written C without and with SLP, trimtab's C, and, per run, hand-written SIMD and trimtab over 4
lanes. All are built for x86-64-v3 (AVX2), because valgrind lacks AVX-512. The count of a run with 0 ticks (start-up) is
subtracted. Results are compared, too. Equal counts do not mean equal times: SLP lowers the count and raises the time.
Needs gcc, g++ and valgrind, on x86-64.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE / "reference")]
import compiled
import spec
from paired import difference, machine, row
from references import CC, CXX, HAND_C, HAND_SLP, KNOWN, SOURCES, sh, truth

from trimtab.compiler.native.build import compiler_flags
from trimtab.compiler.native.compiler import find_compiler
from trimtab.compiler.walk_program import JOB_TEXT

MARCH, LANES = "-march=x86-64-v3", 4


class Counted(NamedTuple):
    """Number of instructions per tick and run, and the results of the first run."""

    instructions: float
    numbers: Any


def callgrind(folder: Path, ticks: int) -> tuple[int, Any]:
    """Return the number of instructions of the program in a folder, and its output."""
    command = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null", "./program", str(ticks)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    if done.returncode or "Collected : " not in done.stderr:
        sys.exit(f"{' '.join(command)} ended with status {done.returncode} and said\n{done.stderr[-1000:]}")
    return int(done.stderr.split("Collected : ")[1].split()[0]), np.array(done.stdout.split(), float)


def counted(folder: Path, runs: int = 1) -> Counted:
    """Count instructions per tick and run, without start-up."""
    whole, numbers = callgrind(folder, spec.N)
    return Counted((whole - callgrind(folder, 0)[0]) / spec.N / runs, numbers)


def hand(source: str, *flags: str, runs: int = 1) -> Counted:
    """Count the instructions of a program of reference/."""
    compiler, libraries = (CXX, ["-lmvec"]) if source.endswith("cpp") else (CC, [])
    language = "c++" if libraries else "c"
    with tempfile.TemporaryDirectory() as name:
        files = ["-x", language, str(SOURCES / "callgrind_main.c"), str(SOURCES / source), "-o", f"{name}/program"]
        sh(compiler, "-O3", MARCH, *flags, *files, *libraries, "-lm", "-lpthread")
        return counted(Path(name), runs)


def generated(lanes: int) -> Counted:
    """Count the instructions of trimtab's program for one run, or over lanes, with its flags except that of the CPU."""
    loop, language = compiled.parts(), "c++" if lanes else "c"
    own, shared = np.arange(lanes, dtype=np.float64), compiled.campaign_inputs() if lanes else compiled.inputs()[0]
    table = loop.table
    sizes = {"SHARED": len(shared), "OWN": len(own), "TICKS": len(table.t), "RUNS": max(lanes, 1)}
    defines = [f"-D{n}={v}" for n, v in (sizes | {"COUNT": loop.widths[1]}).items()]
    compiler = find_compiler(language)
    usual = compiler_flags(language, compiler.kind if compiler else "gcc")
    flags = [MARCH if f.startswith("-march") else f for f in usual]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "text").write_text(compiled.text(lanes))
        (folder / "job.h").write_text(f"#include <stdint.h>\n{JOB_TEXT}")
        arrays = (shared, own, np.asarray(table.t, np.int64), np.asarray(table.h, np.int64), loop.row)
        (folder / "input").write_bytes(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays))
        files = ["-x", language, f"{name}/text", str(SOURCES / "callgrind_flight.c"), "-o", f"{name}/program"]
        sh(CXX if lanes else CC, *flags, *defines, f"-I{name}", *files, "-lm", "-lpthread")
        found = counted(folder, max(lanes, 1))
    return found._replace(numbers=found.numbers[loop.at] * compiled.SCALE)


def main() -> int:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--markdown", action="store_true", help="print rows for the documentation's table at the end")
    a = p.parse_args()
    if shutil.which("valgrind") is None:
        sys.exit("valgrind not found (Debian: apt-get install valgrind)")
    print(machine("jax"))
    simd, lanes = f"hand-written SIMD, {LANES} lanes (AVX2), per run", f"trimtab, {LANES} lanes (AVX2), per run"
    jobs = {
        HAND_C: lambda: hand("hover_c.c", "-fno-tree-vectorize"),
        HAND_SLP: lambda: hand("hover_c.c"),
        "trimtab C": lambda: generated(0),
        simd: lambda: hand("hover_simd.cpp", f"-DW={LANES}", runs=LANES),
        lanes: lambda: generated(LANES),
    }
    found, bad = {}, []
    print(f"\n{'':46}{'instructions per tick':>22}{'x hand-written C':>18}{'max diff':>10}")
    for name, job in jobs.items():
        found[name] = job()
        count, apart = found[name].instructions, difference(truth(found[name].numbers), truth(KNOWN))
        print(f"{name:46}{count:22.0f}{count / found[HAND_C].instructions:18.3f}{apart:10.0e}", flush=True)
        bad += [] if apart <= 1e-9 else [name]
    print(f"\nWRONG by more than 1e-09: {', '.join(bad)}" if bad else "\nall results agree to 1e-09")
    if a.markdown:
        for name, c in found.items():
            ratio = f"{c.instructions:.0f} ({c.instructions / found[HAND_C].instructions:.2f} x hand-written C)"
            print(row(f"instructions per tick: {name}", ratio, "", "python benchmarks/instructions.py"))
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main())
