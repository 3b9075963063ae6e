"""Whether the runs of a campaign meet a requirement: met, not met, or undecided, and by which one-sided bound.

A requirement `x <= b @ c` is met when the upper bound of x is at most b, not met when its lower bound is above b, and
undecided between. Each bound holds with confidence c by itself: who demands 95 % is wrongly told "met" in at most 5 %
of the campaigns in which it isn't so, and wrongly told "not met" in at most 5 % of those in which it is.

Source: the bounds' modules; that a one-sided bound answers a one-sided question: Clopper, Pearson, Biometrika 26
(1934); that no run exceeds a limit says, at confidence c, that at least (1 - c)^(1/n) of all worlds don't: [1] Wilks,
"Determination of sample sizes for setting tolerance limits", Ann. Math. Statist. 12 (1941).
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.campaign.grammar import EXTREMES, LEVEL, Requirement
from trimtab.campaign.statistics.intervals import (
    LEAST_FOR_MEAN,
    Proportion,
    as_column,
    least_trials_anytime,
    mean,
    proportion,
    quantile,
)
from trimtab.core.errors import InputError

MET, NOT_MET, UNDECIDED = "met", "not met", "undecided"


class RequirementVerdict(NamedTuple):
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
    def is_met(self) -> bool:
        """Whether a gate may open: only when it is met; undecided is not good enough."""
        return self.outcome == MET

    def __str__(self) -> str:
        """In a line, as in "met: success >= 0.99 @ 95%: 0.9962 in 5000 runs, at least 0.9943 …"."""
        return f"{self.outcome}: {self.requirement.text}: {self.value:.4g} in {self.trials} runs; {self.note}"


def least_runs(requirement: Requirement, *, anytime: bool = False) -> int:
    """How many runs it takes at least until a requirement can be met, if all go well."""
    if requirement.statistic == "success":
        share = requirement.bound if requirement.relation == ">=" else 1 - requirement.bound
    elif requirement.statistic == "quantile":
        share = requirement.p if requirement.relation == "<=" else 1 - requirement.p
    else:
        return LEAST_FOR_MEAN if requirement.statistic == "mean" else 1
    tail = 1 - requirement.level
    if anytime:
        return least_trials_anytime(share, tail)
    return math.ceil(math.log(tail) / math.log(share) * (1 - 1e-14))


def evaluate_requirement(
    requirement: Requirement, columns: Mapping[str, Any], *, anytime: bool = False
) -> RequirementVerdict:
    """Judge one requirement.

    Args:
        requirement: which.
        columns: metrics by name, each of shape (n,): independent runs, row 0 to n - 1, none left out; "success" is
            true or false.
        anytime: whether flying stopped, or may stop, on what is seen here.
    """
    requirement.check(columns, anytime=anytime)
    x = as_column(columns[requirement.metric], f"metric {requirement.metric!r}")
    bad = int(np.count_nonzero(~np.isfinite(x)))
    if requirement.statistic in EXTREMES:
        return _evaluate_extreme(requirement, x, bad)
    if requirement.statistic == "mean" and bad:
        note = f"{bad} runs have no finite value, and so the mean has none"
        return RequirementVerdict(requirement, NOT_MET, math.inf, math.inf, math.inf, len(x), bad, note)
    value, low, high = _one_sided_bounds(requirement, x, anytime)
    upwards = requirement.relation == ">="
    if (low >= requirement.bound) if upwards else (high <= requirement.bound):
        outcome = MET
    elif (high < requirement.bound) if upwards else (low > requirement.bound):
        outcome = NOT_MET
    else:
        outcome = UNDECIDED
    note = _verdict_note(requirement, outcome, low, high, len(x), bad, anytime)
    return RequirementVerdict(requirement, outcome, value, low, high, len(x), bad, note)


def _one_sided_bounds(requirement: Requirement, x: Any, anytime: bool) -> tuple[float, float, float]:
    """The value, and both bounds, each one-sided at the level: the two-sided interval of level 2 c - 1."""
    level = 2 * requirement.level - 1
    if requirement.statistic == "success":
        rate = success_proportion(x, level, anytime=anytime)
        return rate.share, rate.low, rate.high
    if requirement.statistic == "mean":
        average = mean(x, level)
        return average.value, average.low, average.high
    worst = math.inf if requirement.relation == "<=" else -math.inf
    band = quantile(np.where(np.isfinite(x), x, worst), requirement.p, level, anytime=anytime)
    return band.value, band.low, band.high


def success_proportion(success: Any, level: float, *, anytime: bool = False) -> Proportion:
    """The share of successes in a column of true and false; refuses a column that holds anything else."""
    x = as_column(success, "metric 'success'")
    if not np.isin(x, (0.0, 1.0)).all():
        problem = "a success is neither true nor false"
        raise InputError("metric 'success'", problem, fix="give true or false for each run; a run that ran away: false")
    return proportion(int(x.sum()), len(x), level, anytime=anytime)


def _evaluate_extreme(requirement: Requirement, x: Any, bad: int) -> RequirementVerdict:
    upwards = requirement.relation == ">="
    x = np.where(np.isfinite(x), x, -math.inf if upwards else math.inf)
    value = float(x.max() if requirement.statistic == "max" else x.min())
    met = value >= requirement.bound if upwards else value <= requirement.bound
    note = "of the runs flown"
    if met and (requirement.statistic == "max") != upwards:
        covered = (1 - LEVEL) ** (1 / len(x))
        note += f"; at 95 % confidence at least {100 * covered:.4g} % of all worlds keep to it too"
    if bad:
        note += f"; {bad} runs have no finite value and count against it"
    return RequirementVerdict(requirement, MET if met else NOT_MET, value, value, value, len(x), bad, note)


def _verdict_note(
    requirement: Requirement, outcome: str, low: float, high: float, n: int, bad: int, anytime: bool
) -> str:
    at = f"with {100 * requirement.level:.6g} % confidence (one-sided{', at every number of runs' if anytime else ''})"
    if outcome == UNDECIDED:
        note = f"between {low:.4g} and {high:.4g}, each {at}"
        least = least_runs(requirement, anytime=anytime)
        if n < least:
            note += f"; it takes {least} runs at least"
        elif requirement.statistic == "mean" and math.isinf(high):
            note += "; runs that all give the same value don't tell how far others lie"
        else:
            note += "; more runs would tell"
    elif (outcome == MET) == (requirement.relation == ">="):
        note = f"at least {low:.4g} {at}"
    else:
        note = f"at most {high:.4g} {at}"
    return note + (f"; {bad} runs have no finite value and count against it" if bad else "")
