"""Success as it is typed, for what judges runs by their logs: conditions on metrics, all of which must hold."""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from trimtab.campaign.statistics.condition import parse_condition
from trimtab.campaign.statistics.measure import rows_of
from trimtab.campaign.statistics.metrics import parse_metric
from trimtab.campaign.workers.ready import signals_of
from trimtab.loop.scenario import Scenario
from trimtab.run.batch import Batch


def success_of(scenario: Scenario, texts: Iterable[str]) -> tuple[Callable[[Batch], Any], tuple[str, ...]]:
    """Which runs of a batch meet every condition, (n,), and the signals that must be logged for it.

    Args:
        scenario: what flies.
        texts: conditions, e.g. "error_rms:yaw_rate <= 0.5".

    Raises: InputError for a condition on what the scenario doesn't have.
    """
    shapes, units = signals_of(scenario)
    conditions = [parse_condition(text) for text in texts]
    metrics = [parse_metric(c.metric, shapes, scenario.targets, units) for c in conditions]

    def judge(batch: Batch) -> Any:
        rows = rows_of(scenario, batch)
        with np.errstate(over="ignore", invalid="ignore"):
            held = [c.holds(m.of(rows)) for c, m in zip(conditions, metrics, strict=True)]
        return np.all(held, axis=0)

    return judge, tuple(sorted({s for m in metrics for s in m.signals}))
