"""Rows of the Saltelli design."""

import numpy as np
import pytest
from scipy import stats

from trimtab.campaign.sampling.saltelli import check_factors, rows_per_base, saltelli_rows
from trimtab.core.errors import InputError


def test_rows_are_a_then_one_from_b_each_then_b():
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


def test_without_noise_all_rows_fly_with_the_same_numbers():
    rows = saltelli_rows(7, 0, 50, 3, noise=False)
    assert not rows.words.any()
    np.testing.assert_array_equal(rows.u[4], saltelli_rows(7, 0, 6, 3).u[5])


@pytest.mark.parametrize(("first", "last"), [(0, 1), (1, 2), (0, 17), (13, 14), (5, 999), (600, 601)])
def test_a_row_depends_on_its_number_alone(first, last):
    whole, part = saltelli_rows(3, 0, 1000, 2), saltelli_rows(3, first, last, 2)
    np.testing.assert_array_equal(part.u, whole.u[first:last])
    np.testing.assert_array_equal(part.words, whole.words[first:last])


def test_points_are_inside_and_evenly_spread():
    """A power of two of Sobol's points, shifted: each of as many equal cells of each axis holds one of them."""
    u = saltelli_rows(11, 0, 256 * 8, 5).u.reshape(256, 8, 5)
    for points in (u[:, 0], u[:, -1]):
        cells = np.sort((points * 256).astype(int), axis=0)
        np.testing.assert_array_equal(cells, np.repeat(np.arange(256)[:, None], 5, axis=1))
    assert (u > 0).all()
    assert (u < 1).all()
    both = np.concatenate([u[:, 0], u[:, -1]], axis=1)
    assert np.abs(np.corrcoef(both.T) - np.eye(10)).max() < 0.05


def test_seeds_give_other_points_each_of_them_uniform():
    first = np.array([saltelli_rows(seed, 0, 1, 2).u[0] for seed in range(300)])
    for axis in first.T:
        assert stats.kstest(axis, "uniform").pvalue > 1e-3


def test_rows_are_these():
    """As they were first made: a campaign goes on after years."""
    pinned = [[0.31930820911657065, 0.39492679142858833], [0.31930820911657065, 0.9393151790136471]]
    np.testing.assert_allclose(saltelli_rows(1, 7, 9, 2).u, pinned, atol=1e-12)


@pytest.mark.parametrize(
    ("factors", "correlated", "says"),
    [
        (["a", "b"], [["a", "b"]], "a, b are correlated"),
        ([], [], "no parameter is dispersed"),
        (["a", "a"], [], "'a' is there twice"),
        (["a", "noise"], [], "random numbers"),
    ],
)
def test_refuses_factors_that_cannot_be_told_apart(factors, correlated, says):
    with pytest.raises(InputError, match=says):
        check_factors(factors, correlated)
    check_factors(["a", "b"], [["a"]])


@pytest.mark.parametrize("wrong", [(1, 1, 2), (-1, 1, 2), (0, 5, 0)])
def test_refuses_what_is_no_row(wrong):
    with pytest.raises(InputError):
        saltelli_rows(0, *wrong)
