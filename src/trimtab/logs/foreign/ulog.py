"""Reader of PX4's ULog files. Topics are uORB messages. ``sensor_accel[1]`` is the second instance of ``sensor_accel``.

Source: PX4 user guide, ULog file format. The files are read with the package pyulog.
"""

import contextlib
import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.logs.foreign.tables import (
    Table,
    TopicSummary,
    import_package,
    name_file,
    refuse_damage,
    refuse_topic,
    summarise_rows,
)

TIME, TIME_UNIT = "timestamp", "us"


def list_ulog(path: Path) -> list[TopicSummary]:
    """List every topic of a ULog file. The elements of an array are named ``q[0]`` etc."""
    found = []
    for data in _load(path, None).data_list:
        count = len(next(iter(data.data.values()), ()))
        seconds = data.data[TIME].astype(np.float64) * 1e-6 if TIME in data.data else np.zeros(count)
        found.append(summarise_rows(_topic_name(data), list(data.data), seconds))
    return found


def read_ulog(path: Path, topics: Iterable[str]) -> dict[str, Table]:
    """Read the tables of the named topics from a ULog file.

    Raises:
        InputError: a topic is unknown, or the file is damaged.
    """
    wanted = set(topics)
    log = _load(path, sorted({name.partition("[")[0] for name in wanted}))
    tables = {}
    for data in log.data_list:
        time = (TIME, TIME_UNIT) if TIME in data.data else ("", "")
        tables[_topic_name(data)] = Table(data.data, {}, *time)
    tables |= {f"{name}[0]": table for name, table in tables.items() if "[" not in name}
    for name in wanted:
        if name not in tables:
            refuse_topic(name_file(path), name, [summary.name for summary in list_ulog(path)])
    return {name: tables[name] for name in wanted}


def _topic_name(data: Any) -> str:
    return data.name if data.multi_id == 0 else f"{data.name}[{data.multi_id}]"


def _load(path: Path, names: list[str] | None) -> Any:
    where = name_file(path)
    package = import_package(where, "pyulog")
    try:
        with open(path, "rb") as stream, contextlib.redirect_stdout(io.StringIO()):  # the reader prints warnings
            return package.ULog(stream, names)
    except Exception as error:  # damaged bytes may raise any error; the error must name the file
        refuse_damage(where, "ULog", error)
