"""The interval of a mean."""

import math

import numpy as np
import pytest
from scipy import stats

from trimtab.campaign.statistics.mean import mean
from trimtab.core.errors import InputError


def test_without_skewness_it_is_students_interval():
    x = np.r_[-np.arange(1.0, 51.0), np.arange(1.0, 51.0)] + 7
    found = mean(x, 0.9)
    low, high = stats.t.interval(0.9, 99, loc=7, scale=stats.sem(x))
    assert (found.value, found.low, found.high) == pytest.approx((7, low, high), rel=1e-9)


def test_bounds_invert_the_transformation():
    x = np.random.default_rng(0).exponential(size=200)
    found, n, s, g = mean(x), 200, x.std(ddof=1), stats.skew(x)
    for bound, t in ((found.low, 1), (found.high, -1)):
        w = (x.mean() - bound) / s
        h = w + g * w**2 / 3 + g**2 * w**3 / 27 + g / (6 * n)
        assert math.sqrt(n) * h == pytest.approx(t * stats.t.ppf(0.975, n - 1), rel=1e-9)


def one_sided(draw, runs, true_mean, campaigns=2000):
    """How often (the lower bound, the upper bound) at 95 % hold the mean; the same for Student's."""
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


@pytest.mark.parametrize("name", DRAWS)
def test_each_bound_holds_the_mean_in_95_per_cent(name):
    """2000 campaigns of 200 runs, 3 sigma of 2000 repetitions. Student's upper bound of exponential runs doesn't."""
    draw, true_mean = DRAWS[name]
    ours, student = one_sided(draw, 200, true_mean)
    np.testing.assert_allclose(ours, 0.95, atol=0.015)
    if name == "exponential":
        assert student[1] < 0.935


def test_no_bounds_where_the_runs_tell_none():
    for x in (np.arange(29.0), np.full(500, 3.0)):
        found = mean(x)
        assert (found.low, found.high) == (-math.inf, math.inf)
    ran_away = mean(np.r_[np.arange(100.0), np.nan])
    assert (ran_away.value, ran_away.low, ran_away.high, ran_away.not_finite) == (math.inf, -math.inf, math.inf, 1)


def test_in_words():
    assert str(mean(np.arange(100.0))) == "49.5 (43.74 to 55.26)"


@pytest.mark.parametrize("wrong", [([], 0.9), ([1.0], 1.0), ([[1.0]], 0.9)])
def test_refuses_what_is_no_column(wrong):
    with pytest.raises(InputError):
        mean(*wrong)
