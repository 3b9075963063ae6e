"""The picture of a run's navigation shows errors, bands and NIS of the log, and samples outside the bands."""

import numpy as np
import pytest
from matplotlib.image import imread

from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity
from trimtab.core.time import ms, to_seconds
from trimtab.logs.log import Log
from trimtab.plots.navigation import plot_navigation

T = np.arange(0, ms(5000), ms(10))
BASE = "estimate.state"


@pytest.fixture(scope="module")
def log():
    g, n = np.random.default_rng(1), len(T)
    signals = {"truth.heading": np.sin(to_seconds(T)), f"{BASE}.sigma_heading": np.full(n, 0.02)}
    signals[f"{BASE}.heading"] = signals["truth.heading"] + 0.02 * g.standard_normal(n)
    signals |= {f"{BASE}.gyro_bias": np.full(n, 0.03), f"{BASE}.sigma_gyro_bias": 0.1 / (1 + to_seconds(T))}
    z = g.standard_normal((n, 1))
    fix = {"nis": z[:, 0] ** 2, "normalised": z, "used": np.arange(n), "rejected": np.zeros(n, int)}
    return Log(t=to_seconds(T), ticks=T, signals=signals | {f"{BASE}.heading_fix.{k}": v for k, v in fix.items()})


@pytest.mark.thorough
def test_panels_show_error_bias_and_nis(log, tmp_path):
    figure = plot_navigation(log, tmp_path / "n.png", title="Test")
    titles = [axes.get_title("left") for axes in figure.axes]
    assert titles == ["Heading error", "Gyro bias", "NIS of heading"]
    heading, bias, nis = figure.axes
    np.testing.assert_allclose(heading.lines[0].get_ydata(), log[f"{BASE}.heading"] - log["truth.heading"], atol=1e-12)
    band = heading.collections[0].get_paths()[0].vertices[:, 1]
    assert (band.min(), band.max()) == (pytest.approx(-0.04), pytest.approx(0.04))
    outside = heading.lines[1].get_ydata()
    assert (np.abs(outside[np.isfinite(outside)]) > 0.04).all()
    assert np.isfinite(outside).any()
    np.testing.assert_array_equal(bias.lines[0].get_ydata(), 0.03)
    assert len(nis.lines[0].get_ydata()) == len(T) - 1  # the first row holds no update
    assert "consistent" in figure.get_suptitle()
    assert imread(tmp_path / "n.png").std() > 0.05


def changed(log, **signals):
    return Log(
        t=log.t, ticks=log.ticks, signals={**log.signals, **{k.replace("__", "."): v for k, v in signals.items()}}
    )


@pytest.mark.thorough
def test_run_without_valid_estimate_is_drawn_without_states(log, tmp_path):
    never = changed(log, estimate__valid=np.zeros(len(T), bool))
    figure = plot_navigation(never, tmp_path / "n.png")
    assert [axes.get_title("left") for axes in figure.axes if axes.axison] == ["NIS of heading"]
    assert "no estimate became valid" in figure.get_suptitle()
    assert (tmp_path / "n.png").stat().st_size > 1000
    silent = changed(never, estimate__state__heading_fix__used=np.zeros(len(T), int))
    assert not [axes for axes in plot_navigation(silent, tmp_path / "m.png").axes if axes.axison]


@pytest.mark.thorough
def test_one_valid_estimate_is_enough_for_a_picture(log, tmp_path):
    once = changed(log, estimate__valid=np.arange(len(T)) == len(T) - 1)
    assert "Heading error" in [axes.get_title("left") for axes in plot_navigation(once, tmp_path / "n.png").axes]


def test_unaided_states_are_not_drawn(log):
    lost = changed(
        log,
        estimate__state__north=np.zeros(len(T)),
        estimate__state__sigma_north=np.full(len(T), 38.0),
        estimate__state__position_fix__used=np.zeros(len(T), int),
    )
    titles = [axes.get_title("left") for axes in plot_navigation(lost).axes]
    assert titles == ["Heading error", "Gyro bias", "NIS of heading"]


def test_rejects_log_without_sigmas(log):
    bare = Log(t=log.t, ticks=log.ticks, signals={"truth.heading": log["truth.heading"]})
    with pytest.raises(InputError, match="no sigmas"):
        plot_navigation(bare)


def test_heading_and_its_band_are_in_degrees(log):
    declared = {f"{BASE}.heading": Quantity("rad", "For the picture.", kind="angle")}
    heading, *_ = plot_navigation(Log(log.t, log.ticks, log.signals, declared)).axes
    assert heading.get_ylabel() == "deg"
    off = np.degrees(log[f"{BASE}.heading"] - log["truth.heading"])
    np.testing.assert_allclose(heading.lines[0].get_ydata(), off, atol=1e-10)
    band = heading.collections[0].get_paths()[0].vertices[:, 1]
    assert (band.min(), band.max()) == (pytest.approx(-np.degrees(0.04)), pytest.approx(np.degrees(0.04)))
