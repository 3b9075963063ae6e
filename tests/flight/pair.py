"""A vehicle and an autopilot as two programs, started as a user would start them."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

from answers import complaints

BUILD_S = 200
"""Seconds in which a program is compiled and has flown: only a failure takes this long."""
WATCHED = "--watchdog", "250 ms"
"""For flights of which the outputs' watchdog is no part: where more tests run than there are cores, a process waits for
the usual 50 ms now and then, and a vehicle whose outputs went safe ends with exit code 1."""
DISARMED_S = 10
"""Seconds in which a vehicle that was armed ends after its autopilot."""


class Ended(NamedTuple):
    """Exit status, JSON result, and messages to the user."""

    status: int
    result: dict | None
    said: str


class Program:
    """`trimtab …` as a process, with its keys and its messages to the user in a folder.

    inside: command prefix, e.g. nsenter.
    """

    def __init__(self, *arguments, folder, inside=()):
        self._said = Path(folder) / f"said-{arguments[0]}.txt"
        command = [
            *inside,
            sys.executable,
            "-c",
            "import sys; from trimtab.cli import main; sys.exit(main())",
            *arguments,
        ]
        environment = {**os.environ, "TRIMTAB_CONFIG": str(Path(folder) / "config")}
        with self._said.open("w") as said:
            self.process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=said, text=True)

    def wait_for(self, *words):
        """Wait until the process has printed one of these words or has ended."""
        end = time.monotonic() + BUILD_S
        while self.process.poll() is None and not any(word in self._said.read_text() for word in words):
            assert time.monotonic() < end, self._said.read_text()
            time.sleep(0.05)

    def said(self):
        """Messages to the user so far."""
        return self._said.read_text()

    def terminate_after(self, patience):
        """Terminate the process unless it ends within `patience` seconds."""
        try:
            self.process.wait(patience)
        except subprocess.TimeoutExpired:
            self.process.terminate()

    def finished(self):
        """Wait for the end of the process and return its result. Kill it after a timeout."""
        try:
            out, _ = self.process.communicate(timeout=BUILD_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            out, _ = self.process.communicate()
            raise AssertionError(f"did not end: {out} {self._said.read_text()}") from None
        lines = out.strip().splitlines()
        result = json.loads(lines[-1]) if lines and lines[-1].startswith("{") else None
        assert result is None or not complaints(result), complaints(result)
        return Ended(self.process.returncode, result, self._said.read_text())


def make_key(folder, vehicle="hovercraft"):
    from trimtab.flight.mavlink.keys import create_key

    create_key(Path(folder) / "config" / "keys" / f"{vehicle}.key")


def fly_pair(folder, scenario, listen, link, *both, vehicle=(), pilot=(), inside=((), ())):
    """Run vehicle and autopilot until both have ended. inside: see `Program`, one for each of the two.

    The autopilot starts when the vehicle is ready, because it waits only ten seconds for an answer.
    """
    if "--unsigned" not in both:
        from trimtab.commands.line import vehicle_name

        make_key(folder, vehicle_name(scenario))

    def start(verb, option, uri, out, own, where):
        words = (verb, scenario, option, uri, "--out", str(folder / out), "--json", *both, *own)
        return Program(*words, folder=folder, inside=where)

    there = start("vehicle", "--listen", listen, "there", (*WATCHED, *vehicle), inside[0])
    try:
        there.wait_for("listens on", "waits on")
        here = start("fly", "--link", link, "here", pilot, inside[1]).finished()
        if here.status:  # one that flew ends by itself; one that nobody armed waits for ever
            there.terminate_after(DISARMED_S)
        return there.finished(), here
    finally:
        if there.process.poll() is None:
            there.process.kill()
            there.process.wait()
