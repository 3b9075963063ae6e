"""The closed loop: errors without aiding grow as the theory's polynomials, with it the NEES is what it should be."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from estimators.flights import DT, MEMS, NEAR, QUICK, TICK, frames, monte_carlo, ticks, turn

from trimtab.compiler.function import lower_function
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import key
from trimtab.estimators.inertial.dual_filter import InertialNoise
from trimtab.estimators.inertial.feedback import AidedInertialFeedback
from trimtab.logs.consistency import CONSISTENT, nees_verdict

FORM = to_arrays(AidedInertialFeedback(noise=MEMS, start=NEAR))


def alone(form, imu_reading, n):
    """Beliefs after each of n ticks without aiding, the IMU reading felt all the time."""

    def step(node, _):
        node = form.propagate(node, DT, imu_reading, jnp.zeros(2))
        return node, form.belief(node)

    first = jax.tree.map(jnp.asarray, replace(form.first(), imu_reading=imu_reading))
    return jax.jit(lambda first: jax.lax.scan(step, first, None, length=n)[1], compiler_options=QUICK)(first)


@pytest.mark.thorough
def test_unaided_errors_grow_as_predicted_polynomials():
    """At rest with biases: heading b t, velocity and position of a force that turns away with it."""
    n = 1500  # 9.8 s; the first term left out, a b^3 t^4/24, stays below 4e-8
    b, a = 1e-3, np.array([0.1, -0.05])
    x = np.asarray(alone(FORM, np.array([b, *a]), n).x)
    t = np.arange(1, n + 1) * DT
    np.testing.assert_allclose(x[:, 0], b * t, rtol=1e-11)
    np.testing.assert_allclose(x[:, 1] - a[0] * t, -a[1] * b * t**2 / 2 - a[0] * b**2 * t**3 / 6, atol=1e-7)
    north = a[0] * t**2 / 2 - a[1] * b * t**3 / 6 - a[0] * b**2 * t**4 / 24
    east = a[1] * t**2 / 2 + a[0] * b * t**3 / 6 - a[1] * b**2 * t**4 / 24
    np.testing.assert_allclose(x[:, 3], north, atol=1e-6)
    np.testing.assert_allclose(x[:, 4], east, atol=1e-6)
    straight = np.asarray(alone(FORM, np.array([0.0, *a]), n).x)
    np.testing.assert_allclose(straight[:, 3], a[0] * t**2 / 2, rtol=1e-10)
    np.testing.assert_allclose(straight[:, 1], a[0] * t, rtol=1e-10)


def test_unaided_variances_grow_as_predicted_polynomials():
    noise = InertialNoise(gyro=1e-4, gyro_walk=1e-4, forward=1e-2, starboard=1e-2, force_walk=1e-3)
    form = to_arrays(AidedInertialFeedback(noise=noise, start=NEAR))
    n = 3000
    t = np.arange(1, n + 1) * DT
    P = np.asarray(alone(form, np.zeros(3), n).P)
    s = {name: float(getattr(form.start, f"sigma_{name}")) ** 2 for name in ("heading", "velocity", "position")}
    bg, ba = float(form.start.sigma_gyro_bias) ** 2, float(form.start.sigma_force_bias) ** 2
    qg, qf = 1e-4 * DT, 1e-2 * DT
    np.testing.assert_allclose(P[:, 0, 0], s["heading"] + bg * t**2 + qg * t + 1e-4 * t**3 / 3, rtol=1e-9)
    np.testing.assert_allclose(P[:, 1, 1], s["velocity"] + ba * t**2 + qf * t + 1e-3 * t**3 / 3, rtol=1e-9)
    position = s["position"] + s["velocity"] * t**2 + ba * t**4 / 4 + qf * t**3 / 3 + 1e-3 * t**5 / 20
    np.testing.assert_allclose(P[:, 4, 4], position, rtol=1e-9)


@pytest.mark.thorough
def test_nees_over_500_seeds_is_within_the_95_percent_bounds():
    nees, _, _ = monte_carlo(FORM, turn(ticks(250)), n=250, every=15, reads=True, runs=500)
    verdict = nees_verdict(np.asarray(nees), 8)
    assert verdict.verdict == CONSISTENT, verdict


@jax.jit
def corrected(form, heading):
    return form.correct_heading(form.first(), heading)


@pytest.mark.parametrize("turns", [0.0, 2 * np.pi, -6 * np.pi])
def test_heading_innovation_is_wrapped(turns):
    node = corrected(FORM, np.float64(0.01 + turns))
    assert 0 < node.heading < 0.01


@pytest.mark.thorough
def test_first_fix_replaces_an_unknown_start():
    """As [1] does, which starts at the first measurement with its variance."""
    form = to_arrays(AidedInertialFeedback())
    node = form.correct_position(form.correct_heading(form.first(), np.float64(3.0)), np.array([4.0, -5.0]))
    x, P = form.belief(node)
    np.testing.assert_allclose(np.asarray(x)[[0, 3, 4]], [3.0, 4.0, -5.0], atol=1e-3)
    np.testing.assert_allclose([P[0, 0], P[3, 3]], [1.6e-4, 5.6e-4], rtol=1e-4)


@pytest.mark.thorough
def test_step_lowers_to_generated_c():
    form = to_arrays(AidedInertialFeedback())
    state, now = form.init(key(0)), np.int64(TICK)
    one = np.ones(1, bool)
    t = np.full(1, TICK)
    stacked = frames(form, t, (t, np.zeros((1, 3)), one), (t, np.zeros((1, 1)), one), (t, np.zeros((1, 2)), one))
    frame = jax.tree.map(lambda a: a[0], stacked)
    assert lower_function(lambda f, s, x: f.step(now, s, x), (form, state, frame)).text("f")
