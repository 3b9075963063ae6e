"""A share and its exact interval."""

import numpy as np
import pytest
from scipy import stats

from trimtab.core.errors import InputError
from trimtab.logs.proportion import proportion


def bound(k, n, tail, low):
    """By bisection of the binomial's own tails."""
    a, b = 0.0, 1.0
    for _ in range(80):
        p = (a + b) / 2
        above = (1 - stats.binom.cdf(k - 1, n, p)) < tail if low else stats.binom.cdf(k, n, p) > tail
        a, b = (p, b) if above else (a, p)
    return a


@pytest.mark.parametrize(("k", "n", "level"), [(1, 10, 0.95), (7, 10, 0.9), (97, 100, 0.95), (999, 1000, 0.99)])
def test_bounds_solve_the_equations_that_define_them(k, n, level):
    found = proportion(k, n, level)
    tail = (1 - level) / 2
    assert found.low == pytest.approx(bound(k, n, tail, True), rel=1e-9)
    assert found.high == pytest.approx(bound(k, n, tail, False), rel=1e-9)
    assert found.share == k / n


def test_none_and_all():
    """Without a failure in n trials the lower bound is (tail)^(1/n)."""
    none, every = proportion(0, 40), proportion(40, 40)
    assert (none.low, every.high) == (0.0, 1.0)
    assert every.low == pytest.approx(0.025 ** (1 / 40), rel=1e-12)
    assert none.high == pytest.approx(1 - every.low, rel=1e-12)


@pytest.mark.parametrize("n", [5, 30, 200])
def test_it_holds_the_truth_as_often_as_it_says(n):
    """Coverage summed over all outcomes, not sampled, for probabilities from rare to certain."""
    intervals = [proportion(k, n) for k in range(n + 1)]
    low, high = np.array([i.low for i in intervals]), np.array([i.high for i in intervals])
    for p in np.linspace(0.002, 0.998, 250):
        assert stats.binom.pmf(np.arange(n + 1), n, p)[(low <= p) & (p <= high)].sum() >= 0.95


def test_in_words():
    assert str(proportion(973, 1000)) == "97.3 % (96.1 to 98.2)"


@pytest.mark.parametrize("wrong", [(3, 2), (-1, 2), (0, 0), (1.5, 2), (1, 2, 1.0), (1, 2, 0.0)])
def test_refuses_what_is_no_count(wrong):
    with pytest.raises(InputError, match="proportion"):
        proportion(*wrong)
