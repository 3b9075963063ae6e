"""One finding: its smallest case, what happened at first, and a function that runs the case."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]


class Outcome(NamedTuple):
    """Result of a case: one line about what happened, and True if the behaviour is right."""

    text: str
    holds: bool


class Finding(NamedTuple):
    """Finding of a review.

    id: of the row.  case: the smallest input.  at_first: what happened.  run: runs the case on the present code.
    """

    id: str
    case: str
    at_first: str
    run: Callable[[], Outcome]


def run_python(script: str, **environment: str) -> tuple[int, str]:
    """Run a script in a new interpreter, which may die. Return the exit status and the last line that it printed."""
    return _run([sys.executable, "-c", script], environment)


def run_command(*words: str) -> tuple[int, str]:
    """Run a command of trimtab. Return the exit status and the last line that it printed."""
    return _run([sys.executable, "-m", "trimtab", *words], {})


def _run(command: list[str], environment: dict[str, str]) -> tuple[int, str]:
    paths = os.pathsep.join([str(ROOT / "src"), str(ROOT), os.environ.get("PYTHONPATH", "")])
    surroundings = {name: value for name, value in os.environ.items() if name != "JAX_ENABLE_X64"}
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
        env=surroundings | {"PYTHONPATH": paths} | environment,
    )
    lines = (done.stdout + done.stderr).strip().splitlines()
    return done.returncode, lines[-1] if lines else ""


def run_tests(*names: str) -> Outcome:
    """Run tests by name, `file::function` below tests, and return their counts. The tests hold the behaviour."""
    command = [sys.executable, "-m", "pytest", "-q", "-n0", "-m", "", "--no-header", "--durations=0", "-ra"]
    paths = os.pathsep.join([str(ROOT / "src"), str(ROOT)])
    done = subprocess.run(
        [*command, *(f"tests/{name}" for name in names)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
        env={name: value for name, value in os.environ.items() if name != "JAX_ENABLE_X64"} | {"PYTHONPATH": paths},
    )
    lines = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR")) or " passed" in line]
    return Outcome("; ".join([*lines, *(names if done.returncode == 0 else [])]), done.returncode == 0)
