"""Stopping a campaign as soon as an interval is as narrow as wanted: `width(success) <= 0.004 @ 95%`.

It is looked at after each block, over runs 0 to n - 1 in order: never over those that happened to finish first, for
runs that fail are often the quick ones. Whoever stops on what he sees sees something else: the plain interval of 95 %
stopped at a width holds some probabilities in 93.4 % only, a plain quantile's band in far fewer. So

- a probability gets the interval of Clopper and Pearson with tails 0.6 times as large, which by exact calculation holds
  at least as often as `level` says, for every probability, for this rule and no other;
- a quantile gets the band that holds at every number of runs at once (`anytime.py`): how often any other held would
  depend on the metric's distribution, which nobody knows.

docs/campaign/stopping.md has the numbers.

Source: [1] Frey, "Fixed-width sequential confidence intervals for a proportion", American Statistician 64 (2010), for
tails made smaller until exact calculation shows the coverage; the factor is ours.
"""

import math
import re
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.campaign.statistics.quantiles import quantile
from trimtab.campaign.statistics.requirement import LEVEL, read_level, read_statistic, success_proportion
from trimtab.core.errors import InputError, closest

FORMS = ("width(success) <= 0.01 @ 95%", "width(p95(METRIC)) <= 0.5 @ 95%")
TAILS = 0.6
"""Tails of the interval of a probability, relative to those of one for a fixed number of runs."""
_WHOLE = re.compile(r"width\s*\((?P<what>.+)\)\s*<=\s*(?P<width>[^@]+?)\s*(?:@(?P<level>[^@]*))?")


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
        names = list(metrics)
        if self.metric not in names:
            fix = f"add the metric {self.metric!r} to the campaign or stop on one that it has"
            near = closest(self.metric, names) or names
            raise InputError(f"stopping '{self.text}'", f"there is no metric {self.metric!r}", choices=near, fix=fix)


class StoppingState(NamedTuple):
    """How far it is. done: whether to stop.  value, low, high: of the runs so far.  foreseen: runs in all, if no value
    changes: the width goes down with the square root of them; inf where nothing can be foreseen.
    """

    is_met: bool
    value: float
    low: float
    high: float
    trials: int
    expected_runs: float

    def __str__(self) -> str:
        """As in "0.9971 (0.9943 to 0.9987), 5000 of about 21000 runs"."""
        rest = (
            "enough"
            if self.is_met
            else f"of about {self.expected_runs:.2g}"
            if math.isfinite(self.expected_runs)
            else "so far"
        )
        return f"{self.value:.4g} ({self.low:.4g} to {self.high:.4g}), {self.trials} runs, {rest}"


def parse_stopping(text: str) -> StoppingRule:
    """Read `width(success) <= W @ 95%` or `width(pNN(METRIC)) <= W @ 95%`; without `@` the confidence is 95 %."""
    part = f"stopping '{text}'"
    whole = _WHOLE.fullmatch(text.strip())
    if whole is None:
        raise InputError(part, "that is no width to stop at", choices=FORMS, fix=f"write e.g. `{FORMS[0]}`")
    statistic, metric, p = read_statistic(whole["what"].strip(), part, FORMS)
    if statistic not in ("success", "quantile"):
        problem = f"there is no interval of the {statistic} that holds when flying stops on it"
        raise InputError(part, problem, choices=FORMS, fix="stop on the success or on a quantile, e.g. p50")
    try:
        width = float(whole["width"])
    except ValueError:
        width = math.nan
    if not 0 < width < (1 if statistic == "success" else math.inf):
        fix = "give a number above 0, in the metric's unit; for the success below 1"
        raise InputError(part, f"{whole['width']!r} is no width", fix=fix)
    level = LEVEL if whole["level"] is None else read_level(whole["level"], part)
    return StoppingRule(text.strip(), statistic, metric, p, width, level)


def evaluate_stopping(wanted: StoppingRule, columns: Mapping[str, Any]) -> StoppingState:
    """Whether the interval is as narrow as wanted.

    Args:
        wanted: the rule.
        columns: metrics by name, each of shape (n,): rows 0 to n - 1 of independent runs, none left out.
    """
    wanted.check(columns)
    if wanted.statistic == "success":
        found = success_proportion(columns[wanted.metric], 1 - TAILS * (1 - wanted.level))
        value, low, high, trials = found.share, found.low, found.high, found.trials
    else:
        band = quantile(columns[wanted.metric], wanted.p, wanted.level, anytime=True)
        value, low, high, trials = band.value, band.low, band.high, band.trials
    width = high - low if np.isfinite([low, high]).all() else math.inf
    foreseen = trials * max((width / wanted.width) ** 2, 1.0)
    return StoppingState(width <= wanted.width, value, low, high, trials, foreseen)
