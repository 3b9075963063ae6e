"""Receding horizon: limits, rates, holding, commands in transit, ideal flights, and an independent optimiser."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize

import trimtab
from trimtab.core.record import replace
from trimtab.core.reference import Circle, FigureEight, pass_waypoints
from trimtab.core.rng import key
from trimtab.core.signals import Estimate
from trimtab.laws.pose import READS
from trimtab.laws.receding_horizon import STAGES, RecedingHorizon
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

LAW = replace(RecedingHorizon(), lag=0.0)
ARM = 0.096 / (2.6 * 0.32)
MS = 10_000


def state_of(x):
    return HovercraftState(**dict(zip(READS, x, strict=True)))


def estimate_of(x, t=0, age=0.0, valid=True):
    return Estimate(t=t, age=age, fresh=True, valid=valid, state=state_of(x))


def at_rest(reference, heading):
    """Return the state (6,) in the order of READS, with P at the start of the reference."""
    place = np.asarray(reference.at(0.0).place) - ARM * np.array([np.cos(heading), np.sin(heading)])
    return np.array([0.0, 0.0, 0.0, heading, *place])


def tick(law, t, x, state, age=0.0, valid=True):
    """Step the law, then the vehicle for one millisecond (RK4) under its demand."""
    state, output = law.step(t, state, estimate_of(x, t, age, valid))

    def rate(x):
        dx = Hovercraft().dynamics(0.0, state_of(x), output.demand)
        return jnp.stack([getattr(dx, name) for name in READS])

    h = 1e-3
    k1 = rate(x)
    k2 = rate(x + h / 2 * k1)
    k3 = rate(x + h / 2 * k2)
    k4 = rate(x + h * k3)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), state, output


@cache
def flight(reference, period=1):
    """Return a compiled flight of one second, with a row each 20 ms."""

    def second(law, t, x, state):
        law = replace(law, reference=reference)

        def row(carry, _):
            def step(k, carry):
                t, x, state = carry
                x, state, _ = tick(law, t, x, state)
                return t + MS, x, state

            t, x, state = jax.lax.fori_loop(0, 20, step, carry)
            return (t, x, state), (x, state.output)

        return jax.lax.scan(row, (t, x, state), length=50)

    first = jax.tree.map(np.asarray, LAW.init(key(0)))
    return trimtab.compile(second, LAW, np.int64(0), np.zeros(6), first)


def fly(reference, x, seconds, law=LAW):
    """Return states (n, 6) and outputs each 20 ms."""
    carry = np.int64(0), np.asarray(x), jax.tree.map(np.asarray, law.init(key(0)))
    rows = []
    for _ in range(seconds):
        carry, row = flight(reference)(law, *carry)
        rows.append(row)
    return jax.tree.map(lambda *a: np.concatenate(a), *rows)


PATHS = {
    "circle": (Circle(), 0.05),
    "eight": (FigureEight(), 0.08),
    "waypoints": (pass_waypoints([(0, 0), (3, 0), (3, 3), (0, 4)], 0.4), 0.06),
}


SLOW = [pytest.param(name, marks=pytest.mark.thorough) for name in ("eight", "waypoints")]


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["circle", *SLOW])
def test_tracks_paths_within_force_and_rate_limits(name):
    """From any heading: on the path within 15 s, with thrust, angle and their rates always within the limits."""
    reference, near = PATHS[name]
    for heading in (0.0, 2.5):
        _, output = fly(reference, at_rest(reference, heading), 30)
        assert np.sqrt(np.mean(output.position_error[750:] ** 2)) < near
        assert output.thrust.max() <= LAW.push + 1e-12
        assert output.thrust.min() >= -LAW.pull - 1e-12
        assert np.abs(output.force_angle).max() <= LAW.deflection + 1e-12
        assert np.abs(np.diff(output.thrust)).max() <= 0.02 * LAW.thrust_rate + 1e-12
        assert np.abs(np.diff(output.force_angle)).max() <= 0.02 * LAW.angle_rate + 1e-12
        assert output.solved.mean() > 0.9
        np.testing.assert_allclose(output.demand.FX, output.thrust * np.cos(output.force_angle), rtol=1e-12)
        np.testing.assert_allclose(output.demand.FY, -output.thrust * np.sin(output.force_angle), rtol=1e-12)


@pytest.mark.thorough
def test_tighter_limits_are_respected():
    law = replace(LAW, push=0.5, pull=0.3, deflection=0.2, thrust_rate=1.0, angle_rate=0.5)
    _, output = fly(Circle(), at_rest(Circle(), 1.0), 10, law)
    assert output.thrust.max() <= 0.5 + 1e-12
    assert output.thrust.min() >= -0.3 - 1e-12
    assert np.abs(np.diff(output.thrust)).max() <= 0.02 + 1e-12
    assert np.abs(np.diff(output.force_angle)).max() <= 0.01 + 1e-12


@cache
def steps():
    """Return the compiled step of the law, with time and validity as arguments."""
    state = jax.tree.map(np.asarray, LAW.init(key(0)))
    step = lambda law, t, state, x, age, valid: law.step(t, state, estimate_of(x, t, age, valid))  # noqa: E731
    return trimtab.compile(step, LAW, np.int64(0), state, np.zeros(6), 0.0, True)


def first_state():
    return jax.tree.map(np.asarray, LAW.init(key(0)))


@pytest.mark.thorough
def test_demand_is_held_between_control_periods():
    x = at_rest(Circle(), 0.5)
    state, output = steps()(LAW, np.int64(0), first_state(), x, 0.0, True)
    for t in (1, 7, 19):
        held, same = steps()(LAW, np.int64(t * MS), state, x + 0.3, 0.0, True)
        assert jax.tree.leaves(same) == jax.tree.leaves(output)
        jax.tree.map(np.testing.assert_array_equal, held, state)
    _, other = steps()(LAW, np.int64(20 * MS), state, x + 0.3, 0.0, True)
    assert float(other.thrust) != float(output.thrust)


@pytest.mark.thorough
def test_reference_starts_with_the_first_valid_estimate():
    x, late = at_rest(Circle(), 0.0), np.int64(1234 * MS)
    state, _ = steps()(LAW, late, first_state(), x, 0.0, False)
    assert not state.began
    state, output = steps()(LAW, late, state, x, 0.0, True)
    assert state.began
    assert int(state.start) == int(late)
    np.testing.assert_allclose([output.north_reference, output.east_reference], [1.5, 0.0], atol=1e-12)


def test_nan_and_extreme_states_stay_within_the_limits():
    for x in (np.full(6, np.nan), np.full(6, 1e6), np.array([0, 0, 50.0, 0, 0, 0])):
        state, output = steps()(LAW, np.int64(0), first_state(), x, 0.0, True)
        assert -LAW.pull <= output.thrust <= LAW.push
        assert abs(output.force_angle) <= LAW.deflection
        assert np.isfinite(state.thrust).all()
        assert not (output.solved and np.isnan(x).any())


def test_state_is_predicted_over_commands_in_transit():
    """An old estimate with the commands sent since equals the state that they lead to."""
    rng = np.random.default_rng(2)
    sent = np.column_stack([rng.uniform(-20, 20, 8), rng.uniform(-0.3, 0.3, 8)])
    x = rng.normal(size=6)
    ahead = 0.13
    there = LAW._carry_on(jnp.asarray(x), jnp.asarray(sent), ahead)

    def rate(t, x, thrust, angle):
        u, v, r, heading = x[:4]
        FX, FY = thrust * np.cos(angle), -thrust * np.sin(angle)
        c, s = np.cos(heading), np.sin(heading)
        return [v * r + FX / 2.6, -u * r + FY / 2.6, -0.32 * FY / 0.096, r, c * u - s * v, s * u + c * v]

    wanted = np.array(x)
    for back, span in zip(range(6, -1, -1), [0.01, *[0.02] * 6], strict=True):
        wanted = solve_ivp(rate, (0, span), wanted, args=sent[back], rtol=1e-10, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(there, wanted, atol=1e-5)


def plan_cost(plan, x, law, before):
    """Return the cost of a plan in numpy: RK4 of the thesis' equations."""

    def rate(x, thrust, angle):
        u, v, r, heading = x[:4]
        FX, FY = thrust * np.cos(angle), -thrust * np.sin(angle)
        c, s = np.cos(heading), np.sin(heading)
        return np.array([v * r + FX / 2.6, -u * r + FY / 2.6, -0.32 * FY / 0.096, r, c * u - s * v, s * u + c * v])

    plan, cost, last, h = np.reshape(plan, (STAGES, 2)), 0.0, np.asarray(before), 0.2
    for k, move in enumerate(plan):
        k1 = rate(x, *move)
        k2 = rate(x + h / 2 * k1, *move)
        k3 = rate(x + h / 2 * k2, *move)
        k4 = rate(x + h * k3, *move)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        u, v, r, heading, north, east = x
        n, b = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
        p = law.reference.at((k + 1) * h)
        e = np.array([north, east]) + ARM * n - np.asarray(p.place)
        w = n * u + b * (v + ARM * r) - np.asarray(p.velocity)
        a, j = np.asarray(p.acceleration), np.asarray(p.jerk)
        push = a - law.k1 * e - law.k2 * w
        turning = (a[0] * j[1] - a[1] * j[0]) / (a @ a + law.least**2)
        aim = np.hypot(np.hypot(*push), 1e-3) * n - push
        square = law.position**2 * e @ e + law.velocity**2 * w @ w + law.alignment_weight**2 * aim @ aim
        square += law.yaw**2 * (r - turning) ** 2
        cost += (law.last**2 if k == STAGES - 1 else 1.0) * square
        cost += (law.effort * move[0]) ** 2 + (law.steering * move[1]) ** 2
        cost += (law.thrust_change * (move[0] - last[0])) ** 2 + (law.angle_change * (move[1] - last[1])) ** 2
        last = move
    return cost


