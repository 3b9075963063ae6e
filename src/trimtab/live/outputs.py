"""The outputs of a vehicle in a process of their own, which makes them safe when the vehicle's process falls silent.

The vehicle hands over a row as often as it works one out, and at least each HEARTBEAT; the outputs' process applies it.
No row for the watchdog's time, or the end of the socket between them, and it writes the safe row by itself: thrust at
once, the lift fan after the failsafe's delay. It needs nothing but the standard library, so that it starts in a moment.
Source: docs page, Vehicle (Watchdog).
"""

import contextlib
import gc
import json
import math
import mmap
import os
import select
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic_ns, sleep
from typing import NamedTuple

from trimtab.core.errors import InputError, argument_name

HEARTBEAT = 5_000_000
"""At least so often (ns) a row is handed over, changed or not."""
PRIORITY = 41
"""Above that of the vehicle's loop."""
START_S, END_S = 10.0, 5.0
HEAD = struct.Struct("<q??")
"""Of a row: when it was handed over (ns of the monotonic clock), whether somebody commands, whether the lift turns."""
PORT_HEAD = struct.Struct("<QqB?")
"""Of the port: number of the writing (odd while it is under way), when it was written (ns), state, lift."""
STATES = ("waiting", "driven", "safe", "latched")
WAITING, DRIVEN, SAFE, LATCHED = range(4)
READY, TRIPPED, END = b"ready", b"tripped ", b"end"
EXITING = 0x4
"""Among Linux's flags of a process: it is on its way out."""
GONE = "the vehicle's process is gone"
PORT_FILE, LOG_FILE = "outputs.bin", "outputs.txt"


class OutputRow(NamedTuple):
    """What acts. values: of the command, in the order of its record."""

    state: int
    lift: bool
    values: tuple[float, ...]


class Watchdog:
    """Which row acts, by what has come and when; times in ns of one clock."""

    def __init__(self, safe: Sequence[float], timeout: int, lift_delay: int, latch: int) -> None:
        """timeout: silence after which the safe row acts.  latch: silence after which it goes on acting until disarmed.

        lift_delay: how long the lift fan turns on after the safe row began to act.
        """
        self._safe, self._timeout, self._lift_delay, self._latch = tuple(safe), timeout, lift_delay, latch
        self.row = OutputRow(WAITING, False, self._safe)
        self._stamp = self._lift_until = 0

    def take_row(self, stamp: int, is_commanded: bool, lift: bool, values: tuple[float, ...]) -> None:
        """A row handed over at a time; where the safe one is latched it acts only once nobody commands any more."""
        state, lift_now = self.row.state, self.row.lift and self.row.state != DRIVEN
        latched = state == LATCHED or (state != WAITING and stamp - self._stamp >= self._latch)
        self._stamp = stamp
        if latched and is_commanded:
            self.row = OutputRow(LATCHED, lift_now, self._safe)
            return
        self.row = OutputRow(DRIVEN, lift, values)

    def check(self, now: int, is_gone: bool = False) -> bool:
        """Let time pass to now; whether the safe row begins to act. is_gone: nothing more can come."""
        row = self.row
        if row.state == DRIVEN and (is_gone or now - self._stamp >= self._timeout):
            self._lift_until = now + (self._lift_delay if row.lift else 0)
            self.row = OutputRow(SAFE, row.lift and now < self._lift_until, self._safe)
            return True
        if row.lift and row.state != DRIVEN and now >= self._lift_until:
            self.row = row._replace(lift=False)
        if row.state == SAFE and (is_gone or now - self._stamp >= self._latch):
            self.row = self.row._replace(state=LATCHED)
        return False

    def next_check(self) -> int | None:
        """When something may change by time alone; None for never."""
        if self.row.state == DRIVEN:
            return self._stamp + self._timeout
        times = [self._lift_until] if self.row.lift else []
        times += [self._stamp + self._latch] if self.row.state == SAFE else []
        return min(times, default=None)

    def silence(self, now: int) -> int:
        """How long nothing has been handed over."""
        return now - self._stamp


def _open_own(path: str, flags: int) -> int:
    """A file that nobody else can write to, whatever this process's mask says: who writes it moves the craft."""
    return os.open(path, flags, 0o644)


