"""The picture of a stability map shows its points, boundary and theory."""

import numpy as np

from trimtab.analysis.campaign.search.axes import axis_of_link, axis_of_path
from trimtab.analysis.campaign.search.map_theory import StabilityCriterion
from trimtab.analysis.campaign.search.stability_map import StabilityMap, trace_boundary
from trimtab.plots.stability_map import plot_stability_map


class Named:
    name = "a flight"


def made(inside):
    x, y = axis_of_link("delay", np.linspace(0, 0.4, 5)), axis_of_path("gain", np.linspace(1, 3, 5), "kg/s")
    at_x, at_y = np.linspace(0, 0.4, 33), np.linspace(1, 3, 33)
    traced = trace_boundary(lambda p: inside(at_x[p[:, 0]], at_y[p[:, 1]]).astype(float), (5, 5), 3)
    return StabilityMap(Named(), x, y, at_x, at_y, traced, 4, "none")


def test_stability_map_shows_points_boundary_and_theory(tmp_path):
    found = made(lambda x, y: x * y < 0.5)
    at = np.linspace(0, 0.4, 9), np.linspace(1, 3, 9)
    line = StabilityCriterion("delay margin", *at, 0.5 - np.outer(*at))
    figure = plot_stability_map(found, tmp_path / "map.png", theory=[line])
    assert (tmp_path / "map.png").stat().st_size > 5000
    axes = figure.axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("uplink delay (s)", "gain (kg/s)")
    assert axes.get_title() == f"a flight: {found.traced_boundary.evaluated_points} points flown of 1089"
    (drawn,) = [k for k in axes.get_lines() if len(k.get_xdata()) > 2]
    np.testing.assert_allclose(drawn.get_xdata() * drawn.get_ydata(), 0.5, atol=0.01)
    dots = np.concatenate([c.get_offsets() for c in axes.collections if len(c.get_offsets()) > 1])
    np.testing.assert_allclose(dots, found.sample_points)
    assert [t.get_text() for t in figure.legends[0].get_texts()] == [
        "flown",
        "boundary",
        "delay margin (linear, no loss)",
    ]
    criteria = [StabilityCriterion(name, *at, 0.5 - np.outer(*at)) for name in ("delay margin", "jitter margin")]
    whole = plot_stability_map(found, theory=criteria)
    whole.canvas.draw()
    legend = whole.legends[0].get_window_extent()
    assert whole.bbox.x0 <= legend.x0 < legend.x1 <= whole.bbox.x1, "the legend is cut"
    colours = axes.collections[0].get_array().reshape(32, 32)  # rows are y
    assert (colours[0, 0], colours[-1, -1]) == (1.0, 0.0)


def test_map_without_boundary_has_no_boundary_line():
    figure = plot_stability_map(made(lambda x, y: x < 9), title="all of it")
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["flown"]
    assert figure.axes[0].get_title() == "all of it: 25 points flown of 1089"
