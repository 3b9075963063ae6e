"""Process of a vehicle's outputs. It applies the received output rows, and makes the outputs safe if no rows arrive.

This module imports only the standard library, so that the process starts quickly.
Source: docs page, Vehicle (Watchdog).
"""

import contextlib
import functools
import gc
import json
import os
import signal
import socket
import struct
import sys
import threading
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TextIO

from trimtab.core.clock import NS_PER_SECOND, SYSTEM_CLOCK, Clock
from trimtab.core.line_writer import LineWriter
from trimtab.flight.output_port import (
    DRIVEN,
    LATCHED,
    LIFE_PERIOD,
    SAFE,
    WAITING,
    OutputPort,
    OutputRow,
    port_path,
)
from trimtab.flight.outputs import ECHO, END, HEAD, LOG_FILE, PORT_FILE, READY, TRIPPED, OutputsOrders, RowSocket
from trimtab.flight.watchdog import Watchdog

PRIORITY = 41
"""Real-time priority of this process, above the priority of the vehicle's loop."""
EXITING = 0x4
"""Flag in /proc/PID/stat by which Linux marks a process that is ending."""
GONE = "the vehicle's process is gone"
STOPPED = "the vehicle's process is stopped"
HANGS = "the vehicle's process hangs or is starved"


def write_error_line(text: str) -> None:
    """Write a line to standard error. If the terminal was closed together with the vehicle, do nothing."""
    with contextlib.suppress(OSError):
        os.write(sys.stderr.fileno(), f"{text}\n".encode())


def open_log(folder: Path) -> TextIO:
    """Create the log file of the outputs, which is still written after the vehicle's process has ended."""
    return (folder / LOG_FILE).open("x", encoding="utf-8", buffering=1)


def open_port(folder: Path, orders: OutputsOrders) -> OutputPort:
    """Make the port in shared memory, and a link to the port in the folder of the log.

    Raises OSError if the folder already contains a port, or if memory is full.
    """
    port = OutputPort(port_path(os.getpid()), orders.safe, orders.lift_delay)
    try:
        (folder / PORT_FILE).symlink_to(port.path)
    except OSError:
        port.close()
        raise
    return port


