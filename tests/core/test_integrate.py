"""Runge and Kutta's classical method: exact on cubics, fourth order, and nothing at a zero step."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.integrate import rk4


def test_exact_on_a_cubic_in_time():
    got = rk4(lambda t, x: 4 * t**3 - t, 1.0, jnp.asarray(2.0), 0.7)
    assert float(got) == pytest.approx(2.0 + (1.7**4 - 1) - (1.7**2 - 1) / 2, rel=1e-14)


def test_linear_equation_gives_the_taylor_polynomial():
    h = 0.3
    got = rk4(lambda t, x: -2.0 * x, 0.0, jnp.asarray(1.0), h)
    z = -2.0 * h
    assert float(got) == pytest.approx(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24, rel=1e-14)


def test_error_falls_with_the_fourth_power():
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


def test_zero_step_gives_the_state_back():
    x = {"a": jnp.array([1.0, 2.0]), "b": jnp.asarray(3.0)}
    got = rk4(lambda t, x: jax.tree.map(jnp.exp, x), 5.0, x, 0.0)
    assert jax.tree.all(jax.tree.map(lambda a, b: bool((a == b).all()), x, got))


def test_negative_step_goes_back():
    def f(t, x):
        return -x + t

    there = rk4(f, 0.0, jnp.asarray(1.0), 1e-3)
    assert float(rk4(f, 1e-3, there, -1e-3)) == pytest.approx(1.0, abs=1e-14)
