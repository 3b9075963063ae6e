"""Rule that stops a campaign as soon as a confidence interval is narrow enough: `width(success) <= 0.004 @ 95%`.

The rule is evaluated after each block of runs, over runs 0 to n - 1 in order, without gaps. Runs that finish early are
not used out of order, because failing runs often finish early. Stopping on an observed width reduces the coverage.
The usual 95 % interval then covers some probabilities in only 93.4 % of campaigns, and the usual band of a quantile in
far fewer. Therefore

- for a probability, the interval of Clopper and Pearson is used with tail probabilities multiplied by 0.6. By exact
  calculation, the confidence of this interval is at least `level` for every probability if only this rule stops the
  campaign;
- for a quantile, the band that is valid at all numbers of runs together is used (`anytime` in `intervals`), because the
  coverage of any other band would depend on the metric's unknown distribution.

docs/campaign/metrics.md contains the calculated coverages.

Source: [1] Frey, "Fixed-width sequential confidence intervals for a proportion", American Statistician 64 (2010), for
tail probabilities reduced until an exact calculation shows the coverage. The factor 0.6 is this package's own result.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.analysis.campaign.grammar import StoppingRule
from trimtab.analysis.campaign.statistics.intervals import quantile
from trimtab.analysis.campaign.statistics.requirement import success_proportion

TAILS = 0.6
"""Factor on the tail probabilities of a success probability's interval, to allow for a campaign that stops early."""


class StoppingState(NamedTuple):
    """Progress of a stopping rule. is_met: True if the campaign may stop.

    value, low, high: statistic of the runs flown, and its interval.  trials: number of runs flown.
    expected_runs: estimated total number of runs, or inf if unknown. The width of the interval is assumed to be
    inversely proportional to the square root of the number of runs.
    """

    is_met: bool
    value: float
    low: float
    high: float
    trials: int
    expected_runs: float

    def __str__(self) -> str:
        """Return a summary, as in "0.9971 (0.9943 to 0.9987), 5000 of about 21000 runs"."""
        rest = f"of about {self.expected_runs:.2g}" if math.isfinite(self.expected_runs) else "so far"
        rest = "enough" if self.is_met else rest
        return f"{self.value:.4g} ({self.low:.4g} to {self.high:.4g}), {self.trials} runs, {rest}"


def evaluate_stopping(rule: StoppingRule, columns: Mapping[str, Any]) -> StoppingState:
    """Evaluate a stopping rule.

    Args:
        rule: the rule.
        columns: metric name -> values (n,) of independent runs 0 to n - 1, without gaps.
    """
    rule.check(columns)
    if rule.statistic == "success":
        interval = success_proportion(columns[rule.metric], 1 - TAILS * (1 - rule.level))
        value, low, high, trials = interval.share, interval.low, interval.high, interval.trials
    else:
        band = quantile(columns[rule.metric], rule.p, rule.level, anytime=True)
        value, low, high, trials = band.value, band.low, band.high, band.trials
    width = high - low if np.isfinite([low, high]).all() else math.inf
    expected = trials * max((width / rule.width) ** 2, 1.0)
    return StoppingState(width <= rule.width, value, low, high, trials, expected)
