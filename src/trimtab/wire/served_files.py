"""What a vehicle lets others read: documents that it holds in memory, and the logs of one folder. Nothing is written.

    /NAME         a document
    /logs/NAME    a log: a plain file of the log folder itself, with one of LOG_ENDINGS

A path is taken apart before anything is opened: no other folder, no hidden file and no link can be named.
"""

import contextlib
import os
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from trimtab.core.time import UNITS_PER_SECOND

LOGS = "logs"
LOG_ENDINGS = (".mcap", ".txt")
LARGEST_NAME = 200


class FileEntry(NamedTuple):
    """One file. size: bytes.  time: when it was last written (s, since 1970); 0 where that is not known."""

    name: str
    size: int
    time: int = 0


class OpenFile:
    """A file that is being read."""

    def __init__(self, data: bytes | int, size: int) -> None:
        """data: all of it, or a descriptor, which is this object's from now on."""
        self._data, self.size = data, size

    @property
    def is_log(self) -> bool:
        """Whether reading it may wait for a disk."""
        return isinstance(self._data, int)

    def read(self, offset: int, size: int) -> bytes:
        """Bytes of it; fewer at the end, none beyond, or where the disk fails."""
        size = max(min(size, self.size - offset), 0)
        if isinstance(self._data, bytes):
            return self._data[offset : offset + size]
        try:
            return os.pread(self._data, size, offset) if size else b""
        except OSError:
            return b""

    def close(self) -> None:
        """Give the descriptor back."""
        if isinstance(self._data, int):
            with contextlib.suppress(OSError):
                os.close(self._data)
            self._data, self.size = b"", 0


class ServedFiles:
    """The files of one vehicle."""

    def __init__(self, documents: Mapping[str, bytes] | None = None, folder: Path | None = None) -> None:
        """Nothing is opened yet.

        Args:
            documents: name -> content.
            folder: of the logs; None: there are none.
        """
        self.documents, self.folder = dict(documents or {}), folder

    def list_logs(self) -> list[FileEntry]:
        """The logs by name."""
        entries = list[FileEntry]()
        with contextlib.suppress(OSError):
            for entry in os.scandir(self.folder) if self.folder is not None else ():
                if _is_log_name(entry.name) and entry.is_file(follow_symlinks=False):
                    about = entry.stat(follow_symlinks=False)
                    entries.append(FileEntry(entry.name, about.st_size, int(about.st_mtime)))
        return sorted(entries)

    def list_folder(self, path: str) -> tuple[list[str], list[FileEntry]] | None:
        """Folders and files at a path; None where there is no such folder."""
        parts = _split_path(path)
        if parts == []:
            return [LOGS], [FileEntry(name, len(data)) for name, data in sorted(self.documents.items())]
        return ([], self.list_logs()) if parts == [LOGS] else None

    def open(self, path: str) -> OpenFile | None:
        """The file at a path; None where there is none that may be read."""
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
    """When the next packet of a transfer may leave, so that it is no faster than a rate."""

    def __init__(self, rate: float) -> None:
        """rate: bytes a second."""
        self._rate, self._next = rate, 0

    def is_due(self, now: int) -> bool:
        """Whether one may leave; times in 100 ns."""
        return now >= self._next

    def count(self, size: int, now: int, share: float = 1.0) -> None:
        """A packet of so many bytes leaves now; share: of the rate that there is."""
        self._next = now + int(size / (self._rate * share) * UNITS_PER_SECOND)


def _split_path(path: str) -> list[str] | None:
    """The names in a path; None for one that leads up, or that is none."""
    if "\0" in path or len(path) > LARGEST_NAME:
        return None
    parts = [part for part in path.split("/") if part not in ("", ".")]
    return None if ".." in parts else parts


def _is_log_name(name: str) -> bool:
    return name.endswith(LOG_ENDINGS) and not name.startswith(".") and "/" not in name and len(name) <= LARGEST_NAME
