"""Verdicts on sequences whose statistics are known."""

import numpy as np
import pytest
from scipy import stats

from trimtab.core.errors import InputError
from trimtab.logs.consistency import (
    CONSISTENT,
    OPTIMISTIC,
    PESSIMISTIC,
    chi_square_bounds,
    convergence,
    gate_threshold,
    nees_verdict,
    nis_verdict,
    whiteness,
)


def test_bounds_are_those_of_the_literature():
    """[4] section 5.4.2: 50 runs of two states, 95 %: 1.5 to 2.6 (74.2 and 129.6 over 50)."""
    assert chi_square_bounds(2, 50) == pytest.approx((74.22 / 50, 129.56 / 50), abs=1e-3)
    low, high = chi_square_bounds(8, 500)
    assert 7.6 < low < 8 < high < 8.4


def test_bounds_hold_as_often_as_they_say():
    g = np.random.default_rng(0)
    means = g.chisquare(3, (4000, 20)).mean(axis=1)
    low, high = chi_square_bounds(3, 20, 0.9)
    assert np.mean((means >= low) & (means <= high)) == pytest.approx(0.9, abs=0.015)


def test_the_gate_is_the_quantile():
    assert gate_threshold(1, 0.9999) == pytest.approx(15.137, abs=1e-3)
    assert gate_threshold(2, 0.9999) == pytest.approx(-2 * np.log(1e-4), rel=1e-12)


@pytest.mark.parametrize(("scale", "verdict"), [(1.0, CONSISTENT), (1.5, OPTIMISTIC), (0.6, PESSIMISTIC)])
def test_verdicts(scale, verdict):
    g = np.random.default_rng(1)
    nees = scale * g.chisquare(8, (100, 60))
    found = nees_verdict(nees, 8)
    assert found.verdict == verdict
    assert found.expected == 8
    assert found.mean == pytest.approx(8 * scale, rel=0.02)
    assert found.inside == pytest.approx(0.95, abs=0.08) if scale == 1 else found.inside < 0.1
    assert nis_verdict(scale * g.chisquare(2, 500), 2).verdict == verdict
    assert nis_verdict(scale * g.chisquare(2, (20, 50)), 2).verdict == verdict


def test_white_innovations_are_white_and_others_not():
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


def test_the_whiteness_test_is_wrong_as_rarely_as_it_says():
    g = np.random.default_rng(3)
    p = [whiteness(g.standard_normal(200), 10).p for _ in range(600)]
    assert np.mean(np.array(p) < 0.05) == pytest.approx(0.05, abs=0.025)
    assert stats.kstest(p, "uniform").pvalue > 1e-3
    p = [whiteness(g.standard_normal((200, 2)), 10).p for _ in range(400)]
    assert stats.kstest(p, "uniform").pvalue > 1e-3


def test_convergence_of_a_bias():
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
def test_what_cannot_be_judged_is_refused(call):
    with pytest.raises(InputError):
        call()
