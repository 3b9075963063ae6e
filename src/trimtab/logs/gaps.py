"""Assembly of log rows from messages with equal times, and descriptions of missing rows."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from trimtab.logs.contents import Damage
from trimtab.logs.messages import NS_PER_TICK

SECONDS_PER_NS = 1e-9


class JoinedRows(NamedTuple):
    """Rows of a log.

    times: times of the rows (n,), in ns.  places: topic -> index of the message that belongs to each row (n,).
    missing: times (ns), before the last row, at which the message of at least one topic is missing.
    """

    times: Any
    places: Mapping[str, Any]
    missing: Any


def join_by_time(times: Mapping[str, Sequence[int]]) -> JoinedRows:
    """Return the rows of a log. A row consists of the messages of all topics at one time.

    A time at which the message of a topic is missing has no row.

    times: topic -> time (ns) of each message.
    """
    columns = {topic: np.array(column, np.int64) for topic, column in times.items()}
    first = next(iter(columns.values()))
    if all(np.array_equal(column, first) for column in columns.values()):
        everywhere = np.arange(len(first))
        return JoinedRows(first, dict.fromkeys(columns, everywhere), np.zeros(0, np.int64))
    common, known = first, first
    for column in columns.values():
        common, known = np.intersect1d(common, column), np.union1d(known, column)
    places = {}
    for topic, column in columns.items():
        order = np.argsort(column, kind="stable")
        places[topic] = order[np.searchsorted(column[order], common)]
    missing = np.setdiff1d(known, common)
    return JoinedRows(common, places, missing[missing < common[-1]] if len(common) else missing)


def describe_gaps(damages: Sequence[Damage], joined: JoinedRows, epoch: int) -> list[dict[str, Any]]:
    """Return a description of each gap in a log, as a dictionary with the keys "after_s" and "text".

    A damaged section of the file is a gap. All times with missing messages together are one gap. "after_s" is the time
    (s) of the last row before the gap, or None. "text" is a message for the user.

    Args:
        damages: damaged sections of the file.
        joined: rows of the log.
        epoch: time of day at time zero of the log (ns).
    """

    def seconds(time: int) -> float:
        return (time - epoch) // NS_PER_TICK * NS_PER_TICK * SECONDS_PER_NS

    gaps, times, missing = [], joined.times, joined.missing
    for damage in damages:
        k = 0 if damage.after is None else int(np.searchsorted(times, damage.after, "right"))
        after = seconds(int(times[k - 1])) if k else None
        begin = "from the start" if after is None else f"after {after:g} s"
        end = f"before {seconds(int(times[k])):g} s" if k < len(times) else "to the end"
        gaps.append({"after_s": after, "text": f"instants {begin} {end} are missing: {damage.why}"})
        first, last = times[k - 1] if k else -np.inf, times[k] if k < len(times) else np.inf
        missing = missing[(missing <= first) | (missing >= last)]
    if len(missing):
        earlier = times[times < missing[0]]
        where = f"{seconds(int(missing[0])):g} s"
        where += f" to {seconds(int(missing[-1])):g} s" if len(missing) > 1 else ""
        text = f"{len(missing)} instants, {where}, are left out: the message of at least one topic is missing"
        gaps.append({"after_s": seconds(int(earlier[-1])) if len(earlier) else None, "text": text})
    return gaps
