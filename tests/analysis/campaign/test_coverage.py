"""Intervals of a success probability and bands of quantiles where the truth is known: 95 ± 1.5 % hold it."""

import numpy as np
import pytest
from scipy import stats

from trimtab.analysis.campaign.statistics.intervals import proportion, quantile, ranks

RUNS, CAMPAIGNS = 2000, 2000
A, STEPS = 0.8, 4
END = np.sqrt((1 - A ** (2 * STEPS)) / (1 - A**2))
"""Standard deviation of the last state."""


def linear_runs(campaigns, runs, seed):
    """The last state of every run, shape (campaigns, runs), flown step by step."""
    rng = np.random.default_rng(seed)
    x = np.zeros((campaigns, runs))
    for _ in range(STEPS):
        x *= A
        x += rng.standard_normal(x.shape)
    return x


def bounds_of_all_counts():
    found = [proportion(k, RUNS) for k in range(RUNS + 1)]
    return np.array([f.low for f in found]), np.array([f.high for f in found])


@pytest.mark.parametrize("p", [0.3, 0.9, 0.97])
def test_success_interval_coverage_for_a_biased_coin(p):
    """The interval never covers less than it says, and with few runs more; with 2000 runs its exact coverage here lies
    between 95.0 % and 96.1 %, so that 95 ± 1.5 % (3 sigma of 2000 repetitions) is a check of the interval.
    """
    low, high = bounds_of_all_counts()
    k = np.arange(RUNS + 1)
    assert 0.95 <= stats.binom.pmf(k, RUNS, p)[(low <= p) & (p <= high)].sum() < 0.961
    heads = (np.random.default_rng(7).random((CAMPAIGNS, RUNS), dtype=np.float32) < p).sum(axis=1)
    assert np.mean((low[heads] <= p) & (p <= high[heads])) == pytest.approx(0.95, abs=0.015)


@pytest.mark.thorough
def test_success_interval_coverage_for_a_linear_system():
    """Success: the last state stays within 1.7 of its standard deviations."""
    p = 2 * stats.norm.cdf(1.7) - 1
    low, high = bounds_of_all_counts()
    successes = (np.abs(linear_runs(CAMPAIGNS, RUNS, seed=11)) < 1.7 * END).sum(axis=1)
    assert np.mean((low[successes] <= p) & (p <= high[successes])) == pytest.approx(0.95, abs=0.015)


def test_quantile_band_has_95_percent_coverage():
    """2000 campaigns of 2000 runs of a linear system whose metric is Gaussian with known variance.

    With 2000 runs the steps of the binomial are small: the coverage, summed exactly, is 95.0 % to 96.0 %, so that
    95 ± 1.5 % (3 sigma of 2000 repetitions) is a check of the band and not of its steps.
    """
    metric = np.sort(linear_runs(campaigns=2000, runs=2000, seed=1), axis=1)
    for p in (0.5, 0.9, 0.95):
        low, high = ranks(2000, p, 0.95)
        exact = stats.binom.cdf(high - 1, 2000, p) - stats.binom.cdf(low - 1, 2000, p)
        assert 0.95 <= exact < 0.961
        truth = END * stats.norm.ppf(p)
        covered = np.mean((metric[:, low - 1] <= truth) & (truth <= metric[:, high - 1]))
        assert covered == pytest.approx(0.95, abs=0.015)
    found = quantile(metric[0], 0.95)
    low, high = ranks(2000, 0.95, 0.95)
    assert (found.low, found.high, found.value) == (metric[0, low - 1], metric[0, high - 1], metric[0, 1899])
