"""The plan view: positions of lines, marks and fence, and the pictures that contain it."""

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.time import to_seconds
from trimtab.logs.log import Log
from trimtab.plots.plan import MARKS, Fence, find_fence, has_plan, plot_plan
from trimtab.plots.run import plot_run
from trimtab.plots.style import BLUE, GREEN, ORANGE, VERMILION


def flown(n=400, metadata=None, estimate=True, seed=0, lost=None):
    """A quarter of a circle of 3 m, about the origin; the estimate is a centimetre to the north."""
    ticks = np.arange(n) * 10_000
    angle = np.linspace(0, np.pi / 2, n)
    north, east = 3 * np.cos(angle), 3 * np.sin(angle)
    if lost is not None:
        north[lost:] = np.nan
    signals = {
        "truth.north": north + 0.1 * seed,
        "truth.east": east,
        "truth.heading": angle + np.pi / 2,
        "law.north_reference": north + 0.05,
        "law.east_reference": east,
        "estimate.valid": np.arange(n) >= 50,
    }
    if estimate:
        signals |= {"estimate.state.north": north + 0.01, "estimate.state.east": east}
    return Log(to_seconds(ticks), ticks, signals, {}, metadata or {})


def lines(axes, colour):
    return [line for line in axes.get_lines() if line.get_color() == colour and len(line.get_xdata()) > 2]


def test_lines_match_the_logged_positions():
    log, ideal = flown(), flown(seed=1)
    axes = plot_plan(log, ideal).axes[0]
    truth = lines(axes, BLUE)[0]
    np.testing.assert_array_equal(truth.get_xdata(), log["truth.east"])
    np.testing.assert_array_equal(truth.get_ydata(), log["truth.north"])
    np.testing.assert_array_equal(lines(axes, VERMILION)[0].get_ydata(), ideal["truth.north"])
    for colour, shift in ((GREEN, 0.05), (ORANGE, 0.01)):
        (line,) = lines(axes, colour)
        np.testing.assert_allclose(line.get_ydata()[50:], log["truth.north"][50:] + shift)
        assert np.isnan(line.get_ydata()[:50]).all()  # nothing was known, and so nothing asked, before
    order = [line.get_color() for line in axes.get_lines() if len(line.get_xdata()) > 2]
    assert order.index(GREEN) < order.index(BLUE) < order.index(ORANGE)
    assert axes.get_aspect() == 1.0
    assert axes.get_xlim()[0] < 0
    assert axes.get_ylim()[1] > 3


def test_heading_marks_point_along_the_nose():
    log = flown()
    marks = [line for line in plot_plan(log).axes[0].get_lines() if len(line.get_xdata()) == 2]
    assert len(marks) == MARKS
    for mark in marks:
        (x, x2), (y, y2) = mark.get_data()
        k = int(np.argmin(np.hypot(log["truth.east"] - x, log["truth.north"] - y)))
        assert np.arctan2(x2 - x, y2 - y) == pytest.approx(log["truth.heading"][k], abs=1e-6)


def limit(k, fields, low, high):
    head = f"autopilot.supervisor.limits.{k}"
    return {f"{head}.fields": fields, f"{head}.low": low, f"{head}.high": high}


def test_tightest_fence_is_used_and_drawn_when_near():
    parameters = {
        **limit(0, ["yaw_rate"], -12, 12),
        **limit(1, ["north"], -1.0, 90.0),
        **limit(2, ["north"], -2.0, 80.0),
        **limit(3, ["north", "east"], -1e9, 4.0),
    }
    assert find_fence(parameters) == Fence(south=-1.0, north=80.0, distance=4.0)
    axes = plot_plan(flown(metadata={"parameters": parameters})).axes[0]
    fence = [line for line in axes.get_lines() if line.get_linestyle() == ":"]
    assert len(fence) == 2
    assert set(fence[0].get_ydata()) == {-1.0}
    np.testing.assert_allclose(np.hypot(*fence[1].get_data()), 4.0)


def test_run_picture_has_a_plan_only_for_planar_vehicles():
    figure = plot_run(flown(), flown(seed=1))
    titles = [a.get_title(loc="left") for a in figure.axes]
    assert titles.count("Plan") == 1
    place = figure.axes[titles.index("Plan")].get_position()
    others = [a.get_position() for a, title in zip(figure.axes, titles, strict=True) if title != "Plan"]
    assert len(others) == 5
    assert not any(place.overlaps(other) for other in others)
    legend = [t.get_text() for t in figure.legends[0].get_texts()]
    assert legend == ["real", "ideal", "estimate", "reference"]
    ticks = np.arange(20)
    log = Log(to_seconds(ticks), ticks, {"truth.altitude": np.zeros(20)})
    assert not has_plan(log)
    assert [a.get_title(loc="left") for a in plot_run(log).axes] == ["Altitude"]
    with pytest.raises(InputError, match="no north and east"):
        plot_plan(log)


@pytest.mark.thorough("2")
@pytest.mark.parametrize("n", [1, 2])
def test_very_short_and_stationary_runs_are_drawn(n, tmp_path):
    log = flown(n, estimate=False)
    plot_plan(log, log, tmp_path / "plan.png", title="Short")
    assert (tmp_path / "plan.png").exists()
    assert not has_plan(flown(5).between(0, 0))


def test_nan_positions_still_give_a_picture():
    """The finite part of a diverged flight is drawn."""
    axes = plot_plan(flown(lost=200)).axes[0]
    assert np.isfinite([*axes.get_xlim(), *axes.get_ylim()]).all()
