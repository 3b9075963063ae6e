"""What a campaign must show: `success >= 0.99 @ 95%` and the like, read from text and judged by one-sided bounds.

A requirement `x <= b @ c` is met when the upper bound of x is at most b, not met when its lower bound is above b, and
undecided between. Each bound holds with confidence c by itself: who demands 95 % is wrongly told "met" in at most 5 %
of the campaigns in which it isn't so, and wrongly told "not met" in at most 5 % of those in which it is.

Source: the bounds' modules; that a one-sided bound answers a one-sided question: Clopper, Pearson, Biometrika 26
(1934).

Whether the runs of a campaign meet a requirement: met, not met, or undecided, and by which bound.

Source: the bounds' modules; that no run exceeds a limit says, at confidence c, that at least (1 - c)^(1/n) of all
worlds don't: [1] Wilks, "Determination of sample sizes for setting tolerance limits", Ann. Math. Statist. 12 (1941).
"""

import math
import re
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, NoReturn

import numpy as np

from trimtab.campaign.statistics.anytime import proportion_anytime
from trimtab.campaign.statistics.mean import mean
from trimtab.campaign.statistics.quantiles import as_column, quantile
from trimtab.core.errors import InputError, closest
from trimtab.logs.proportion import Proportion, proportion

LEVEL = 0.95
"""Confidence where the text names none."""
EXTREMES = ("max", "min")
FORMS = ("success >= 0.99 @ 95%", "p95(METRIC) <= 10 @ 95%", "mean(METRIC) <= 2 @ 95%", "max(METRIC) <= 20")
_WHOLE = re.compile(r"(?P<what>[^<>=]+?)\s*(?P<relation>[<>=]+)\s*(?P<bound>[^@<>=]+?)\s*(?:@(?P<level>[^@]*))?")
_CALL = re.compile(r"(?P<statistic>p[0-9.]+|mean|max|min)\s*\(\s*(?P<metric>.+?)\s*\)")


class Requirement(NamedTuple):
    """One requirement.

    text: as written.  statistic: success, quantile, mean, max or min.  metric: of which, "success" for that.
    p: which quantile; nan for others.  relation: "<=" or ">=".  bound: in SI units.  level: confidence; nan for max,
    min.
    """

    text: str
    statistic: str
    metric: str
    p: float
    relation: str
    bound: float
    level: float

    def check(self, metrics: Iterable[str], *, anytime: bool = False) -> None:
        """Refuse what can't be judged, before anything flies.

        Args:
            metrics: names of those that the campaign gives.
            anytime: whether flying stops on what it says.
        """
        names = list(metrics)
        if self.metric not in names:
            near = closest(self.metric, names) or names
            fix = f"add the metric {self.metric!r} to the campaign or ask for one that it has"
            raise InputError(f"requirement '{self.text}'", f"there is no metric {self.metric!r}", choices=near, fix=fix)
        if anytime and self.statistic == "mean":
            problem = "the bound of a mean doesn't hold when flying stops on what it says"
            raise InputError(f"requirement '{self.text}'", problem, fix="fly a fixed number of runs, or ask for p50")

    def least_runs(self, *, anytime: bool = False) -> int:
        """How many runs it takes at least until it can be met, if all go well."""
        from trimtab.campaign.statistics.mean import LEAST

        if self.statistic == "success":
            share = self.bound if self.relation == ">=" else 1 - self.bound
        elif self.statistic == "quantile":
            share = self.p if self.relation == "<=" else 1 - self.p
        else:
            return LEAST if self.statistic == "mean" else 1
        tail = 1 - self.level
        if anytime:
            from trimtab.campaign.statistics.anytime import least_trials_anytime

            return least_trials_anytime(share, tail)
        return math.ceil(math.log(tail) / math.log(share) * (1 - 1e-14))


def parse_requirement(text: str) -> Requirement:
    """Read a requirement: `WHAT <= NUMBER @ CONFIDENCE%`, where WHAT is one of success, pNN(METRIC), mean, max, min.

    A metric's name may hold colons and dots. Without `@` the confidence is 95 %. Numbers in SI units; a success may be
    in per cent.
    """
    whole = _WHOLE.fullmatch(text.strip())
    if whole is None:
        _refuse(text, "that is no comparison of a statistic with a number")
    what, relation = whole["what"].strip(), whole["relation"]
    if relation not in ("<=", ">="):
        _refuse(text, f"{relation!r} is no relation it knows", choices=("<=", ">="))
    statistic, metric, p = read_statistic(what, f"requirement '{text}'", FORMS)
    bound = _parse_number(text, whole["bound"], percent=statistic == "success")
    level = LEVEL if whole["level"] is None else read_level(whole["level"], f"requirement '{text}'")
    if statistic in EXTREMES:
        if whole["level"] is not None:
            problem = f"no number of runs tells the {statistic} over all worlds, at no confidence"
            fix = f"write `{what} {relation} {bound:g}` for the runs flown, or a quantile: `p99.9({metric}) …`"
            raise InputError(f"requirement '{text}'", problem, fix=fix)
        level = math.nan
    if statistic == "success" and not (0 < bound < 1):
        fix = "give a probability between 0 and 1, e.g. `success >= 0.999`"
        raise InputError(f"requirement '{text}'", f"no number of runs shows a probability of {bound:g}", fix=fix)
    return Requirement(text.strip(), statistic, metric, p, relation, bound, level)


