"""Computer on which a live program runs: its clock, disk, links, processes and signals.

Live code uses a Machine and does not call the system itself. So the same code runs in virtual time, on the machines of
`flight.virtual_machine`.
Source: docs page, Testing.
"""

import contextlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from typing import NamedTuple, Protocol

from trimtab.core.clock import NS_PER_SECOND, SYSTEM_CLOCK, Clock
from trimtab.core.interfaces import Link
from trimtab.core.line_writer import LineWriter
from trimtab.flight.flight_log import SYSTEM_DISK, Disk
from trimtab.flight.mavlink.authority import draw_session
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.outputs import StartOutputs, start_outputs_process
from trimtab.flight.real_time import RealTimeGrant, real_time
from trimtab.flight.transports.open_link import open_link

STORE_PERIOD_S = 1.0
"""Time (s) between two stores of a future time stamp. A restarted program continues from the stored time stamp."""


SAME_KEYPRESS_S = 0.3
"""Time (s) within which a second signal counts as the same request: some terminals and wrappers send two signals."""


@contextlib.contextmanager
def catch_interrupts(clock: Clock = SYSTEM_CLOCK) -> Iterator[Callable[[], bool]]:
    """Turn Ctrl-C, SIGTERM and SIGHUP into a flag, so that the craft is disarmed and logs are closed.

    A second signal more than `SAME_KEYPRESS_S` after the first ends the program at once. SIGHUP is sent when a terminal
    or an ssh session is lost. If SIGHUP was ignored before, as under nohup, it stays ignored.
    """
    asked: list[int] = []

    def note(_number: int, _: object) -> None:
        now = clock.monotonic_ns()
        if asked and now - asked[0] > SAME_KEYPRESS_S * NS_PER_SECOND:
            raise KeyboardInterrupt
        asked.append(now)

    numbers = [signal.SIGINT, signal.SIGTERM]
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    before = {number: signal.signal(number, note) for number in numbers}
    try:
        yield lambda: bool(asked)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def store_stamps_ahead(endpoint: Endpoint) -> Iterator[None]:
    """Store future time stamps of an endpoint in another thread, so that the control loop never waits for the disk."""
    done = threading.Event()

    def keep() -> None:
        while not done.wait(STORE_PERIOD_S):
            endpoint.store_stamps()

    thread = threading.Thread(target=keep, daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
        endpoint.close()


def list_stamp_problems(endpoint: Endpoint) -> list[str]:
    """Return a message if time stamps could not be stored beside the key, else an empty list."""
    failed = 0 if endpoint.stamps is None else endpoint.stamps.unsaved
    fix = "free space on the disk of the key, else old packets may be accepted after a restart"
    return [f"the time stamps beside the key could not be stored (failed attempts: {failed}): {fix}"] if failed else []


class LineSink(Protocol):
    """Receiver of lines for the user. Only `settle` waits."""

    def settle(self) -> int:
        """Wait briefly for lines that are not written yet.

        Return the number of lost lines, including lines still unwritten.
        """
        ...

    def put(self, text: str) -> None:
        """Queue a line for the user."""
        ...


@contextlib.contextmanager
def write_lines(write: Callable[[str], object]) -> Iterator[LineSink]:
    """Write lines in a thread. At the end, wait at most one second for the remaining lines."""
    writer = LineWriter(write)
    try:
        yield writer
    finally:
        writer.close()


class OpenLink(Protocol):
    """Function that opens a link, see `transports.open_link.open_link`."""

    def __call__(self, uri: str, *, listen: bool = False) -> Link:
        """Open the link of an address."""
        ...


class Machine(NamedTuple):
    """Parts of a computer that a live program uses. The default is the computer that runs Python."""

    clock: Clock = SYSTEM_CLOCK
    disk: Disk = SYSTEM_DISK
    open_link: OpenLink = open_link
    start_outputs: StartOutputs = start_outputs_process
    """Function that starts the process of a vehicle's outputs."""
    real_time: Callable[[bool], AbstractContextManager[RealTimeGrant]] = real_time
    """Context in which the program has real-time scheduling and locked memory, if the system allows it."""
    catch_interrupts: Callable[[], AbstractContextManager[Callable[[], bool]]] = catch_interrupts
    """Context that turns a signal to end the program into a flag."""
    store_stamps_ahead: Callable[[Endpoint], AbstractContextManager[None]] = store_stamps_ahead
    """Context that stores future time stamps of an endpoint, and closes the endpoint at the end."""
    write_lines: Callable[[Callable[[str], object]], AbstractContextManager[LineSink]] = write_lines
    """Context that writes lines for the user in a thread, so that the program never waits for the terminal."""
    typed_words: Callable[[], Sequence[str]] = lambda: sys.argv[1:]
    """Function that returns the words of the command line after the program's name."""
    draw_session: Callable[[], int] = draw_session
    """Function that returns a random session number."""


SYSTEM_MACHINE = Machine()
