"""Plans are free of collisions, keep the limits, and are repeated by another integrator."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from trimtab.core.errors import InputError
from trimtab.design.obstacles import ObstacleFloor, PlanTask, read_task
from trimtab.loop.reference_text import parse_reference
from trimtab.run.planner import ARRIVED, KEEP, LAW, plan_path

HALL = Path(__file__).parents[2] / "examples" / "hall.toml"
EMPTY = ObstacleFloor((-4, 4), (-4, 4), np.zeros((0, 3)))
ARM = 0.096 / (2.6 * 0.32)
STATE = ("surge_velocity", "sway_velocity", "yaw_rate", "heading", "north", "east")


@pytest.fixture(scope="module")
def hall():
    task = read_task(HALL)
    return task, plan_path(task)


def check_plan(task, plan, file):
    """Check the plan as flown and as read from its table: no collision at any millisecond, and arrival."""
    flown = plan.flown
    places = np.column_stack([flown["north"], flown["east"]])
    fine = np.linspace(0, len(places) - 1, 20 * len(places))
    between = np.column_stack([np.interp(fine, np.arange(len(places)), p) for p in places.T])
    assert task.floor.clearance(between).min() >= task.radius + KEEP - 1e-3
    assert flown["thrust"].max() <= LAW.push + 1e-12
    assert flown["thrust"].min() >= -LAW.pull - 1e-12
    assert np.abs(flown["force_angle"]).max() <= LAW.deflection + 1e-12
    assert np.abs(np.diff(flown["thrust"])).max() <= LAW.thrust_rate * 0.02 + 1e-12
    assert np.abs(np.diff(flown["force_angle"])).max() <= LAW.angle_rate * 0.02 + 1e-12
    file.write_text(plan.table())
    path = parse_reference(str(file))
    for t in np.linspace(0, plan.times[-1], 400):
        point = path.at(t)
        nose = np.array([np.cos(point.heading), np.sin(point.heading)])
        assert task.floor.clearance([np.asarray(point.place) - ARM * nose])[0] >= task.radius
    assert np.hypot(*(plan.places[-1] - task.goal)) < ARRIVED[0]


@pytest.mark.thorough
def test_plan_crosses_the_hall_without_collision(hall, tmp_path):
    task, plan = hall
    check_plan(task, plan, tmp_path / "plan.csv")
    np.testing.assert_allclose(plan.places[0], task.start, atol=1e-9)
    assert plan.length < 18


@pytest.mark.thorough
def test_planned_inputs_reproduce_the_planned_flight(hall):
    """The thesis' equations by scipy, with the logged inputs held, from the first state to the last."""
    _, plan = hall
    flown = plan.flown

    def rate(t, x, FX, FY):
        u, v, r, heading = x[:4]
        c, s = np.cos(heading), np.sin(heading)
        return [v * r + FX / 2.6, -u * r + FY / 2.6, -0.32 * FY / 0.096, r, c * u - s * v, s * u + c * v]

    x = np.array([flown[name][0] for name in STATE])
    for k in range(len(flown["time"]) - 1):
        f, angle = flown["thrust"][k], flown["force_angle"][k]
        force = f * np.cos(angle), -f * np.sin(angle)
        x = solve_ivp(rate, (0, 0.02), x, args=force, rtol=1e-9, atol=1e-10).y[:, -1]
    np.testing.assert_allclose(x, [flown[name][-1] for name in STATE], atol=1e-5)


@pytest.mark.thorough
def test_plan_turns_a_misaligned_start_heading(tmp_path):
    task = PlanTask(EMPTY, (-2, -2), (2, 2), 0.35, heading=2.4)
    plan = plan_path(task)
    assert plan.flown["heading"][0] == pytest.approx(2.4)
    check_plan(task, plan, tmp_path / "plan.csv")


@pytest.mark.thorough
@pytest.mark.timeout(1800)
def test_plans_on_random_floors_are_valid(tmp_path):
    """Each floor is planned, or rejected for its route or its flight; every plan is valid."""
    rng = np.random.default_rng(5)
    planned = 0
    for _ in range(8):
        circles = np.column_stack([rng.uniform(-2.5, 2.5, (4, 2)), rng.uniform(0.2, 0.8, 4)])
        task = PlanTask(EMPTY._replace(circles=circles), (-3.3, -3.3), (3.3, 3.3), 0.35, rng.uniform(-np.pi, np.pi))
        try:
            plan = plan_path(task)
        except InputError:
            continue
        check_plan(task, plan, tmp_path / "plan.csv")
        planned += 1
    print(f"{planned} of 8 floors planned")
    assert planned >= 6


def test_rejects_a_floor_without_a_route():
    low = np.array([[-0.1, -4], [0.1, -4], [0.1, -0.3], [-0.1, -0.3]])
    task = PlanTask(EMPTY._replace(polygons=(low, low * [1, -1])), (-2, 0), (2, 0), 0.4)
    with pytest.raises(InputError, match=r"no route for a craft of radius 0\.4 m"):
        plan_path(task)


@pytest.mark.thorough
def test_rejects_a_route_that_cannot_be_flown():
    """A gap with 6 cm on either side: the tail swings out further."""
    low = np.array([[-1.0, -4], [1.0, -4], [1.0, -0.37], [-1.0, -0.37]])
    task = PlanTask(EMPTY._replace(polygons=(low, low * [1, -1])), (-3, -3), (3, -3), 0.3)
    with pytest.raises(InputError, match=r"flown within its limits, the craft .* 3 other tempos .* fail too"):
        plan_path(task)
