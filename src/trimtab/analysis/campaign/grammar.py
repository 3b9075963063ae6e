"""Grammar in which the user types metrics, conditions, requirements, stopping rules and costs.

    METRIC       KIND:SIGNAL, as in settling:yaw_rate, robustness:FORMULA, or file.py:function
    CONDITION    METRIC <= NUMBER                       success of a run, with <=, <, > or >=
                 FORMULA                                the same as robustness:FORMULA > 0
    STATISTIC    success, pNN(METRIC), mean(METRIC), max(METRIC), min(METRIC)
    REQUIREMENT  STATISTIC <= NUMBER @ CONFIDENCE%      the campaign must show this, with <= or >=
    STOP         width(STATISTIC) <= NUMBER @ CONFIDENCE%
    COST         WEIGHT*METRIC + METRIC + …             sum that tuning minimises. A robustness has a negative weight,
                                                        as in -robustness:FORMULA, because it is to be maximised

The name of a metric may contain colons and dots. The default confidence is 95 %. Numbers are in SI units. A bound for
the success may also be in per cent. A FORMULA is written in signal temporal logic, see `core.formula`. `statistics` and
`search.cost` compute the values.
"""

import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple, NoReturn

import numpy as np

from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.formula import EXAMPLE, is_temporal
from trimtab.core.suggestions import closest
from trimtab.core.units import NUMBER, find_sizes

ROBUSTNESS = "robustness"
"""Kind of metric that measures how far a run is from violating a formula."""
LEVEL = 0.95
"""Default confidence of a requirement or a stopping rule, as a probability."""
EXTREMES = ("max", "min")
COMPARE: Mapping[str, Callable[[Any, Any], Any]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
}
REQUIREMENTS = ("success >= 0.99 @ 95%", "p95(METRIC) <= 10 @ 95%", "mean(METRIC) <= 2 @ 95%", "max(METRIC) <= 20")
STOPS = ("width(success) <= 0.01 @ 95%", "width(p95(METRIC)) <= 0.5 @ 95%")
_COMPARISON = re.compile(
    r"\s*(?P<subject>.+?)\s*(?P<relation>[<>=]+)\s*(?P<bound>[^@<>=]+?)\s*(?:@(?P<level>[^@<>=]*))?", re.DOTALL
)
_CALL = re.compile(r"(?P<statistic>p[0-9.]+|mean|max|min)\s*\(\s*(?P<metric>.+?)\s*\)")
_WIDTH = re.compile(r"width\s*\((?P<statistic>.+)\)")
_TERM = re.compile(rf"(?:(?P<weight>[0-9.eE+-]+)\s*\*\s*|(?P<minus>-)\s*)?(?P<metric>{ROBUSTNESS}:.+|\S+)")
_INSIDE = re.compile(r"\(.*\)")


class MetricName(NamedTuple):
    """Name of a metric, KIND:SUBJECT.

    kind: kind of metric, or name of a Python file.  subject: signal, formula, or name of a function in the Python file.
    """

    kind: str
    subject: str

    @property
    def is_function(self) -> bool:
        """Return True if the metric is a function in a Python file."""
        return self.kind.endswith(".py")


class Condition(NamedTuple):
    """Condition for the success of a run: a metric, a comparison and a bound."""

    metric: str
    compare: str
    bound: float

    def holds(self, column: Any) -> Any:
        """Return True for each run (n,) in which the condition holds. It does not hold if the metric is NaN."""
        with np.errstate(invalid="ignore"):
            return COMPARE[self.compare](column, self.bound)


class Requirement(NamedTuple):
    """Requirement that a campaign must meet.

    text: requirement as typed.  statistic: "success", "quantile", "mean", "max" or "min".  metric: metric whose
    statistic is required, or "success".  p: level of the quantile; NaN for other statistics.  relation: "<=" or ">=".
    bound: number with which the statistic is compared, in SI units.  level: confidence; NaN for max and min.
    """

    text: str
    statistic: str
    metric: str
    p: float
    relation: str
    bound: float
    level: float

    def check(self, metrics: Iterable[str], *, anytime: bool = False) -> None:
        """Raise InputError if the requirement cannot be evaluated, before any run starts.

        Args:
            metrics: names of the campaign's metrics.
            anytime: True if the campaign may stop early because of the results.
        """
        part = f"requirement '{self.text}'"
        _check_metric(part, self.metric, metrics, "ask for")
        if anytime and self.statistic == "mean":
            problem = "the bound of a mean is not valid in a campaign that stops early because of its results"
            raise InputError(part, problem, fix="leave the stopping rule out, or require p50 in place of the mean")


