"""Inverse dynamics of a path, checked by the equations of motion; infeasible paths and suggested fixes."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.integrate import rk4
from trimtab.core.record import replace
from trimtab.core.reference import Circle, FigureEight, interpolate_path, pass_waypoints
from trimtab.core.rotation import DEG
from trimtab.core.signals import PlanarForce
from trimtab.laws.path_feasibility import ThrustLimits, path_motion, refuse_infeasible
from trimtab.scenarios import catalogue
from trimtab.vehicles.hovercraft import Friction, Hovercraft, HovercraftState

PLANT, LIMITS = Hovercraft(), ThrustLimits()
A = float(PLANT.percussion_arm)
DRAG = Hovercraft(friction=Friction(force_viscous=0.3, force_quadratic=0.2, torque_viscous=0.02))
PATHS = {
    "circle": (Circle(ease=0.0), PLANT),
    "eight": (FigureEight(ease=0.0), PLANT),
    "circle with drag": (Circle(ease=0.0), DRAG),
}


@pytest.mark.thorough
@pytest.mark.parametrize("name", PATHS)
def test_open_loop_forces_follow_the_path(name):
    """Open loop, from the initial state of the path: no feedback corrects a wrong force."""
    path, plant = PATHS[name]
    motion = path_motion(path, plant, 20.0)
    k, seconds = 200, 12.0  # away from the ends, where slopes are taken one-sided
    begin = float(motion.t[k])
    heading, rate = float(motion.heading[k]), float(motion.yaw_rate[k])
    point = path.at(begin)
    n, b = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
    place = point.place - A * n
    x = HovercraftState(n @ point.velocity, b @ point.velocity - A * rate, rate, place[0], place[1], heading)

    def rates(t, x):
        force = PlanarForce(jnp.interp(t, motion.t, motion.FX), jnp.interp(t, motion.t, motion.FY))
        return plant.dynamics(t, x, force)

    def tick(x, t):
        return rk4(rates, t, x, 0.02), None

    end, _ = jax.jit(lambda x: jax.lax.scan(tick, x, begin + 0.02 * jnp.arange(round(seconds / 0.02))))(x)
    wanted = path.at(begin + seconds)
    reached = np.array([end.north, end.east]) + A * np.array([np.cos(end.heading), np.sin(end.heading)])
    assert np.hypot(*(reached - wanted.place)) < (0.02 if plant is PLANT else 0.05)
    np.testing.assert_allclose(end.heading, motion.heading[k + round(seconds / 0.02)], atol=0.03)


@pytest.mark.thorough
def test_circle_needs_the_centripetal_force():
    """FX = m w^2 (R + a), no FY, and the nose looks at the centre."""
    motion = path_motion(Circle(radius=1.5, period=15.0, ease=0.0), PLANT, 30.0)
    w = 2 * np.pi / 15
    np.testing.assert_allclose(motion.FX, 2.6 * w**2 * (1.5 + A), rtol=1e-6)
    np.testing.assert_allclose(motion.FY, 0.0, atol=1e-6)
    np.testing.assert_allclose(motion.yaw_rate, w, rtol=1e-6)
    np.testing.assert_allclose(np.cos(motion.heading), -np.cos(w * motion.t), atol=1e-6)


REFUSED = {
    "fast circle": (Circle(radius=1.5, period=8.0), r"2\.60 N forward, but the maximum is 1\.30 N"),
    "wide eight": (FigureEight(length=4.0, width=2.0, period=40.0), "N to the side with .* the rudder turns the force"),
    "backing too hard": (FigureEight(length=6.0, width=1.5, period=25.0), "N backward, but the maximum is 0.60 N"),
    "quick small circle": (Circle(radius=0.02, period=3.93, ease=20.0), "the nose has to turn at 1.60 rad/s"),
    "slow large circle": (Circle(radius=20.0, period=260.0, ease=60.0), "thrust in the dead zone, below 0.05 N"),
    "fast way-points": (
        pass_waypoints([[0, 0], [3, 0], [3, 3], [0, 4]], 0.9),
        "N to the side with 0.07 N along the nose",
    ),
}


@pytest.mark.thorough
@pytest.mark.parametrize("name", REFUSED)
def test_rejects_infeasible_paths_with_time_and_fix(name):
    path, problem = REFUSED[name]
    with pytest.raises(InputError, match=problem) as refused:
        refuse_infeasible(path, PLANT, LIMITS, 90.0)
    error = refused.value
    assert error.part == "reference"
    assert re.search(r"at \d+\.\d s", error.problem)
    assert error.fix


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("north", "when"),
    [(lambda t: 0.1 * t**3 / 400, 20), (lambda t: 2 - 0.1 * (20 - t) ** 3 / 400, 0)],
    ids=["ends at full speed", "begins at full speed"],
)
def test_rejects_a_reference_that_does_not_begin_and_end_at_rest(north, when):
    """A straight path of 20 s whose speed rises from zero to 0.3 m/s, or falls from 0.3 m/s to zero."""
    t = np.linspace(0, 20, 11)
    path = interpolate_path(t, np.column_stack([north(t), 0 * t]))
    with pytest.raises(InputError, match=rf"at {when}.0 s the velocity of the reference jumps by 0.30 m/s") as refused:
        refuse_infeasible(path, PLANT, LIMITS, 40.0)
    assert "begin and end at rest" in refused.value.fix


@pytest.mark.thorough
def test_suggested_fix_is_feasible_and_near_the_limit():
    """The suggested period is within 5 % of the shortest feasible one."""
    path = Circle(radius=1.5, period=8.0)
    with pytest.raises(InputError) as refused:
        refuse_infeasible(path, PLANT, LIMITS, 40.0)
    values = {name: float(v) for name, v in re.findall(r'reference\.(\w+)": "([\d.]+)', refused.value.fix)}
    refuse_infeasible(replace(path, **values), PLANT, LIMITS, 80.0)
    least = 2 * np.pi * np.sqrt(2.6 * (1.5 + A) / (0.8 * 1.3))
    assert values["period"] == pytest.approx(least, rel=0.05)
    assert values["period"] >= least


@pytest.mark.thorough
def test_path_without_period_suggests_a_slowdown_factor():
    with pytest.raises(InputError, match=r"make the reference 1\.\d\d times slower") as refused:
        refuse_infeasible(REFUSED["fast way-points"][0], PLANT, LIMITS, 40.0)
    factor = float(re.search(r"([\d.]+) times slower", refused.value.fix)[1])
    refuse_infeasible(pass_waypoints([[0, 0], [3, 0], [3, 3], [0, 4]], 0.9 / factor), PLANT, LIMITS, 40.0 * factor)


@pytest.mark.thorough
def test_path_infeasible_at_any_tempo_suggests_enlarging():
    zigzag = interpolate_path(np.arange(12) * 0.5, [[k % 2 * 0.3, k * 0.02] for k in range(12)])
    with pytest.raises(InputError, match="make the path larger"):
        refuse_infeasible(zigzag, PLANT, LIMITS, 5.0)


@pytest.mark.thorough("circle", "waypoints")
@pytest.mark.parametrize("reference", ["circle", "eight", "waypoints"])
def test_scenario_paths_are_feasible_within_the_actuator_limits(reference):
    scenario, _ = catalogue.load_scenario("hovercraft/track", {"reference": reference})
    law, allocation = scenario.autopilot.law, scenario.autopilot.allocation
    refuse_infeasible(law.reference, law.model, law.limits, 90.0)
    stops = np.array([allocation.rudder.angle_min, allocation.rudder.angle_max])
    angles = np.abs(np.asarray(allocation.geometry.force_angle(stops)))
    assert float(law.limits.angle) == pytest.approx(angles.min(), abs=0.1 * DEG)
    fan = allocation.thruster
    top = float(fan.speed_max_rpm)
    for limit, speed in ((law.limits.push, top), (law.limits.pull, -top)):
        least = min(abs(float(fan.force(speed, stop))) for stop in stops)
        assert float(limit) == pytest.approx(least, abs=0.01)
    assert float(law.limits.dead_zone) == float(allocation.dead_zone)