class OutputPort:
    """A small file in shared memory with the row that acts now, for a driver or a bench to read."""

    def __init__(self, path: Path, values: int, *, create: bool = False) -> None:
        """values: how many numbers a row has."""
        self._numbers = struct.Struct(f"<{values}d")
        size = PORT_HEAD.size + self._numbers.size
        with open(path, "x+b" if create else "r+b", opener=_open_own) as file:
            if create:
                os.posix_fallocate(file.fileno(), 0, size)  # a full disk is found now, not by a signal at the first row
            self._memory = mmap.mmap(file.fileno(), size)
        self._count = 0

    def write(self, row: OutputRow) -> None:
        """Have a row act."""
        self._count += 2
        PORT_HEAD.pack_into(self._memory, 0, self._count - 1, monotonic_ns(), row.state, row.lift)
        self._numbers.pack_into(self._memory, PORT_HEAD.size, *row.values)
        struct.pack_into("<Q", self._memory, 0, self._count)

    def read(self) -> tuple[int, OutputRow]:
        """When the row that acts was written (ns), and the row."""
        while True:
            count, stamp, state, lift = PORT_HEAD.unpack_from(self._memory, 0)
            values = self._numbers.unpack_from(self._memory, PORT_HEAD.size)
            if count % 2 == 0 and struct.unpack_from("<Q", self._memory, 0)[0] == count:
                return stamp, OutputRow(state, lift, values)


