"""How far a run is from failing: one number, below 0 for a failure, with a slope among successes and failures.

Each condition has its room, in parts of the room that it allows, and a run has that of its worst condition:

    settling:s <= T      1 - max |e|/band, over the rows from the last one at or before T
    first_reach:s <= T   1 - min |e|/band, over the rows up to T
    any other <= b       (b - x)/|b|, or b - x where b = 0
    >= and >             the same with the other sign
    margin               min of room/(1 + |room|), in (-1, 1);  a run that ran away: -2 + t/T of the row where it did

so that a signal that never settles is not just infinitely late, but so far from its band; and one that settles has the
room that is left of it. A margin is negative where a condition does not hold, and only there.

Source: Fainekos, Pappas, "Robustness of temporal logic specifications for continuous-time signals", Theoretical
Computer Science 410 (2009), definition 13: "always from T on in the band" and "once until T" as least and largest room.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from trimtab.campaign.statistics.condition import Condition
from trimtab.campaign.statistics.metrics import Metric, Rows
from trimtab.campaign.workers.ready import Ready

NAME = "margin"
LEAST = 1e-12
"""Of the margin of a condition that does not hold by less than can be told."""


def with_margin(ready: Ready) -> Ready:
    """The same campaign with one more column, `margin`."""
    of = {m.name: m for m in ready.metrics}
    signals = tuple(sorted({s for c in ready.success for s in of[c.metric].signals}))
    more = Metric(NAME, signals, lambda rows: margin(rows, ready.success, of))
    return ready._replace(metrics=(*(m for m in ready.metrics if m.name != NAME), more))


def margins(columns: Mapping[str, Any]) -> Any:
    """Margins (n,) of a campaign's columns; a run whose last state is no number failed, whatever its metrics say."""
    return np.where(columns["lost"], np.minimum(columns[NAME], -1.0), columns[NAME])


def margin(rows: Rows, conditions: tuple[Condition, ...], metrics: Mapping[str, Metric]) -> Any:
    """Margins (n,) of some runs.

    Args:
        rows: of the runs.
        conditions: all of which must hold.
        metrics: by name, those of the conditions.
    """
    found = np.min([_one(rows, c, metrics[c.metric]) for c in conditions], axis=0)
    wrong = [~np.isfinite(v).reshape(*v.shape[:2], -1).all(axis=2) for v in rows.signals.values()]
    bad = np.any(wrong, axis=0)
    late = rows.t[np.argmax(bad, axis=1)] / max(rows.t[-1], 1e-9)
    return np.where(bad.any(axis=1), -2.0 + late, found)


def _one(rows: Rows, condition: Condition, metric: Metric) -> Any:
    """Margins of one condition: of the sign that the condition itself has."""
    with np.errstate(invalid="ignore", over="ignore"):
        value = np.asarray(metric.of(rows), np.float64)
        room = _room(rows, condition, value)
        squashed = np.where(np.isinf(room), np.sign(room), room / (1 + np.abs(room)))
    holds = condition.holds(value)
    squashed = np.where(np.isnan(squashed), np.where(holds, 1.0, -1.0), squashed)
    return np.where(holds, np.maximum(squashed, 0.0), np.minimum(squashed, -LEAST))


def _room(rows: Rows, condition: Condition, value: Any) -> Any:
    kind, _, path = condition.metric.partition(":")
    sign = 1.0 if condition.compare in ("<", "<=") else -1.0
    if kind in ("settling", "first_reach"):
        side = "right" if condition.compare in ("<=", ">") else "left"
        last = max(int(np.searchsorted(rows.t - rows.t[0], condition.bound, side)) - 1, 0)
        share = np.abs(rows.error(path)) / rows.band(path)
        return sign * (1 - (share[:, last:].max(axis=1) if kind == "settling" else share[:, : last + 1].min(axis=1)))
    return sign * (condition.bound - value) / (abs(condition.bound) or 1.0)
