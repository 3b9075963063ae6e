"""Intervals of a probability, a quantile and a mean."""

import math

import numpy as np
import pytest
from scipy import stats

from trimtab.analysis.campaign.statistics.intervals import least_trials, mean, proportion, quantile, ranks
from trimtab.core.errors import InputError


def bound(k, n, tail, low):
    """Return the bound by bisection of the binomial tails."""
    a, b = 0.0, 1.0
    for _ in range(80):
        p = (a + b) / 2
        above = (1 - stats.binom.cdf(k - 1, n, p)) < tail if low else stats.binom.cdf(k, n, p) > tail
        a, b = (p, b) if above else (a, p)
    return a


@pytest.mark.parametrize(("k", "n", "level"), [(1, 10, 0.95), (7, 10, 0.9), (97, 100, 0.95), (999, 1000, 0.99)])
def test_proportion_bounds_solve_their_defining_equations(k, n, level):
    found = proportion(k, n, level)
    tail = (1 - level) / 2
    assert found.low == pytest.approx(bound(k, n, tail, True), rel=1e-9)
    assert found.high == pytest.approx(bound(k, n, tail, False), rel=1e-9)
    assert found.share == k / n


def test_proportion_bounds_for_zero_and_all_successes():
    """Without a failure in n trials the lower bound is (tail)^(1/n)."""
    none, every = proportion(0, 40), proportion(40, 40)
    assert (none.low, every.high) == (0.0, 1.0)
    assert every.low == pytest.approx(0.025 ** (1 / 40), rel=1e-12)
    assert none.high == pytest.approx(1 - every.low, rel=1e-12)


@pytest.mark.parametrize("n", [5, 30, 200])
def test_proportion_interval_has_the_stated_coverage(n):
    """Coverage summed over all outcomes, not sampled, for probabilities from rare to certain."""
    intervals = [proportion(k, n) for k in range(n + 1)]
    low, high = np.array([i.low for i in intervals]), np.array([i.high for i in intervals])
    for p in np.linspace(0.002, 0.998, 250):
        assert stats.binom.pmf(np.arange(n + 1), n, p)[(low <= p) & (p <= high)].sum() >= 0.95


def test_proportion_is_formatted_as_percent_and_interval():
    assert str(proportion(973, 1000)) == "97.3 % (96.1 to 98.2)"


@pytest.mark.parametrize("wrong", [(3, 2), (-1, 2), (0, 0), (1.5, 2), (1, 2, 1.0), (1, 2, 0.0)])
def test_rejects_invalid_counts_and_levels(wrong):
    with pytest.raises(InputError, match="proportion"):
        proportion(*wrong)


@pytest.mark.parametrize(("n", "p", "level"), [(100, 0.5, 0.95), (1000, 0.95, 0.9), (72, 0.95, 0.95), (20, 0.1, 0.99)])
def test_quantile_ranks_are_the_narrowest_keeping_the_tails(n, p, level):
    """By summing the binomial's probabilities one by one."""
    pmf = [math.comb(n, k) * p**k * (1 - p) ** (n - k) for k in range(n + 1)]
    tail = (1 - level) / 2
    low = max([m for m in range(1, n + 1) if math.fsum(pmf[:m]) <= tail], default=0)
    high = min([m for m in range(1, n + 1) if math.fsum(pmf[m:]) <= tail], default=n + 1)
    assert ranks(n, p, level) == (low, high)


def test_quantile_of_too_few_runs_has_no_upper_bound():
    assert least_trials(0.95, 0.95) == 72
    few, enough = quantile(np.arange(71.0), 0.95), quantile(np.arange(72.0), 0.95)
    assert (few.high, few.needed_runs) == (math.inf, 72)
    assert enough.high == 71.0
    assert "both bounds need 72 runs" in str(few)
    assert str(enough) == "p95 68 (63 to 71)"


def test_low_quantiles_mirror_high_ones():
    x = np.random.default_rng(0).normal(size=500)
    up, down = quantile(x, 0.9), quantile(-x, 0.1)
    assert (up.low, up.high) == (-down.high, -down.low)
    for anytime in (False, True):
        assert least_trials(0.05, 0.95, anytime=anytime) == least_trials(0.95, 0.95, anytime=anytime)
    few, enough = quantile(np.arange(71.0), 0.05), quantile(np.arange(72.0), 0.05)
    assert (few.low, few.needed_runs) == (-math.inf, 72)
    assert enough.low == 0.0


