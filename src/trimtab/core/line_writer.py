"""Lines for the user, written by a thread. Code that reports a line never waits for a terminal, a pipe or a disk.

A paused terminal, a full pipe or a stalled disk can block a write for any time. A flight must not wait for them. Lines
that the thread cannot write, or that do not fit into the queue, are counted.
"""

import os
import threading
from collections.abc import Callable
from contextlib import suppress
from queue import SimpleQueue

ROOM = 1000
"""Maximum number of lines that wait in the queue."""
CLOSE_S = 1.0
"""Maximum time (s) for which closing waits until the remaining lines are written."""


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
        """Number of lines lost so far: they will not be written."""
        return self._overflowed + self._failed

    def put(self, text: str) -> None:
        """Put a line into the queue. Never waits. If the queue is full, the line is lost."""
        if self._lines.qsize() >= ROOM:
            self._overflowed += 1
        else:
            self._lines.put(text)

    def settle(self, patience: float = CLOSE_S) -> int:
        """Wait until the waiting lines are written, for at most `patience` seconds. Return the number of lost lines.

        Lines that are not written by then count as lost. More lines may be put into the queue later.
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
