"""Integration steps: exact cases, the order of each step, and the order of its error estimate."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import RK45

from trimtab.core.integrate import (
    dormand_prince,
    error_ratio,
    next_step,
    rk4,
    rk4_with_doubling,
    rk4_with_error,
)
from trimtab.core.rosenbrock import rodas


def test_rk4_is_exact_on_a_cubic_in_time():
    got = rk4(lambda t, x: 4 * t**3 - t, 1.0, jnp.asarray(2.0), 0.7)
    assert float(got) == pytest.approx(2.0 + (1.7**4 - 1) - (1.7**2 - 1) / 2, rel=1e-14)


def test_rk4_of_a_linear_equation_gives_the_taylor_polynomial():
    h = 0.3
    got = rk4(lambda t, x: -2.0 * x, 0.0, jnp.asarray(1.0), h)
    z = -2.0 * h
    assert float(got) == pytest.approx(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24, rel=1e-14)


def test_rk4_error_falls_with_the_fourth_power():
    """x'' = -x with forcing: error at t = 2 for halved steps, slope of its logarithm within 0.1 of 4."""

    def f(t, x):
        return {"p": x["v"], "v": -x["p"] + jnp.sin(3 * t)}

    def end(n):
        h = 2.0 / n
        start = {"p": jnp.asarray(1.0), "v": jnp.asarray(0.0)}
        last = jax.lax.fori_loop(0, n, lambda i, x: rk4(f, i * h, x, h), start)
        return float(last["p"])

    truth = np.cos(2.0) + 3 / 8 * np.sin(2.0) - np.sin(6.0) / 8
    errors = [abs(end(n) - truth) for n in (20, 40, 80)]
    slopes = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert slopes == pytest.approx(4.0, abs=0.1)


def test_zero_step_returns_the_same_state():
    x = {"a": jnp.array([1.0, 2.0]), "b": jnp.asarray(3.0)}
    got = rk4(lambda t, x: jax.tree.map(jnp.exp, x), 5.0, x, 0.0)
    assert jax.tree.all(jax.tree.map(lambda a, b: bool((a == b).all()), x, got))


def test_negative_step_undoes_a_positive_step():
    def f(t, x):
        return -x + t

    there = rk4(f, 0.0, jnp.asarray(1.0), 1e-3)
    assert float(rk4(f, 1e-3, there, -1e-3)) == pytest.approx(1.0, abs=1e-14)


def forced(t, x):
    return {"p": x["v"], "v": -x["p"] + jnp.sin(3 * t)}


START = {"p": jnp.asarray(1.0), "v": jnp.asarray(0.0)}


@pytest.mark.thorough("rk4_with_error-4-4")
@pytest.mark.parametrize(
    ("step", "order", "estimate"),
    [(rk4_with_error, 4, 4), (rk4_with_doubling, 4, 5), (dormand_prince, 5, 5), (rodas, 4, 4)],
)
def test_order_of_each_step_and_its_error_estimate(step, order, estimate):
    step = jax.jit(step, static_argnums=0)

    def end(n):
        x = START
        for i in range(n):
            x, error = step(forced, 2.0 * i / n, x, 2.0 / n)
        return float(x["p"]), max(abs(float(e)) for e in error.values())

    truth = np.cos(2.0) + 3 / 8 * np.sin(2.0) - np.sin(6.0) / 8
    ends = np.array([end(n) for n in (40, 80, 160)])
    errors, estimates = np.abs(ends[:, 0] - truth), np.abs(ends[:, 1])
    assert np.log2(errors[:-1] / errors[1:]) == pytest.approx(order, abs=0.25)
    assert np.log2(estimates[:-1] / estimates[1:]) == pytest.approx(estimate, abs=0.25)


def test_error_estimation_does_not_change_the_step():
    plain = jax.jit(rk4, static_argnums=0)(forced, 0.3, START, 0.1)
    for step in (rk4_with_error, rk4_with_doubling):
        estimated, _ = jax.jit(step, static_argnums=0)(forced, 0.3, START, 0.1)
        assert (plain["p"], plain["v"]) == (estimated["p"], estimated["v"])


def test_step_doubling_estimates_the_true_error():
    """In a single step, step doubling estimates the true error within 5 %; the embedded formula does not."""

    def exact(t):
        """x'' = -x + sin 3t from (1, 0) at time zero."""
        p = np.cos(t) + 3 / 8 * np.sin(t) - np.sin(3 * t) / 8
        return np.array([p, -np.sin(t) + 3 / 8 * np.cos(t) - 3 / 8 * np.cos(3 * t)])

    x1, error = rk4_with_doubling(forced, 0.0, START, 0.05)
    true = exact(0.05) - [float(x1["p"]), float(x1["v"])]
    assert [float(error["p"]), float(error["v"])] == pytest.approx(true.tolist(), rel=0.05)
    _, embedded = rk4_with_error(forced, 0.0, START, 0.05)
    assert abs(float(embedded["v"])) > 5 * abs(true[1])


def test_dormand_prince_step_matches_scipy():
    step = RK45(lambda t, y: [y[1], -y[0] + np.sin(3 * t)], 0.3, [1.0, 0.0], 2.0, first_step=0.1, rtol=1e3, atol=1e3)
    step.step()
    x, _ = dormand_prince(forced, 0.3, START, 0.1)
    assert [float(x["p"]), float(x["v"])] == pytest.approx(step.y.tolist(), rel=1e-14)


@pytest.mark.thorough
def test_rodas_step_is_l_stable():
    def error(rate):
        x, _ = rodas(lambda t, x: -rate * (x - jnp.cos(t)), 0.0, jnp.asarray(5.0), 0.1)
        return abs(float(x) - np.cos(0.1))

    assert error(1e8) < 1e-5
    assert error(1e8) / error(1e9) == pytest.approx(10, rel=0.05)  # L-stable: R(z) falls like 1/z
    far = rk4(lambda t, x: -1e9 * (x - jnp.cos(t)), 0.0, jnp.asarray(5.0), 0.1)
    assert abs(float(far)) > 1e20


def test_error_ratio_is_the_worst_and_infinite_for_nan():
    x, x1 = {"a": jnp.array([1.0, -3.0])}, {"a": jnp.array([2.0, 1.0])}
    ratio = error_ratio({"a": jnp.array([1e-3, -2e-3])}, x, x1, 1e-3, 1e-3)
    assert float(ratio) == pytest.approx(max(1e-3 / 3e-3, 2e-3 / 4e-3))
    assert float(error_ratio({"a": jnp.array([np.nan, 0.0])}, x, x1, 1e-3, 1e-3)) == np.inf


@pytest.mark.parametrize(("ratio", "factor"), [(1.0, 0.9), (32.0, 0.45), (1e9, 0.2), (np.inf, 0.2), (0.0, 5.0)])
def test_next_step_size_follows_the_error_ratio(ratio, factor):
    assert float(next_step(0.1, ratio, 5)) == pytest.approx(0.1 * factor)
