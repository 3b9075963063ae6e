import numpy as np
from matplotlib.image import imread

from trimtab.design.dilution import dilution_map
from trimtab.plots.dilution import plot_dilution

SQUARE = np.array([[1.5, 1.5, -2.7], [1.5, -1.5, -2.7], [-1.5, -1.5, -2.7], [-1.5, 1.5, -2.7]])


def test_picture_shows_the_map_and_the_beacons(tmp_path):
    grid = np.linspace(-3, 3, 41)
    found = dilution_map(SQUARE, grid, grid)
    figure = plot_dilution(found, tmp_path / "map.png", title="Square")
    axes = figure.axes[0]
    assert axes.get_title() == "Square"
    mesh = axes.collections[0].get_array()
    np.testing.assert_array_equal(np.ma.getmaskarray(mesh), np.isinf(found.dilution))
    np.testing.assert_array_equal(mesh.compressed(), found.dilution[np.isfinite(found.dilution)])
    x, y = axes.lines[0].get_data()
    np.testing.assert_array_equal(np.stack([y, x], 1), SQUARE[:, :2])  # north up, east to the right
    assert imread(tmp_path / "map.png").std() > 0.05


def test_map_without_boundary_is_drawn():
    found = dilution_map(SQUARE, np.linspace(-0.1, 0.1, 5), np.linspace(-0.1, 0.1, 5))
    assert len(plot_dilution(found).axes) == 2
