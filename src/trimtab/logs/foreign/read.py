"""Detection of the format of a foreign log, and conversion of the log with a mapping.

CSV files need no additional package. They contain a line of names, optionally with units, and then one line of numbers
for each instant.
"""

import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from trimtab.core.errors import InputError
from trimtab.core.time import to_seconds
from trimtab.core.units import find_size
from trimtab.core.user_file import open_user_file
from trimtab.logs.contents import MAGIC, OWN_START, parse_contents
from trimtab.logs.csv_table import read_table, time_unit
from trimtab.logs.foreign.ardupilot import list_bin, read_bin
from trimtab.logs.foreign.convert import convert_table
from trimtab.logs.foreign.mapping import LogMapping, TopicMap, read_mapping
from trimtab.logs.foreign.ros import list_bag, list_mcap, read_bag, read_mcap_topics
from trimtab.logs.foreign.tables import Table, TopicSummary, name_file, summarise_rows
from trimtab.logs.foreign.ulog import list_ulog, read_ulog
from trimtab.logs.log import Log
from trimtab.logs.messages import LAYOUT, RUN
from trimtab.logs.samples import PERIOD_MAX, TRUTH, SampleSeries, log_samples, usual_period


def list_csv(path: Path) -> list[TopicSummary]:
    """Return the summary of a CSV file as that of a single topic, which has the name of the file."""
    table = _read_table(path)
    scale = find_size(table.time_unit, "s") or 1.0
    seconds = table.columns[table.time] * scale if table.time and table.time not in table.problems else []
    count = len(next(iter(table.columns.values())))
    return [summarise_rows(path.name, list(table.columns), seconds)._replace(rows=count)]


def read_csv_topics(path: Path, topics: Iterable[str]) -> dict[str, Table]:
    """Read the tables of topics from CSV files.

    A topic name that ends in .csv is a file in the folder of `path`. Any other topic name stands for `path` itself.
    """
    files = {topic: path.with_name(topic) if topic.lower().endswith(".csv") else path for topic in topics}
    tables = {file: _read_table(file) for file in set(files.values())}
    return {topic: tables[file] for topic, file in files.items()}


def _read_table(path: Path) -> Table:
    table = read_table(path, gaps=True)
    columns = {column.name: column.values for column in table.columns}
    said = {c.name: unit for c in table.columns if (unit := c.unit or time_unit(c.name))}
    time = next((name for name in columns if time_unit(name) is not None), "")
    problems = {column.name: column.problem for column in table.columns if column.problem}
    seconds = time and time not in problems and not usual_period(columns[time]) > PERIOD_MAX
    return Table(columns, said, time, said.get(time, "s" if seconds else ""), problems, table.lines)


class LogFormat(NamedTuple):
    """Format of foreign logs.

    magic: first bytes of each file, or empty if these are not fixed.  suffixes: endings of file names.  list_topics:
    function that lists the topics of a file.  read_topics: function that reads topics of a file.
    """

    name: str
    magic: bytes
    suffixes: tuple[str, ...]
    list_topics: Callable[[Path], list[TopicSummary]]
    read_topics: Callable[[Path, Iterable[str]], Mapping[str, Table]]


ULOG = LogFormat("ULog", b"ULog\x01\x12\x35", (".ulg",), list_ulog, read_ulog)
BIN = LogFormat("ArduPilot BIN", b"\xa3\x95\x80", (".bin",), list_bin, read_bin)
MCAP = LogFormat("MCAP", MAGIC, (".mcap",), list_mcap, read_mcap_topics)
ROSBAG2 = LogFormat("rosbag2", b"", (), list_bag, read_bag)
ROSBAG = LogFormat("ROS bag", b"#ROSBAG V2.0", (".bag",), list_bag, read_bag)
CSV = LogFormat("CSV", b"", (".csv", ".txt"), list_csv, read_csv_topics)
FORMATS = (ULOG, BIN, MCAP, ROSBAG2, ROSBAG, CSV)
HEAD_BYTES = 1 << 20
"""Number of bytes, from the start of a file, that are searched for the metadata of a trimtab log."""


