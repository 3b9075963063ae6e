"""How many draws an average is worth, and what is said of it."""

import numpy as np
import pytest
from scipy import stats

from trimtab.logs.consistency import assess_average, effective_draws


def test_draws_of_white_and_of_lasting_errors():
    """A first-order sequence: its squares are worth n (1 - a²)/(1 + a²) draws; a constant about one."""
    g, n = np.random.default_rng(0), 4000
    for a in (0.0, 0.5, 0.9, 0.97):
        z, noise = np.zeros((n, 20)), g.standard_normal((n, 20))
        for k in range(1, n):
            z[k] = a * z[k - 1] + np.sqrt(1 - a * a) * noise[k]
        assert np.mean(effective_draws(z)) == pytest.approx(n * (1 - a * a) / (1 + a * a), rel=0.1)
    assert 0.9 < effective_draws(np.full((500, 1), 0.3))[0] < 2


def test_zeros_are_one_draw_and_decide_nothing():
    """Innovations that are all exactly 0: no correlation can be taken, and bounds are still numbers."""
    z = np.stack([np.zeros(500), np.random.default_rng(0).standard_normal(500)], axis=1)
    draws = effective_draws(z)
    assert draws[0] == 1.0
    assert 300 < draws[1] <= 500
    one = assess_average(0.0, draws[:1], 1, 0.025)
    assert one.verdict == "undecided"
    assert np.isfinite([one.low, one.high, one.draws]).all()


def first_order(a, n, runs, seed=0):
    """Columns of a stationary Gaussian sequence of variance 1."""
    g = np.random.default_rng(seed)
    z = np.zeros((n, runs))
    z[0], noise = g.standard_normal(runs), g.standard_normal((n, runs))
    for k in range(1, n):
        z[k] = a * z[k - 1] + np.sqrt(1 - a * a) * noise[k]
    return z


def test_interval_of_the_factor_holds_it_as_often_as_it_says():
    """95 % of 400 runs, each worth about 50 draws of the thousand samples it has; binomial spread 1.1 %."""
    z = first_order(0.95, 1000, 400)
    inside = [
        one.factor_low <= 1 <= one.factor_high
        for one in (assess_average(np.mean(c * c), effective_draws(c[:, None]), 1, 0.025) for c in z.T)
    ]
    assert np.mean(inside) >= 0.92


def test_bounds_are_those_of_chi_square_and_verdicts_follow():
    low, high = stats.chi2.ppf([0.025, 0.975], 100) / 50
    for mean, verdict in ((2.0, "consistent"), (8.0, "optimistic"), (0.5, "pessimistic"), (2.4 * 1.2, "consistent")):
        one = assess_average(mean, np.full(2, 50.0), 2, 0.025)
        assert (one.low, one.high) == (pytest.approx(low), pytest.approx(high))
        assert one.factor == pytest.approx(np.sqrt(mean / 2))
        assert one.factor_low == pytest.approx(np.sqrt(mean / high))
        assert one.verdict == verdict


def test_few_draws_can_only_say_too_large():
    assert assess_average(1e-3, np.full(1, 5.0), 1, 0.025).verdict == "undecided"
    assert assess_average(1.0, np.full(1, 5.0), 1, 0.025).verdict == "undecided"
    assert assess_average(20.0, np.full(1, 5.0), 1, 0.025).verdict == "optimistic"
