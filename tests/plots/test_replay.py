"""The picture of a replay: its rows and the data of each line."""

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.image import imread

from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity
from trimtab.core.time import ms, to_seconds
from trimtab.logs.log import Log
from trimtab.plots.replay import common_signals, plot_replay
from trimtab.plots.style import BLUE, GREY, VERMILION

T = np.arange(0, ms(400), ms(2))
WAVE = np.sin(40 * to_seconds(T))


def log(ticks=T, **signals):
    return Log(t=to_seconds(ticks), ticks=ticks, signals=signals)


RECORDED = {
    "estimate.state.heading": WAVE + 0.1,
    "estimate.state.sigma_heading": WAVE,
    "estimate.state.fix.nis": WAVE,
    "estimate.valid": WAVE > 0,
    "law.demand.FX": 3 * WAVE,
    "law.mode": (WAVE > 0).astype(np.int32),
}


def test_lines_match_the_noted_rms_errors(tmp_path):
    """The log has rows between the steps; the truth is that of the steps."""
    fine = np.arange(0, ms(400), ms(1))
    whole = log(fine, **{"truth.heading": np.sin(40 * to_seconds(fine))})
    replayed = log(**(RECORDED | {"estimate.state.heading": WAVE - 0.2}))
    figure = plot_replay(whole, log(**RECORDED), replayed, tmp_path / "replay.png")
    values, errors, demand, difference = figure.axes
    lines = {to_hex(line.get_color()).upper(): line.get_ydata() for line in values.lines}
    np.testing.assert_array_equal(lines[GREY.upper()], np.sin(40 * to_seconds(T)))
    np.testing.assert_array_equal(lines[BLUE.upper()], WAVE + 0.1)
    np.testing.assert_array_equal(lines[VERMILION.upper()], WAVE - 0.2)
    np.testing.assert_allclose(errors.lines[0].get_ydata(), 0.1, atol=1e-12)
    np.testing.assert_allclose(errors.lines[1].get_ydata(), -0.2, atol=1e-12)
    assert errors.get_title("right") == "rms recorded 0.1, replayed 0.2"
    assert demand.get_title("left") == "law.demand.FX"
    assert difference.get_title("right") == "rms 0"
    assert imread(tmp_path / "replay.png").std() > 0.05


def test_compares_only_real_signals_in_both_logs():
    assert common_signals(log(**RECORDED), log(**RECORDED)) == ["estimate.state.heading", "law.demand.FX"]
    fewer = {p: v for p, v in RECORDED.items() if "heading" not in p}
    assert common_signals(log(**RECORDED), log(**fewer)) == ["law.demand.FX"]


def test_rejects_logs_without_common_signals():
    with pytest.raises(InputError, match="in common"):
        plot_replay(log(**RECORDED), log(**RECORDED), log(**{"estimate.other": WAVE}))


def test_declared_heading_is_plotted_in_degrees():
    declared = {"estimate.state.heading": Quantity("rad", "For the picture.", kind="angle")}
    recorded = Log(to_seconds(T), T, RECORDED, declared)
    values, errors, *_ = plot_replay(
        log(**{"truth.x": WAVE}), recorded, log(**RECORDED | {"estimate.state.heading": WAVE + 0.3})
    ).axes
    assert (values.get_ylabel(), errors.get_ylabel()) == ("deg", "deg")
    np.testing.assert_allclose(errors.lines[0].get_ydata(), np.degrees(0.2))
    np.testing.assert_allclose(values.lines[0].get_ydata(), np.degrees(WAVE + 0.1))
