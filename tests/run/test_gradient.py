"""Gradients of whole runs in C against differences of JAX runs, for runs without mode switches."""

import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.record import leaves, replace, with_leaf
from trimtab.core.time import seconds, to_seconds
from trimtab.run.gradient import gradient, gradients
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
PATHS = ("autopilot.law.k1", "autopilot.law.k2", "world.vehicle.mass", "initial.yaw_rate")


def cost(s):
    return s.truth.yaw_rate**2 + 0.5 * s.truth.sway_velocity**2


def four_costs(s):
    return jnp.full(4, s.truth.yaw_rate**2)


@pytest.fixture(scope="module")
def ideal():
    scenario, _ = catalogue.load_scenario("hovercraft/zero-velocity")
    return replace(scenario.ideal(), duration=seconds(4))


def integral(scenario):
    log = simulate(scenario, backend="jax")
    running = log["truth.yaw_rate"] ** 2 + 0.5 * log["truth.sway_velocity"] ** 2
    return float((running * np.diff(np.append(log.t, to_seconds(scenario.duration)))).sum())


@pytest.mark.thorough
def test_cost_equals_the_integral_over_the_log(ideal):
    assert gradient(ideal, cost, PATHS[:1]).cost == pytest.approx(integral(ideal), rel=1e-12)


@pytest.mark.parametrize("path", PATHS)
def test_gradient_matches_central_differences(ideal, path):
    found = gradient(ideal, cost, PATHS)
    value = float({p: v for p, v, _ in leaves(ideal)}[path])
    h = 1e-5 * max(abs(value), 1.0)
    high, low = (integral(with_leaf(ideal, path, lambda old, d, s=s: value + s * h)) for s in (1, -1))
    assert found.slope[path] == pytest.approx((high - low) / (2 * h), rel=1e-6, abs=1e-8)


def test_cost_integral_starts_at_its_start_time(ideal):
    """Against sums over the log from the first instant at or after the start time."""
    since = tuple(int(seconds(s)) for s in (0, 1, 1.00005, 3.999))
    along = [("autopilot.law.k1", ())]
    found = gradients(ideal, four_costs, along, seeds=[0], runs=[0], since=since)
    log = simulate(ideal, backend="jax")
    steps = np.diff(np.append(log.ticks, ideal.duration)) * 1e-7
    for cost_since, first in zip(found.costs[0], since, strict=True):
        assert cost_since == pytest.approx((log["truth.yaw_rate"] ** 2 * steps)[log.ticks >= first].sum(), rel=1e-9)


@pytest.mark.thorough
def test_gradient_is_finite_for_a_scenario_with_imperfections():
    scenario, _ = catalogue.load_scenario("hovercraft/zero-velocity")
    found = gradient(replace(scenario, duration=seconds(1)), cost, ("autopilot.law.k2",))
    assert np.isfinite(found.cost)
    assert np.isfinite(found.slope["autopilot.law.k2"])


@pytest.mark.parametrize("paths", [(), ("autopilot.law.k3",), ("key.seed",)])
def test_rejects_paths_that_are_not_real_parameters(ideal, paths):
    with pytest.raises(InputError, match="parameter"):
        gradient(ideal, cost, paths)
