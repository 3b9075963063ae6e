"""The command line as its users call it: a process of its own, its exit code, and what it printed.

What differs from one call to the next without meaning anything is masked: wall-clock times and the load of the machine
(`TIMED`), and the places of files (`PLACES`). All else is compared.
"""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

ENTRY = "import sys; from trimtab.cli import main; sys.exit(main())"
"""What the installed command `trimtab` runs; see project.scripts in pyproject.toml."""

INTERRUPTIBLE = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
"""Put before ENTRY, makes Ctrl-C end the command also in the background, where a shell has it ignored."""

TIMED = ("wall_s", "cpu_s")
"""Keys, at any depth, whose values are durations on this machine's clock."""

PLACES = ("file", "files", "folder")
"""Keys, at any depth, of files: of their paths the last name is kept."""

MASKED = "masked"


class Ended(NamedTuple):
    """Exit code, and what was printed to either stream."""

    code: int
    out: str
    err: str

    @property
    def printed(self) -> Any:
        """The JSON object of standard output, masked; None where there is none."""
        lines = [line for line in self.out.splitlines() if line.startswith("{")]
        return masked(json.loads(lines[-1])) if lines else None


def environment(folder: Path) -> dict[str, str]:
    """That of the caller, with keys in a folder, a terminal of known width, and no display."""
    own = {"TRIMTAB_CONFIG": str(folder / "config"), "COLUMNS": "120", "MPLBACKEND": "agg", "NO_COLOR": "1"}
    return {**os.environ, **own}


def start(*words: str, folder: Path) -> "subprocess.Popen[str]":
    """The command, running in a folder."""
    return subprocess.Popen(
        [sys.executable, "-c", ENTRY, *words],
        cwd=folder,
        env=environment(folder),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def ended(process: "subprocess.Popen[str]", limit: float = 900.0) -> Ended:
    """Its end; killed where that does not come."""
    try:
        out, err = process.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        process.kill()
        out, err = process.communicate()
        err += f"\nkilled after {limit:g} s"
    return Ended(process.returncode, out, err)


def call(*words: str, folder: Path, limit: float = 900.0) -> Ended:
    """Run the command in a folder to its end."""
    folder.mkdir(parents=True, exist_ok=True)
    return ended(start(*words, folder=folder), limit)


def both(server: tuple[str, ...], client: tuple[str, ...], *, folder: Path, ready: str) -> tuple[Ended, Ended]:
    """Two commands that talk to each other; the second starts when the first has said a word, or some seconds later.

    The first is told to stop, as by Ctrl-C, where it runs on after the second.
    """
    folder.mkdir(parents=True, exist_ok=True)
    said = folder / "server-said.txt"
    with said.open("w") as errors:
        one = subprocess.Popen(
            [sys.executable, "-c", INTERRUPTIBLE + ENTRY, *server],
            cwd=folder,
            env=environment(folder),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
        )
        try:
            end = time.monotonic() + 120
            while ready not in said.read_text() and one.poll() is None and time.monotonic() < end:
                time.sleep(0.05)
            other = call(*client, folder=folder, limit=300)
            try:
                out, _ = one.communicate(timeout=20)
            except subprocess.TimeoutExpired:
                one.send_signal(signal.SIGINT)
                out, _ = one.communicate(timeout=20)
        finally:
            if one.poll() is None:
                one.kill()
                one.wait()
    return Ended(one.returncode, out, said.read_text()), other


def masked(value: Any) -> Any:
    """The same without what the clock decides, and files by their last name alone."""
    if isinstance(value, dict):
        return {k: MASKED if k in TIMED else _place(v) if k in PLACES else masked(v) for k, v in value.items()}
    return [masked(v) for v in value] if isinstance(value, list) else value


def skeleton(value: Any) -> Any:
    """Names and kinds of the values only, for figures that are all measured on the clock."""
    if isinstance(value, dict):
        return {k: skeleton(v) for k, v in value.items()}
    if isinstance(value, list):
        return [skeleton(v) for v in value]
    return "number" if isinstance(value, int | float) and not isinstance(value, bool) else type(value).__name__


def _place(value: Any) -> Any:
    if isinstance(value, list):
        return [_place(v) for v in value]
    return Path(value).name if isinstance(value, str) else masked(value)
