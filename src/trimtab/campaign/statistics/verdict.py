"""Whether the runs of a campaign meet a requirement: met, not met, or undecided, and by which bound.

Source: the bounds' modules; that no run exceeds a limit says, at confidence c, that at least (1 - c)^(1/n) of all
worlds don't: [1] Wilks, "Determination of sample sizes for setting tolerance limits", Ann. Math. Statist. 12 (1941).
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.campaign.statistics.anytime import proportion_anytime
from trimtab.campaign.statistics.mean import mean
from trimtab.campaign.statistics.quantiles import column, quantile
from trimtab.campaign.statistics.requirement import EXTREMES, LEVEL, Requirement
from trimtab.core.errors import InputError
from trimtab.logs.proportion import Proportion, proportion

MET, NOT_MET, UNDECIDED = "met", "not met", "undecided"


class Verdict(NamedTuple):
    """What the runs say of a requirement.

    outcome: met, not met or undecided.  value: of the runs flown.  low, high: bounds for all worlds, each one-sided at
    the requirement's confidence; for max and min both are the value: they speak of the runs flown.  trials: how many
    runs.  not_finite: how many had no finite value; they count against the requirement.  note: why.
    """

    requirement: Requirement
    outcome: str
    value: float
    low: float
    high: float
    trials: int
    not_finite: int
    note: str

    @property
    def good(self) -> bool:
        """Whether a gate may open: only when it is met; undecided is not good enough."""
        return self.outcome == MET

    def __str__(self) -> str:
        """In a line, as in "met: success >= 0.99 @ 95%: 0.9962 in 5000 runs, at least 0.9943 …"."""
        return f"{self.outcome}: {self.requirement.text}: {self.value:.4g} in {self.trials} runs; {self.note}"


def judge(wanted: Requirement, columns: Mapping[str, Any], *, anytime: bool = False) -> Verdict:
    """Judge one requirement.

    Args:
        wanted: the requirement.
        columns: metrics by name, each of shape (n,): independent runs, row 0 to n - 1, none left out; "success" is
            true or false.
        anytime: whether flying stopped, or may stop, on what is seen here.
    """
    wanted.check(columns, anytime=anytime)
    x = column(columns[wanted.metric], f"metric {wanted.metric!r}")
    bad = int(np.count_nonzero(~np.isfinite(x)))
    if wanted.statistic in EXTREMES:
        return _judge_extreme(wanted, x, bad)
    if wanted.statistic == "mean" and bad:
        note = f"{bad} runs have no finite value, and so the mean has none"
        return Verdict(wanted, NOT_MET, math.inf, math.inf, math.inf, len(x), bad, note)
    value, low, high = _bounds(wanted, x, anytime)
    upwards = wanted.relation == ">="
    if (low >= wanted.bound) if upwards else (high <= wanted.bound):
        outcome = MET
    elif (high < wanted.bound) if upwards else (low > wanted.bound):
        outcome = NOT_MET
    else:
        outcome = UNDECIDED
    note = _note(wanted, outcome, low, high, len(x), bad, anytime)
    return Verdict(wanted, outcome, value, low, high, len(x), bad, note)


def _bounds(wanted: Requirement, x: Any, anytime: bool) -> tuple[float, float, float]:
    """The value, and both bounds, each one-sided at the level: the two-sided interval of level 2 c - 1."""
    level = 2 * wanted.level - 1
    if wanted.statistic == "success":
        found = share(x, level, anytime=anytime)
        return found.share, found.low, found.high
    if wanted.statistic == "mean":
        average = mean(x, level)
        return average.value, average.low, average.high
    worst = math.inf if wanted.relation == "<=" else -math.inf
    band = quantile(np.where(np.isfinite(x), x, worst), wanted.p, level, anytime=anytime)
    return band.value, band.low, band.high


def share(success: Any, level: float, *, anytime: bool = False) -> Proportion:
    """The share of successes in a column of true and false; refuses a column that holds anything else."""
    x = column(success, "metric 'success'")
    if not np.isin(x, (0.0, 1.0)).all():
        problem = "a success is neither true nor false"
        raise InputError("metric 'success'", problem, fix="give true or false for each run; a run that ran away: false")
    return (proportion_anytime if anytime else proportion)(int(x.sum()), len(x), level)


def _judge_extreme(wanted: Requirement, x: Any, bad: int) -> Verdict:
    upwards = wanted.relation == ">="
    x = np.where(np.isfinite(x), x, -math.inf if upwards else math.inf)
    value = float(x.max() if wanted.statistic == "max" else x.min())
    met = value >= wanted.bound if upwards else value <= wanted.bound
    note = "of the runs flown"
    if met and (wanted.statistic == "max") != upwards:
        covered = (1 - LEVEL) ** (1 / len(x))
        note += f"; at 95 % confidence at least {100 * covered:.4g} % of all worlds keep to it too"
    if bad:
        note += f"; {bad} runs have no finite value and count against it"
    return Verdict(wanted, MET if met else NOT_MET, value, value, value, len(x), bad, note)


def _note(wanted: Requirement, outcome: str, low: float, high: float, n: int, bad: int, anytime: bool) -> str:
    at = f"with {100 * wanted.level:.6g} % confidence (one-sided{', at every number of runs' if anytime else ''})"
    if outcome == UNDECIDED:
        note = f"between {low:.4g} and {high:.4g}, each {at}"
        least = wanted.least_runs(anytime=anytime)
        if n < least:
            note += f"; it takes {least} runs at least"
        elif wanted.statistic == "mean" and math.isinf(high):
            note += "; runs that all give the same value don't tell how far others lie"
        else:
            note += "; more runs would tell"
    elif (outcome == MET) == (wanted.relation == ">="):
        note = f"at least {low:.4g} {at}"
    else:
        note = f"at most {high:.4g} {at}"
    return note + (f"; {bad} runs have no finite value and count against it" if bad else "")
