"""Consistency verdicts on sequences with known statistics."""

import numpy as np
import pytest
from scipy import stats

from trimtab.core.errors import InputError
from trimtab.logs.consistency import (
    CONSISTENT,
    OPTIMISTIC,
    PESSIMISTIC,
    assess_average,
    chi_square_bounds,
    convergence,
    effective_draws,
    gate_threshold,
    nees_verdict,
    nis_verdict,
    whiteness,
)


def test_chi_square_bounds_match_the_literature():
    """[4] section 5.4.2: 50 runs of two states, 95 %: 1.5 to 2.6 (74.2 and 129.6 over 50)."""
    assert chi_square_bounds(2, 50) == pytest.approx((74.22 / 50, 129.56 / 50), abs=1e-3)
    low, high = chi_square_bounds(8, 500)
    assert 7.6 < low < 8 < high < 8.4


def test_chi_square_bounds_have_the_stated_coverage():
    g = np.random.default_rng(0)
    means = g.chisquare(3, (4000, 20)).mean(axis=1)
    low, high = chi_square_bounds(3, 20, 0.9)
    assert np.mean((means >= low) & (means <= high)) == pytest.approx(0.9, abs=0.015)


def test_gate_threshold_equals_the_chi_square_quantile():
    assert gate_threshold(1, 0.9999) == pytest.approx(15.137, abs=1e-3)
    assert gate_threshold(2, 0.9999) == pytest.approx(-2 * np.log(1e-4), rel=1e-12)


@pytest.mark.parametrize(("scale", "verdict"), [(1.0, CONSISTENT), (1.5, OPTIMISTIC), (0.6, PESSIMISTIC)])
def test_nees_and_nis_verdicts_match_the_error_scale(scale, verdict):
    g = np.random.default_rng(1)
    nees = scale * g.chisquare(8, (100, 60))
    found = nees_verdict(nees, 8)
    assert found.verdict == verdict
    assert found.expected == 8
    assert found.mean == pytest.approx(8 * scale, rel=0.02)
    assert found.inside == pytest.approx(0.95, abs=0.08) if scale == 1 else found.inside < 0.1
    assert nis_verdict(scale * g.chisquare(2, 500), 2).verdict == verdict
    assert nis_verdict(scale * g.chisquare(2, (20, 50)), 2).verdict == verdict


def test_whiteness_test_detects_correlated_innovations():
    g = np.random.default_rng(2)
    white = g.standard_normal((800, 2))
    found = whiteness(white)
    assert found.white
    assert found.correlation.shape == (20,)
    assert found.inside >= 0.85
    coloured = white.copy()
    coloured[1:] += 0.5 * white[:-1]
    told = whiteness(coloured)
    assert not told.white
    assert told.correlation[0] == pytest.approx(0.5 / 1.25, abs=0.05)
    assert told.p < 1e-6


@pytest.mark.parametrize("m", [1, 2])
def test_whiteness_statistic_matches_the_ljung_box_formula(m):
    """[6]: N (N + 2) times the sum of rho_k² over the products in it, here of m innovations at each of n instants."""
    y = np.random.default_rng(5).standard_normal((9, m))
    found = whiteness(y, 4)
    total = 0.0
    for k in range(1, 5):
        products = [y[i, j] * y[i + k, j] for i in range(9 - k) for j in range(m)]
        rho = sum(products) / np.sum(y * y)
        assert found.correlation[k - 1] == pytest.approx(rho, rel=1e-12)
        total += rho**2 / len(products)
    assert found.statistic == pytest.approx(9 * m * (9 * m + 2) * total, rel=1e-12)
    assert found.p == pytest.approx(stats.chi2.sf(found.statistic, 4), rel=1e-9)


def test_whiteness_test_has_the_stated_false_alarm_rate():
    g = np.random.default_rng(3)
    p = [whiteness(g.standard_normal(200), 10).p for _ in range(600)]
    assert np.mean(np.array(p) < 0.05) == pytest.approx(0.05, abs=0.025)
    assert stats.kstest(p, "uniform").pvalue > 1e-3
    p = [whiteness(g.standard_normal((200, 2)), 10).p for _ in range(400)]
    assert stats.kstest(p, "uniform").pvalue > 1e-3


def test_bias_convergence_time_and_final_sigma():
    t = np.arange(100.0)
    sigma = np.exp(-t / 20)
    found = convergence(t, 0.5 * sigma, sigma, 0.1)
    assert found.time == np.ceil(20 * np.log(10))
    assert found.final == pytest.approx(0.5)
    assert found.inside == 1.0
    assert convergence(t, sigma, sigma, 1e-9).time is None
    assert convergence(t, 3 * sigma, sigma, 0.1).inside == 0.0


@pytest.mark.parametrize(
    "call",
    [
        lambda: chi_square_bounds(0, 5),
        lambda: chi_square_bounds(2, 5, 1.0),
        lambda: nees_verdict(np.ones(5), 2),
        lambda: nis_verdict([], 2),
        lambda: nis_verdict([1.0, np.nan], 2),
        lambda: whiteness(np.ones(10), 10),
    ],
)
def test_invalid_arguments_are_rejected(call):
    with pytest.raises(InputError):
        call()


def test_effective_draws_match_first_order_correlation():
    """The squares of a first-order sequence are worth n (1 - a²)/(1 + a²) draws; those of a constant about one."""
    g, n = np.random.default_rng(0), 4000
    for a in (0.0, 0.5, 0.9, 0.97):
        z, noise = np.zeros((n, 20)), g.standard_normal((n, 20))
        for k in range(1, n):
            z[k] = a * z[k - 1] + np.sqrt(1 - a * a) * noise[k]
        assert np.mean(effective_draws(z)) == pytest.approx(n * (1 - a * a) / (1 + a * a), rel=0.1)
    assert 0.9 < effective_draws(np.full((500, 1), 0.3))[0] < 2


def test_all_zero_innovations_give_an_undecided_verdict():
    """All innovations are exactly 0: no correlation can be computed, but the bounds stay finite."""
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


def test_factor_interval_has_the_stated_coverage():
    """95 % of 400 runs, each worth about 50 draws of the thousand samples it has; binomial spread 1.1 %."""
    z = first_order(0.95, 1000, 400)
    inside = [
        one.factor_low <= 1 <= one.factor_high
        for one in (assess_average(np.mean(c * c), effective_draws(c[:, None]), 1, 0.025) for c in z.T)
    ]
    assert np.mean(inside) >= 0.92


def test_average_bounds_match_chi_square_and_set_the_verdict():
    low, high = stats.chi2.ppf([0.025, 0.975], 100) / 50
    for mean, verdict in ((2.0, "consistent"), (8.0, "optimistic"), (0.5, "pessimistic"), (2.4 * 1.2, "consistent")):
        one = assess_average(mean, np.full(2, 50.0), 2, 0.025)
        assert (one.low, one.high) == (pytest.approx(low), pytest.approx(high))
        assert one.factor == pytest.approx(np.sqrt(mean / 2))
        assert one.factor_low == pytest.approx(np.sqrt(mean / high))
        assert one.verdict == verdict


def test_few_draws_can_only_give_an_optimistic_verdict():
    assert assess_average(1e-3, np.full(1, 5.0), 1, 0.025).verdict == "undecided"
    assert assess_average(1.0, np.full(1, 5.0), 1, 0.025).verdict == "undecided"
    assert assess_average(20.0, np.full(1, 5.0), 1, 0.025).verdict == "optimistic"
