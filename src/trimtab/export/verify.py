"""Check of an exported folder: compile the C code without warnings, replay the test vectors, and compare each output
value with the simulation on JAX."""

import json
import os
import re
import subprocess
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError

WARNINGS = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror")
EXACT = ("-O2", "-ffp-contract=off", "-fno-tree-slp-vectorize", "-fwrapv", "-fno-math-errno")
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g")


class VerificationReport(NamedTuple):
    """Result of the check of an exported folder.

    good: True if every output value is within its tolerance and the sanitizers found no errors.
    worst: largest difference and tolerance of each output, by the output's name.
    first: step, output, computed value and expected value of the first output value out of tolerance, or None.
    stack_bytes: stack (bytes) of the step function and of the functions that it calls, as reported by the compiler.
    sanitized: True if the sanitizers were run, False if the compiler has none.
    """

    good: bool
    steps: int
    worst: dict[str, tuple[float, float]]
    first: tuple[int, str, Any, Any] | None
    stack_bytes: int
    sanitized: bool


def verify_folder(folder: Path) -> VerificationReport:
    """Compile and replay a folder written by `trimtab export`, and compare each output value with the expected value.

    Raises InputError if the folder was not written by `trimtab export`, if no compiler is found, or if the C code does
    not compile without warnings.
    """
    about = _read_manifest(folder)
    compiler = find_compiler("c")
    if compiler is None:
        raise InputError(
            "export --verify",
            "no C compiler found",
            fix="install gcc or clang, or set the environment variable CC to a C compiler",
        )
    cc = [compiler.path, *compiler.options]
    _check_header(folder / f"{about['name']}.h")
    wanted = _read_rows((folder / "vectors.csv").read_text().splitlines()[1:])[:, len(about["inputs"]) :]
    with tempfile.TemporaryDirectory() as scratch:
        got = _run_replay(cc, folder, about["name"], Path(scratch), ())
        stack = _deepest_stack(Path(scratch))
        sanitized = _run_sanitizers(cc, folder, about["name"], Path(scratch), got)
    tolerance = np.array([about["tolerance"][n] for n in about["outputs"]])
    worst, first = compare_samples(got, wanted, about["outputs"], tolerance)
    return VerificationReport(first is None, len(wanted), worst, first, stack, sanitized)


def compare_samples(
    got: Any, wanted: Any, names: list[str], tolerance: Any
) -> tuple[dict[str, tuple[float, float]], tuple[int, str, Any, Any] | None]:
    """Return the largest difference of each output, and the first value out of tolerance. NaN counts as equal to
    NaN."""
    if got.shape != wanted.shape:
        problem = f"the replay printed {got.shape[0]} x {got.shape[1]} numbers, expected {wanted.shape}"
        raise InputError("export --verify", problem, fix="export the folder again")
    columns = [_differences(got[:, k], wanted[:, k], exact=tolerance[k] == 0) for k in range(len(names))]
    off = np.array(columns).reshape(len(names), len(wanted)).T
    worst = {n: (float(off[:, k].max(initial=0.0)), float(tolerance[k])) for k, n in enumerate(names)}
    bad = np.argwhere(off > tolerance)
    if not len(bad):
        return worst, None
    step, k = bad[0]
    return worst, (int(step), names[k], got[step, k], wanted[step, k])


def _differences(got: Any, wanted: Any, exact: bool) -> Any:
    """Return the error of each value, 0 where both values are NaN. exact: True to compare the values as integers of any
    size."""
    kind = object if exact else np.float64
    got, wanted = np.asarray(got, kind), np.asarray(wanted, kind)
    with np.errstate(invalid="ignore"):  # the difference of two equal infinities is NaN
        off = np.abs(got - wanted).astype(np.float64)
    same = (got == wanted) | ((got != got) & (wanted != wanted))
    return np.where(same, 0.0, np.where(np.isnan(off), np.inf, off))


