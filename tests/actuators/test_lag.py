"""Lags against numerical integration and scipy's matrix exponential, the F-16's elevator, and each other's limits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

from trimtab.actuators.lag import FirstOrderLag, SecondOrderLag, SecondOrderLagState
from trimtab.compiler.compiled_function import compile
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.record import replace, to_arrays
from trimtab.core.time import ms

DT = 2e-3
LEAST = 300
"""Periods of the shortest flight: the stages of a kind share a program."""


@jax.jit
def _flown(stage, command, rest, dt):
    def step(state, value):
        after, out = stage.step(state, value, dt)
        return jax.tree.map(jnp.asarray, after), out

    return jax.lax.scan(step, stage.init(rest), command)[1]


def fly(stage, command, rest=0.0, dt=DT):
    """Return the output of a stage for each number of a command."""
    n = len(command)
    held = np.pad(np.asarray(command, float), (0, max(0, LEAST - n)), "edge")
    return jax.tree.map(lambda out: np.asarray(out)[:n], _flown(to_arrays(stage), held, rest, dt))


def steps_of(n=400):
    """A command of steps, small and large, up and down."""
    return np.repeat(np.random.default_rng(3).normal(0, 1, n // 20), 20)


def integrate_in_small_steps(rates, command, y0, n=400):
    """Position after each period of rates(y, u), by n steps of the midpoint rule in each."""
    y, out, h = np.array(y0, float), [], DT / n
    for u in command:
        for _ in range(n):
            k1 = rates(y, u)
            k2 = rates(y + h / 2 * k1, u)
            y = y + h * k2
        out.append(y[0])
    return np.array(out)


def test_first_order_step_response_is_exponential():
    out = fly(FirstOrderLag(time_constant=0.03), np.ones(50)).value
    np.testing.assert_allclose(out, 1 - np.exp(-DT * np.arange(1, 51) / 0.03), rtol=1e-13)


@pytest.mark.thorough
def test_rate_limited_first_order_lag_matches_integration():
    command, stage = steps_of(200), FirstOrderLag(time_constant=0.04, rate_limit=12.0)
    wanted = integrate_in_small_steps(lambda y, u: np.clip((u - y) / 0.04, -12, 12), command, [0.0])
    out = fly(stage, command)
    np.testing.assert_allclose(out.value, wanted, atol=1e-6)
    assert 0 < out.limited.sum() < len(command)


def test_f16_elevator_keeps_rate_and_position_limits():
    """20.2 1/s, 60 deg/s, 25 deg: commanded 40 deg it slides until 60/20.2 deg are left, and stops at 25."""
    stage = FirstOrderLag(time_constant=1 / 20.2, rate_limit=60.0, low=-25.0, high=25.0)
    out = fly(stage, np.full(300, 40.0)).value
    t = DT * np.arange(1, 301)
    np.testing.assert_allclose(out, np.minimum(60 * t, 25.0), rtol=1e-12)
    back = fly(stage, np.full(100, -5.0), rest=25.0).value
    assert back[0] == pytest.approx(25 - 60 * DT)  # and leaves the stop at once


def test_rate_limit_turns_sine_into_triangle():
    """A sine whose slope is far above the limit comes out as a triangle of height rate * period / 4."""
    w, rate, dt = 2 * np.pi, 0.5, 1e-3
    t = dt * np.arange(1, 40001)
    out = fly(FirstOrderLag(time_constant=0.0, rate_limit=rate), np.sin(w * t), dt=dt).value[
        37000:
    ]  # the start is forgotten slowly
    assert np.ptp(out) / 2 == pytest.approx(rate / 4, rel=5e-3)
    assert np.abs(np.diff(out)).max() == pytest.approx(rate * dt, rel=1e-9)
    assert (np.abs(np.diff(out)) > 0.99 * rate * dt).mean() > 0.98


@pytest.mark.parametrize("damping", [0.2, 0.7, 1.0 - 1e-9, 1.0, 1.0 + 1e-5, 1.8, 30.0])
def test_second_order_lag_matches_matrix_exponential(damping):
    w = 70.0
    A = np.array([[0.0, 1.0], [-w * w, -2 * damping * w]])
    Phi, x, out = expm(A * DT), np.zeros(2), []
    command = steps_of(160)
    for u in command:
        x = Phi @ (x - [u, 0]) + [u, 0]
        out.append(x[0])
    np.testing.assert_allclose(fly(SecondOrderLag(frequency=w, damping=damping), command).value, out, atol=1e-11)


@pytest.mark.parametrize("damping", [0.5, 1.0, 1.4])
def test_rate_limited_second_order_lag_matches_integration(damping):
    """Of small steps, after each of which the rate is cut off."""
    w, top, command, n = 60.0, 6.0, steps_of(160), 400
    x = v = 0.0
    wanted, h = [], DT / n
    for u in command.tolist():
        for _ in range(n):
            v = min(max(v + h * (w * w * (u - x) - 2 * damping * w * v), -top), top)
            x += h * v
        wanted.append(x)
    out = fly(SecondOrderLag(frequency=w, damping=damping, rate_limit=top), command)
    np.testing.assert_allclose(out.value, wanted, atol=1e-3)  # of first order: a step moves it by 3e-5
    assert 20 < out.limited.sum() < 140


@pytest.mark.thorough
def test_rate_limit_instants_are_independent_of_period():
    """Eight times as many periods give the same: the instants at which the limit is met and left are not rounded."""
    stage = SecondOrderLag(frequency=60.0, damping=0.7, rate_limit=6.0)
    command = steps_of(160)
    fine = fly(stage, np.repeat(command, 8), dt=DT / 8).value[7::8]
    np.testing.assert_allclose(fly(stage, command).value, fine, atol=1e-9)


@pytest.mark.thorough
def test_output_holds_at_stop_and_leaves_at_once():
    stage = SecondOrderLag(frequency=60.0, damping=0.5, low=-1.0, high=1.0)
    out = fly(stage, np.r_[np.full(100, 3.0), np.full(5, 0.5)])
    assert float(out.value.max()) == 1.0
    assert out.value[60] == 1.0
    assert out.limited[60]
    assert out.value[100] < 1.0
    at_stop = SecondOrderLagState(x=jnp.asarray(1.0), rate=jnp.asarray(5.0))
    assert float(stage.step(at_stop, 3.0, DT)[0].rate) == 0.0


@pytest.mark.parametrize("stage", [FirstOrderLag(time_constant=0.0), SecondOrderLag(frequency=0.0)])
def test_zero_lag_leaves_only_the_limits(stage):
    command = steps_of(100)
    out = fly(stage, command)
    np.testing.assert_array_equal(out.value, command)
    assert not out.limited.any()
    slow = fly(replace(stage, rate_limit=5.0), command).value
    assert np.abs(np.diff(np.r_[0.0, slow])).max() == pytest.approx(5.0 * DT)


@pytest.mark.thorough("stage1")
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
@pytest.mark.parametrize("stage", [FirstOrderLag(rate_limit=4.0, high=0.5), SecondOrderLag(rate_limit=4.0, high=0.5)])
def test_lag_of_vectors_in_c_matches_jax(stage):
    command = np.stack([steps_of(60), -steps_of(60)], axis=1)
    stage = to_arrays(stage)

    def run(stage, u):
        def step(state, value):
            after, out = stage.step(state, value, DT)
            return jax.tree.map(jnp.asarray, after), out

        return jax.lax.scan(step, stage.init(np.zeros(2)), u)[1].value

    np.testing.assert_allclose(compile(run, stage, command)(stage, command), jax.jit(run)(stage, command), atol=1e-12)


@pytest.mark.thorough
def test_gradient_by_frequency_is_finite():
    stage = to_arrays(SecondOrderLag(rate_limit=1.0))
    slope = jax.grad(lambda w: _flown(replace(stage, frequency=w), np.ones(60), 0.0, DT).value[-1])(60.0)
    assert np.isfinite(slope)


def test_rejects_invalid_limits_and_period():
    with pytest.raises(InputError, match="below high"):
        FirstOrderLag(low=1.0, high=1.0).check()
    with pytest.raises(InputError, match="below high"):
        SecondOrderLag(low=1.0, high=0.0).check()
    with pytest.raises(InputError, match="at most 5 ms"):
        SecondOrderLag(frequency=100.0).check_period(ms(6))
    SecondOrderLag(frequency=100.0).check_period(ms(5))
