"""Limit of a log's size on the disk, and behaviour of the log at this limit.

A rolling log consists of numbered files, vehicle.mcap, vehicle-2.mcap, …, each of which is a complete log. The oldest
files are deleted when all files together exceed the limit, so the log of the end of the flight is kept. A log that does
not roll stops at the limit, and the flight continues. Later rows are only counted, as unwritten. The log of the start
of the flight is kept, so the flight can be replayed from its start. Source: docs page, Stream.
"""

import re
from pathlib import Path
from typing import NamedTuple

from trimtab.core.errors import InputError, argument, argument_name

UNITS = {"kB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
SMALLEST = 10**6
FILES = 8
"""Number of files into which a rolling log is divided."""
DEFAULT_LIMIT = 2 * UNITS["GB"]


class LogLimit(NamedTuple):
    """Limit of a log's size. size: maximum total size of the log's files (bytes).

    rolls: True to delete the oldest files at the limit, False to stop the log.
    """

    size: int
    rolls: bool

    @property
    def file_size(self) -> int:
        """Return the size (bytes) at which a file of the log is full."""
        return self.size // FILES if self.rolls else self.size


def parse_size(text: str) -> int:
    """Return the number of bytes for a text such as "500 MB". Raise InputError if it is invalid or below 1 MB."""
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kMGT]B)\s*", text)
    size = round(float(found[1]) * UNITS[found[2]]) if found else 0
    if size < SMALLEST:
        problem = f"{text!r} is not a size of at least one megabyte"
        raise InputError(argument_name("log_limit"), problem, choices=tuple(UNITS), fix=argument("log_limit", "2 GB"))
    return size


def format_size(size: int) -> str:
    """Return the text of a size in bytes, with a suitable unit."""
    unit = max((u for u, n in UNITS.items() if size >= n), key=UNITS.__getitem__, default="kB")
    return f"{size / UNITS[unit]:g} {unit}"


def round_size(size: float) -> str:
    """Return the text of an estimated size in bytes, with two significant digits."""
    return format_size(int(float(f"{size:.2g}")))


def numbered_file(first: Path, number: int) -> Path:
    """Return the path of file number `number` of a log. Numbers start at 1."""
    return first if number == 1 else first.with_name(f"{first.stem}-{number}{first.suffix}")


def list_files(first: Path) -> list[Path]:
    """Return the existing files of a log, in order."""
    pattern = re.compile(rf"{re.escape(first.stem)}-(\d+){re.escape(first.suffix)}")
    numbered = sorted((int(m[1]), p) for p in first.parent.glob("*") if (m := pattern.fullmatch(p.name)))
    return [*([first] if first.exists() else []), *(p for _, p in numbered)]
