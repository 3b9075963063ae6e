"""Vehicle or autopilot as a separate process, started as a user would start it."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from time import monotonic, sleep
from typing import Any

LOOK_S = 0.02
START_S, END_S = 240.0, 120.0
"""Longest time until a process is ready, and until it ends after a request. Only a failure takes as long."""


class NotReady(Exception):
    """Error: a process did not print the awaited text, or did not end.

    is_late: True if it got no processor time or hangs.
    """

    def __init__(self, text: str, is_late: bool) -> None:
        super().__init__(text)
        self.is_late = is_late


class Process:
    """Process of `trimtab …`, with its output kept in a file."""

    def __init__(self, *words: str, folder: Path, name: str, environment: dict[str, str]) -> None:
        self.name, self._output_file, self._out = name, folder / f"{name}.said", folder / f"{name}.json"
        path = os.pathsep.join(p for p in sys.path if p)
        with self._output_file.open("wb") as said, self._out.open("wb") as out:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "trimtab", *words, "--json"],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=said,
                env={**os.environ, "PYTHONPATH": path, **environment},
            )

    @property
    def pid(self) -> int:
        """Process ID."""
        return self._process.pid

    @property
    def status(self) -> int | None:
        """Exit status, or None while the process runs."""
        return self._process.poll()

    @property
    def output_text(self) -> str:
        """Output for the user so far."""
        return self._output_file.read_text("utf-8", "replace")

    @property
    def result(self) -> dict[str, Any] | None:
        """JSON result that the process prints at its end, else None."""
        lines = self._out.read_text("utf-8", "replace").strip().splitlines()
        with contextlib.suppress(ValueError, IndexError):
            return json.loads(lines[-1])
        return None

    def wait_for(self, text: str, count: int = 1, patience: float = START_S) -> None:
        """Wait until the process has printed a text. Raise NotReady if it ends or stays silent."""
        given_up = monotonic() + patience
        while self.output_text.count(text) < count:
            if self.status is not None or monotonic() > given_up:
                raise NotReady(
                    f"{self.name} did not print {text!r}: {self.output_text.strip()[-300:]}", self.status is None
                )
            sleep(LOOK_S)

    def send(self, number: int) -> None:
        """Send a signal to the process."""
        with contextlib.suppress(ProcessLookupError):
            self._process.send_signal(number)

    def children(self, word: str) -> list[int]:
        """Return the IDs of its child processes whose command line contains a word."""
        found = Path(f"/proc/{self.pid}/task/{self.pid}/children").read_text().split()
        return [int(n) for n in found if word in Path(f"/proc/{n}/cmdline").read_text()]

    def send_child(self, word: str, number: int) -> None:
        """Send a signal to its child processes whose command line contains a word."""
        for child in self.children(word):
            os.kill(child, number)

    def finish(self, patience: float = END_S) -> None:
        """Wait for the end. Raise NotReady and kill the process if it does not end."""
        try:
            self._process.wait(patience)
        except subprocess.TimeoutExpired:
            self.kill()
            raise NotReady(f"{self.name} did not end: {self.output_text.strip()[-300:]}", True) from None

    def kill(self) -> None:
        """Kill the process."""
        self.send(signal.SIGKILL)
        self._process.wait()
