"""A vehicle started from the command line, for ground stations that are independent of trimtab."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys

from flight.transports.ends import free_port

PATIENCE = 120.0
"""Seconds; only a failure takes this long."""


class Served:
    """A running `trimtab vehicle hovercraft/forward` on UDP."""

    def __init__(self, config, *options) -> None:
        self.port = free_port(socket.SOCK_DGRAM)
        self.config = config
        command = [sys.executable, "-m", "trimtab", "vehicle", "hovercraft/forward", "--json"]
        command += ["--listen", f"udp://127.0.0.1:{self.port}", *options]
        self._process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"TRIMTAB_CONFIG": str(config)},
        )
        assert self._process.stderr is not None
        said = ""
        for line in self._process.stderr:
            said += line
            if "listens on" in line:
                return
        raise AssertionError(said)

    @property
    def passphrase(self):
        return (self.config / "keys" / "hovercraft.key").read_text().strip()

    def stop(self):
        """End the vehicle and return its report."""
        self._process.send_signal(signal.SIGINT)
        out, _ = self._process.communicate(timeout=PATIENCE)
        assert self._process.returncode == (1 if json.loads(out)["problems"] else 0)
        return json.loads(out)

    def kill(self):
        if self._process.poll() is None:
            self._process.kill()
        self._process.communicate()


@contextlib.contextmanager
def served(config, *options):
    vehicle = Served(config, *options)
    try:
        yield vehicle
    finally:
        vehicle.kill()
