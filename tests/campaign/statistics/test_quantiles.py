"""Quantiles with distribution-free bands."""

import math

import numpy as np
import pytest

from trimtab.campaign.statistics.quantiles import least_trials, quantile, ranks
from trimtab.core.errors import InputError


@pytest.mark.parametrize(("n", "p", "level"), [(100, 0.5, 0.95), (1000, 0.95, 0.9), (72, 0.95, 0.95), (20, 0.1, 0.99)])
def test_ranks_are_the_narrowest_that_keep_the_tails(n, p, level):
    """By summing the binomial's probabilities one by one."""
    pmf = [math.comb(n, k) * p**k * (1 - p) ** (n - k) for k in range(n + 1)]
    tail = (1 - level) / 2
    low = max([m for m in range(1, n + 1) if math.fsum(pmf[:m]) <= tail], default=0)
    high = min([m for m in range(1, n + 1) if math.fsum(pmf[m:]) <= tail], default=n + 1)
    assert ranks(n, p, level) == (low, high)


def test_too_few_runs_have_no_upper_bound():
    assert least_trials(0.95, 0.95) == 72
    few, enough = quantile(np.arange(71.0), 0.95), quantile(np.arange(72.0), 0.95)
    assert (few.high, few.needed_runs) == (math.inf, 72)
    assert enough.high == 71.0
    assert "both bounds want 72 runs" in str(few)
    assert str(enough) == "p95 68 (63 to 71)"


def test_low_quantiles_mirror_high_ones():
    x = np.random.default_rng(0).normal(size=500)
    up, down = quantile(x, 0.9), quantile(-x, 0.1)
    assert (up.low, up.high) == (-down.high, -down.low)


def test_runs_without_a_number_count_as_the_worst():
    x = np.r_[np.arange(90.0), [np.nan] * 6, [np.inf] * 4]
    found = quantile(x, 0.95)
    assert (found.value, found.high, found.not_finite) == (math.inf, math.inf, 10)
    assert quantile(x, 0.5).value == 49.0
    assert quantile(x, 0.05, missing=-math.inf).value == -math.inf
    assert quantile(np.full(3, np.nan), 0.5).value == math.inf


def test_the_value_is_the_smallest_that_a_share_p_does_not_exceed():
    x = np.random.default_rng(5).permutation(np.arange(1.0, 101.0))
    for percent in range(1, 100):
        assert quantile(x, percent / 100).value == percent


def test_a_band_for_stopping_is_wider():
    x = np.random.default_rng(0).normal(size=2000)
    fixed, anytime = quantile(x, 0.9), quantile(x, 0.9, anytime=True)
    assert anytime.low < fixed.low < fixed.high < anytime.high
    assert anytime.needed_runs > fixed.needed_runs == 36


@pytest.mark.parametrize(
    "wrong", [([], 0.5), ([1.0], 0.0), ([1.0], 1.0), ([[1.0]], 0.5), (["a"], 0.5), ([1.0], 0.5, 1)]
)
def test_refuses_what_is_no_column_or_share(wrong):
    with pytest.raises(InputError):
        quantile(*wrong)
