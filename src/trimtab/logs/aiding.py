"""What aided the navigation of a run: each sensor's updates once, and the states that no sensor corrected.

Source: docs page, Aiding in a log.
"""

from typing import Any, NamedTuple

import numpy as np

from trimtab.logs.log import Log

BY_POSITION = ("surge_velocity", "sway_velocity", "north", "east", "forward_bias", "starboard_bias")
"""What only positions, or ranges, correct."""
BY_HEADING = ("heading", "gyro_bias")
"""What headings correct, and positions through the motion."""


class Updates(NamedTuple):
    """Updates by one sensor: times (n,) s, NIS (n,), normalised innovations (n, dof).

    refused: how many the gate kept out.  unseen: those that came between two rows of the log with another after them.
    """

    t: Any
    nis: Any
    normalised: Any
    refused: int
    unseen: int


def where_state(log: Log) -> str | None:
    """Path of the state that knows its sigmas; None where there is none."""
    found = [p.rpartition(".")[0] for p in log.paths if p.startswith("estimate.") and p.endswith(".sigma_heading")]
    return found[0] if found else None


def fixes(log: Log) -> dict[str, str]:
    """Name of each aiding sensor -> path of its fix; "range" where each range counts by itself."""
    ends = ("nis", "normalised", "used", "rejected")
    found = [p[:-4] for p in log.paths if p.startswith("estimate.") and p.endswith(".nis")]
    whole = [p for p in found if all(f"{p}.{end}" in log for end in ends)]
    return {"range" if log[f"{p}.nis"].ndim > 1 else p.rpartition(".")[2].removesuffix("_fix"): p for p in whole}


def flag(log: Log, path: str, otherwise: bool) -> Any:
    """A signal (rows,) as booleans; the same everywhere where the log has none."""
    return log[path].astype(bool) if path in log else np.full(len(log), otherwise)


def unaided(log: Log) -> frozenset[str]:
    """States that no measurement corrected, though the estimate was valid.

    Of a vehicle without a position sensor the place is a guess that grows. Of a run without a valid estimate nothing
    can be said: there, an aid that was wanted did not come.
    """
    base = where_state(log)
    if not flag(log, "estimate.valid", True).any():
        return frozenset()
    counts = {n: f"{base}.{n}_fix.used" for n in ("position", "heading") if f"{base}.{n}_fix.used" in log}
    never = {n for n, path in counts.items() if not log[path].any()}
    alone = BY_POSITION if "position" in never else ()
    return frozenset((*alone, *BY_HEADING) if never and never == set(counts) else alone)


def updates(log: Log, path: str, since: float) -> Updates:
    """A measurement counts where the number of those used and refused rises from one row to the next."""
    refused = log[f"{path}.rejected"].astype(np.int64)
    more = np.diff(log[f"{path}.used"].astype(np.int64) + refused, prepend=0)
    new, nis = np.diff(refused, prepend=0), log[f"{path}.nis"]
    rows = (more > 0) & (log.t >= since)
    if nis.ndim > 1:
        return _ranges(log, path, rows, more, new)
    rows &= np.isfinite(nis)
    values = log[f"{path}.normalised"][rows]
    values = values[:, None] if values.ndim == 1 else values
    return Updates(log.t[rows], nis[rows], values, int(new[rows].sum()), int((more[rows] - 1).sum()))


def _ranges(log: Log, path: str, rows: Any, more: Any, new: Any) -> Updates:
    """Of a RangeFix (rows, n): each range that was predicted is an update with one degree of freedom, in order.

    Not predicted are those that disagree with the rest, and all of a ping at which the filter waited for a start; then
    the last innovations are left standing.
    """
    nis, ran = log[f"{path}.nis"], flag(log, f"{path}.tracking", True)
    rows = rows & np.append(ran[:1], ran[:-1])
    came = rows[:, None] & np.isfinite(nis) & (log[f"{path}.innovation"] != 0)
    refusals = np.diff(log[f"{path}.refused_in_a_row"].astype(np.int64), axis=0, prepend=0) > 0
    shown = np.sum(came | log[f"{path}.accepted"].astype(bool) | refusals, axis=1)
    unseen = int(np.maximum(more - shown, 0)[rows].sum())
    t = np.broadcast_to(log.t[:, None], nis.shape)
    return Updates(t[came], nis[came], log[f"{path}.normalised"][came][:, None], int(new[rows].sum()), unseen)
