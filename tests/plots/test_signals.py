"""Plots of any signals of a log: selection by path, and one panel per signal."""

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity
from trimtab.core.time import ms, to_seconds
from trimtab.logs.log import Log
from trimtab.plots.signals import plot_signals, select_paths
from trimtab.plots.style import CHATTER

TICKS = np.arange(50) * ms(20)


@pytest.fixture
def log():
    t = to_seconds(TICKS)
    signals = {"truth.x": np.sin(t), "truth.v": np.stack([t, -t], axis=1), "law.mode": np.zeros(50, np.int32)}
    return Log(t=t, ticks=TICKS, signals=signals, declarations={"truth.x": Quantity("m", "Where it is.")})


def test_selects_paths_components_and_wildcards_in_order(log):
    assert select_paths(log, ["law.mode", "truth.*", "truth.v[1]"]) == [
        "law.mode",
        "truth.x",
        "truth.v[0]",
        "truth.v[1]",
    ]


@pytest.mark.parametrize(
    ("wanted", "near"), [("truth.y", "truth.x"), ("truth", "truth.x"), ("nothing*", "truth.x")], ids=lambda word: word
)
def test_unknown_path_error_lists_similar_paths(wanted, near, log):
    with pytest.raises(InputError) as refused:
        select_paths(log, [wanted])
    assert near in refused.value.choices


def test_rejects_too_many_panels(log):
    wide = Log(t=log.t, ticks=TICKS, signals={"truth.q": np.zeros((50, 30))})
    with pytest.raises(InputError, match="too many"):
        select_paths(wide, ["truth.q"])


def test_draws_a_panel_per_signal_and_line_per_log(log, tmp_path):
    other = Log(t=log.t, ticks=TICKS, signals={"truth.x": np.cos(log.t)})
    figure = plot_signals({"a": log, "b": other}, ["truth.x", "law.mode"], tmp_path / "both.svg", title="both")
    assert [len(axis.lines) for axis in figure.axes] == [2, 1]
    assert figure.axes[0].get_ylabel() == "m"
    np.testing.assert_array_equal(figure.axes[0].lines[1].get_ydata(), np.cos(log.t))
    assert (tmp_path / "both.svg").read_text().startswith("<?xml")


def test_heading_is_in_degrees_and_chatter_is_noted():
    ticks = np.arange(20_000) * ms(1)
    signals = {"truth.heading": np.sin(to_seconds(ticks)), "law.sign": np.where(np.arange(20_000) % 2, 1.0, -1.0)}
    declared = {"truth.heading": Quantity("rad", "For the picture.", kind="angle")}
    heading, sign = plot_signals({"a": Log(to_seconds(ticks), ticks, signals, declared)}, list(signals)).axes
    assert heading.get_ylabel() == "deg"
    assert np.asarray(heading.lines[0].get_ydata()).max() == pytest.approx(np.degrees(1.0), rel=1e-6)
    assert not heading.collections
    assert heading.get_title("right") == ""
    assert sign.get_title("right") == f"pale, {CHATTER}"
    assert np.abs(sign.lines[0].get_ydata()).max() < 0.01