class StoppingRule(NamedTuple):
    """Rule that stops a campaign once a confidence interval is narrow enough.

    text: rule as typed.  statistic: "success" or "quantile".  metric, p: metric and level of the quantile.
    width: width of the interval at which the campaign stops, upper minus lower bound, in the metric's unit.
    level: two-sided confidence of the interval.
    """

    text: str
    statistic: str
    metric: str
    p: float
    width: float
    level: float

    def check(self, metrics: Iterable[str]) -> None:
        """Raise InputError if the campaign does not have the metric, before any run starts."""
        _check_metric(f"stopping '{self.text}'", self.metric, metrics, "stop on")


class CostTerm(NamedTuple):
    """One term of a cost: a metric with a weight."""

    weight: float
    metric: str


def parse_metric(text: str) -> MetricName:
    """Split the text of a metric at the first colon. `statistics.metrics.find_metric` checks if the metric exists."""
    kind, _, subject = text.partition(":")
    return MetricName(kind, subject)


def parse_condition(text: str) -> Condition:
    """Read a condition: `METRIC <= NUMBER`, or a formula.

    `statistics.metrics.find_metric` checks the condition's signals.
    """
    if is_temporal(text) and not text.lstrip().startswith(f"{ROBUSTNESS}:"):
        return Condition(f"{ROBUSTNESS}:{text.strip()}", ">", 0.0)
    match = _COMPARISON.fullmatch(text)
    if match and match["relation"] in COMPARE and match["level"] is None:
        bound = _parse_number(match["bound"])
        if bound is not None:
            return Condition(match["subject"], match["relation"], bound)
        if with_unit := NUMBER.fullmatch(match["bound"]):
            plain = with_unit[1] if 1.0 in find_sizes(with_unit[2]).values() else "NUMBER"
            problem = f"{match['bound']!r} has a unit; a bound must be a plain number in the metric's own unit"
            fix = argument("success", [f"{match['subject']} {match['relation']} {plain}"])
            raise InputError(argument_name("success"), problem, fix=fix)
    problem = f"{text!r} is not a condition; write a metric, a comparison and a number, or a formula"
    fix = f"{argument('success', ['settling:yaw_rate <= 10'])}, or {argument('success', [EXAMPLE])}"
    raise InputError(argument_name("success"), problem, choices=COMPARE, fix=fix)


def parse_requirement(text: str) -> Requirement:
    """Read a requirement, `STATISTIC <= NUMBER @ CONFIDENCE%`."""
    part, match = f"requirement '{text}'", _COMPARISON.fullmatch(text.strip())
    if match is None or re.search("[<>=]", _INSIDE.sub("", match["subject"])):
        _refuse_requirement(part, "must compare a statistic with a number")
    subject, relation = match["subject"], match["relation"]
    if relation not in ("<=", ">="):
        _refuse_requirement(part, f"unknown comparison {relation!r}", choices=("<=", ">="))
    kind, metric, p = _parse_statistic(subject, part, REQUIREMENTS)
    bound = _parse_number(match["bound"], percent=kind == "success")
    if bound is None or not math.isfinite(bound):
        problem = f"{match['bound']!r} is not a finite number"
        _refuse_requirement(part, problem, fix="write a plain number in SI units, without the unit")
    level = _parse_level(match["level"], part)
    if kind in EXTREMES:
        if match["level"] is not None:
            problem = f"a finite number of runs cannot bound the {kind} over all possible runs"
            fix = (
                f"write `{subject} {relation} {bound:g}` to judge only the runs flown, or require a "
                f"quantile: `p99.9({metric}) …`"
            )
            raise InputError(part, problem, fix=fix)
        level = math.nan
    if kind == "success" and not (0 < bound < 1):
        fix = "require a probability between 0 and 1, e.g. `success >= 0.999`"
        raise InputError(part, f"a finite number of runs cannot prove a probability of {bound:g}", fix=fix)
    return Requirement(text.strip(), kind, metric, p, relation, bound, level)


def parse_stopping(text: str) -> StoppingRule:
    """Read a stopping rule, `width(STATISTIC) <= NUMBER @ CONFIDENCE%`, for the success or a quantile."""
    part, match = f"stopping '{text}'", _COMPARISON.fullmatch(text.strip())
    inside = _WIDTH.fullmatch(match["subject"]) if match and match["relation"] == "<=" else None
    if match is None or inside is None:
        raise InputError(part, "must limit the width of an interval", choices=STOPS, fix=f"write e.g. `{STOPS[0]}`")
    kind, metric, p = _parse_statistic(inside["statistic"].strip(), part, STOPS)
    if kind not in ("success", "quantile"):
        problem = f"the interval of the {kind} is not valid in a campaign that stops because of this interval"
        raise InputError(part, problem, choices=STOPS, fix="limit the width of the success or of a quantile, e.g. p50")
    width = _parse_number(match["bound"])
    if width is None or not 0 < width < (1 if kind == "success" else math.inf):
        fix = "write a number above 0, in the metric's unit; for the success also below 1"
        raise InputError(part, f"{match['bound']!r} is not a valid width", fix=fix)
    return StoppingRule(text.strip(), kind, metric, p, width, _parse_level(match["level"], part))


