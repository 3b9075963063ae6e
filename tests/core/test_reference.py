"""Reference paths: each derivative is that of the one before, splines go where they should, and C gives the same."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from trimtab.compiler.compiled_function import compile
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.interfaces import Reference
from trimtab.core.reference import (
    Circle,
    FigureEight,
    PiecewisePath,
    interpolate_path,
    pass_waypoints,
    retime,
)

CORNERS = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 3.0], [0.0, 4.0]])
PATHS = {
    "circle": Circle(radius=1.7, period=18.0, north=0.4, east=-0.3, start=0.7),
    "circle at once": Circle(ease=0.0, clockwise=False),
    "eight": FigureEight(axis=0.5, north=1.0),
    "waypoints": pass_waypoints(CORNERS, 0.4),
    "one leg": pass_waypoints(CORNERS[:2], 0.4),
    "headed": interpolate_path(np.arange(8.0), np.random.default_rng(2).normal(size=(8, 2)), np.arange(8) / 3),
}
ORDERS = ("place", "velocity", "acceleration", "jerk", "snap")


@pytest.mark.thorough("circle at once", "one leg", "headed")
@pytest.mark.parametrize("name", PATHS)
def test_derivatives_of_each_path_are_consistent(name):
    path = PATHS[name]
    assert isinstance(path, Reference)
    both = jax.jit(lambda t: jax.jvp(path.at, (t,), (1.0,)))
    for t in np.random.default_rng(1).uniform(0.1, 30, 40):
        point, rate = both(t)
        inside = not isinstance(path, PiecewisePath) or t < path.times[-1]
        for order, after in pairwise(ORDERS):
            if order == "place" or inside:
                np.testing.assert_allclose(getattr(rate, order), getattr(point, after), atol=1e-9, err_msg=order)


def test_circle_keeps_its_radius_and_starts_at_rest():
    path = PATHS["circle"]
    at = jax.jit(path.at)
    for t in (0.0, 5.0, 20.0, 47.0):
        point = at(t)
        assert np.hypot(*(point.place - np.array([0.4, -0.3]))) == pytest.approx(1.7)
    first, late, round_later = at(0.0), at(40.0), at(58.0)
    np.testing.assert_allclose([first.velocity, first.acceleration, first.jerk], 0, atol=1e-12)
    assert np.hypot(*late.velocity) == pytest.approx(2 * np.pi * 1.7 / 18)
    np.testing.assert_allclose(late.place, round_later.place, atol=1e-9)
    assert late.velocity[0] * (late.place[1] + 0.3) < 0  # clockwise from above: on the east side it goes south


@pytest.mark.thorough
def test_figure_eight_keeps_acceleration_direction_at_the_crossing():
    """Where the acceleration passes zero, its direction does not turn, so that no torque is needed without thrust."""
    path = FigureEight(length=4.0, width=2.0, period=40.0, ease=0.0)
    t = 10.0 + np.linspace(-0.2, 0.2, 9)
    a = np.array([path.at(x).acceleration for x in t])
    assert np.abs(a[4]).max() < 1e-12
    lines = np.unwrap(np.arctan2(a[:, 1], a[:, 0])[[0, 1, 2, 3, 5, 6, 7, 8]], period=np.pi)
    assert np.ptp(lines) < 1e-6  # the sine of twice the phase alone would turn by 3e-4
    places = np.array([path.at(x).place for x in np.linspace(0, 40, 400)])
    np.testing.assert_allclose(np.abs(places).max(0), [2.0, 1.0], rtol=3e-3)


@pytest.mark.thorough
def test_waypoint_path_passes_corners_and_ends_at_rest():
    path = pass_waypoints(CORNERS, (0.4, 0.3, 0.4))
    for t, corner in zip(path.times, [path.at(t).place for t in path.times], strict=True):
        assert np.hypot(*(CORNERS - corner).T).min() < 1e-9, t
    for end in (0.0, float(path.times[-1]) - 1e-9, 1e3):
        point = path.at(end)
        np.testing.assert_allclose([point.velocity, point.acceleration], 0, atol=1e-6)
    np.testing.assert_allclose(path.at(1e3).place, CORNERS[-1], atol=1e-12)
    one = pass_waypoints(CORNERS[:2], 0.4)
    fastest = max(float(one.at(t).velocity[0]) for t in np.linspace(0, float(one.times[-1]), 501)[:-1])
    assert fastest == pytest.approx(0.4, rel=1e-4)


def test_interpolated_path_matches_scipy_spline():
    t, x = np.linspace(0, 9, 12) ** 1.1, np.random.default_rng(4).normal(size=(12, 2))
    spline, path = make_interp_spline(t, x, k=5), interpolate_path(t, x)
    point_at = jax.jit(path.at)
    for at in np.random.default_rng(5).uniform(t[0], t[-1], 30):
        point = point_at(at)
        for order, name in enumerate(ORDERS):
            wanted = spline(at, order)
            np.testing.assert_allclose(getattr(point, name), wanted, rtol=1e-6, atol=1e-8 * 10**order)


def test_retimed_derivatives_follow_the_chain_rule():
    path = PATHS["eight"]

    def later(t):
        s, c = 0.3 * jnp.sin(t), 0.3 * jnp.cos(t)
        return retime(path.at(t + s), (1 + c, -s, -c, s))

    point, rate = jax.jit(lambda t: jax.jvp(later, (t,), (1.0,)))(7.0)
    for order, after in pairwise(ORDERS):
        np.testing.assert_allclose(getattr(rate, order), getattr(point, after), atol=1e-9)


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda: pass_waypoints([[0.0, 0.0]], 0.4), "at least two way-points"),
        (lambda: pass_waypoints([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0]], 0.4), "same position, 1 0"),
        (lambda: pass_waypoints(CORNERS, 0.0), "must be above 0"),
        (lambda: interpolate_path([0.0, 1.0, 1.0], np.zeros((3, 2)), rests=True), "determine a smooth path"),
        (lambda: interpolate_path([0.0, 1.0], np.zeros((2, 2))), "at least 6"),
        (lambda: PiecewisePath(np.array([0.0, 1.0, 0.5]), np.zeros((2, 6, 3))).check(), "times must increase"),
    ],
)
def test_rejects_invalid_path(make, problem):
    with pytest.raises(InputError, match=problem):
        make()


@pytest.mark.thorough("circle", "eight")
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
@pytest.mark.parametrize("name", ["circle", "eight", "waypoints"])
def test_compiled_path_matches_jax(name):
    path = PATHS[name]
    run = compile(lambda path, t: path.at(t), path, np.float64(0.0))
    at = jax.jit(path.at)
    for t in (0.0, 3.3, 11.0, 100.0):
        wanted, given = at(t), run(path, np.float64(t))
        for order in ORDERS:
            np.testing.assert_allclose(getattr(given, order), getattr(wanted, order), rtol=1e-12, atol=1e-12)
