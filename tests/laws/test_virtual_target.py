"""Virtual target: the rate of V, convergence to the path, and infeasible paths."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.reference import Circle, FigureEight, pass_waypoints
from trimtab.core.signals import Estimate
from trimtab.laws.virtual_target import BEGIN, VirtualTarget, VirtualTargetState
from trimtab.run.simulate import simulate_batch
from trimtab.scenarios.build import build
from trimtab.scenarios.dubins.path import GOALS
from trimtab.vehicles.dubins_car import DubinsCar, DubinsCarState

NIMBLE = DubinsCar(speed=1.2, radius=1e-3)
"""Turns as tightly as it is told: with it the law is never at its limit."""
LAW = VirtualTarget(reference=FigureEight(ease=0.0), craft=NIMBLE)
RNG = np.random.default_rng(3)
CASES = [(DubinsCarState(*RNG.normal(0, [2, 2, 2])), RNG.uniform(0, 25)) for _ in range(12)]


def ask(law, x, progress, valid=True, dt=0.01):
    estimate = Estimate(t=0, age=0.0, fresh=True, valid=jnp.asarray(valid), state=x, stick=None, dt=dt)
    return law.step(0, VirtualTargetState(progress), estimate)


@pytest.mark.parametrize(
    ("x", "progress"), [*CASES[:3], *(pytest.param(*case, marks=pytest.mark.thorough) for case in CASES[3:])]
)
def test_lyapunov_rate_matches_the_proof(x, progress):
    """V' = -k1 a^2 - k2 q^2/g along the closed loop, from the car's equations alone."""
    new, out = ask(LAW, x, progress)
    rates = NIMBLE.dynamics(0.0, x, out.demand), (new.progress - progress) / 0.01
    start = jax.tree.map(jnp.asarray, (x, progress))
    _, slope = jax.jvp(lambda x, s: ask(LAW, x, s)[1].lyapunov, start, jax.tree.map(jnp.asarray, rates))
    a, q = float(out.along_track), float(out.heading_error)
    assert not out.saturated
    assert float(slope) == pytest.approx(-LAW.k1 * a**2 - LAW.k2 * q**2 / LAW.g, rel=1e-9, abs=1e-9)


CIRCLE = Circle(radius=2.0, period=12.0, ease=0.0)


def test_turn_rate_on_the_path_matches_the_curvature():
    """A quarter of the way around, heading south."""
    out = ask(replace(LAW, reference=CIRCLE), DubinsCarState(0.0, 2.0, np.pi), 3.0)[1]
    assert float(out.demand.turn_rate) == pytest.approx(1.2 / 2.0)
    assert [out.cross_track, out.along_track, out.heading_error] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


def test_steers_back_to_the_path_within_turn_limit():
    law = VirtualTarget(reference=CIRCLE)
    outside, far = (ask(law, DubinsCarState(0.0, e, np.pi), 3.0)[1] for e in (2.1, 4.0))
    assert outside.cross_track < 0  # to the left of a path that turns to the right
    assert outside.demand.turn_rate > 1.0 / 2.0
    assert far.saturated
    assert float(far.demand.turn_rate) == pytest.approx(1.0 / 0.8)


def test_path_is_extended_straight_before_its_start():
    """Before the start the target moves on the first tangent and does not turn."""
    law, x, w = replace(LAW, reference=CIRCLE), np.array([2.0, -3.0]), 2 * np.pi / 12
    angle, pace = w * BEGIN, 2.0 * w
    ahead, right = np.array([-np.sin(angle), np.cos(angle)]), -np.array([np.cos(angle), np.sin(angle)])
    target = 2.0 * np.array([np.cos(angle), np.sin(angle)]) + (-2.0 - BEGIN) * pace * ahead
    new, out = ask(law, DubinsCarState(*x, np.pi / 2 + angle), -2.0)
    assert [out.north_reference, out.east_reference] == pytest.approx(target, abs=1e-12)
    along, across = (x - target) @ ahead, (x - target) @ right
    assert [out.along_track, out.cross_track] == pytest.approx([along, across], abs=1e-12)
    assert float(out.demand.turn_rate) == pytest.approx(-law.g * across * 1.2, abs=1e-12)
    assert float(new.progress) == pytest.approx(-2.0 + 0.01 * (1.2 + law.k1 * along) / pace)
    away = ask(law, DubinsCarState(2.0, -1.0, -np.pi / 2), 0.0)[0]
    assert away.progress < 0.0


def test_invalid_estimate_holds_the_target():
    assert ask(LAW, CASES[0][0], 3.0, valid=False)[0].progress == 3.0


def drive(law, x, seconds, dt=0.05):
    """Return the car's state after the given time, and the last output of the law."""
    state = law.init(None)

    def step(x, state):
        estimate = Estimate(t=0, age=0.0, fresh=True, valid=jnp.asarray(True), state=x, stick=None, dt=dt)
        state, out = law.step(0, state, estimate)
        x = jax.tree.map(lambda v, d: v + dt * d, x, law.craft.dynamics(0.0, x, out.demand))
        return x, state, out

    step, out = jax.jit(step), None
    x, state = jax.tree.map(jnp.float64, (x, state))
    for _ in range(int(seconds / dt)):
        x, state, out = step(x, state)
    return x, out


def test_rest_to_rest_path_continues_straight_beyond_its_end():
    """A path that starts and ends at rest has a direction there: its first and its last direction of motion."""
    law = VirtualTarget(reference=pass_waypoints(((0.0, 0.0), (4.0, 0.0), (8.0, 3.0)), 0.5))
    x, out = drive(law, DubinsCarState(-1.0, 0.1, 0.0), 6.0)
    assert abs(float(out.cross_track)) < 0.02
    assert float(x.north) > 3.0
    x, out = drive(law, DubinsCarState(-1.0, 0.1, 0.0), 20.0)
    last = law.reference.at(law.reference.times[-1] - 0.1).velocity
    assert float(x.heading) == pytest.approx(float(np.arctan2(last[1], last[0])), abs=0.02)
    assert np.hypot(x.north - 8.0, x.east - 3.0) > 5.0
    assert abs(float(out.cross_track)) < 0.02
    assert out.along_track == 0.0


@pytest.mark.thorough
@pytest.mark.parametrize("runs", [100, pytest.param(1000, marks=pytest.mark.thorough)])
def test_car_converges_to_the_path_from_random_starts(runs):
    """From within 2 m of the start, at any heading."""
    rng = np.random.default_rng(5)
    spread = {f"initial.{name}": rng.uniform(-2, 2, runs) for name in ("north", "east")}
    spread["initial.heading"] = rng.uniform(-np.pi, np.pi, runs)
    batch = simulate_batch(build("dubins/path", {"duration": "20 s"}).ideal(), seeds=[0] * runs, spread=spread)
    north, east, heading = GOALS["LSR"]
    h = np.deg2rad(heading)
    across = np.cos(h) * (batch.final["truth.east"] - east) - np.sin(h) * (batch.final["truth.north"] - north)
    assert np.abs(across).max() < 2e-3  # off the line on which it goes on beyond the goal
    assert np.abs(np.sin(batch.final["truth.heading"] - h)).max() < 2e-3
    assert np.cos(batch.final["truth.heading"] - h).min() > 0


@pytest.mark.thorough
def test_rejects_a_path_with_too_tight_bends():
    tight = VirtualTarget(reference=Circle(radius=0.5, period=6.0, ease=0.0))
    with pytest.raises(InputError, match=r"radius at .* is 0\.50 m"):
        tight.check_duration(10.0)
    replace(tight, craft=DubinsCar(radius=0.5)).check_duration(10.0)
