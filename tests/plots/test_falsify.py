"""The picture of a search: its numbers are those of the result."""

import numpy as np
import pytest

from trimtab.campaign.search.falsify import FalsificationResult
from trimtab.campaign.workers.prepare import CampaignPlan
from trimtab.plots.falsify import plot_falsify


def found(least):
    rng = np.random.default_rng(0)
    points, tried = rng.random((40, 2)), rng.uniform(0.2, 0.9, (40, 4))
    tried[30, 2] = least
    stages = np.repeat([-1, 0, 1, 2], 10)
    names = ("world.vehicle.mass", "autopilot.law.k1")
    return FalsificationResult(
        CampaignPlan("a"), least, {}, points[30], 2, {}, 160, None, tried, points, stages, names, 1.0
    )


@pytest.mark.parametrize(("least", "said"), [(-0.25, "failure, margin -0.25"), (0.1, "no failure, least margin 0.1")])
def test_least_so_far_and_the_worst_point_are_drawn(tmp_path, least, said):
    made = found(least)
    figure = plot_falsify(made, tmp_path / "worst.png", title="a search")
    assert (tmp_path / "worst.png").stat().st_size > 5000
    assert figure.get_suptitle() == f"a search: {said}"
    left, right = figure.axes
    (so_far,) = [line for line in left.lines if line.get_label() == "least so far"]
    assert so_far.get_ydata()[-1] == least
    assert so_far.get_xdata()[-1] == 160
    assert np.array_equal(right.lines[-1].get_xdata(), made.point)
    assert [label.get_text() for label in right.get_yticklabels()] == ["mass", "k1"]