class Outputs:
    """The vehicle's end: hands rows over, and never waits."""

    def __init__(
        self,
        safe: Sequence[float],
        *,
        timeout: int,
        lift_delay: int,
        latch: int,
        folder: Path | None = None,
        wanted_real_time: bool = False,
    ) -> None:
        """Start the process. Times in ns, see `Watchdog`. folder: for the port and the outputs' own log.

        Raises:
            InputError: it did not start.
        """
        self._line, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        orders = {
            "safe": list(safe),
            "timeout": timeout,
            "lift_delay": lift_delay,
            "latch": latch,
            "folder": None if folder is None else str(folder),
            "real_time": wanted_real_time,
            "vehicle": os.getpid(),
        }
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
        command = [sys.executable, "-m", "trimtab.live.outputs", str(there.fileno()), json.dumps(orders)]
        with there:
            self.process = subprocess.Popen(
                command, pass_fds=(there.fileno(),), env=environment, start_new_session=True, stdout=subprocess.DEVNULL
            )
        self._line.settimeout(START_S)
        try:
            said = self._line.recv(64)
        except OSError:
            said = b""
        if said != READY:
            self.process.kill()
            self.process.wait()
            self._line.close()
            where = "" if folder is None else f" over {PORT_FILE} and {LOG_FILE} in {folder}"
            raise InputError(
                "outputs", f"their process did not start{where}", fix=f"{argument_name('out')} with a new folder"
            )
        self._line.setblocking(False)
        self._numbers = struct.Struct(f"<{len(safe)}d")
        self._content, self._stamp = b"", 0
        self.is_alive = True

    def hand_over(self, is_commanded: bool, lift: bool, values: Sequence[float]) -> int:
        """A row for the outputs; returns how long (ns) a silence was that had made them safe, mostly 0."""
        now = monotonic_ns()
        content = HEAD.pack(0, is_commanded, lift)[8:] + self._numbers.pack(*values)
        if content == self._content and now - self._stamp < HEARTBEAT:
            return 0
        self._content, self._stamp = content, now
        try:
            self._line.send(now.to_bytes(8, "little") + content)
            said = self._line.recv(64)
        except BlockingIOError:
            return 0
        except OSError:
            said = b""
        self.is_alive = self.is_alive and bool(said)
        return int(said.removeprefix(TRIPPED)) if said.startswith(TRIPPED) else 0

    def close(self) -> None:
        """End them, safe."""
        with contextlib.suppress(OSError):
            self._line.setblocking(True)
            self._line.send(END)
        self._line.close()
        try:
            self.process.wait(END_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


class _OutputsLog:
    """Lines of when and why, in a file that outlives the vehicle's process, and to people."""

    def __init__(self, folder: Path | None) -> None:
        self._file = None if folder is None else (folder / LOG_FILE).open("xb", buffering=0)

    def write(self, text: str) -> None:
        line = f"{datetime.now(UTC).isoformat(timespec='milliseconds')}  {monotonic_ns() * 1e-9:.4f} s  outputs: {text}"
        for place in (self._file, sys.stderr):
            with contextlib.suppress(OSError):  # a full disk; a terminal that is gone with the vehicle
                if place is not None:
                    os.write(place.fileno(), f"{line}\n".encode())


def serve_outputs(line: socket.socket, orders: dict[str, object]) -> None:
    """Apply rows from a socket until it ends and everything is at rest."""
    safe, folder, vehicle = orders["safe"], orders["folder"], orders["vehicle"]
    assert isinstance(safe, list)
    assert isinstance(vehicle, int)
    timeout, lift_delay, latch = (int(str(orders[name])) for name in ("timeout", "lift_delay", "latch"))
    watchdog = Watchdog(safe, timeout, lift_delay, latch)
    place = None if folder is None else Path(str(folder))
    log = _OutputsLog(place)
    port = None if place is None else OutputPort(place / PORT_FILE, len(safe), create=True)
    numbers, acting, is_gone, has_ended = struct.Struct(f"<{len(safe)}d"), None, False, False
    poll = select.poll()
    poll.register(line, select.POLLIN)
    line.setblocking(False)
    line.send(READY)
    while True:
        if not is_gone:
            is_gone, has_ended = _take_rows(line, watchdog, numbers, timeout)
        now = monotonic_ns()
        state, tripped = watchdog.row.state, watchdog.check(now, is_gone)
        if port is not None and watchdog.row != acting:
            acting = watchdog.row
            port.write(acting)
        if tripped:
            why = "the vehicle has ended" if has_ended else _find_cause(vehicle, is_gone)
            log.write(f"safe, {watchdog.silence(now) * 1e-6:.1f} ms after the last row: {why}")
        elif state in (SAFE, LATCHED) and watchdog.row.state == DRIVEN:
            log.write("rows come again")
        if state == SAFE and watchdog.row.state == LATCHED and not is_gone:
            log.write("latched until the vehicle is disarmed")
        due = watchdog.next_check()
        if is_gone:
            if not watchdog.row.lift:
                log.write("at rest; " + ("the vehicle has ended" if has_ended else GONE))
                return
            sleep(max((due or now) - now, 0) * 1e-9)
        else:
            poll.poll(None if due is None else max(math.ceil((due - now) * 1e-6), 0))


def _take_rows(line: socket.socket, watchdog: Watchdog, numbers: struct.Struct, timeout: int) -> tuple[bool, bool]:
    """Everything that lies waiting; whether the vehicle's end is closed, and whether it said so."""
    is_gone = has_ended = False
    while not is_gone:
        try:
            data = line.recv(HEAD.size + numbers.size)
        except BlockingIOError:
            break
        except OSError:
            data = b""
        has_ended = data == END
        is_gone = not data or has_ended
        if not is_gone:
            stamp, is_commanded, lift = HEAD.unpack_from(data)
            was_waiting, silence = watchdog.row.state == WAITING, watchdog.silence(stamp)
            watchdog.take_row(stamp, is_commanded, lift, numbers.unpack_from(data, HEAD.size))
            if not was_waiting and silence >= timeout:
                with contextlib.suppress(OSError):
                    line.send(TRIPPED + str(silence).encode())
    return is_gone, has_ended


def _find_cause(vehicle: int, is_gone: bool) -> str:
    """Why no row comes, as the system shows it."""
    if is_gone:
        return GONE
    try:
        words = Path(f"/proc/{vehicle}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        state, is_exiting = words[0], bool(int(words[6]) & EXITING)
    except (OSError, IndexError):
        return GONE
    if is_exiting:  # it gives back its memory first, and closes its sockets after
        return GONE
    return "the vehicle's process is stopped" if state in "Tt" else "the vehicle's process hangs or is starved"


def main() -> None:
    """Serve the vehicle whose socket is named; Ctrl-C and a request to terminate are the vehicle's affair."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    gc.disable()
    orders = json.loads(sys.argv[2])
    if orders["real_time"]:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    with socket.socket(fileno=int(sys.argv[1])) as line:
        serve_outputs(line, orders)


if __name__ == "__main__":
    main()
