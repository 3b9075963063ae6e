"""Intervals that hold at every number of runs at once."""

import numpy as np
import pytest
from scipy import integrate, stats

from trimtab.analysis.campaign.statistics.intervals import (
    least_trials_anytime,
    log_evidence,
    lower_bound,
    proportion,
    ranks_anytime,
)
from trimtab.core.errors import InputError


@pytest.mark.parametrize(("k", "n", "p"), [(3, 10, 0.2), (0, 5, 0.4), (10, 10, 0.9), (95, 100, 0.99), (40, 50, 0.1)])
def test_log_evidence_equals_numerical_integral(k, n, p):
    ratio = lambda theta: (theta / p) ** k * ((1 - theta) / (1 - p)) ** (n - k)  # noqa: E731
    value, _ = integrate.quad(ratio, p, 1, epsabs=0, epsrel=1e-11, points=[max(p, k / n)])
    assert log_evidence(k, n, p) == pytest.approx(np.log(value / (1 - p)), abs=1e-9)


@pytest.mark.parametrize("p", [0.05, 0.5, 0.97])
def test_evidence_is_a_martingale(p):
    """The mean of the evidence over all outcomes of n runs is 1, as Ville's inequality requires."""
    for n in (1, 7, 60):
        k = np.arange(n + 1)
        assert stats.binom.pmf(k, n, p) @ np.exp(log_evidence(k, n, p)) == pytest.approx(1, rel=1e-9)


def test_anytime_bounds_solve_their_equation_and_mirror():
    k, n = np.array([1, 30, 99, 100]), 100
    low = lower_bound(k, n, 0.025)
    np.testing.assert_allclose(log_evidence(k, n, low), np.log(40), rtol=1e-9)
    found, mirrored = proportion(30, 100, anytime=True), proportion(70, 100, anytime=True)
    assert (found.low, found.high) == pytest.approx((1 - mirrored.high, 1 - mirrored.low), rel=1e-12)
    assert (proportion(0, 9, anytime=True).low, proportion(9, 9, anytime=True).high) == (0, 1)
    assert found.share == 0.3


@pytest.mark.thorough("0.02", "0.5", "0.9")
@pytest.mark.parametrize("p", [0.02, 0.5, 0.9, 0.99])
def test_anytime_interval_has_stated_coverage_at_every_run(p):
    """2000 coins are thrown 1000 times and checked after each throw: each side fails in at most 2.5 % (+ 3 sigma)."""
    heads = np.cumsum(np.random.default_rng(3).random((2000, 1000)) < p, axis=1)
    low, high = np.array([ranks_anytime(n, p, 0.95) for n in range(1, 1001)]).T
    too_high, too_low = (heads >= high).any(axis=1).mean(), (heads < low).any(axis=1).mean()
    assert max(too_high, too_low) < 0.025 + 3 * np.sqrt(0.025 / 2000)
    assert too_high + too_low > 0.002  # it can fail: the check would see evidence that never grows


@pytest.mark.parametrize(("p", "n"), [(0.5, 40), (0.95, 400), (0.05, 400), (0.99, 100)])
def test_anytime_ranks_match_direct_evidence_search(p, n):
    low, high = ranks_anytime(n, p, 0.95)
    counts = np.arange(n + 1)
    few = counts[log_evidence(n - counts, n, 1 - p) >= np.log(40)]  # counts below the quantile that are too few
    many = counts[log_evidence(counts, n, p) >= np.log(40)]
    assert low == (few.max() + 1 if len(few) else 0)
    assert high == (many.min() if len(many) else n + 1)


def test_least_anytime_trials_solve_the_bound():
    n = least_trials_anytime(0.99, 0.05)
    assert lower_bound(n, n, 0.05) >= 0.99 > lower_bound(n - 1, n - 1, 0.05)


def test_rejects_more_successes_than_trials():
    with pytest.raises(InputError):
        proportion(3, 2, anytime=True)
