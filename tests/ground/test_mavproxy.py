"""Headless MAVProxy reads, arms and commands a vehicle with its passphrase, and gets no answer with another one."""

import contextlib
import importlib.util
import os
import re
import subprocess
import sys
import threading
import time

import pytest
from ground.serving import PATIENCE, served

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.skipif(importlib.util.find_spec("MAVProxy") is None, reason="pip install --no-deps MAVProxy"),
]
AGAIN = 3.0


class MavProxy:
    """A MAVProxy process controlled by typed lines."""

    def __init__(self, port, home) -> None:
        command = [sys.executable, "-W", "ignore", "-u", "-m", "MAVProxy.mavproxy", "--mav20", "--nowait", "--no-state"]
        self._process = subprocess.Popen(
            [*command, f"--master=udpout:127.0.0.1:{port}"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=home,
            env=os.environ | {"HOME": str(home), "TERM": "dumb", "MPLBACKEND": "agg"},
        )
        self.said = ""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self):
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self.said += line

    def type(self, line, wanted=None):
        """Type a line repeatedly until the wanted text appears in the output."""
        start, end, again = len(self.said), time.monotonic() + PATIENCE, 0.0
        while True:
            if time.monotonic() > again:
                again = time.monotonic() + AGAIN
                assert self._process.stdin is not None
                self._process.stdin.write(f"{line}\n")
                self._process.stdin.flush()
            if wanted is None or re.search(wanted, self.said[start:]):
                return
            assert time.monotonic() < end, f"after {line!r}: {self.said[start:]}"
            time.sleep(0.05)

    def close(self):
        with contextlib.suppress(OSError):
            self.type("exit")
        try:
            self._process.communicate(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


@contextlib.contextmanager
def mavproxy(port, home):
    home.mkdir()
    found = MavProxy(port, home)
    try:
        yield found
    finally:
        found.close()


def test_mavproxy_with_the_key_reads_arms_and_sets_parameters(tmp_path):
    more = ("--origin", "38.9897,-76.9378,20", "--out", str(tmp_path / "out"), "--parameters", str(tmp_path / "kept"))
    with served(tmp_path, *more) as vehicle, mavproxy(vehicle.port, tmp_path / "home") as station:
        station.type(f"signing key {vehicle.passphrase}", "Setup signing key")
        station.type("", "Detected vehicle 1:1")
        station.type("param fetch", r"Received \d+ parameters")
        station.type("param show WV_MASS", r"WV_MASS\s+2\.[56]")
        station.type("param set WV_MASS 2.75")
        station.type("param show WV_MASS", r"WV_MASS\s+2\.75")
        station.type("param fetch WV_MASS", r"WV_MASS\s*=\s*2\.75")
        station.type("long PREFLIGHT_STORAGE 1", "Parameters stored for the next start")
        station.type("status GLOBAL_POSITION_INT", r"lat : 38989[67]")
        station.type("status HOME_POSITION", "HOME_POSITION {latitude")
        station.type("ftp list /logs", r"vehicle\.mcap")
        station.type("log list", r"Log 2 ")
        station.type("link", r"link 1 OK \(.*, 0 lost, 0\.0% loss")
        station.type("status ATTITUDE", "ATTITUDE {time_boot_ms")
        station.type("status LOCAL_POSITION_NED", "LOCAL_POSITION_NED {time_boot_ms")
        station.type("mode MANUAL", "Mode MANUAL")
        station.type("mode GUIDED", "Mode GUIDED")
        station.type("arm throttle", r"\bARMED")
        station.type("disarm", "DISARMED")
        assert "fence breach" not in station.said
        assert "AP: computer: arm request" in station.said
        report = vehicle.stop()
    assert report["released_s"] is not None


def test_mavproxy_without_the_right_key_gets_no_answer(tmp_path):
    with served(tmp_path) as vehicle:
        for k, passphrase in enumerate((None, "a-passphrase-that-is-another")):
            with mavproxy(vehicle.port, tmp_path / f"home{k}") as station:
                station.type("", "link 1 down")
                if passphrase:
                    station.type(f"signing key {passphrase}", "Setup signing key")
                end = time.monotonic() + 5.0
                while time.monotonic() < end:
                    station.type("arm throttle")
                    station.type("mode MANUAL")
                    time.sleep(0.2)
                assert "Detected vehicle" not in station.said
                assert "ARMED" not in station.said
        report = vehicle.stop()
    assert report["released_s"] is None
    assert report["line"]["bytes_out"] == 0
    assert report["wire"]["unsigned"] > 0
    assert report["wire"]["wrong_signature"] > 0
