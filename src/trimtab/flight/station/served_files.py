"""Files that a vehicle serves to ground stations: documents in memory, and the logs of one folder. Files are never
written.

    /NAME         a document in memory
    /logs/NAME    a log: a regular file directly in the log folder, with one of LOG_ENDINGS

A path is checked before a file is opened, so that no other folder, hidden file or symbolic link can be read.
"""

import contextlib
import itertools
import os
import stat
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from trimtab.core.clock import SYSTEM_CLOCK
from trimtab.core.time import UNITS_PER_SECOND

LOGS = "logs"
LOG_ENDINGS = (".mcap", ".txt")
LARGEST_NAME = 200
MOST_ENTRIES = 2000
"""Maximum number of directory entries of the log folder that are read for a list."""
PATIENCE_S = 0.005
"""Longest time (s) that the vehicle's loop waits for a new list of the logs. If reading the folder takes longer, the
previous list is sent."""
FLYING_SHARE = 0.05
"""Fraction of the maximum rate that a transfer may use while the vehicle is armed."""
LISTING_PERIOD_S = 0.5
"""Shortest time (s) between two readings of the log folder. Requests in between, e.g. for the next part of a long list,
are answered from the last list."""


class FileEntry(NamedTuple):
    """Served file. size: number of bytes.  time: time of the last modification (s since 1970), or 0 if it is
    unknown."""

    name: str
    size: int
    time: int = 0


class OpenFile:
    """File that a ground station is reading."""

    def __init__(self, data: bytes | int, size: int) -> None:
        """data: content of the file, or an open file descriptor, which this object closes."""
        self._data, self.size = data, size

    @property
    def is_log(self) -> bool:
        """Return True if the file is a log. Reading a log may wait for a disk."""
        return isinstance(self._data, int)

    def read(self, offset: int, size: int) -> bytes:
        """Return `size` bytes of the file from `offset` on. The result is shorter at the end of the file, and empty if
        the disk fails."""
        size = max(min(size, self.size - offset), 0)
        if isinstance(self._data, bytes):
            return self._data[offset : offset + size]
        try:
            return os.pread(self._data, size, offset) if size else b""
        except OSError:
            return b""

    def close(self) -> None:
        """Close the descriptor of the file."""
        if isinstance(self._data, int):
            with contextlib.suppress(OSError):
                os.close(self._data)
            self._data, self.size = b"", 0


class ServedFiles:
    """Documents and logs that one vehicle serves to ground stations."""

    def __init__(
        self,
        documents: Mapping[str, bytes] | None = None,
        folder: Path | None = None,
        patience: float = PATIENCE_S,
    ) -> None:
        """Prepare to serve documents and logs.

        Args:
            documents: content of each document, by name.
            folder: folder of the logs, or None to serve no logs.
            patience: longest time to wait for a new list of the logs (s).
        """
        self.documents, self.folder = dict(documents or {}), folder
        self._patience, self._listed = patience, list[FileEntry]()
        self._lister: threading.Thread | None = None

    def list_logs(self, *, is_armed: bool) -> list[FileEntry]:
        """Return the list of the logs, sorted by name. A thread reads the folder, because a disk may hang. While the
        vehicle is armed, return the last list."""
        if is_armed:
            return self._listed
        if self.folder is not None and (self._lister is None or not self._lister.is_alive()):
            ready = threading.Event()
            self._lister = threading.Thread(target=self._list, args=(self.folder, ready), name="logs", daemon=True)
            self._lister.start()
            ready.wait(self._patience)
        return self._listed

    def _list(self, folder: Path, ready: threading.Event) -> None:
        if hasattr(os, "sched_setscheduler"):
            with contextlib.suppress(OSError):  # the thread inherits real-time scheduling; reset it
                os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        entries = list[FileEntry]()
        with contextlib.suppress(OSError), os.scandir(folder) as found:
            for entry in itertools.islice(found, MOST_ENTRIES):
                if _is_log_name(entry.name) and entry.is_file(follow_symlinks=False):
                    about = entry.stat(follow_symlinks=False)
                    entries.append(FileEntry(entry.name, about.st_size, int(about.st_mtime)))
        self._listed = sorted(entries)
        ready.set()
        SYSTEM_CLOCK.wait(None, LISTING_PERIOD_S)

    def has_document(self, path: str) -> bool:
        """Return True if a document with this path exists. Reading a document needs no disk."""
        parts = _split_path(path)
        return parts is not None and len(parts) == 1 and parts[0] in self.documents

    def list_folder(self, path: str, *, is_armed: bool) -> tuple[list[str], list[FileEntry]] | None:
        """Return the folders and the files in the folder at a path, or None if the folder does not exist."""
        parts = _split_path(path)
        if parts == []:
            return [LOGS], [FileEntry(name, len(data)) for name, data in sorted(self.documents.items())]
        return ([], self.list_logs(is_armed=is_armed)) if parts == [LOGS] else None

    def open(self, path: str) -> OpenFile | None:
        """Open the file at a path. Return None if the file does not exist or may not be read."""
        parts = _split_path(path)
        if parts is not None and len(parts) == 1 and parts[0] in self.documents:
            return OpenFile(self.documents[parts[0]], len(self.documents[parts[0]]))
        if parts is None or len(parts) != 2 or parts[0] != LOGS or self.folder is None or not _is_log_name(parts[1]):
            return None
        try:
            file = os.open(self.folder / parts[1], os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError:
            return None
        about = os.fstat(file)
        if not stat.S_ISREG(about.st_mode):
            os.close(file)
            return None
        return OpenFile(file, about.st_size)


class Pace:
    """Pacer of packets, which keeps a transfer below a maximum rate."""

    def __init__(self, rate: float) -> None:
        """rate: maximum rate (byte/s)."""
        self._rate, self._next = rate, 0

    def is_due(self, now: int) -> bool:
        """Return True if a packet may be sent at time `now` (100 ns)."""
        return now >= self._next

    def count(self, size: int, now: int, *, is_armed: bool) -> None:
        """Count a packet of `size` bytes that is sent now. While the vehicle is armed, the maximum rate is lower."""
        share = FLYING_SHARE if is_armed else 1.0
        self._next = now + int(size / (self._rate * share) * UNITS_PER_SECOND)


def _split_path(path: str) -> list[str] | None:
    """Return the names in a path, or None if the path contains ".." or is not valid."""
    if "\0" in path or len(path) > LARGEST_NAME:
        return None
    parts = [part for part in path.split("/") if part not in ("", ".")]
    return None if ".." in parts else parts


def _is_log_name(name: str) -> bool:
    return name.endswith(LOG_ENDINGS) and not name.startswith(".") and "/" not in name and len(name) <= LARGEST_NAME
