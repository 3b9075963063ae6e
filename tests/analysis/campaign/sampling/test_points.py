"""Sample points of runs in the unit cube: they depend only on seed and run number, and are evenly spread."""

import numpy as np
import pytest
from scipy import stats

from trimtab.analysis.campaign.sampling.points import (
    DESIGNS,
    SAMPLINGS,
    check_factors,
    points,
    rows_per_base,
    saltelli_rows,
)
from trimtab.core.errors import InputError


@pytest.mark.thorough("morris")
@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_partial_sample_equals_part_of_the_full_sample(sampling):
    whole = points(sampling, 3, ("a", "b"), 1000, 0, 1000)
    for first, last in ((0, 1), (1, 2), (3, 500), (501, 502), (998, 1000)):
        piece = points(sampling, 3, ("a", "b"), 1000, first, last)
        assert (piece.u == whole.u[first:last]).all()
        assert (piece.words == whole.words[first:last]).all()


@pytest.mark.parametrize("sampling", ["random", "sobol"])
def test_more_runs_do_not_change_the_first_runs(sampling):
    assert (points(sampling, 3, ("a",), 100, 0, 100).u == points(sampling, 3, ("a",), 900, 0, 100).u).all()


def test_draws_of_a_parameter_are_independent_of_others():
    alone = points("random", 3, ("b",), 100, 0, 100).u[:, 0]
    assert (alone == points("random", 3, ("a", "b", "c"), 100, 0, 100).u[:, 1]).all()


@pytest.mark.parametrize("sampling", [s for s in SAMPLINGS if s not in DESIGNS])
def test_points_are_uniform_and_differ_between_seeds(sampling):
    u = points(sampling, 5, ("a", "b"), 4096, 0, 4096).u
    assert u.min() > 0
    assert u.max() < 1
    for column in u.T:
        assert stats.kstest(column, "uniform").pvalue > 1e-3
    assert abs(stats.spearmanr(u).statistic) < 0.05
    assert not (u == points(sampling, 6, ("a", "b"), 4096, 0, 4096).u).any()


def test_designs_have_lower_discrepancy_than_random():
    def unevenness(sampling):
        return stats.qmc.discrepancy(points(sampling, 1, ("a", "b"), 512, 0, 512).u)

    assert unevenness("sobol") < unevenness("random") / 20
    counts, _ = np.histogram(points("latin", 1, ("a",), 512, 0, 512).u, bins=512, range=(0, 1))
    assert (counts == 1).all()


def test_rejects_unknown_sampling():
    with pytest.raises(InputError, match=r"Choices: random, sobol, latin"):
        points("grid", 0, ("a",), 10, 0, 10)


def test_saltelli_rows_have_the_a_ab_b_order():
    rows = saltelli_rows(7, 0, 64 * 6, 3)
    assert rows_per_base(3) == 6
    u, words = rows.u.reshape(64, 6, 3), rows.words.reshape(64, 6)
    a, b = u[:, 0], u[:, 5]
    assert (a != b).all()
    for i in range(3):
        expected = a.copy()
        expected[:, i] = b[:, i]
        np.testing.assert_array_equal(u[:, i + 1], expected)
    np.testing.assert_array_equal(u[:, 4], a)  # the noise: the same point, other numbers
    np.testing.assert_array_equal(words[:, :4], np.repeat(2 * np.arange(64)[:, None], 4, axis=1))
    np.testing.assert_array_equal(words[:, 4:], np.repeat(2 * np.arange(64)[:, None] + 1, 2, axis=1))


def test_saltelli_rows_without_noise_share_random_numbers():
    rows = saltelli_rows(7, 0, 50, 3, noise=False)
    assert not rows.words.any()
    np.testing.assert_array_equal(rows.u[4], saltelli_rows(7, 0, 6, 3).u[5])


@pytest.mark.parametrize(("first", "last"), [(0, 1), (1, 2), (0, 17), (13, 14), (5, 999), (600, 601)])
def test_saltelli_row_depends_only_on_its_number(first, last):
    whole, part = saltelli_rows(3, 0, 1000, 2), saltelli_rows(3, first, last, 2)
    np.testing.assert_array_equal(part.u, whole.u[first:last])
    np.testing.assert_array_equal(part.words, whole.words[first:last])


def test_saltelli_points_are_stratified_inside_the_cube():
    """For 2^k shifted Sobol points, each of 2^k equal cells of every axis holds exactly one point."""
    u = saltelli_rows(11, 0, 256 * 8, 5).u.reshape(256, 8, 5)
    for sample in (u[:, 0], u[:, -1]):
        cells = np.sort((sample * 256).astype(int), axis=0)
        np.testing.assert_array_equal(cells, np.repeat(np.arange(256)[:, None], 5, axis=1))
    assert (u > 0).all()
    assert (u < 1).all()
    both = np.concatenate([u[:, 0], u[:, -1]], axis=1)
    assert np.abs(np.corrcoef(both.T) - np.eye(10)).max() < 0.05


@pytest.mark.thorough
def test_seeds_give_uniformly_distributed_points():
    first = np.array([saltelli_rows(seed, 0, 1, 2).u[0] for seed in range(300)])
    for axis in first.T:
        assert stats.kstest(axis, "uniform").pvalue > 1e-3


def test_saltelli_rows_match_pinned_values():
    """The pinned values never change, so that an old campaign can be continued."""
    pinned = [[0.31930820911657065, 0.39492679142858833], [0.31930820911657065, 0.9393151790136471]]
    np.testing.assert_allclose(saltelli_rows(1, 7, 9, 2).u, pinned, atol=1e-12)


@pytest.mark.parametrize(
    ("factors", "correlated", "says"),
    [
        (["a", "b"], [["a", "b"]], "a, b are correlated"),
        ([], [], "no parameter varies"),
        (["a", "a"], [], "'a' is given twice"),
        (["a", "noise"], [], "random numbers"),
    ],
)
def test_rejects_correlated_or_repeated_factors(factors, correlated, says):
    with pytest.raises(InputError, match=says):
        check_factors(factors, correlated)
    check_factors(["a", "b"], [["a"]])


@pytest.mark.parametrize("wrong", [(1, 1, 2), (-1, 1, 2), (0, 5, 0)])
def test_rejects_invalid_row_range(wrong):
    with pytest.raises(InputError):
        saltelli_rows(0, *wrong)
