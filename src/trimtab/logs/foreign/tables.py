"""Common representation of foreign logs: for each topic, a table of columns and a summary."""

import importlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np

from trimtab.core.errors import InputError, install_command
from trimtab.core.suggestions import closest
from trimtab.core.time import FOREVER
from trimtab.logs.measurements import name_lines

LOG_TIME = "log_time"
"""Name of the column with the time (ns) at which a message was recorded, if the format has such a time."""
LONGEST_ARRAY = 64
"""Maximum length of an array whose elements become columns. Longer arrays, e.g. images, are left out."""


class Table(NamedTuple):
    """Columns of one topic of a foreign log.

    columns: name -> values (n,), with the data type in the file.  units: name of a column -> unit, if the file states
    units.  time: name of the usual time column, or "".  time_unit: unit of this column.  problems: name of a column ->
    reason why the column has no numbers, with the line number in the file if known.  lines: line number in the file of
    each row, for a file of text.
    """

    columns: Mapping[str, Any]
    units: Mapping[str, str] = {}
    time: str = ""
    time_unit: str = ""
    problems: Mapping[str, str] = {}
    lines: Sequence[int] = ()

    def name_rows(self, rows: Iterable[int]) -> str:
        """Return the line numbers or row numbers of some of the rows as text, e.g. "lines 4, 7 and 12"."""
        if self.lines:
            return name_lines([self.lines[row] for row in rows])
        return name_lines([row + 1 for row in rows]).replace("line", "row")


class TopicSummary(NamedTuple):
    """Summary of one topic of a foreign log.

    name: name of the topic in a mapping.  fields: names of the columns that a mapping can use.  rows: number of rows.
    rate: mean rate of the rows (Hz), or 0 for fewer than two rows or rows without times.
    """

    name: str
    fields: tuple[str, ...]
    rows: int
    rate: float


def import_package(where: str, module: str) -> Any:
    """Return a module of a package that the optional dependencies ``trimtab[logs]`` install.

    Raises:
        InputError: the package is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = (error.name or module).partition(".")[0]
        fix = install_command("logs")
        raise InputError(
            where, f"reading this file needs the package {package!r}, which is not installed", fix=fix
        ) from None


def refuse_topic(where: str, topic: str, known: Iterable[str]) -> NoReturn:
    """Raise InputError because a file does not have a topic. The message lists the topics of the file."""
    names = sorted(known)
    near = closest(topic, names, 1)
    fix = f'topic = "{near[0]}"' if near else "set  topic = …  in the mapping to one of the choices"
    raise InputError(where, f"has no topic {topic!r}", choices=names, fix=fix)


def refuse_damage(where: str, kind: str, error: Exception) -> NoReturn:
    """Raise InputError because a file has the first bytes of a format, but can't be read. kind: name of the format."""
    said = str(error).partition("\n")[0][:200]
    problem = f"looks like {kind} by its first bytes, but can't be read: {type(error).__name__}: {said}"
    raise InputError(where, problem, fix="copy the file again from the recorder") from None


def summarise_rows(name: str, fields: Sequence[str], seconds: Any) -> TopicSummary:
    """Return the summary of a topic. seconds: times of the topic's rows (n,)."""
    times = np.asarray(seconds, np.float64)
    span = float(times.max() - times.min()) if len(times) > 1 else 0.0
    return TopicSummary(name, tuple(fields), len(times), (len(times) - 1) / span if span > 0 else 0.0)


def flatten_message(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield name and value of each number in a decoded message, e.g. ``linear.x`` and ``covariance[0]``.

    A time that consists of seconds and nanoseconds becomes one number in ns. Texts and long arrays are left out.
    """
    if isinstance(value, bool | int | float | np.number | np.bool_):
        yield name, value
    elif isinstance(value, Mapping):
        items = {str(k): v for k, v in value.items()}  # pyright: ignore[reportUnknownVariableType, reportUnknownMemberType]
        yield from _flatten_members(items, name)
    elif isinstance(value, list | tuple | np.ndarray):
        several: list[Any] = list(value) if len(value) <= LONGEST_ARRAY else []  # pyright: ignore[reportUnknownArgumentType]
        for i, one in enumerate(several):
            yield from flatten_message(one, f"{name}[{i}]")
    elif hasattr(value, "__dataclass_fields__"):
        yield from _flatten_members({n: getattr(value, n) for n in value.__dataclass_fields__}, name)


def _flatten_members(members: Mapping[str, Any], name: str) -> Iterator[tuple[str, Any]]:
    names = {n for n in members if not n.startswith("__")}
    for second, rest in (("sec", "nanosec"), ("sec", "nsec"), ("secs", "nsecs")):
        if names == {second, rest}:
            yield name, int(members[second]) * 1_000_000_000 + int(members[rest])
            return
    for member in members:
        if member in names:
            yield from flatten_message(members[member], f"{name}.{member}" if name else member)


def stack_messages(where: str, topic: str, messages: Sequence[Mapping[str, Any]], times: Sequence[int]) -> Table:
    """Return the table of a topic, made from the topic's messages. Missing values become NaN.

    Args:
        where: name of the file, for errors.
        topic: topic of the messages.
        messages: flat messages from `flatten_message`.
        times: times of recording (ns).
    """
    names = list(dict.fromkeys(name for message in messages for name in message))
    if LOG_TIME in names:
        raise InputError(f"{where}, topic {topic!r}", f"has a field {LOG_TIME!r} of its own", fix="rename the field")
    columns = {name: np.array([message.get(name, np.nan) for message in messages]) for name in names}
    held = [min(time, FOREVER) for time in times]  # later times occur only in damaged files
    return Table(columns | {LOG_TIME: np.array(held, np.int64)}, {}, LOG_TIME, "ns")


def name_file(path: str | Path) -> str:
    """Return the name of a log file for error messages."""
    return f"log file '{path}'"
