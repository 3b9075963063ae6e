"""The picture of an error budget shows its measures and imperfections."""

import numpy as np

from trimtab.plots.error_budget import plot_error_budget
from trimtab.run.error_budget import Cost, ErrorBudget

DEAR = Cost("noise", {"yaw_rate": (0.1, 0.01), "x": (2.0, 0.0)}, {"yaw_rate": (0.4, 0.02), "x": (1.0, 0.1)})
CHEAP = Cost("delay", {"yaw_rate": (0.5, 0.01), "x": (2.0, 0.0)}, {"yaw_rate": (0.0, 0.0), "x": (0.0, 0.0)})
FOUND = ErrorBudget(
    {"yaw_rate": "rad/s", "x": "1"},
    {"yaw_rate": (0.5, 0.01), "x": (2.0, 0.1)},
    {"yaw_rate": (0.05, 0.0), "x": (0.0, 0.0)},
    (DEAR, CHEAP),
)


def test_draws_a_panel_per_measure_and_row_per_imperfection(tmp_path):
    figure = plot_error_budget(FOUND, tmp_path / "budget.png", title="a flight")
    assert (tmp_path / "budget.png").stat().st_size > 5000
    first, second = figure.axes
    assert (first.get_title(), first.get_xlabel(), second.get_xlabel()) == ("yaw rate", "rms (rad/s)", "rms")
    assert [label.get_text() for label in first.get_yticklabels()] == ["noise", "delay"]
    dots = [np.asarray(line.get_xdata()) for line in first.get_lines() if line.get_marker() == "o"]
    np.testing.assert_array_equal(dots, [[0.4, 0.0], [0.1, 0.5]])
    bars = [[end[0] for end in bar] for bars in first.collections for bar in bars.get_segments()]
    np.testing.assert_allclose(bars, [[0.36, 0.44], [0.0, 0.0], [0.08, 0.12], [0.48, 0.52]], atol=1e-12)  # two sigmas
    named = [text.get_text() for text in figure.legends[0].get_texts()]
    assert named == [
        "all imperfections",
        "all imperfections except this one",
        "only this imperfection",
        "no imperfection",
    ]
    low, high = first.get_ylim()
    assert low > high  # the dearest is at the top
