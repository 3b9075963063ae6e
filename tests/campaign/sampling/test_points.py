"""Where runs lie in the unit cube: by seed and number alone, evenly."""

import numpy as np
import pytest
from scipy import stats

from trimtab.campaign.sampling.points import DESIGNS, SAMPLINGS, points
from trimtab.core.errors import InputError


@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_any_piece_of_a_campaign_is_the_piece_of_the_whole(sampling):
    whole = points(sampling, 3, ("a", "b"), 1000, 0, 1000)
    for first, last in ((0, 1), (1, 2), (3, 500), (501, 502), (998, 1000)):
        piece = points(sampling, 3, ("a", "b"), 1000, first, last)
        assert (piece.u == whole.u[first:last]).all()
        assert (piece.words == whole.words[first:last]).all()


@pytest.mark.parametrize("sampling", ["random", "sobol"])
def test_more_runs_leave_the_first_as_they_were(sampling):
    assert (points(sampling, 3, ("a",), 100, 0, 100).u == points(sampling, 3, ("a",), 900, 0, 100).u).all()


def test_a_numbers_draws_do_not_depend_on_what_else_differs():
    alone = points("random", 3, ("b",), 100, 0, 100).u[:, 0]
    assert (alone == points("random", 3, ("a", "b", "c"), 100, 0, 100).u[:, 1]).all()


@pytest.mark.parametrize("sampling", [s for s in SAMPLINGS if s not in DESIGNS])
def test_points_are_uniform_and_independent_of_the_seed_before(sampling):
    u = points(sampling, 5, ("a", "b"), 4096, 0, 4096).u
    assert u.min() > 0
    assert u.max() < 1
    for column in u.T:
        assert stats.kstest(column, "uniform").pvalue > 1e-3
    assert abs(stats.spearmanr(u).statistic) < 0.05
    assert not (u == points(sampling, 6, ("a", "b"), 4096, 0, 4096).u).any()


def test_designs_are_more_even_than_chance():
    def unevenness(sampling):
        return stats.qmc.discrepancy(points(sampling, 1, ("a", "b"), 512, 0, 512).u)

    assert unevenness("sobol") < unevenness("random") / 20
    counts, _ = np.histogram(points("latin", 1, ("a",), 512, 0, 512).u, bins=512, range=(0, 1))
    assert (counts == 1).all()


def test_a_sampling_there_is_none_of_is_refused():
    with pytest.raises(InputError, match=r"Choices: random, sobol, latin"):
        points("grid", 0, ("a",), 10, 0, 10)