def detect_format(path: str | os.PathLike[str]) -> LogFormat:
    """Detect the format of a log file by its first bytes, or of a rosbag2 folder by its metadata.yaml.

    Raises:
        InputError: the file is missing or empty, or its format is unknown.
    """
    file, where = Path(path), name_file(Path(path))
    if file.is_dir():
        if (file / "metadata.yaml").is_file():
            return ROSBAG2
        fix = "give a log file in that folder, or the folder of a rosbag2, which contains metadata.yaml"
        raise InputError(where, "is a folder without metadata.yaml", fix=fix)
    try:
        with open_user_file(file) as stream:
            head = stream.read(16)
    except OSError as error:
        raise InputError(where, f"cannot be read: {error.strerror or error}", fix="check the path") from None
    if not head:
        raise InputError(where, "is empty", fix="copy the file again from the recorder")
    for one in FORMATS:
        if one.magic and head.startswith(one.magic):
            return one
    by_name = next((one for one in FORMATS if file.suffix.lower() in one.suffixes), None)
    if by_name is CSV:
        return CSV
    if file.suffix == ".db3":
        raise InputError(where, "is one part of a rosbag2", fix=f"give the folder of the rosbag2: {file.parent}")
    problem = f"is not a {by_name.name} file, although its name has that ending" if by_name else "has an unknown format"
    fix = "a table of text must be named .csv; convert a log of another format to one of the choices"
    raise InputError(where, f"{problem}: the file begins with {head[:8]!r}", choices=[f.name for f in FORMATS], fix=fix)


def is_own_log(path: str | os.PathLike[str]) -> bool:
    """Return True for a log of trimtab, even if it is cut before its description, and also for a file of unknown
    format, so that `read_mcap` reports a problem."""
    try:
        kind = detect_format(path)
        if kind is not MCAP:
            return False
        with open_user_file(path) as stream:
            head = stream.read(HEAD_BYTES)
        if head.startswith(OWN_START) or OWN_START.startswith(head):
            return True
        return bool(parse_contents(path, head).metadata.keys() & {LAYOUT, RUN})
    except InputError:
        return True


def list_topics(path: str | os.PathLike[str]) -> list[TopicSummary]:
    """List the topics of a foreign log, with fields, number of rows and rate of each topic.

    Raises:
        InputError: the file can't be read.
    """
    return detect_format(path).list_topics(Path(path))


def read_foreign(path: str | os.PathLike[str], mapping: str | os.PathLike[str] | LogMapping) -> Log:
    """Read a foreign log and convert it with a mapping, for a replay of an estimator. See `logs.samples.log_samples`.

    The metadata of the result contain the format, the mapping, and the time of the first row on the clock of the
    foreign log (``start_s``). The entry ``converted`` contains, for each sensor, the number of rows, and the numbers of
    rows that are out of order, duplicate or not finite. The entry ``left_out`` describes, for each sensor, the rows
    that are left out.

    Args:
        path: path of a ULog, BIN, MCAP, bag or CSV file, or of the folder of a rosbag2.
        mapping: path of a mapping file, or the result of `read_mapping`.

    Raises:
        InputError: the file or the mapping is invalid. The message names topic and column, and says what to write.
    """
    file, kind = Path(path), detect_format(path)
    chosen = mapping if isinstance(mapping, LogMapping) else read_mapping(mapping)
    every: dict[str, TopicMap] = dict(chosen.sensors)
    if chosen.truth is not None:
        every[f"[{TRUTH}]"] = chosen.truth
    for one in every.values():
        if not one.topic and kind is not CSV:
            names = [summary.name for summary in kind.list_topics(file)]
            raise InputError(one.where, "has no topic", choices=names, fix='topic = "…"')
    tables = kind.read_topics(file, {one.topic for one in every.values()})
    series: dict[str, SampleSeries] = {}
    counts: dict[str, Any] = {}
    left: dict[str, str] = {}
    for name, one in every.items():
        topic = f", topic {one.topic!r}" if one.topic else ""
        plain = name.strip("[]")
        series[name], counts[plain], text = convert_table(name_file(file) + topic, tables[one.topic], one)
        left |= {plain: text} if text else {}
    truth = series.pop(f"[{TRUTH}]", None)
    start = min(int(s.ticks[0]) for s in series.values())
    about = {"file": file.name, "format": kind.name, "start_s": float(to_seconds(start))}
    about |= {"left_out": left} if left else {}
    return log_samples(series, truth, about | {"converted": counts, "mapping": chosen.content})