def parse_cost(text: str) -> tuple[CostTerm, ...]:
    """Read the terms of a cost, `WEIGHT*METRIC + METRIC + …`."""
    terms = []
    for piece in (piece.strip() for piece in _split_outside(text, " + ")):
        match = _TERM.fullmatch(piece)
        weight = _parse_number(match["weight"] or f"{match['minus'] or ''}1") if match else None
        if match is not None and parse_metric(match["metric"]).kind == ROBUSTNESS:
            if weight is None or not -math.inf < weight < 0:
                problem = f"{piece!r} would minimise a robustness, but a large robustness is good"
                raise InputError(
                    argument_name("cost"),
                    problem,
                    fix=f"{argument('cost', '-' + match['metric'])}, with a negative weight",
                )
        elif match is None or weight is None or not 0 < weight < math.inf:
            problem = f"{piece!r} is not a metric with a positive weight"
            raise InputError(
                argument_name("cost"), problem, fix=argument("cost", "error_rms:yaw_rate + 2*error_rms:sway_velocity")
            )
        terms.append(CostTerm(weight, match["metric"]))
    return tuple(terms)


def _split_outside(text: str, separator: str) -> list[str]:
    """Split a text at the separators outside parentheses."""
    pieces, depth = [""], 0
    for k, piece in enumerate(text.split(separator)):
        pieces[-1:] = [piece] if k == 0 else [f"{pieces[-1]}{separator}{piece}"] if depth > 0 else [pieces[-1], piece]
        depth += piece.count("(") - piece.count(")")
    return pieces


def _parse_statistic(text: str, part: str, forms: Iterable[str]) -> tuple[str, str, float]:
    """Read a statistic, e.g. p95(METRIC). Return statistic, metric and quantile level, as in `Requirement`."""
    if text == "success":
        return "success", "success", math.nan
    call = _CALL.fullmatch(text)
    if call is None or call["metric"].count("(") != call["metric"].count(")"):
        fix = "write success, pNN(METRIC), mean(METRIC), max(METRIC) or min(METRIC)"
        raise InputError(part, f"unknown statistic {text!r}", choices=forms, fix=fix)
    name = call["statistic"]
    if not name.startswith("p"):
        return name, call["metric"], math.nan
    p = _parse_number(name[1:] + "%", percent=True)
    if p is None or not 0 < p < 1:
        fix = "the number after p must be above 0 and below 100; p95 is the value that 95 % of the runs do not exceed"
        raise InputError(part, f"{name!r} is not a quantile", choices=("p5", "p50", "p95", "p99.9"), fix=fix)
    return "quantile", call["metric"], p


def _parse_level(text: str | None, part: str) -> float:
    """Read a confidence, "95%" or "0.95", above 50 % and below 100 %. The default is 95 %."""
    if text is None:
        return LEVEL
    level = _parse_number(text.strip(), percent=True)
    if level is None or not 0.5 < level < 1:
        fix = "write a confidence above 50 % and below 100 %, e.g. `@ 95%`"
        raise InputError(part, f"{text.strip()!r} is not a valid confidence", choices=("90%", "95%", "99%"), fix=fix)
    return level


def _parse_number(text: str, *, percent: bool = False) -> float | None:
    """Read a number. Return None if the text is not a number. With `percent`, "95%" is read as 0.95."""
    share = percent and text.endswith("%")
    try:
        return float(text.removesuffix("%") if share else text) / (100 if share else 1)
    except ValueError:
        return None


def _check_metric(part: str, metric: str, metrics: Iterable[str], verb: str) -> None:
    names = list(metrics)
    if metric not in names:
        near = closest(metric, names) or names
        fix = f"add the metric {metric!r} to the campaign, or {verb} a metric of the campaign"
        raise InputError(part, f"unknown metric {metric!r}", choices=near, fix=fix)


def _refuse_requirement(part: str, problem: str, choices: Iterable[str] = REQUIREMENTS, fix: str = "") -> NoReturn:
    raise InputError(part, problem, choices=choices, fix=fix or f"write e.g. `{REQUIREMENTS[0]}`")
