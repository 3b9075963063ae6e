"""Steps on the rotation group: exact for a constant rate, of the expected order otherwise, length kept."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from trimtab.core import quaternion
from trimtab.core.integrate import dormand_prince, rk4_with_error
from trimtab.core.record import quantity, record
from trimtab.core.rosenbrock import rodas
from trimtab.core.rotation_step import rotation_step

J = np.array([1.0, 2.0, 4.0])


@record
class Spin:
    """A free body. Source: this test."""

    q: Any = quantity("1", "Attitude.", shape=(4,))
    w: Any = quantity("rad/s", "Rate.", shape=(3,))


def free(t, x):
    return Spin(quaternion.rate(x.q, x.w), -jnp.cross(x.w, J * x.w) / J)


START = Spin(jnp.array([1.0, 0.0, 0.0, 0.0]), jnp.array([0.7, 2.0, -0.4]))


@functools.partial(jax.jit, static_argnums=(0, 2))
def fly(step, n, f=free, start=START):
    """The state after 2 s in n steps."""
    return jax.lax.fori_loop(0, n, lambda k, x: step(f, k * 2.0 / n, x, 2.0 / n)[0], start)


def test_constant_rate_is_exact_in_one_step():
    start = Spin(START.q, jnp.array([0.3, -0.2, 0.4]))

    def constant(t, x):
        return Spin(quaternion.rate(x.q, x.w), jnp.zeros(3))

    x, error = rotation_step(rk4_with_error, ("q",))(constant, 0.0, start, 3.0)
    np.testing.assert_allclose(x.q, quaternion.exponential(3 * start.w), atol=1e-15)
    assert float(jnp.abs(error.q).max()) < 1e-15
    by_numbers, _ = rk4_with_error(constant, 0.0, start, 3.0)
    assert np.abs(by_numbers.q - x.q).max() > 1e-3


@pytest.mark.thorough
@pytest.mark.parametrize(("step", "order"), [(rk4_with_error, 4), (dormand_prince, 5), (rodas, 4)])
def test_rotation_step_keeps_order_and_quaternion_length(step, order):
    y0 = np.r_[START.q, START.w]

    def rates(t, y):
        p = np.r_[0.0, y[4:]]
        q = y[:4]
        turn = [-q[1:] @ p[1:], *(q[0] * p[1:] + np.cross(q[1:], p[1:]))]
        return np.r_[np.array(turn) / 2, -np.cross(y[4:], J * y[4:]) / J]

    true = solve_ivp(rates, (0, 2), y0, "DOP853", rtol=1e-13, atol=1e-14).y[:4, -1]
    turn = rotation_step(step, ("q",))
    ends = [fly(turn, n) for n in (20, 40, 80)]
    errors = [np.abs(np.asarray(x.q) - true).max() for x in ends]
    assert np.log2(errors[-2] / errors[-1]) == pytest.approx(order, abs=0.35)
    assert [float(x.q @ x.q) for x in ends] == pytest.approx(3 * [1.0], abs=2e-14)
    drift = fly(step, 20).q
    assert abs(float(drift @ drift) - 1) > 1e-8


@pytest.mark.thorough
def test_length_correction_term_is_ignored():
    def corrected(t, x):
        dx = free(t, x)
        return Spin(dx.q + 5.0 * (1 - x.q @ x.q) * x.q, dx.w)

    long = Spin(1.5 * START.q, START.w)
    step = rotation_step(rk4_with_error, ("q",))
    x, same = fly(step, 50, corrected, long), fly(step, 50, free, long)
    np.testing.assert_allclose(x.q, same.q, atol=1e-14)
    assert float(x.q @ x.q) == pytest.approx(2.25, abs=1e-13)  # the length is what it was


@pytest.mark.thorough
def test_error_estimate_of_the_quaternion_has_order_four():
    step = jax.jit(rotation_step(rk4_with_error, ("q",)), static_argnums=0)
    sizes = [float(jnp.abs(step(free, 0.0, START, h)[1].q).max()) for h in (0.2, 0.1)]
    assert np.log2(sizes[0] / sizes[1]) == pytest.approx(4.0, abs=0.5)
