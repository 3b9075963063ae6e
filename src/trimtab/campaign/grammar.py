"""What is typed of a campaign's numbers: the one grammar of metrics, conditions, requirements, stops and costs.

    METRIC       KIND:SIGNAL, as in settling:yaw_rate, robustness:FORMULA, or file.py:function
    CONDITION    METRIC <= NUMBER                       when a run is a success; <, > and >= too
                 FORMULA                                the same as robustness:FORMULA > 0
    STATISTIC    success, pNN(METRIC), mean(METRIC), max(METRIC), min(METRIC)
    REQUIREMENT  STATISTIC <= NUMBER @ CONFIDENCE%      what a campaign must show; >= too
    STOP         width(STATISTIC) <= NUMBER @ CONFIDENCE%
    COST         WEIGHT*METRIC + METRIC + …             what tuning makes small; a robustness, whose weight is below
                                                        0, as in -robustness:FORMULA, it makes large

A metric's name may hold colons and dots. Without `@` the confidence is 95 %. Numbers are in SI units; a success may be
in per cent. A FORMULA is one of signal temporal logic, `core.formula`. What a text means for a campaign is computed in
`statistics` and in `search.cost`.
"""

import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple, NoReturn

import numpy as np

from trimtab.core.errors import InputError, argument, argument_name, closest
from trimtab.core.formula import EXAMPLE, is_temporal
from trimtab.core.units import NUMBER, find_sizes

ROBUSTNESS = "robustness"
"""Kind of the metric that is how far a run is from breaking a formula."""
LEVEL = 0.95
"""Confidence where the text names none."""
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
    """A metric as written. kind: before the colon, a kind or a file.  subject: after it, a signal or a function."""

    kind: str
    subject: str

    @property
    def is_function(self) -> bool:
        """Whether it is a function of a file."""
        return self.kind.endswith(".py")


class Condition(NamedTuple):
    """When a run is a success: a metric, how it is compared, and with what."""

    metric: str
    compare: str
    bound: float

    def holds(self, column: Any) -> Any:
        """Whether it holds in each run (n,); never where the metric is no number."""
        with np.errstate(invalid="ignore"):
            return COMPARE[self.compare](column, self.bound)


class Requirement(NamedTuple):
    """What a campaign must show.

    text: as written.  statistic: success, quantile, mean, max or min.  metric: of which; "success" for that.  p: which
    quantile; nan for others.  relation: "<=" or ">=".  bound: in SI units.  level: confidence; nan for max, min.
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
        part = f"requirement '{self.text}'"
        _check_metric(part, self.metric, metrics, "ask for")
        if anytime and self.statistic == "mean":
            problem = "the bound of a mean doesn't hold when flying stops on what it says"
            raise InputError(part, problem, fix="fly a fixed number of runs, or ask for p50")


class StoppingRule(NamedTuple):
    """When to stop. text: as written.  statistic: success or quantile.  metric, p: of which.

    width: of the whole interval, upper bound minus lower, in the metric's unit.  level: two-sided confidence.
    """

    text: str
    statistic: str
    metric: str
    p: float
    width: float
    level: float

    def check(self, metrics: Iterable[str]) -> None:
        """Refuse a metric that the campaign doesn't give, before anything flies."""
        _check_metric(f"stopping '{self.text}'", self.metric, metrics, "stop on")


class CostTerm(NamedTuple):
    """A metric of a cost, and how much it counts."""

    weight: float
    metric: str


def parse_metric(text: str) -> MetricName:
    """Both sides of a metric's colon; whether a scenario has it says `statistics.metrics.find_metric`."""
    kind, _, subject = text.partition(":")
    return MetricName(kind, subject)


