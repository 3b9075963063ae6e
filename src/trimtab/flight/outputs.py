"""Vehicle's connection to the process of its outputs. This process makes the outputs safe if the vehicle sends no
output rows.

An output row contains the values of all servos and motors. The vehicle sends each row that it computes, and at least
one row per HEARTBEAT. The process of the outputs applies the row. If no row arrives within the watchdog's time-out, or
if the socket closes, the process applies the safe row: safe thrust immediately, lift fan off after the failsafe's
delay. `flight.outputs_process` contains the process.
Source: docs page, Vehicle (Watchdog).
"""

import contextlib
import json
import os
import socket
import struct
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

from trimtab.core.clock import NS_PER_SECOND, SYSTEM_CLOCK, Clock
from trimtab.core.errors import InputError, argument_name
from trimtab.flight.output_port import LIFE_TIMEOUT, port_path

HEARTBEAT = 5_000_000
"""Longest time (ns) between two output rows that the vehicle sends. After this time, an unchanged row is sent again."""
START_S, END_S = 10.0, 5.0
HEAD = struct.Struct("<q??")
"""Format of the header of an output row: time of sending (ns, monotonic clock), True if the vehicle obeys a command,
True if the lift fan turns.
"""
READY, TRIPPED, END, ECHO = b"ready", b"tripped ", b"end", b"echo"
DIED, FROZEN = "the outputs' process died", "the outputs' process is frozen"
PORT_FILE, LOG_FILE = "outputs.bin", "outputs.txt"


class RowSocket(Protocol):
    """Interface of one end of the connection between vehicle and outputs. The connection keeps the boundaries of
    packets and never blocks."""

    def fileno(self) -> int:
        """Return the file descriptor, or -1 once the socket is closed."""
        ...

    def send(self, packet: bytes, /) -> int:
        """Send a packet. Raise BlockingIOError if the buffer is full, or OSError if the other end is closed."""
        ...

    def recv(self, size: int, /) -> bytes:
        """Return the next packet, or empty bytes if the other end is closed. Raise BlockingIOError if no packet has
        arrived."""
        ...

    def close(self) -> None:
        """Close this end of the connection."""
        ...


class OutputsProcess(NamedTuple):
    """Running process of the outputs."""

    line: RowSocket
    pid: int
    end: Callable[[], None]
    """Function that waits until the process has ended, and kills a process that does not end."""


class OutputsOrders(NamedTuple):
    """Settings passed to the process of the outputs at its start. Times are in ns, see `Watchdog`."""

    safe: tuple[float, ...]
    timeout: int
    lift_delay: int
    latch: int
    folder: str | None
    """Folder for the port and the log of the outputs, or None to write neither."""
    real_time: bool
    vehicle: int
    """Process id of the vehicle's process."""


StartOutputs = Callable[[OutputsOrders], OutputsProcess]


def start_outputs_process(orders: OutputsOrders) -> OutputsProcess:
    """Start the process of the outputs on this machine.

    Raises:
        InputError: the process did not start.
    """
    line, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [
        sys.executable,
        "-m",
        "trimtab.flight.outputs_process",
        str(there.fileno()),
        json.dumps(orders._asdict()),
    ]
    with there:
        process = subprocess.Popen(
            command, pass_fds=(there.fileno(),), env=environment, start_new_session=True, stdout=subprocess.DEVNULL
        )
    line.settimeout(START_S)
    try:
        said = line.recv(64)
    except OSError:
        said = b""
    if said != READY:
        process.kill()
        process.wait()
        line.close()
        where = "" if orders.folder is None else f"; the process creates {PORT_FILE} and {LOG_FILE} in {orders.folder}"
        raise InputError(
            "outputs",
            f"the process of the outputs did not start{where}",
            fix=f"{argument_name('out')} with a folder that does not exist yet",
        )
    line.setblocking(False)

    def end() -> None:
        try:
            process.wait(END_S + orders.lift_delay / NS_PER_SECOND)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        with contextlib.suppress(OSError):  # remove the port, which remains if the process was killed
            port_path(process.pid).unlink(missing_ok=True)

    return OutputsProcess(line, process.pid, end)


class Outputs:
    """Connection of the vehicle to the process of its outputs. It sends output rows and never blocks.

    Args:
        safe: output values that make the vehicle safe.
        timeout: time (ns) without output rows after which the safe row is applied.
        lift_delay: time (ns) for which the lift fan keeps turning after the safe row takes effect.
        latch: time (ns) without output rows after which the safe row remains applied until the vehicle is disarmed.
        folder: folder for the port and the log of the outputs, or None to write neither.
        wanted_real_time: True to ask the system for real-time scheduling.
        clock: clock of the vehicle's process.
        start: function that starts the process.
    """

    def __init__(
        self,
        safe: Sequence[float],
        *,
        timeout: int,
        lift_delay: int,
        latch: int,
        folder: Path | None = None,
        wanted_real_time: bool = False,
        clock: Clock = SYSTEM_CLOCK,
        start: StartOutputs = start_outputs_process,
    ) -> None:
        """Start the process of the outputs. Raise InputError if the process does not start."""
        where = None if folder is None else str(folder)
        orders = OutputsOrders(tuple(safe), timeout, lift_delay, latch, where, wanted_real_time, os.getpid())
        self.process, self._clock = start(orders), clock
        self._line = self.process.line
        self._numbers = struct.Struct(f"<{len(safe)}d")
        self._content, self._stamp = b"", 0
        self._echo = self._looked = self._clock.monotonic_ns()
        self.problem = ""
        """Problem of the process of the outputs, or an empty string while the process works."""

    @property
    def is_alive(self) -> bool:
        """Return True while the process of the outputs works."""
        return not self.problem

    def hand_over(self, is_commanded: bool, lift: bool, values: Sequence[float]) -> int:
        """Send an output row to the process. Return the time (ns) without rows if the process had to apply the safe
        row, otherwise 0."""
        now = self._clock.monotonic_ns()
        content = HEAD.pack(0, is_commanded, lift)[8:] + self._numbers.pack(*values)
        if content == self._content and now - self._stamp < HEARTBEAT:
            return 0
        self._content, self._stamp = content, now
        if now - self._looked >= LIFE_TIMEOUT / 2:  # this process or the machine was stopped for some time
            self._echo = now
        self._looked = now
        silence = 0
        try:
            with contextlib.suppress(BlockingIOError):  # the buffer is full if the process is frozen
                self._line.send(now.to_bytes(8, "little") + content)
            while True:
                silence = max(silence, self._take_answer(self._line.recv(64), now))
        except BlockingIOError:
            if now - self._echo >= LIFE_TIMEOUT:
                self.problem = FROZEN
        except OSError:
            self.problem = DIED
        return silence

    def _take_answer(self, answer: bytes, now: int) -> int:
        """Handle a packet from the process of the outputs. Return the time (ns) without rows that the packet reports,
        or 0."""
        if not answer:
            raise BrokenPipeError
        self._echo = now
        return int(answer.removeprefix(TRIPPED)) if answer.startswith(TRIPPED) else 0

    def close(self) -> None:
        """Make the outputs safe and end their process."""
        with contextlib.suppress(OSError):
            self._line.send(END)
        self._line.close()
        self.process.end()
