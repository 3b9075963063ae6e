"""Reader of ArduPilot's dataflash logs (.BIN). The topics of such a log are message types, e.g. IMU, ATT and GPS.

All sensors of one kind have the same message type. A field of the message, usually ``I``, is the number of the sensor.
A mapping selects a sensor by where = {I = 0}. Units are read from the file. Source: ArduPilot, Logger library. The
files are read with pymavlink's DFReader.
"""

import contextlib
import io
import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.core.errors import InputError
from trimtab.logs.foreign.tables import (
    Table,
    TopicSummary,
    import_package,
    name_file,
    refuse_damage,
    refuse_topic,
    summarise_rows,
)

TIMES = {"TimeUS": "us", "TimeMS": "ms"}
"""Name of the time column in ArduPilot's new and old log format -> time unit."""


def list_bin(path: Path) -> list[TopicSummary]:
    """List every message type of a .BIN file that has at least one message."""
    rows = _read_messages(path, None)
    found = []
    for name, (columns, values) in rows.items():
        time = next((n for n in TIMES if n in columns), None)
        scale = 1e-6 if time == "TimeUS" else 1e-3
        at = columns.index(time) if time else -1
        seconds = [row[at] * scale for row in values] if time else [0.0] * len(values)
        found.append(summarise_rows(name, columns, seconds))
    return sorted(found)


def read_bin(path: Path, topics: Iterable[str]) -> dict[str, Table]:
    """Read the tables of the named message types from a .BIN file.

    Raises:
        InputError: a message type is unknown, or the file has no valid message.
    """
    wanted = sorted(set(topics))
    with _open(path) as reader:
        known = [reader.id_to_name[i] for i, count in enumerate(reader.counts) if count and i in reader.id_to_name]
        formats = {name: reader.formats[i] for name, i in reader.name_to_id.items()}
    for name in wanted:
        if name not in known:
            refuse_topic(name_file(path), name, known)
    messages = _read_messages(path, wanted)
    tables = {}
    for name in wanted:
        if name not in messages:
            problem = f"the messages {name!r} can't be read"
            raise InputError(name_file(path), problem, choices=messages, fix="copy the file again from the card")
        columns, values = messages[name]
        units = getattr(formats[name], "units", None) or []
        said = {n: u.replace("µ", "u") for n, u in zip(columns, units, strict=False) if u}
        time = next((n for n in TIMES if n in columns), "")
        arrays = {n: np.array([row[i] for row in values]) for i, n in enumerate(columns)}
        tables[name] = Table(arrays, said, time, TIMES.get(time, ""))
    return tables


def _read_messages(path: Path, types: list[str] | None) -> dict[str, tuple[list[str], list[list[Any]]]]:
    """Return the message type -> names of the columns, and values of the messages."""
    rows: dict[str, tuple[list[str], list[list[Any]]]] = {}
    with _open(path) as reader:
        try:
            with _silence():
                while (message := reader.recv_match(type=types)) is not None:
                    columns, values = rows.setdefault(message.get_type(), (list(message.fmt.columns), []))
                    values.append([_plain(getattr(message, name)) for name in columns])
        except Exception as error:  # damaged bytes may raise any error, and the message must name the file
            refuse_damage(name_file(path), "a .BIN of ArduPilot", error)
    return rows


def _plain(value: Any) -> Any:
    return value if isinstance(value, int | float) else math.nan


@contextlib.contextmanager
def _open(path: Path) -> Iterator[Any]:
    """Open a .BIN file with pymavlink's reader, and close the file after use."""
    where = name_file(path)
    package = import_package(where, "pymavlink.DFReader")
    try:
        with _silence():
            reader = package.DFReader_binary(str(path))
    except Exception as error:  # damaged bytes may raise any error
        refuse_damage(where, "a .BIN of ArduPilot", error)
    try:
        if not getattr(reader, "name_to_id", None):
            raise InputError(where, "contains no message of ArduPilot", fix="copy the file again from the card")
        yield reader
    finally:
        reader.data_map.close()
        reader.filehandle.close()


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Suppress the warnings that pymavlink's reader prints."""
    with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
        yield
