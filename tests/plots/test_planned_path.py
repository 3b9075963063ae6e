"""The picture of a plan shows the floor, every obstacle, the way and the flight, and the limits that were kept."""

import numpy as np
import pytest
from matplotlib.image import imread

from trimtab.design.obstacles import ObstacleFloor, PlanTask
from trimtab.plots.planned_path import plot_planned_path
from trimtab.run.planner import LAW, plan_path

TRIANGLE = np.array([[-3.0, 2], [-2, 2], [-2, 3]])
TASK = PlanTask(ObstacleFloor((-4, 4), (-4, 4), np.array([[0, -1.5, 0.5]]), (TRIANGLE,)), (-2, 0), (2, 0), 0.3)


@pytest.mark.thorough
def test_planned_path_shows_floor_flight_and_limits(tmp_path):
    plan = plan_path(TASK)
    figure = plot_planned_path(TASK, plan, tmp_path / "plan.png", title="hall")
    floor, thrust, angle, _ = figure.axes
    kinds = [type(patch).__name__ for patch in floor.patches]
    assert kinds.count("Polygon") == 1
    assert kinds.count("Circle") == 1 + len(range(0, len(plan.flown["time"]), 50))
    labels = {line.get_label(): line for line in floor.lines}
    named = [text.get_text() for text in floor.get_legend().get_texts()]
    assert named == ["searched path", "flight, centre of mass", "nose", "start", "goal"]
    np.testing.assert_array_equal(labels["flight, centre of mass"].get_xdata(), plan.flown["east"])
    assert (labels["goal"].get_xdata()[0], labels["goal"].get_ydata()[0]) == (0, 2)
    for axes, most in ((thrust, LAW.push), (angle, LAW.deflection)):
        assert any(np.ptp(line.get_ydata()) == 0 and line.get_ydata()[0] == most for line in axes.lines)
    assert imread(tmp_path / "plan.png").shape[1] > 800
