"""Routes keep their clearance, rest at both ends and are short; a gap that is too narrow is measured."""

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.design.obstacles import ObstacleFloor, PlanTask
from trimtab.design.route import GRID, MARGINS, Tempo, find_route

EMPTY = ObstacleFloor((-4, 4), (-4, 4), np.zeros((0, 3)))


def wall(gap):
    """Across the floor at north 0, but for a gap of that width at east 0."""
    low, high = np.array([[-0.1, -4], [0.1, -4], [0.1, -gap / 2], [-0.1, -gap / 2]]), np.array([1, -1])
    return EMPTY._replace(polygons=(low, low * high))


def task(floor, radius=0.4, start=(-2, -2), goal=(2, 2)):
    return PlanTask(floor, start, goal, radius)


def check_way(task, route, tempo=None):
    tempo = tempo or Tempo()
    assert task.floor.clearance(route.places).min() >= task.radius + route.margin - 0.03
    np.testing.assert_allclose(route.places[[0, -1]], [task.start, task.goal], atol=1e-9)
    step, dt = np.hypot(*np.diff(route.places, axis=0).T), np.diff(route.times)
    assert (dt > 0).all()
    speed = step / dt
    assert speed.max() <= tempo.speed * (1 + 1e-9)
    pull = np.diff(speed) / ((dt[1:] + dt[:-1]) / 2)
    assert np.abs(pull).max() <= tempo.along * 1.3


def test_route_on_empty_floor_is_straight():
    route = find_route(task(EMPTY))
    check_way(task(EMPTY), route)
    length = np.hypot(*np.diff(route.places, axis=0).T).sum()
    assert length == pytest.approx(np.sqrt(32), rel=1e-3)


@pytest.mark.thorough
def test_routes_on_random_floors_keep_clearance():
    """Every route that is found keeps its clearance; a floor without a route is rejected."""
    rng = np.random.default_rng(4)
    refused = 0
    for _ in range(12):
        circles = np.column_stack([rng.uniform(-3, 3, (6, 2)), rng.uniform(0.2, 0.9, 6)])
        given = task(EMPTY._replace(circles=circles), 0.3, (-3.5, -3.5), (3.5, 3.5))
        try:
            check_way(given, find_route(given))
        except InputError:
            refused += 1
    assert refused < 6


@pytest.mark.parametrize("gap", [0.5, 0.7])
def test_narrow_gap_error_reports_the_gap_width(gap):
    with pytest.raises(InputError, match=r"no route for a craft of radius 0\.4 m: the widest passage is") as refusal:
        find_route(task(wall(gap)))
    widest = float(str(refusal.value).split("widest passage is ")[1].split()[0])
    assert widest == pytest.approx(gap, abs=2 * GRID)
    assert f"{2 * (0.4 + MARGINS[-1]):.2f} m are needed" in str(refusal.value)


def test_route_passes_gap_with_reduced_margin():
    given = task(wall(1.2))
    route = find_route(given)
    check_way(given, route)
    assert route.margin < MARGINS[0]


def test_closed_wall_reports_zero_passage_width():
    with pytest.raises(InputError, match=r"the widest passage is 0.00 m"):
        find_route(task(EMPTY._replace(polygons=(np.array([[-0.1, -4.5], [0.1, -4.5], [0.1, 4.5], [-0.1, 4.5]]),))))


@pytest.mark.parametrize(
    ("start", "goal", "says"),
    [((-3.9, 0), (2, 2), "the start -3.9 0 is 0.10 m from"), ((-2, -2), (5, 0), "the goal 5 0 lies in an obstacle or")],
)
def test_rejects_start_or_goal_without_clearance(start, goal, says):
    with pytest.raises(InputError, match=says):
        find_route(task(EMPTY, start=start, goal=goal))


@pytest.mark.parametrize(
    ("floor", "goal", "says"),
    [
        (EMPTY, (-2, -2.01), "start and goal are less than 5 cm apart"),
        (EMPTY._replace(north=(-4000, 4000)), (2, 2), "8000 m by 8 m is too large: at most 10000"),
    ],
)
def test_rejects_a_route_without_length_and_a_huge_floor(floor, goal, says):
    with pytest.raises(InputError, match=says):
        find_route(task(floor, goal=goal))
