"""Ring buffer of fixed size in shared memory, which passes rows of numbers and short texts from one process to another.

The writing process never waits. If the ring buffer is full, a new row is dropped and counted. A gap in the sequence
numbers shows the reading process where rows are missing. If one of the processes ends, the rows in the ring buffer can
still be read.
"""

import math
import shutil
import struct
import sys
import time
from collections.abc import Callable
from multiprocessing import resource_tracker, shared_memory
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError

COLUMNS, ROWS, EVENTS, ROWS_WRITTEN, ROWS_READ, ROWS_DROPPED, TEXTS_WRITTEN, TEXTS_READ = range(8)
"""Indices of the values in the ring buffer's header: sizes, then counters of the writing and of the reading process."""
HEAD = 128
TEXT_HEAD = struct.Struct("<qqd")
"""Header of a text: sequence number of the next row, length of the text (bytes), first number of the previous row."""
TEXT_BYTES = 232
"""Maximum length of a text in the ring buffer (bytes)."""
TEXT = TEXT_HEAD.size + TEXT_BYTES
SETTLE = 1e-4
"""Time (s) after which a value that one processor core has written is visible to all cores, on any type of machine."""
SHARED = Path("/dev/shm")


class TextEvent(NamedTuple):
    """Text in the ring buffer. before: sequence number of the first row written after the text.

    newest: first number, e.g. the time, of the last row written before the text, or NaN if no row was written.
    """

    before: int
    newest: float
    text: str


