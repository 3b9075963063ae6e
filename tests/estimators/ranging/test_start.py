"""The closed-form start against numpy's least squares, and from situations that are exact."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.compiler.function import lower_function
from trimtab.core.record import replace
from trimtab.estimators.ranging import start as rs
from trimtab.estimators.ranging.range_errors import RangeErrorModel
from trimtab.estimators.ranging.tightly_coupled import TightlyCoupled, update_running

LEVERS = np.array([[0.2, 0.0], [-0.2, 0.0]])
LIMITS = {"enough": 4, "longest": 3.0, "heading_limit": 0.25}
W = np.eye(2) / 0.03**2


def turned(a, x):
    c, s = np.cos(a), np.sin(a)
    return np.array([c * x[0] - s * x[1], s * x[0] + c * x[1]])


@jax.jit
def _carried(start, dt, imu_reading):
    return rs.propagate_start(start, dt, imu_reading, imu_reading, jnp.zeros(3))


def fly(heading, rate, force, v, p, pings=4, noise=0.0, steps=50):
    """Places of two units in turn each 100 ms, felt constant in B; the start, and the truth at its end."""
    g = np.random.default_rng(5)
    start, dt = jax.tree.map(jnp.asarray, rs.empty_start()), 0.1 / steps
    state = np.array([heading, *v, *p])
    for k in range(pings):
        lever = LEVERS[k % 2]
        place = state[3:] + turned(state[0], lever) + noise * g.standard_normal(2)
        start = rs.add_unit_position(start, place, lever, W)
        if k == pings - 1:
            break
        for _ in range(steps):
            start = _carried(start, dt, np.array([rate, *force]))
            a = turned(state[0], force), turned(state[0] + rate * dt, force)
            state[3:] += state[1:3] * dt + dt * dt / 6 * (a[1] + 2 * a[0])
            state[1:3] += dt / 2 * (a[0] + a[1])
            state[0] += rate * dt
    return start, state


@pytest.mark.thorough
@pytest.mark.parametrize("heading", [-3.0, -1.0, 0.0, 2.0])
def test_four_pings_of_two_units_give_the_full_state(heading):
    """Turning and accelerating, from any heading: exact."""
    start, truth = fly(heading, -2.0, (0.3, -1.2), (0.4, -0.2), (1.0, 2.0))
    found = rs.solve_start(start, np.zeros(2), **LIMITS)
    assert found.usable
    np.testing.assert_allclose(found.x, truth, atol=1e-9)


@pytest.mark.thorough
def test_three_or_inconsistent_pings_give_no_start():
    start, _ = fly(0.5, 0.1, (0, 0), (0, 0), (0, 0), pings=3)
    assert not rs.solve_start(start, np.zeros(2), **LIMITS).usable
    start, _ = fly(0.5, 0.1, (0, 0), (0, 0), (0, 0), pings=8, noise=0.5)
    found = rs.solve_start(start, np.zeros(2), **LIMITS)
    assert not found.usable
    assert found.inconsistent


@pytest.mark.thorough
def test_start_covariance_is_consistent_over_400_starts():
    """Errors of 400 noisy starts against the reported covariance: NEES 5 of 5."""
    total = []
    start, truth = fly(0.7, 0.5, (0.2, 0.1), (0.1, 0.2), (1.0, 2.0), pings=6)
    found = jax.jit(lambda s: rs.solve_start(s, np.zeros(2), **LIMITS))
    C = np.linalg.inv(np.asarray(start.N))
    L = np.linalg.cholesky(C)
    g = np.random.default_rng(2)
    for _ in range(400):
        noisy = start.__class__(**{**vars_of(start), "g": start.g + np.asarray(start.N) @ (L @ g.standard_normal(6))})
        f = found(noisy)
        e = np.asarray(f.x) - truth
        total.append(e @ np.linalg.solve(np.asarray(f.P), e))
    assert np.mean(total) == pytest.approx(5, abs=0.7)


def vars_of(start):
    return {name: getattr(start, name) for name in start.__dataclass_fields__}


@pytest.mark.thorough
def test_bias_uncertainty_grows_with_elapsed_time():
    """A constant rate error turns by its time, a constant force error moves by half its time squared."""
    start, _ = fly(0.7, 0.0, (0, 0), (0.1, 0.2), (1.0, 2.0), pings=6)
    gyro, force, T = 0.02, 0.3, 0.5
    assert float(start.elapsed) == pytest.approx(T)
    known, unsure = (rs.solve_start(start, np.array(s), **LIMITS).P for s in ((0.0, 0.0), (gyro, force)))
    grown = np.diag(np.asarray(unsure) - np.asarray(known))
    wanted = [gyro * T, force * T, force * T, force * T**2 / 2, force * T**2 / 2]
    np.testing.assert_allclose(grown, np.square(wanted), rtol=1e-6)


@pytest.mark.thorough
def test_single_stationary_unit_needs_a_heading():
    start = jax.tree.map(jnp.asarray, rs.empty_start())
    for _ in range(5):
        start = rs.add_unit_position(start, np.array([1.0, 2.0]), np.zeros(2), W)
        start = _carried(start, 0.1, np.zeros(3))
    assert not rs.solve_start(start, np.zeros(2), **LIMITS).usable
    found = rs.solve_start(rs.add_heading(start, 0.6, 1e-4), np.zeros(2), **LIMITS)
    assert found.usable
    np.testing.assert_allclose(found.x, [0.6, 0, 0, 1, 2], atol=1e-9)


def test_start_is_not_propagated_before_the_first_ping():
    start = jax.tree.map(jnp.asarray, rs.empty_start())
    assert float(_carried(start, 0.1, np.ones(3)).elapsed) == 0.0
    assert float(rs.add_heading(start, 0.3, 1.0).N[4, 4]) == 0.0


@pytest.mark.thorough
def test_start_solution_lowers_to_generated_c():
    assert lower_function(lambda s: rs.solve_start(s, np.zeros(2), **LIMITS), (rs.empty_start(),)).text("f")


def test_lost_filter_restarts_from_an_empty_start():
    """All four ranges 3 m too long; the patience is one ping."""
    form = TightlyCoupled(errors=RangeErrorModel(patience=1), begins="given")
    node = replace(form.first(), start=replace(rs.empty_start(), pings=np.int32(3), elapsed=np.float64(2)))
    size = np.ones(len(node.x))
    size[[0, 3, 4]] = 0.03  # the filter knows its heading to 0.05 rad and its place to 30 cm
    node = replace(node, P=node.P * np.outer(size, size))
    yes, ranges = np.ones(4, bool), np.linalg.norm(form.beacons, axis=1)
    update = jax.jit(lambda ranges: update_running(form, node, ranges, np.int32(0), yes))
    lost = update(ranges + 3.0)
    assert not lost.position_fix.tracking
    assert (int(lost.start.pings), float(lost.start.elapsed)) == (0, 0.0)
    fine = update(ranges)
    assert fine.position_fix.tracking
    assert int(fine.start.pings) == 3
