"""Comparison of two laws in the same runs: the interval of the difference equals scipy's."""

import numpy as np
import pytest
from scipy import stats

from trimtab.analysis.campaign.search.comparison import compare


def test_comparison_matches_scipy_paired_t_interval():
    rng = np.random.default_rng(2)
    before = rng.standard_normal(40)
    after = before - 0.2 + 0.3 * rng.standard_normal(40)
    found = compare(before, after)
    low, high = stats.ttest_rel(after, before).confidence_interval(0.95)
    assert (found.low, found.high) == pytest.approx((low, high))
    assert found.improves == (high < 0)
    lost = compare(np.append(before, np.inf), np.append(after, 0.0))
    assert np.isnan(lost.difference)
    assert (lost.better, lost.improves) == (int((after < before).sum()) + 1, True)
    assert not compare(after, before).improves
