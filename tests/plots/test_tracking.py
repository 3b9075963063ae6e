"""The picture of tracking: its rows, their order, and the data of each line."""

import numpy as np
import pytest
from matplotlib.image import imread

from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity
from trimtab.core.time import ms, to_seconds
from trimtab.logs.log import Log
from trimtab.plots.run import select_panels
from trimtab.plots.style import GREEN, GREY, VERMILION
from trimtab.plots.tracking import plot_tracking, tracking_rows

T = np.arange(0, ms(5000), ms(10))
WAVE = np.sin(to_seconds(T))


def log(**more):
    signals = {
        "truth.bend": WAVE,
        "truth.h": 100 * WAVE,
        "estimate.state.bend": WAVE + 0.1,
        "estimate.state.h": 100 * WAVE,
        "estimate.state.without_measurement.bend": WAVE + 0.5,
        "law.bend_reference": WAVE - 0.2,
        "law.h_reference": 100 * WAVE - 3,
        "law.idle": np.zeros((len(T), 2)),
        "actuators.u.fuel": WAVE,
    }
    return Log(t=to_seconds(T), ticks=T, signals=signals | more)


def test_tracked_signals_precede_inputs_and_estimates(tmp_path):
    assert [(r.name, r.is_estimated) for r in tracking_rows(log())] == [("h", False), ("bend", True)]
    figure = plot_tracking(log(), tmp_path / "t.png", title="Test")
    titles = [axes.get_title("left") for axes in figure.axes if axes.axison]
    assert titles == ["h", "h minus reference", "fuel", "bend", "bend: estimate minus truth"]
    assert imread(tmp_path / "t.png").std() > 0.05


@pytest.mark.parametrize("name", ["north", "east", "heading", "yaw_rate", "depth"])
def test_references_of_other_pictures_are_omitted(name):
    more = {f"truth.{name}": WAVE, f"law.{name}_reference": WAVE}
    assert [row.name for row in tracking_rows(log(**more))] == ["h", "bend"]


def test_lines_match_signals_and_unaided_observer_is_shown():
    axes = {a.get_title("left"): a for a in plot_tracking(log()).axes}
    np.testing.assert_allclose(axes["h minus reference"].lines[0].get_ydata(), 3.0)
    wanted = [line for line in axes["bend"].lines if line.get_color() == GREEN]
    np.testing.assert_allclose(wanted[0].get_ydata(), WAVE - 0.2)
    error = {line.get_color(): line.get_ydata() for line in axes["bend: estimate minus truth"].lines}
    np.testing.assert_allclose(error[VERMILION], 0.1)
    np.testing.assert_allclose(error[GREY], 0.5)
    assert "without measurement" in axes["bend: estimate minus truth"].get_title("right")


def test_noted_rms_excludes_the_first_tenth_of_the_run():
    spoilt = 100 * WAVE - 3
    spoilt[: len(T) // 10] = 1e6  # the first tenth does not count
    axes = {a.get_title("left"): a for a in plot_tracking(log(**{"law.h_reference": spoilt})).axes}
    assert axes["h minus reference"].get_title("right").startswith("rms 3 after")


def test_rejects_run_without_references():
    with pytest.raises(InputError, match="X_reference"):
        plot_tracking(Log(t=to_seconds(T), ticks=T, signals={"truth.h": WAVE}))


def test_run_picture_shows_reference_and_omits_idle_terms():
    panels = {p.paths[0]: p for p in select_panels(log())}
    assert panels["truth.h"].demand_path == "law.h_reference"
    assert "law.h_reference" not in panels
    assert "law.idle" not in panels
    assert "law.busy" in {p.paths[0] for p in select_panels(log(**{"law.busy": np.ones((len(T), 2))}))}


def test_two_sigma_band_of_a_vector_surrounds_the_error():
    sigma = np.stack([np.full(len(T), 0.07), np.full(len(T), 9.0)], axis=1)
    more = {
        "estimate.state.sigma": sigma,
        "estimate.state.without_measurement.other": WAVE,
    }
    figure = plot_tracking(log(**more))
    axes = {a.get_title("left"): a for a in figure.axes}["bend: estimate minus truth"]
    edges = [line.get_ydata() for line in axes.lines if line.get_color() == "black"]
    assert [set(np.round(edge, 12)) for edge in edges] == [{-0.14}, {0.14}]
    assert "dashed: two sigmas" in "".join(text.get_text() for text in figure.texts)
    bare = plot_tracking(log())
    assert "two sigmas" not in "".join(text.get_text() for text in bare.texts)


def test_two_sigma_band_uses_sigma_named_after_the_state():
    figure = plot_tracking(log(**{"estimate.state.sigma_bend": np.full(len(T), 0.2)}))
    axes = {a.get_title("left"): a for a in figure.axes}["bend: estimate minus truth"]
    assert [line.get_ydata()[0] for line in axes.lines if line.get_color() == "black"] == [-0.4, 0.4]


def test_initial_transient_outside_axes_is_shown_in_inset():
    started = WAVE + 0.1 + 5 * np.exp(-to_seconds(T) / 0.03)
    axes = {a.get_title("left"): a for a in plot_tracking(log(**{"estimate.state.bend": started})).axes}
    error = axes["bend: estimate minus truth"]
    (inset,) = error.child_axes
    (shown,) = [line for line in inset.lines if line.get_color() == VERMILION]
    assert np.asarray(shown.get_ydata()).max() == pytest.approx(5.1)
    low, high = error.get_ylim()
    assert low < np.asarray(shown.get_ydata())[-1] < high < 5.1
    assert inset.get_xlim()[1] < T[-1] / 1e7 / 20
    assert not axes["h minus reference"].child_axes


def test_heading_error_and_sigma_are_in_degrees():
    more = {
        "truth.heading_true": WAVE,
        "law.heading_true_reference": WAVE - 0.2,
        "estimate.state.heading_true": WAVE + 0.1,
        "estimate.state.sigma_heading_true": np.full(len(T), 0.2),
    }
    made = log(**more)
    declared = {path: Quantity("rad", "For the picture.", kind="angle") for path in more}
    axes = {a.get_title("left"): a for a in plot_tracking(Log(made.t, made.ticks, made.signals, declared)).axes}
    error = axes["heading true: estimate minus truth"]
    assert (axes["heading true"].get_ylabel(), error.get_ylabel()) == ("deg", "deg")
    lines = {line.get_color(): line.get_ydata() for line in error.lines}
    np.testing.assert_allclose(lines[VERMILION], np.degrees(0.1))
    np.testing.assert_allclose(lines["black"], np.degrees(0.4))