def test_non_finite_runs_count_as_the_worst():
    x = np.r_[np.arange(90.0), [np.nan] * 6, [np.inf] * 4]
    found = quantile(x, 0.95)
    assert (found.value, found.high, found.not_finite) == (math.inf, math.inf, 10)
    assert quantile(x, 0.5).value == 49.0
    assert quantile(x, 0.05, missing=-math.inf).value == -math.inf
    assert quantile(np.full(3, np.nan), 0.5).value == math.inf


def test_quantile_is_the_smallest_value_covering_share_p():
    x = np.random.default_rng(5).permutation(np.arange(1.0, 101.0))
    for percent in range(1, 100):
        assert quantile(x, percent / 100).value == percent


def test_anytime_band_is_wider_than_fixed_band():
    x = np.random.default_rng(0).normal(size=2000)
    fixed, anytime = quantile(x, 0.9), quantile(x, 0.9, anytime=True)
    assert anytime.low < fixed.low < fixed.high < anytime.high
    assert anytime.needed_runs > fixed.needed_runs == 36


@pytest.mark.parametrize(
    "wrong", [([], 0.5), ([1.0], 0.0), ([1.0], 1.0), ([[1.0]], 0.5), (["a"], 0.5), ([1.0], 0.5, 1)]
)
def test_quantile_rejects_invalid_column_or_share(wrong):
    with pytest.raises(InputError):
        quantile(*wrong)


def test_mean_of_symmetric_data_has_student_interval():
    x = np.r_[-np.arange(1.0, 51.0), np.arange(1.0, 51.0)] + 7
    found = mean(x, 0.9)
    low, high = stats.t.interval(0.9, 99, loc=7, scale=stats.sem(x))
    assert (found.value, found.low, found.high) == pytest.approx((7, low, high), rel=1e-9)


def test_mean_bounds_invert_the_skewness_transformation():
    x = np.random.default_rng(0).exponential(size=200)
    found, n, s, g = mean(x), 200, x.std(ddof=1), stats.skew(x)
    for bound, t in ((found.low, 1), (found.high, -1)):
        w = (x.mean() - bound) / s
        h = w + g * w**2 / 3 + g**2 * w**3 / 27 + g / (6 * n)
        assert math.sqrt(n) * h == pytest.approx(t * stats.t.ppf(0.975, n - 1), rel=1e-9)


def one_sided(draw, runs, true_mean, campaigns=2000):
    """Return the coverage of the lower and the upper 95 % bound; the same for Student's bounds."""
    rows = draw(np.random.default_rng(2), (campaigns, runs))
    found = [mean(row, 0.9) for row in rows]
    t = stats.t.ppf(0.95, runs - 1) * rows.std(axis=1, ddof=1) / math.sqrt(runs)
    ours = np.mean([(f.low <= true_mean, f.high >= true_mean) for f in found], axis=0)
    centre = rows.mean(axis=1)
    return ours, np.array([np.mean(centre - t <= true_mean), np.mean(centre + t >= true_mean)])


DRAWS = {
    "gaussian": (lambda rng, size: rng.normal(2, 1, size), 2.0),
    "uniform": (lambda rng, size: rng.uniform(0, 1, size), 0.5),
    "exponential": (lambda rng, size: rng.exponential(1, size), 1.0),
}


@pytest.mark.thorough("gaussian", "uniform")
@pytest.mark.parametrize("name", DRAWS)
def test_mean_bounds_have_95_percent_coverage(name):
    """2000 campaigns of 200 runs, 3 sigma of 2000 repetitions. Student's upper bound of exponential runs doesn't."""
    draw, true_mean = DRAWS[name]
    ours, student = one_sided(draw, 200, true_mean)
    np.testing.assert_allclose(ours, 0.95, atol=0.015)
    if name == "exponential":
        assert student[1] < 0.935


def test_mean_of_few_or_constant_runs_has_no_bounds():
    for x in (np.arange(29.0), np.full(500, 3.0)):
        found = mean(x)
        assert (found.low, found.high) == (-math.inf, math.inf)
    ran_away = mean(np.r_[np.arange(100.0), np.nan])
    assert (ran_away.value, ran_away.low, ran_away.high, ran_away.not_finite) == (math.inf, -math.inf, math.inf, 1)


def test_mean_is_formatted_with_its_interval():
    assert str(mean(np.arange(100.0))) == "49.5 (43.74 to 55.26)"


@pytest.mark.parametrize("wrong", [([], 0.9), ([1.0], 1.0), ([[1.0]], 0.9)])
def test_mean_rejects_invalid_column_or_level(wrong):
    with pytest.raises(InputError):
        mean(*wrong)
