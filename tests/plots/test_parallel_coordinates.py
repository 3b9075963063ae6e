"""Runs drawn as lines through their parameters."""

import numpy as np
import pytest
from matplotlib.image import imread

from trimtab.core.errors import InputError
from trimtab.plots.campaign import MOST_LINES, plot_parallel, short_names
from trimtab.plots.style import thin_rows

RNG = np.random.default_rng(0)


def test_failures_are_drawn_on_top_and_successes_are_thinned(tmp_path):
    a, b = RNG.normal(size=5000), RNG.uniform(2, 3, size=5000)
    success = np.arange(5000) % 100 > 0
    figure = plot_parallel(
        {"v.a": a, "v.b": b, "fixed": np.full(5000, 7.0)},
        success,
        tmp_path / "p.png",
        "Title",
        units={"v.a": "kg", "fixed": "1"},
    )
    axes = figure.axes[0]
    good, bad = axes.collections
    assert (len(good.get_segments()), len(bad.get_segments())) == (MOST_LINES, 50)
    assert bad.get_zorder() > good.get_zorder()
    assert [t.get_text() for t in figure.legends[0].get_texts()] == [
        "4950 succeeded, 400 of them drawn",
        "50 failed",
    ]
    places = np.array([segment[:, 1] for segment in bad.get_segments()])
    rows = np.flatnonzero(~success)
    np.testing.assert_allclose(places[:, 0], (a[rows] - a.min()) / np.ptp(a))
    np.testing.assert_allclose(places[:, 2], 0.5)
    written = [t.get_text() for t in axes.texts]
    assert f"{a.max():.3g}" in written
    assert [t.get_text() for t in axes.get_xticklabels()] == ["a (kg)", "b", "fixed"]
    assert imread(tmp_path / "p.png").shape == (520, 1000, 4)


def test_campaign_without_failures_is_drawn(tmp_path):
    plot_parallel({"a": [1.0, 2.0]}, [True, True], tmp_path / "p.png")


def test_thinned_rows_are_evenly_spaced():
    rows = thin_rows(np.arange(1000), 10)
    np.testing.assert_array_equal(rows, [0, 111, 222, 333, 444, 555, 666, 777, 888, 999])
    np.testing.assert_array_equal(thin_rows(np.arange(5), 10), np.arange(5))


def test_parameter_names_are_shortened_while_unique():
    assert short_names(["a.b.mass", "a.b.gain"]) == ["mass", "gain"]
    assert short_names(["up.delay", "down.delay", "x"]) == ["up.delay", "down.delay", "x"]
    assert short_names(["a", "a"]) == ["a", "a"]


@pytest.mark.parametrize("parameters", [{}, {"a": [1.0]}, {"a": [1.0, np.nan]}])
def test_rejects_missing_or_invalid_parameters(parameters):
    with pytest.raises(InputError):
        plot_parallel(parameters, [True, False])
