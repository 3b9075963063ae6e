"""The terminal of a computer in virtual time. It can hang, as after Ctrl-S or behind a full pipe.

A program that writes to a terminal that hangs stands still. Lines that are handed to a queue wait there, as in
`line_writer.LineWriter`.
Source: docs page, Testing.
"""

from collections import deque
from collections.abc import Callable

from trimtab.core.clock import NS_PER_SECOND
from trimtab.core.line_writer import CLOSE_S, ROOM
from trimtab.flight.virtual_time import VirtualTime

LOOK_S = 0.001
"""Time between two checks whether the terminal takes lines again (s)."""


class VirtualTerminal:
    """Terminal of one computer. `hangs` may be changed while programs run."""

    def __init__(self, time: VirtualTime) -> None:
        self._time = time
        self.hangs = False
        """True while the terminal takes no lines."""

    def wait_for_room(self) -> None:
        """Hold up the running program while the terminal hangs."""
        clock = self._time.running.clock
        while self.hangs:
            clock.wait(None, LOOK_S)

    def open_queue(self, write: Callable[[str], object]) -> "VirtualLines":
        """Return a queue of lines, as `machine.write_lines` does. write: writes a line."""
        return VirtualLines(self, self._time, write)


class VirtualLines:
    """Lines for the user of one program. It is a `machine.LineSink`.

    The program writes the lines that wait with its next line, or when it settles.
    """

    def __init__(self, terminal: VirtualTerminal, time: VirtualTime, write: Callable[[str], object]) -> None:
        self._terminal, self._time, self._write = terminal, time, write
        self._waiting = deque[str]()
        self.lost_count = 0

    def put(self, text: str) -> None:
        """Take a line. Never waits. A line that does not fit is lost."""
        if not self._terminal.hangs:
            self._write_waiting()
            self._write(text)
        elif len(self._waiting) < ROOM:
            self._waiting.append(text)
        else:
            self.lost_count += 1

    def _write_waiting(self) -> None:
        while self._waiting:
            self._write(self._waiting.popleft())

    def settle(self) -> int:
        """Wait for the waiting lines, for at most `CLOSE_S`. Return the number of lost lines, those included."""
        clock = self._time.running.clock
        given_up = clock.monotonic_ns() + CLOSE_S * NS_PER_SECOND
        while self._waiting and self._terminal.hangs and clock.monotonic_ns() < given_up:
            clock.wait(None, LOOK_S)
        if not self._terminal.hangs:
            self._write_waiting()
        return self.lost_count + len(self._waiting)
