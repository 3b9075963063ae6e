"""Lines of text for the user, written by a thread, so that a flight never waits for a terminal, a pipe or a disk.

A paused terminal, a full pipe or a stalled disk can block a write for an unlimited time. Lines that the thread cannot
write, or that do not fit into the queue, are counted.
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
        """Start the thread. write: function that writes a line; it may block, and may raise OSError or ValueError."""
        self._write = write
        self._lines = SimpleQueue[str | threading.Event | None]()
        self._overflowed = self._failed = 0
        self._thread = threading.Thread(target=self._run, name="lines", daemon=True)
        self._thread.start()

    @property
    def lost_count(self) -> int:
        """Return the number of lines lost so far, which will not be written."""
        return self._overflowed + self._failed

    def put(self, text: str) -> None:
        """Put a line into the queue without waiting. If the queue is full, the line is lost."""
        if self._lines.qsize() >= ROOM:
            self._overflowed += 1
        else:
            self._lines.put(text)

    def settle(self, patience: float = CLOSE_S) -> int:
        """Wait until the queued lines are written, for at most `patience` seconds. Return the number of lost lines.

        Lines that are not written within this time count as lost. More lines may be put into the queue later.
        """
        written = threading.Event()
        self._lines.put(written)
        if written.wait(patience):
            return self.lost_count
        return self.lost_count + self._lines.qsize()  # the queued event counts for the line being written

    def close(self, patience: float = CLOSE_S) -> int:
        """Write the queued lines, for at most `patience` seconds. Return the number of lost lines."""
        self._lines.put(None)
        self._thread.join(patience)
        return self.lost_count + max(self._lines.qsize() - 1, 0)

    def _run(self) -> None:
        if hasattr(os, "sched_setscheduler"):
            with suppress(OSError):  # this thread must not inherit real-time scheduling
                os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        while (text := self._lines.get()) is not None:
            if isinstance(text, threading.Event):
                text.set()
                continue
            try:
                self._write(text)
            except (OSError, ValueError):
                self._failed += 1
