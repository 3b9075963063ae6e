"""Lines for the user, written by a thread. Code that reports a line never waits for a terminal, a pipe or a disk.

A paused terminal, a full pipe and a disk that hangs hold up a write for as long as they like. A flight must not wait
for them. Lines that the thread cannot write, or that do not fit into the queue, are counted.
"""

import os
import threading
from collections.abc import Callable
from contextlib import suppress
from queue import SimpleQueue

ROOM = 1000
"""Largest number of waiting lines."""
CLOSE_S = 1.0
"""Longest time (s) for which closing waits for lines that were not written yet."""


class LineWriter:
    """Queue of lines, and the thread that writes them."""

    def __init__(self, write: Callable[[str], object]) -> None:
        """write: writes a line; it may wait, and it may raise OSError or ValueError if it cannot write."""
        self._write = write
        self._lines = SimpleQueue[str | threading.Event | None]()
        self._overflowed = self._failed = 0
        self._thread = threading.Thread(target=self._run, name="lines", daemon=True)
        self._thread.start()

    @property
    def lost_count(self) -> int:
        """Number of lines that were not written so far, and will not be."""
        return self._overflowed + self._failed

    def put(self, text: str) -> None:
        """Hand a line over. Never waits. A line that does not fit is lost."""
        if self._lines.qsize() >= ROOM:
            self._overflowed += 1
        else:
            self._lines.put(text)

    def settle(self, patience: float = CLOSE_S) -> int:
        """Wait until the waiting lines are written, for at most `patience` seconds. Return the number of lost lines.

        Lines that still wait then count as lost. Further lines may follow.
        """
        written = threading.Event()
        self._lines.put(written)
        if written.wait(patience):
            return self.lost_count
        return self.lost_count + self._lines.qsize()  # the event waits, too; it stands for the line being written

    def close(self, patience: float = CLOSE_S) -> int:
        """Write the waiting lines, for at most `patience` seconds. Return the number of lost lines."""
        self._lines.put(None)
        self._thread.join(patience)
        return self.lost_count + max(self._lines.qsize() - 1, 0)

    def _run(self) -> None:
        if hasattr(os, "sched_setscheduler"):
            with suppress(OSError):  # a thread inherits real-time scheduling, which writing must not have
                os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        while (text := self._lines.get()) is not None:
            if isinstance(text, threading.Event):
                text.set()
                continue
            try:
                self._write(text)
            except (OSError, ValueError):
                self._failed += 1