def parse_condition(text: str) -> Condition:
    """Read `METRIC <= NUMBER`, or a formula; whether that fits the signals says `statistics.metrics.find_metric`."""
    if is_temporal(text) and not text.lstrip().startswith(f"{ROBUSTNESS}:"):
        return Condition(f"{ROBUSTNESS}:{text.strip()}", ">", 0.0)
    match = _COMPARISON.fullmatch(text)
    if match and match["relation"] in COMPARE and match["level"] is None:
        bound = _parse_number(match["bound"])
        if bound is not None:
            return Condition(match["subject"], match["relation"], bound)
        if with_unit := NUMBER.fullmatch(match["bound"]):
            plain = with_unit[1] if 1.0 in find_sizes(with_unit[2]).values() else "NUMBER"
            problem = f"{match['bound']!r} has a unit: a bound is a plain number in the metric's own unit"
            fix = argument("success", [f"{match['subject']} {match['relation']} {plain}"])
            raise InputError(argument_name("success"), problem, fix=fix)
    problem = f"{text!r} is neither METRIC, a comparison and a number, nor a formula"
    fix = f"{argument('success', ['settling:yaw_rate <= 10'])}, or {argument('success', [EXAMPLE])}"
    raise InputError(argument_name("success"), problem, choices=COMPARE, fix=fix)


def parse_requirement(text: str) -> Requirement:
    """Read `STATISTIC <= NUMBER @ CONFIDENCE%`."""
    part, match = f"requirement '{text}'", _COMPARISON.fullmatch(text.strip())
    if match is None or re.search("[<>=]", _INSIDE.sub("", match["subject"])):
        _refuse_requirement(part, "that is no comparison of a statistic with a number")
    subject, relation = match["subject"], match["relation"]
    if relation not in ("<=", ">="):
        _refuse_requirement(part, f"{relation!r} is no relation it knows", choices=("<=", ">="))
    kind, metric, p = _parse_statistic(subject, part, REQUIREMENTS)
    bound = _parse_number(match["bound"], percent=kind == "success")
    if bound is None or not math.isfinite(bound):
        problem = f"{match['bound']!r} is no finite number"
        _refuse_requirement(part, problem, fix="write a plain number in SI units, without a unit")
    level = _parse_level(match["level"], part)
    if kind in EXTREMES:
        if match["level"] is not None:
            problem = f"no number of runs tells the {kind} over all worlds, at no confidence"
            fix = f"write `{subject} {relation} {bound:g}` for the runs flown, or a quantile: `p99.9({metric}) …`"
            raise InputError(part, problem, fix=fix)
        level = math.nan
    if kind == "success" and not (0 < bound < 1):
        fix = "give a probability between 0 and 1, e.g. `success >= 0.999`"
        raise InputError(part, f"no number of runs shows a probability of {bound:g}", fix=fix)
    return Requirement(text.strip(), kind, metric, p, relation, bound, level)


def parse_stopping(text: str) -> StoppingRule:
    """Read `width(STATISTIC) <= NUMBER @ CONFIDENCE%`, of the success or of a quantile."""
    part, match = f"stopping '{text}'", _COMPARISON.fullmatch(text.strip())
    inside = _WIDTH.fullmatch(match["subject"]) if match and match["relation"] == "<=" else None
    if match is None or inside is None:
        raise InputError(part, "that is no width to stop at", choices=STOPS, fix=f"write e.g. `{STOPS[0]}`")
    kind, metric, p = _parse_statistic(inside["statistic"].strip(), part, STOPS)
    if kind not in ("success", "quantile"):
        problem = f"there is no interval of the {kind} that holds when flying stops on it"
        raise InputError(part, problem, choices=STOPS, fix="stop on the success or on a quantile, e.g. p50")
    width = _parse_number(match["bound"])
    if width is None or not 0 < width < (1 if kind == "success" else math.inf):
        fix = "give a number above 0, in the metric's unit; for the success below 1"
        raise InputError(part, f"{match['bound']!r} is no width", fix=fix)
    return StoppingRule(text.strip(), kind, metric, p, width, _parse_level(match["level"], part))