class Ring:
    """Ring buffer in shared memory. One process calls `Ring.create`, the other process `Ring.attach`.

    Only one thread may write, and only one thread may read.
    """

    def __init__(self, memory: shared_memory.SharedMemory, sizes: tuple[int, int, int]) -> None:
        """Map the ring buffer onto shared memory. sizes: numbers of columns, rows and events."""
        columns, rows, events = sizes
        places = rows * (columns + 1)
        start = HEAD + 8 * places
        self.columns, self.rows, self.events = sizes
        self._memory, buffer = memory, _buffer(memory)
        self._head = buffer[:HEAD].cast("q")
        block = np.frombuffer(buffer, np.float64, places, HEAD).reshape(rows, columns + 1)
        self._sequences, self._numbers = block[:, 0].view(np.int64), block[:, 1:]
        self._marks = buffer[HEAD:start].cast("q")
        self._texts = buffer[start : start + TEXT * events]
        self._written = self._sequence = self._head[ROWS_WRITTEN]

    @classmethod
    def create(cls, name: str = "", *, columns: int, rows: int = 4096, events: int = 256) -> "Ring":
        """Create a ring buffer in shared memory, with all memory pages allocated.

        Args:
            name: name by which the other process opens the ring buffer. Empty: the name is chosen automatically.
            columns: count of numbers in a row.
            rows: maximum number of unread rows. Further rows are dropped.
            events: maximum number of unread texts.
        """
        if min(columns, rows, events) < 1:
            problem = f"must have at least 1 column, row and event, got {columns} columns, {rows} rows, {events} events"
            raise InputError("ring", problem, fix="use at least one of each")
        size = HEAD + 8 * rows * (columns + 1) + TEXT * events
        if SHARED.is_dir() and shutil.disk_usage(SHARED).free < size:
            problem = f"{size / 1e6:.1f} MB do not fit into {SHARED}"
            fix = "use fewer rows, or provide more shared memory, e.g. docker run --shm-size=1g"
            raise InputError("ring", problem, fix=fix)
        try:
            memory = shared_memory.SharedMemory(name or None, create=True, size=size)
        except FileExistsError:
            raise InputError(
                "ring", f"a ring named {name!r} already exists", fix="give another name, or none"
            ) from None
        with _buffer(memory)[:HEAD].cast("q") as head:
            head[COLUMNS], head[ROWS], head[EVENTS] = columns, rows, events
        ring = cls(memory, (columns, rows, events))
        ring._numbers[:] = 0.0
        return ring

    @classmethod
    def attach(cls, name: str) -> "Ring":
        """Open a ring buffer that another process has created. name: name of the ring buffer."""
        try:
            memory = _open_memory(name)
        except FileNotFoundError:
            raise InputError(
                "ring", f"no ring named {name!r} exists", fix="create the ring first: Ring.create"
            ) from None
        with _buffer(memory)[:HEAD].cast("q") as head:
            sizes = head[COLUMNS], head[ROWS], head[EVENTS]
        return cls(memory, sizes)

    @property
    def name(self) -> str:
        """Return the name by which another process opens the ring buffer."""
        return self._memory.name

    @property
    def dropped_rows(self) -> int:
        """Return the number of rows that were dropped because the ring buffer was full."""
        return self._head[ROWS_DROPPED]

    @property
    def waiting_rows(self) -> int:
        """Return the number of rows that have been written but not read."""
        return self._head[ROWS_WRITTEN] - self._head[ROWS_READ]

    def write_row(self, row: Any) -> bool:
        """Write a row, float64 (columns,), without waiting. Return False if the ring buffer is full."""
        head, n, sequence = self._head, self._written, self._sequence
        self._sequence = sequence + 1
        if n - head[ROWS_READ] >= self.rows:
            head[ROWS_DROPPED] += 1
            return False
        k = n % self.rows
        self._numbers[k] = row
        self._marks[k * (self.columns + 1)] = sequence
        self._written = head[ROWS_WRITTEN] = n + 1
        return True

    def write_text(self, text: str) -> bool:
        """Write a text, cut to TEXT_BYTES bytes, without waiting. Return False if the ring buffer is full."""
        head = self._head
        n = head[TEXTS_WRITTEN]
        if n - head[TEXTS_READ] >= self.events:
            return False
        data = text.encode("utf-8", "replace")[:TEXT_BYTES]
        at = n % self.events * TEXT
        newest = self._numbers[(self._written - 1) % self.rows, 0] if self._written else math.nan
        TEXT_HEAD.pack_into(self._texts, at, self._sequence, len(data), newest)
        self._texts[at + TEXT_HEAD.size : at + TEXT_HEAD.size + len(data)] = data
        head[TEXTS_WRITTEN] = n + 1
        return True

    def read_rows(self) -> tuple[Any, Any]:
        """Return the sequence numbers (n,) int64 of all unread rows, and copies of these rows (n, columns)."""
        first, last = self._head[ROWS_READ], self._head[ROWS_WRITTEN]
        time.sleep(SETTLE)
        places = np.arange(first, last) % self.rows
        taken = self._sequences[places], self._numbers[places]
        self._head[ROWS_READ] = last
        return taken

    def read_texts(self) -> list[TextEvent]:
        """Return all unread texts."""
        first, last = self._head[TEXTS_READ], self._head[TEXTS_WRITTEN]
        time.sleep(SETTLE)
        texts = []
        for n in range(first, last):
            at = n % self.events * TEXT
            before, size, newest = TEXT_HEAD.unpack_from(self._texts, at)
            data = bytes(self._texts[at + TEXT_HEAD.size : at + TEXT_HEAD.size + size])
            texts.append(TextEvent(before, newest, data.decode("utf-8", "ignore")))
        self._head[TEXTS_READ] = last
        return texts

    def close(self) -> None:
        """Detach from the ring buffer. The memory remains until `unlink`, or until the process that created it ends."""
        if self._memory.buf is None:
            return
        del self._sequences, self._numbers
        for view in (self._head, self._marks, self._texts):
            view.release()
        self._memory.close()

    def unlink(self) -> None:
        """Remove the name of the ring buffer. The memory is freed when no process uses it any more."""
        self._memory.unlink()

    def __enter__(self) -> "Ring":
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()


def _buffer(memory: shared_memory.SharedMemory) -> Any:
    return memory.buf


def _open_memory(name: str) -> shared_memory.SharedMemory:
    """Open shared memory that another process created. Only that process removes the memory."""
    if sys.version_info >= (3, 13):
        return shared_memory.SharedMemory(name, track=False)
    tracked: Callable[..., Any] = resource_tracker.register
    resource_tracker.register = lambda *_args: None
    try:
        return shared_memory.SharedMemory(name)
    finally:
        resource_tracker.register = tracked
