"""The loss of the terminal of `vehicle` or `fly` in flight: real processes, each on its own pseudo-terminal."""

import contextlib
import os
import signal
import subprocess
import sys
import time

import pytest
from flight.pair import BUILD_S, WATCHED, make_key
from flight.transports.ends import free_port

from trimtab.compiler.native.compiler import find_compiler
from trimtab.logs.mcap import read_mcap

pytestmark = [pytest.mark.real_time, pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")]
RUN = """
import fcntl, signal, sys, termios
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # this test may run under nohup
fcntl.ioctl(0, termios.TIOCSCTTY, 0)  # the system then sends SIGHUP when the terminal is lost
from trimtab.cli import main
sys.exit(main())
"""


class Terminal:
    """A program on its own terminal, with its log in a folder. `text` holds what the program has printed."""

    def __init__(self, folder, out, *words):
        self._own, other = os.openpty()
        environment = {**os.environ, "TRIMTAB_CONFIG": str(folder / "config")}
        command = [sys.executable, "-c", RUN, *words, "--out", str(folder / out)]
        streams = dict.fromkeys(("stdin", "stdout", "stderr"), other)
        self.process = subprocess.Popen(command, env=environment, start_new_session=True, **streams)
        os.close(other)
        os.set_blocking(self._own, False)
        self.text, self.log = "", folder / out

    def read(self):
        with contextlib.suppress(OSError):
            self.text += os.read(self._own, 1 << 16).decode(errors="replace")
        return self.text

    def wait_for(self, text, *others):
        """Read this terminal, and the other terminals, until the program has printed a text."""
        end = time.monotonic() + BUILD_S
        while text not in self.read():
            assert time.monotonic() < end, self.text
            assert self.process.poll() is None, self.text
            for other in others:
                other.read()
            time.sleep(0.05)

    def lose(self):
        """Close the terminal, as when an ssh session is lost."""
        os.close(self._own)
        self._own = -1

    def end(self, *others):
        """Wait for the end of the program. Return its exit code."""
        end = time.monotonic() + BUILD_S
        while self.process.poll() is None:
            assert time.monotonic() < end, self.text
            for each in (self, *others):
                each.read()
            time.sleep(0.05)
        self.read()
        return self.process.returncode

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        if self._own >= 0:
            self.lose()


@pytest.fixture
def flight(tmp_path):
    """A flight whose vehicle is armed: vehicle and autopilot."""
    make_key(tmp_path)
    uri = f"udp://127.0.0.1:{free_port()}"
    programs = [Terminal(tmp_path, "there", "vehicle", "hovercraft/forward", "--listen", uri, *WATCHED)]
    try:
        programs[0].wait_for("listens on")
        programs.append(Terminal(tmp_path, "here", "fly", "hovercraft/forward", "--link", uri, "--duration", "600 s"))
        programs[0].wait_for("computer: arm request", programs[1])
        yield programs
    finally:
        for program in programs:
            program.close()


def events(folder, name):
    """Return the events of a log. Its end must not be missing."""
    log = read_mcap(folder / name)
    assert "truncated" not in log.metadata
    return [event["text"] for event in log.metadata["events"]]


def test_fly_that_loses_its_terminal_disarms_the_vehicle(flight):
    vehicle, autopilot = flight
    autopilot.lose()
    assert autopilot.process.wait(BUILD_S) >= 0  # no signal has killed it
    vehicle.wait_for("disarmed: disarm request")
    vehicle.process.send_signal(signal.SIGINT)
    vehicle.end()
    assert "failsafe" not in vehicle.text
    assert "disarmed: disarm request" in events(vehicle.log, "vehicle.mcap")
    assert events(autopilot.log, "flight.mcap")


def test_vehicle_that_loses_its_terminal_disarms_and_closes_its_log(flight):
    vehicle, autopilot = flight
    vehicle.lose()
    assert vehicle.process.wait(BUILD_S) >= 0
    told = events(vehicle.log, "vehicle.mcap")
    assert told.index("ended by request") < told.index("disarmed: disarm request")
    autopilot.wait_for("the vehicle is no longer armed")
    autopilot.process.send_signal(signal.SIGINT)
    autopilot.end()
