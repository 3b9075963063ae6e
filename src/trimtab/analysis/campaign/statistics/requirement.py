"""Verdict on a campaign's requirement (met, not met or undecided) by a one-sided bound.

A requirement `x <= b @ c` is met if the upper confidence bound of x is at most b, not met if the lower bound of x is
above b, and undecided otherwise. Each bound alone has confidence c. At 95 %, a false "met" occurs in at most 5 % of the
campaigns of a scenario that violates the requirement, and a false "not met" in at most 5 % of the campaigns of one that
satisfies it.

Source: for the bounds, see `intervals`; one-sided bounds for one-sided questions: Clopper, Pearson, Biometrika 26
(1934). If none of n runs exceeds a limit, then with confidence c at least (1 - c)^(1/n) of all possible runs do not
exceed it: [1] Wilks, "Determination of sample sizes for setting tolerance limits", Ann. Math. Statist. 12 (1941).
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.analysis.campaign.grammar import EXTREMES, LEVEL, Requirement
from trimtab.analysis.campaign.statistics.intervals import (
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
    """Verdict on a requirement.

    outcome: "met", "not met" or "undecided".  value: value of the statistic in the runs flown.  low, high: one-sided
    bounds of the true value, each at the requirement's confidence. For max and min both bounds equal the value, and the
    verdict covers only the runs flown.  trials: number of runs.  not_finite: number of runs without a finite value,
    which count as violations.  note: text with the reason for the outcome.
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
        """Return True if the requirement is met. An undecided requirement is not met."""
        return self.outcome == MET

    def __str__(self) -> str:
        """Return one line, as in "met: success >= 0.99 @ 95%: 0.9962 in 5000 runs, at least 0.9943 …"."""
        return f"{self.outcome}: {self.requirement.text}: {self.value:.4g} in {self.trials} runs; {self.note}"


def least_runs(requirement: Requirement, *, anytime: bool = False) -> int:
    """Return the minimum number of runs with which a requirement can be met if every run is within the bound."""
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
    """Return the verdict on one requirement.

    Args:
        requirement: the requirement.
        columns: metric name -> values (n,) of independent runs 0 to n - 1, without gaps. The column "success" contains
            True or False.
        anytime: True if the campaign stopped, or may stop, because of its results.
    """
    requirement.check(columns, anytime=anytime)
    x = as_column(columns[requirement.metric], f"metric {requirement.metric!r}")
    bad = int(np.count_nonzero(~np.isfinite(x)))
    if requirement.statistic in EXTREMES:
        return _evaluate_extreme(requirement, x, bad)
    if requirement.statistic == "mean" and bad:
        note = f"{bad} runs have no finite value, so the mean is not finite"
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
    """Return the statistic, with a lower and an upper bound, each one-sided at the confidence c of the requirement.

    The bounds are the ends of the two-sided interval with confidence 2 c - 1.
    """
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
    """Return the share of successes in an array of True and False. Raise InputError for other values."""
    x = as_column(success, "metric 'success'")
    if not np.isin(x, (0.0, 1.0)).all():
        problem = "each value of success must be true or false"
        raise InputError("metric 'success'", problem, fix="return true or false for each run; false for a diverged run")
    return proportion(int(x.sum()), len(x), level, anytime=anytime)


def _evaluate_extreme(requirement: Requirement, x: Any, bad: int) -> RequirementVerdict:
    upwards = requirement.relation == ">="
    x = np.where(np.isfinite(x), x, -math.inf if upwards else math.inf)
    value = float(x.max() if requirement.statistic == "max" else x.min())
    met = value >= requirement.bound if upwards else value <= requirement.bound
    note = "in the runs flown"
    if met and (requirement.statistic == "max") != upwards:
        covered = (1 - LEVEL) ** (1 / len(x))
        note += f"; at 95 % confidence at least {100 * covered:.4g} % of all possible runs meet it too"
    if bad:
        note += f"; {bad} runs have no finite value and count as violations"
    return RequirementVerdict(requirement, MET if met else NOT_MET, value, value, value, len(x), bad, note)


def _verdict_note(
    requirement: Requirement, outcome: str, low: float, high: float, n: int, bad: int, anytime: bool
) -> str:
    at = f"with {100 * requirement.level:.6g} % confidence (one-sided{', at every number of runs' if anytime else ''})"
    if outcome == UNDECIDED:
        note = f"between {low:.4g} and {high:.4g}, each {at}"
        least = least_runs(requirement, anytime=anytime)
        if n < least:
            note += f"; at least {least} runs are needed"
        elif requirement.statistic == "mean" and math.isinf(high):
            note += "; all runs gave the same value, so their scatter is unknown"
        else:
            note += "; more runs can decide"
    elif (outcome == MET) == (requirement.relation == ">="):
        note = f"at least {low:.4g} {at}"
    else:
        note = f"at most {high:.4g} {at}"
    return note + (f"; {bad} runs have no finite value and count as violations" if bad else "")
