"""How much of a disk a log may take, and what happens there.

A log that may "roll" goes on in numbered files, vehicle.mcap, vehicle-2.mcap, …, each a log of its own, and the oldest
go when all together are too large: what counts is how it ended. One that may not stops there: its rows are counted as
unwritten, and the flight goes on; what counts is that it can be replayed from its start.
Source: docs page, Stream.
"""

import re
from pathlib import Path
from typing import NamedTuple

from trimtab.core.errors import InputError, argument, argument_name

UNITS = {"kB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
SMALLEST = 10**6
FILES = 8
"""Into how many files a log that rolls is divided."""
DEFAULT_LIMIT = 2 * UNITS["GB"]


class LogLimit(NamedTuple):
    """size: bytes of all its files.  rolls: whether it goes on at the cost of the oldest."""

    size: int
    rolls: bool

    @property
    def file_size(self) -> int:
        """Bytes after which a file is full."""
        return self.size // FILES if self.rolls else self.size


def parse_size(text: str) -> int:
    """Bytes from e.g. "500 MB"; refused where it is none, or too small for a log."""
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kMGT]B)\s*", text)
    size = round(float(found[1]) * UNITS[found[2]]) if found else 0
    if size < SMALLEST:
        problem = f"{text!r} is no size of a megabyte or more"
        raise InputError(argument_name("log_limit"), problem, choices=tuple(UNITS), fix=argument("log_limit", "2 GB"))
    return size


def format_size(size: int) -> str:
    """Bytes as people read them."""
    unit = max((u for u, n in UNITS.items() if size >= n), key=UNITS.__getitem__, default="kB")
    return f"{size / UNITS[unit]:g} {unit}"


def round_size(size: float) -> str:
    """The same in two digits, for what is estimated or told in passing."""
    return format_size(int(float(f"{size:.2g}")))


def numbered_file(first: Path, number: int) -> Path:
    """The path of the n-th file of a log, from 1 on."""
    return first if number == 1 else first.with_name(f"{first.stem}-{number}{first.suffix}")


def list_files(first: Path) -> list[Path]:
    """The files of a log that are there, in order."""
    pattern = re.compile(rf"{re.escape(first.stem)}-(\d+){re.escape(first.suffix)}")
    numbered = sorted((int(m[1]), p) for p in first.parent.glob("*") if (m := pattern.fullmatch(p.name)))
    return [*([first] if first.exists() else []), *(p for _, p in numbered)]