def parse_cost(text: str) -> tuple[CostTerm, ...]:
    """Read `WEIGHT*METRIC + METRIC + …`."""
    terms = []
    for piece in (piece.strip() for piece in _split_outside(text, " + ")):
        match = _TERM.fullmatch(piece)
        weight = _parse_number(match["weight"] or f"{match['minus'] or ''}1") if match else None
        if match is not None and parse_metric(match["metric"]).kind == ROBUSTNESS:
            if weight is None or not -math.inf < weight < 0:
                problem = f"{piece!r} would make a robustness small, and only a large one is good"
                raise InputError(
                    argument_name("cost"), problem, fix=f"{argument('cost', '-' + match['metric'])}, a weight below 0"
                )
        elif match is None or weight is None or not 0 < weight < math.inf:
            problem = f"{piece!r} is no metric with a weight above 0"
            raise InputError(
                argument_name("cost"), problem, fix=argument("cost", "error_rms:yaw_rate + 2*error_rms:sway_velocity")
            )
        terms.append(CostTerm(weight, match["metric"]))
    return tuple(terms)


def _split_outside(text: str, separator: str) -> list[str]:
    """Pieces between separators that are in no brackets."""
    pieces, depth = [""], 0
    for k, piece in enumerate(text.split(separator)):
        pieces[-1:] = [piece] if k == 0 else [f"{pieces[-1]}{separator}{piece}"] if depth > 0 else [pieces[-1], piece]
        depth += piece.count("(") - piece.count(")")
    return pieces


def _parse_statistic(text: str, part: str, forms: Iterable[str]) -> tuple[str, str, float]:
    """Statistic, metric and p, as a `Requirement` has them."""
    if text == "success":
        return "success", "success", math.nan
    call = _CALL.fullmatch(text)
    if call is None or call["metric"].count("(") != call["metric"].count(")"):
        fix = "write success, pNN(METRIC), mean(METRIC), max(METRIC) or min(METRIC)"
        raise InputError(part, f"{text!r} is no statistic", choices=forms, fix=fix)
    name = call["statistic"]
    if not name.startswith("p"):
        return name, call["metric"], math.nan
    p = _parse_number(name[1:] + "%", percent=True)
    if p is None or not 0 < p < 1:
        fix = "write p95 for the value that 95 % of the worlds don't exceed; above p0, below p100"
        raise InputError(part, f"{name!r} is no quantile", choices=("p5", "p50", "p95", "p99.9"), fix=fix)
    return "quantile", call["metric"], p


def _parse_level(text: str | None, part: str) -> float:
    """A confidence: "95%" or "0.95", above 50 % and below 100 %; 95 % where there is no text."""
    if text is None:
        return LEVEL
    level = _parse_number(text.strip(), percent=True)
    if level is None or not 0.5 < level < 1:
        fix = "write a confidence above 50 % and below 100 %, e.g. `@ 95%`"
        raise InputError(part, f"{text.strip()!r} is no confidence", choices=("90%", "95%", "99%"), fix=fix)
    return level


def _parse_number(text: str, *, percent: bool = False) -> float | None:
    """A number, or None; where it may be in per cent, "95%" is 0.95."""
    share = percent and text.endswith("%")
    try:
        return float(text.removesuffix("%") if share else text) / (100 if share else 1)
    except ValueError:
        return None


def _check_metric(part: str, metric: str, metrics: Iterable[str], verb: str) -> None:
    names = list(metrics)
    if metric not in names:
        near = closest(metric, names) or names
        fix = f"add the metric {metric!r} to the campaign or {verb} one that it has"
        raise InputError(part, f"there is no metric {metric!r}", choices=near, fix=fix)


def _refuse_requirement(part: str, problem: str, choices: Iterable[str] = REQUIREMENTS, fix: str = "") -> NoReturn:
    raise InputError(part, problem, choices=choices, fix=fix or f"write e.g. `{REQUIREMENTS[0]}`")
