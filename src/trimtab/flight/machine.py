"""Computer on which a live program runs: clock, disk, links, processes and signals.

Live code uses the class Machine and does not call the operating system itself. So the same code also runs in virtual
time, on the machines of `flight.virtual_machine`.
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
"""Time (s) between two writes of a future time stamp to the disk. A restarted program continues from the stored time
stamp."""


SAME_KEYPRESS_S = 0.3
"""Time (s) within which a second signal counts as the same request, because some terminals send a signal twice."""


@contextlib.contextmanager
def catch_interrupts(clock: Clock = SYSTEM_CLOCK) -> Iterator[Callable[[], bool]]:
    """Convert Ctrl-C, SIGTERM and SIGHUP to a flag, so that the program can disarm the vehicle and close its logs
    before it ends.

    A second Ctrl-C or SIGTERM, more than `SAME_KEYPRESS_S` after the first signal, ends the program immediately. SIGHUP
    is sent when a terminal or an ssh session is lost, often twice: by the shell and by the system. If SIGHUP was
    ignored before, as under nohup, it stays ignored.
    """
    asked: list[int] = []

    def note(number: int, _: object) -> None:
        now = clock.monotonic_ns()
        if asked and number in (signal.SIGINT, signal.SIGTERM) and now - asked[0] > SAME_KEYPRESS_S * NS_PER_SECOND:
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
    """Store future time stamps of an endpoint in a separate thread within this context, so that the control loop never
    waits for the disk."""
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
    """Return a list with a message if time stamps could not be stored beside the key, otherwise an empty list."""
    failed = 0 if endpoint.stamps is None else endpoint.stamps.unsaved
    fix = "free space on the disk of the key, else old packets may be accepted after a restart"
    return [f"the time stamps beside the key could not be stored (failed attempts: {failed}): {fix}"] if failed else []


class LineSink(Protocol):
    """Queue of lines of text for the user. Only the method `settle` waits."""

    def settle(self) -> int:
        """Wait a short time for the lines that are not written yet.

        Return the number of lost lines, including lines still unwritten.
        """
        ...

    def put(self, text: str) -> None:
        """Queue a line of text for the user."""
        ...


@contextlib.contextmanager
def write_lines(write: Callable[[str], object]) -> Iterator[LineSink]:
    """Write lines of text for the user in a thread within this context. At the end, wait at most one second for the
    remaining lines."""
    writer = LineWriter(write)
    try:
        yield writer
    finally:
        writer.close()


class OpenLink(Protocol):
    """Function that opens a link, see `transports.open_link.open_link`."""

    def __call__(self, uri: str, *, listen: bool = False) -> Link:
        """Open the link with the given address."""
        ...


class Machine(NamedTuple):
    """Functions of a computer that a live program uses. The defaults are those of the computer that runs Python."""

    clock: Clock = SYSTEM_CLOCK
    disk: Disk = SYSTEM_DISK
    open_link: OpenLink = open_link
    start_outputs: StartOutputs = start_outputs_process
    """Function that starts the process of a vehicle's outputs."""
    real_time: Callable[[bool], AbstractContextManager[RealTimeGrant]] = real_time
    """Function that returns a context in which the program has real-time scheduling and locked memory, if the system
    allows it."""
    catch_interrupts: Callable[[], AbstractContextManager[Callable[[], bool]]] = catch_interrupts
    """Function that returns a context in which a signal to end the program only sets a flag."""
    store_stamps_ahead: Callable[[Endpoint], AbstractContextManager[None]] = store_stamps_ahead
    """Function that returns a context in which the time stamps of an endpoint are stored. At its end the endpoint is
    closed."""
    write_lines: Callable[[Callable[[str], object]], AbstractContextManager[LineSink]] = write_lines
    """Function that returns a context in which a thread writes lines of text for the user, so that the program never
    waits for the terminal."""
    typed_words: Callable[[], Sequence[str]] = lambda: sys.argv[1:]
    """Function that returns the arguments of the command line, without the program's name."""
    draw_session: Callable[[], int] = draw_session
    """Function that returns a random session number."""


SYSTEM_MACHINE = Machine()