@pytest.mark.thorough
@pytest.mark.timeout(1800)
def test_repeated_steps_converge_to_the_slsqp_optimum():
    """At one state and time the plan costs no more than the one of scipy's SLSQP, with the same start and limits."""
    law = replace(LAW, rounds=6, iterations=50, damping=1e-3)
    x, begin = at_rest(law.reference, 0.6) + np.array([0.1, 0.05, 0.1, 0, 0.05, -0.05]), 0.0
    before = np.array([0.1, 0.0])
    plan = np.column_stack([np.full(STAGES, 0.1), np.zeros(STAGES)])
    improve = trimtab.compile(lambda plan: improve_plan(law, x, begin, plan, before), plan)
    for _ in range(30):
        plan, cost = improve(plan)
    assert plan_cost(plan, x, law, before) == pytest.approx(float(cost), rel=1e-6)
    steps = np.append([law.thrust_rate * 0.02, law.angle_rate * 0.02], np.tile([8.0 * 0.2, 3.0 * 0.2], STAGES - 1))

    def changes(u):
        return np.ravel(u) - np.append(before, np.ravel(u)[:-2])

    limits = [
        {"type": "ineq", "fun": lambda u: steps - changes(u)},
        {"type": "ineq", "fun": lambda u: steps + changes(u)},
    ]
    bounds = [(-law.pull, law.push), (-law.deflection, law.deflection)] * STAGES
    found = minimize(plan_cost, plan.ravel(), (x, law, before), "SLSQP", bounds=bounds, constraints=limits, tol=1e-10)
    assert float(cost) <= found.fun * (1 + 1e-4)


def improve_plan(law, x, begin, plan, before):
    from trimtab.core.quadratic_program import first_start, solve_quadratic_program

    program, cost = law._program(x, begin, plan, before)
    start = first_start(2 * STAGES, 4 * STAGES)
    found = solve_quadratic_program(program, start, rounds=law.rounds, iterations=law.iterations)
    return plan + found.x.reshape(STAGES, 2), cost
