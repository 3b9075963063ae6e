"""Pictures of searches show the results of the searches."""

import numpy as np
import pytest

from trimtab.analysis.campaign.search.comparison import compare
from trimtab.analysis.campaign.search.falsify import FalsificationResult
from trimtab.analysis.campaign.search.tune import TuningResult
from trimtab.analysis.campaign.search.tune_methods import TuningStep
from trimtab.analysis.campaign.workers.prepare import CampaignPlan
from trimtab.plots.search import plot_falsify, plot_tune


def found(least):
    rng = np.random.default_rng(0)
    points, tried = rng.random((40, 2)), rng.uniform(0.2, 0.9, (40, 4))
    tried[30, 2] = least
    stages = np.repeat([-1, 0, 1, 2], 10)
    names = ("world.vehicle.mass", "autopilot.law.k1")
    return FalsificationResult(
        CampaignPlan("a"), least, {}, points[30], 2, {}, 160, None, tried, points, stages, names, 1.0
    )


@pytest.mark.thorough("-0.25-failure, margin -0.25")
@pytest.mark.parametrize(
    ("least", "said"), [(-0.25, "failure, margin -0.25"), (0.1, "no failure; smallest margin 0.1")]
)
def test_falsify_plot_shows_best_margin_and_worst_point(tmp_path, least, said):
    made = found(least)
    figure = plot_falsify(made, tmp_path / "worst.png", title="a search")
    assert (tmp_path / "worst.png").stat().st_size > 5000
    assert figure.get_suptitle() == f"a search: {said}"
    left, right = figure.axes
    (so_far,) = [line for line in left.lines if line.get_label() == "smallest so far"]
    assert so_far.get_ydata()[-1] == least
    assert so_far.get_xdata()[-1] == 160
    assert np.array_equal(right.lines[-1].get_xdata(), made.point)
    assert [label.get_text() for label in right.get_yticklabels()] == ["mass", "k1"]


@pytest.mark.thorough("search")
@pytest.mark.parametrize("method", ["search", "gradient"])
def test_tuning_plot_shows_steps_and_intervals(tmp_path, method):
    rng = np.random.default_rng(1)
    before = rng.random(50)
    seen, held = compare(before, before - 0.3 + 0.01 * rng.random(50)), compare(before, before + 0.1)
    steps = [TuningStep(64 * i, 1 / i, np.array([0.1 * i])) for i in range(1, 6)]
    gains = {"autopilot.law.k1": 1.0}, {"autopilot.law.k1": 2.5}
    made = TuningResult(CampaignPlan("a"), method, {}, *gains, steps, [], seen, held, 320, 1.0)
    figure = plot_tune(made, tmp_path / "tune.png", title="a tuning")
    assert (tmp_path / "tune.png").stat().st_size > 5000
    assert figure.get_suptitle() == "a tuning: NO significant improvement in runs not used for tuning"
    cost, gain, worth = figure.axes
    assert np.allclose(cost.lines[0].get_ydata(), [1, 1 / 2, 1 / 3, 1 / 4, 1 / 5])
    assert np.allclose(gain.lines[0].get_ydata(), [0.1, 0.2, 0.3, 0.4, 0.5])
    assert gain.get_legend().get_texts()[0].get_text() == "k1: 1 → 2.5"
    middles = [float(bar.lines[0].get_ydata()[0]) for bar in worth.containers]
    assert middles == pytest.approx([seen.difference, held.difference])


def test_tuning_plot_counts_runs_with_infinite_cost(tmp_path):
    lost = compare(np.array([1.0, np.inf, 2.0]), np.array([0.5, 1.0, 3.0]))
    made = TuningResult(
        CampaignPlan("a"),
        "search",
        {},
        {"k": 1.0},
        {"k": 1.0},
        [TuningStep(1, 1.0, np.zeros(1))],
        [],
        lost,
        lost,
        1,
        1.0,
    )
    texts = [t.get_text() for t in plot_tune(made).axes[2].texts]
    assert texts == ["2 better\n1 worse"] * 2