def read_statistic(what: str, part: str, forms: Iterable[str]) -> tuple[str, str, float]:
    """(statistic, metric, p) of `success`, `p95(METRIC)`, `mean(METRIC)`, …; p is nan where it isn't a quantile."""
    if what == "success":
        return "success", "success", math.nan
    call = _CALL.fullmatch(what)
    if call is None or call["metric"].count("(") != call["metric"].count(")"):
        fix = "write success, pNN(METRIC), mean(METRIC), max(METRIC) or min(METRIC)"
        raise InputError(part, f"{what!r} is no statistic", choices=forms, fix=fix)
    statistic = call["statistic"]
    if not statistic.startswith("p"):
        return statistic, call["metric"], math.nan
    try:
        p = float(statistic[1:]) / 100
    except ValueError:
        p = math.nan
    if not 0 < p < 1:
        fix = "write p95 for the value that 95 % of the worlds don't exceed; above p0, below p100"
        raise InputError(part, f"{statistic!r} is no quantile", choices=("p5", "p50", "p95", "p99.9"), fix=fix)
    return "quantile", call["metric"], p


def read_level(text: str, part: str) -> float:
    """A confidence: "95%" or "0.95", above 50 % and below 100 %."""
    try:
        level = float(text.strip().removesuffix("%")) / (100 if text.strip().endswith("%") else 1)
    except ValueError:
        level = math.nan
    if not 0.5 < level < 1:
        fix = "write a confidence above 50 % and below 100 %, e.g. `@ 95%`"
        raise InputError(part, f"{text.strip()!r} is no confidence", choices=("90%", "95%", "99%"), fix=fix)
    return level


def _parse_number(text: str, number: str, percent: bool) -> float:
    share = percent and number.endswith("%")
    try:
        value = float(number.removesuffix("%") if share else number) / (100 if share else 1)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        _refuse(text, f"{number!r} is no finite number", fix="write a plain number in SI units, without a unit")
    return value


def _refuse(text: str, problem: str, choices: Iterable[str] = FORMS, fix: str = "") -> NoReturn:
    raise InputError(f"requirement '{text}'", problem, choices=choices, fix=fix or f"write e.g. `{FORMS[0]}`")


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


def evaluate_requirement(
    wanted: Requirement, columns: Mapping[str, Any], *, anytime: bool = False
) -> RequirementVerdict:
    """Judge one requirement.

    Args:
        wanted: the requirement.
        columns: metrics by name, each of shape (n,): independent runs, row 0 to n - 1, none left out; "success" is
            true or false.
        anytime: whether flying stopped, or may stop, on what is seen here.
    """
    wanted.check(columns, anytime=anytime)
    x = as_column(columns[wanted.metric], f"metric {wanted.metric!r}")
    bad = int(np.count_nonzero(~np.isfinite(x)))
    if wanted.statistic in EXTREMES:
        return _evaluate_extreme(wanted, x, bad)
    if wanted.statistic == "mean" and bad:
        note = f"{bad} runs have no finite value, and so the mean has none"
        return RequirementVerdict(wanted, NOT_MET, math.inf, math.inf, math.inf, len(x), bad, note)
    value, low, high = _one_sided_bounds(wanted, x, anytime)
    upwards = wanted.relation == ">="
    if (low >= wanted.bound) if upwards else (high <= wanted.bound):
        outcome = MET
    elif (high < wanted.bound) if upwards else (low > wanted.bound):
        outcome = NOT_MET
    else:
        outcome = UNDECIDED
    note = _verdict_note(wanted, outcome, low, high, len(x), bad, anytime)
    return RequirementVerdict(wanted, outcome, value, low, high, len(x), bad, note)


def _one_sided_bounds(wanted: Requirement, x: Any, anytime: bool) -> tuple[float, float, float]:
    """The value, and both bounds, each one-sided at the level: the two-sided interval of level 2 c - 1."""
    level = 2 * wanted.level - 1
    if wanted.statistic == "success":
        found = success_proportion(x, level, anytime=anytime)
        return found.share, found.low, found.high
    if wanted.statistic == "mean":
        average = mean(x, level)
        return average.value, average.low, average.high
    worst = math.inf if wanted.relation == "<=" else -math.inf
    band = quantile(np.where(np.isfinite(x), x, worst), wanted.p, level, anytime=anytime)
    return band.value, band.low, band.high


def success_proportion(success: Any, level: float, *, anytime: bool = False) -> Proportion:
    """The share of successes in a column of true and false; refuses a column that holds anything else."""
    x = as_column(success, "metric 'success'")
    if not np.isin(x, (0.0, 1.0)).all():
        problem = "a success is neither true nor false"
        raise InputError("metric 'success'", problem, fix="give true or false for each run; a run that ran away: false")
    return (proportion_anytime if anytime else proportion)(int(x.sum()), len(x), level)


def _evaluate_extreme(wanted: Requirement, x: Any, bad: int) -> RequirementVerdict:
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
    return RequirementVerdict(wanted, MET if met else NOT_MET, value, value, value, len(x), bad, note)


def _verdict_note(wanted: Requirement, outcome: str, low: float, high: float, n: int, bad: int, anytime: bool) -> str:
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