def _read_rows(lines: list[str]) -> Any:
    """Return the numbers in lines of text as an array of Python numbers, so that large integers are exact."""
    rows = [line.split(",") if line else [] for line in lines]
    width = max(map(len, rows), default=0)
    if any(len(row) != width for row in rows):
        raise InputError("export --verify", "the rows of vectors.csv differ in length", fix="export the folder again")
    numbers = [float(cell) if set(cell) & set(".en") else int(cell) for row in rows for cell in row]
    made = np.empty(len(numbers), object)
    made[:] = numbers
    return made.reshape(len(rows), width)


def _read_manifest(folder: Path) -> dict[str, Any]:
    try:
        about = json.loads((folder / "export.json").read_text())
        if not re.fullmatch(r"[A-Za-z_]\w*", about["name"]):
            raise ValueError("name")
        for key in ("inputs", "outputs", "tolerance"):
            about[key]
        return about
    except (OSError, ValueError, KeyError, TypeError) as error:
        problem = f"{str(folder)!r} is not a folder written by trimtab export ({error})"
        raise InputError("export --verify", problem, fix="trimtab export SCENARIO --out DIR") from None


def _check_header(header: Path) -> None:
    """Raise InputError if a C++ program cannot include the header. If no C++ compiler is found, do nothing."""
    compiler = find_compiler("c++")
    if compiler is None:
        return
    checks = ["-std=c++11", "-pedantic", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "-x", "c++", "-"]
    includes = "".join(f"#include <{name}>\n" for name in ("cmath", "complex", "cstdio", "ctime", "string"))
    text = f'{includes}#include "{header.resolve()}"\n'
    command = [compiler.path, *compiler.options, *checks]
    ran = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
    if ran.returncode:
        said = "\n".join(ran.stderr.splitlines()[:20])
        raise InputError("export --verify", f"a C++ compiler rejected {header.name}:\n{said}", fix="report this error")


def _run_replay(cc: list[str], folder: Path, name: str, scratch: Path, extra: tuple[str, ...]) -> Any:
    program = scratch / f"replay{len(extra)}"
    sources = [os.path.abspath(folder / f) for f in (f"{name}.c", "vectors.c", "replay.c")]
    flags = ["-fstack-usage"] if not extra else []
    command = [*cc, *WARNINGS, *EXACT, *flags, *extra, *sources, "-o", str(program), "-lm"]
    built = subprocess.run(command, capture_output=True, text=True, cwd=scratch, stdin=subprocess.DEVNULL, check=False)
    if built.returncode:
        said = "\n".join(built.stderr.splitlines()[:20])
        raise InputError("export --verify", f"the compiler reported an error:\n{said}", fix="export the folder again")
    vectors = os.path.abspath(folder / "vectors.csv")
    ran = subprocess.run([program, vectors], capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
    if ran.returncode:
        said = "\n".join(ran.stderr.splitlines()[:20])
        raise InputError(
            "export --verify", f"the replay ended with exit code {ran.returncode}:\n{said}", fix="report this error"
        )
    return _read_rows(ran.stdout.splitlines())


def _run_sanitizers(cc: list[str], folder: Path, name: str, scratch: Path, got: Any) -> bool:
    """Run the replay with the address sanitizer and the undefined-behaviour sanitizer. Return False if the compiler has
    no sanitizers."""
    probe = scratch / "probe.c"
    probe.write_text("int main(void) { return 0; }\n")
    command = [*cc, *SANITIZERS, str(probe), "-o", str(scratch / "probe")]
    if subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL, check=False).returncode:
        return False
    again = _run_replay(cc, folder, name, scratch, SANITIZERS)
    if not ((again == got) | ((again != again) & (got != got))).all():
        raise InputError(
            "export --verify", "the results differ when the code is built with sanitizers", fix="report this error"
        )
    return True


def _deepest_stack(scratch: Path) -> int:
    """Return the largest stack (bytes) of a step function, from the compiler's option -fstack-usage. The functions that
    it calls are inlined or in libm."""
    found = [0]
    for file in scratch.glob("*.su"):
        for line in file.read_text().splitlines():
            where, size, kind = line.rsplit("\t", 2)
            if "_step" in where:
                found.append(int(size) if "dynamic" not in kind or "bounded" in kind else 0)
    return max(found)
