"""Terminal of a computer in virtual time. The terminal can hang, as after Ctrl-S or behind a full pipe.

A program that writes directly to a hanging terminal is blocked. A program that uses a queue is not blocked: the lines
wait in the queue, as in `line_writer.LineWriter`.
Source: docs page, Testing.
"""

from collections import deque
from collections.abc import Callable

from trimtab.core.clock import NS_PER_SECOND
from trimtab.core.line_writer import CLOSE_S, ROOM
from trimtab.flight.virtual_time import VirtualTime

LOOK_S = 0.001
"""Time (s) between two checks whether the terminal accepts lines again."""


class VirtualTerminal:
    """Terminal of one computer. `hangs` may be changed while programs run."""

    def __init__(self, time: VirtualTime) -> None:
        self._time = time
        self.hangs = False
        """True while the terminal accepts no lines."""

    def wait_for_room(self) -> None:
        """Block the running program while the terminal hangs."""
        clock = self._time.running.clock
        while self.hangs:
            clock.wait(None, LOOK_S)

    def open_queue(self, write: Callable[[str], object]) -> "VirtualLines":
        """Return a queue of lines within this context, as `machine.write_lines` does. write: function that writes a
        line to the terminal."""
        return VirtualLines(self, self._time, write)


class VirtualLines:
    """Queue of a program's lines for the user, with the interface `machine.LineSink`.

    The waiting lines are written at the next call of `put` or `settle`.
    """

    def __init__(self, terminal: VirtualTerminal, time: VirtualTime, write: Callable[[str], object]) -> None:
        self._terminal, self._time, self._write = terminal, time, write
        self._waiting = deque[str]()
        self.lost_count = 0

    def put(self, text: str) -> None:
        """Add a line to the queue, without waiting. The line is lost if the queue is full."""
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
        """Wait at most `CLOSE_S` seconds until all lines are written. Return the number of lost or unwritten lines."""
        clock = self._time.running.clock
        given_up = clock.monotonic_ns() + CLOSE_S * NS_PER_SECOND
        while self._waiting and self._terminal.hangs and clock.monotonic_ns() < given_up:
            clock.wait(None, LOOK_S)
        if not self._terminal.hangs:
            self._write_waiting()
        return self.lost_count + len(self._waiting)
