"""Tracing of known boundaries: complete, and with few points."""

import numpy as np
import pytest

from trimtab.analysis.campaign.search.stability_map import trace_boundary
from trimtab.core.errors import InputError


def counted(inside, shape):
    """A function of lattice points for `trace_boundary`, on the unit square, that remembers its calls."""
    calls = []

    def values(points):
        calls.append(points)
        x, y = (points / (np.array(shape) - 1)).T
        return inside(x, y).astype(float)

    return values, calls


def disc(x, y):
    return (x - 0.43) ** 2 + (y - 0.57) ** 2 < 0.31**2


def snake(x, y):
    return y < 0.5 + 0.3 * np.sin(9 * x)


def comb(x, y):
    """Enters a coarse cell through one edge and leaves through the same, between its corners."""
    return y < 0.3 + 0.35 * np.exp(-(((x - 0.31) / 0.03) ** 2))


@pytest.mark.parametrize("inside", [disc, snake, comb])
def test_traced_boundary_equals_the_full_grid_boundary(inside):
    shape = (129, 129)
    values, calls = counted(inside, shape)
    found = trace_boundary(values, (9, 9), 4)
    assert found.shape == shape
    assert found.evaluated_points == sum(len(c) for c in calls) == len({tuple(p) for c in calls for p in c.tolist()})
    # oracle: every cell of the full grid whose corners differ
    x, y = np.meshgrid(np.linspace(0, 1, 129), np.linspace(0, 1, 129), indexing="ij")
    whole = inside(x, y)
    corners = np.stack([whole[:-1, :-1], whole[1:, :-1], whole[:-1, 1:], whole[1:, 1:]])
    wanted = np.argwhere(corners.any(0) & ~corners.all(0))
    got = found.boundary_cells()
    assert (got[:, 2] == 1).all()
    np.testing.assert_array_equal(got[np.lexsort(got[:, 1::-1].T), :2], wanted)
    assert found.evaluated_points < 0.25 * found.of == 0.25 * 129 * 129


def test_cells_tile_the_lattice_without_overlap():
    values, calls = counted(disc, (65, 33))
    found = trace_boundary(values, (5, 3), 4)
    covered = np.zeros((64, 32), int)
    for i, j, size in found.cells:
        covered[i : i + size, j : j + size] += 1
    assert (covered == 1).all()
    np.testing.assert_array_equal(np.bincount(found.call_index), [len(c) for c in calls])
    assert len(calls[0]) == 15
    grid = found.grid()
    assert np.isnan(grid).sum() == found.of - found.evaluated_points


def test_straight_boundary_needs_one_call_per_level():
    values, calls = counted(lambda x, y: x + 0.6 * y < 0.77, (65, 65))
    trace_boundary(values, (5, 5), 4)
    assert len(calls) == 5


def test_crossings_along_a_grid_line_are_found():
    values, _ = counted(disc, (129, 129))
    found = trace_boundary(values, (9, 9), 4)
    line = 64  # y = 0.5
    half = np.sqrt(0.31**2 - 0.07**2)
    first, second = found.crossings(line)
    for (low, high), x in ((first, 0.43 - half), (second, 0.43 + half)):
        assert high - low == 1
        assert low / 128 <= x <= high / 128
    assert found.crossings(0) == []
    assert [round(b / 128, 1) for _, b in found.crossings(56, axis=1)] == [0.3, 0.9]


def test_uniform_region_is_not_refined():
    found = trace_boundary(lambda p: np.ones(len(p)), (4, 3), 6)
    assert (found.evaluated_points, len(found.cells), len(found.boundary_cells())) == (12, 6, 0)


def test_fractional_values_are_compared_with_the_threshold():
    found = trace_boundary(lambda p: p[:, 0] / 16, (3, 2), 3, threshold=0.8)
    assert found.crossings(0) == [(12, 13)]


@pytest.mark.parametrize(("coarse", "depth"), [((1, 5), 3), ((5, 5), -1), ((5, 5), 40)])
def test_invalid_grid_and_depth_are_rejected(coarse, depth):
    with pytest.raises(InputError, match="depth"):
        trace_boundary(lambda p: np.ones(len(p)), coarse, depth)