class OutputsLoop:
    """Loop of the outputs. It applies received output rows until the vehicle's process is gone and all outputs are at
    rest."""

    def __init__(
        self,
        line: RowSocket,
        orders: OutputsOrders,
        clock: Clock = SYSTEM_CLOCK,
        *,
        find_cause: Callable[[], str] = lambda: GONE,
        port: OutputPort | None = None,
        tells: Sequence[Callable[[str], object]] = (),
    ) -> None:
        """Report to the vehicle that the outputs are ready.

        Args:
            line: connection to the vehicle.
            orders: settings of the outputs, sent by the vehicle.
            clock: clock of this process.
            find_cause: function that returns the reason why no row arrives although the connection is open.
            port: port for the driver, or None without a driver.
            tells: functions that pass each message to the log and the user. They must not block.
        """
        self._line, self._clock, self._find_cause, self._timeout = line, clock, find_cause, orders.timeout
        self.watchdog = Watchdog(orders.safe, orders.timeout, orders.lift_delay, orders.latch)
        self._port, self._tells = port, tells
        self._next_life = 0
        self._numbers = struct.Struct(f"<{len(orders.safe)}d")
        self._acting: OutputRow | None = None
        self._is_gone = self._has_ended = False
        self._unreported_silence = 0
        line.send(READY)

    def serve(self) -> None:
        """Run until the vehicle's process is gone and all outputs are at rest."""
        try:
            while True:
                due = self.step()
                if self._is_gone and not self.watchdog.row.lift:
                    break
                left = max(due - self._clock.monotonic_ns(), 0) / NS_PER_SECOND
                self._clock.wait(None if self._is_gone else self._line, left)
            self._tell("at rest; " + ("the vehicle has ended" if self._has_ended else GONE))
        finally:
            if self._port is not None:
                self._port.close()

    def _tell(self, text: str) -> None:
        now = datetime.fromtimestamp(self._clock.unix(), UTC).isoformat(timespec="milliseconds")
        line = f"{now}  {self._clock.monotonic_ns() / NS_PER_SECOND:.4f} s  outputs: {text}"
        for tell in self._tells:
            tell(line)

    def step(self) -> int:
        """Apply the received output rows. Return the time (ns) of the next call if no row arrives earlier."""
        if not self._is_gone:
            self._take_rows()
            self._report_silence()
        watchdog, now = self.watchdog, self._clock.monotonic_ns()
        state, tripped = watchdog.row.state, watchdog.check(now, self._is_gone)
        if self._port is not None and watchdog.row != self._acting:
            self._acting = watchdog.row
            self._port.write(self._acting, now)
        self._show_life(now)
        if tripped:
            why = "the vehicle has ended" if self._has_ended else GONE if self._is_gone else self._find_cause()
            self._tell(f"safe, {watchdog.silence(now) * 1e-6:.1f} ms after the last row: {why}")
        elif state in (SAFE, LATCHED) and watchdog.row.state == DRIVEN:
            self._tell("rows arrive again")
        if state == SAFE and watchdog.row.state == LATCHED and not self._is_gone:
            self._tell("latched until the vehicle is disarmed")
        check = watchdog.next_check()
        return self._next_life if check is None else min(check, self._next_life)

    def _show_life(self, now: int) -> None:
        """Signal to the driver and to the vehicle, once per LIFE_PERIOD, that this process works."""
        if now < self._next_life:
            return
        self._next_life = now + LIFE_PERIOD
        if self._port is not None:
            self._port.renew(now)
        if not self._is_gone:
            with contextlib.suppress(OSError):  # the buffer is full if the vehicle is frozen
                self._line.send(ECHO)

    def _take_rows(self) -> None:
        """Read all received output rows. Record if the vehicle has sent END or closed the connection."""
        while not self._is_gone:
            try:
                data = self._line.recv(HEAD.size + self._numbers.size)
            except BlockingIOError:
                break
            except ConnectionResetError:  # closed before all echoes were read; the last packets still arrive
                continue
            except OSError:
                data = b""
            self._has_ended = data == END
            self._is_gone = not data or self._has_ended
            if not self._is_gone:
                self._take_row(data)

    def _take_row(self, data: bytes) -> None:
        watchdog = self.watchdog
        stamp, is_commanded, lift = HEAD.unpack_from(data)
        was_waiting, silence = watchdog.row.state == WAITING, watchdog.silence(stamp)
        watchdog.take_row(stamp, is_commanded, lift, self._numbers.unpack_from(data, HEAD.size))
        if not was_waiting and silence >= self._timeout:
            self._unreported_silence = max(self._unreported_silence, silence)

    def _report_silence(self) -> None:
        """Report to the vehicle that the safe row was applied. If the socket's buffer is full, report later."""
        if self._unreported_silence:
            with contextlib.suppress(OSError):
                self._line.send(TRIPPED + str(self._unreported_silence).encode())
                self._unreported_silence = 0


def find_process_cause(vehicle: int) -> str:
    """Return the reason why a vehicle's process on this machine sends no rows: it is gone, stopped, or hangs."""
    try:
        words = Path(f"/proc/{vehicle}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        state, is_exiting = words[0], bool(int(words[6]) & EXITING)
    except (OSError, IndexError):
        return GONE
    if is_exiting:  # an ending process closes its sockets only after it has freed its memory
        return GONE
    return STOPPED if state in "Tt" else HANGS


def main() -> None:
    """Serve the vehicle at the socket given by the first argument. Ignore Ctrl-C, SIGTERM and SIGHUP."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    gc.disable()
    orders = OutputsOrders(**json.loads(sys.argv[2]))
    folder, port, writers = None if orders.folder is None else Path(orders.folder), None, [LineWriter(write_error_line)]
    if folder is not None:
        try:
            port = open_port(folder, orders)
            log = open_log(folder)
            writers.append(LineWriter(lambda line: log.write(f"{line}\n")))
        except OSError as error:
            if port is not None:
                port.close()
                (folder / PORT_FILE).unlink(missing_ok=True)
            write_error_line(f"outputs: {error}")
            sys.exit(1)
    if orders.real_time:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    with socket.socket(fileno=int(sys.argv[1])) as line:
        line.setblocking(False)
        tells = [writer.put for writer in writers]
        find_cause = functools.partial(find_process_cause, orders.vehicle)
        OutputsLoop(line, orders, find_cause=find_cause, port=port, tells=tells).serve()
    for writer in writers:
        writer.close()
    if folder is not None:
        remover = threading.Thread(target=(folder / PORT_FILE).unlink, kwargs={"missing_ok": True}, daemon=True)
        remover.start()
        remover.join(1.0)
    os._exit(0)  # a thread that still waits for a terminal or a disk must not delay the exit


if __name__ == "__main__":
    main()
