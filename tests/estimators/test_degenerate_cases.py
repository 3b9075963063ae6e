"""The four forms where theory knows the answer: no aiding, and perfect sensors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from estimators.flights import DT, MEMS, NEAR, QUICK, fly

from trimtab.core.record import replace, to_arrays
from trimtab.estimators.inertial.coupled import AidedInertialCoupled
from trimtab.estimators.inertial.direct import AidedInertialDirect
from trimtab.estimators.inertial.dual_filter import InertialNoise
from trimtab.estimators.inertial.feedback import AidedInertialFeedback
from trimtab.estimators.inertial.feedforward import AidedInertialFeedforward

FORMS = (AidedInertialDirect, AidedInertialFeedforward, AidedInertialFeedback, AidedInertialCoupled)
forms = pytest.mark.parametrize("cls", FORMS, ids=lambda cls: cls.__name__)


def unaided(form, imu_reading):
    """Beliefs after each sample of felt (n, 3) but the first, with which it starts; a tick apart."""

    def step(node, row):
        node = form.propagate(node, DT, row, jnp.zeros(2))
        return node, form.belief(node)

    first = jax.tree.map(jnp.asarray, replace(form.first(), imu_reading=imu_reading[0]))
    run = jax.jit(lambda first, imu_reading: jax.lax.scan(step, first, imu_reading)[1], compiler_options=QUICK)
    return jax.tree.map(np.asarray, run(first, jnp.asarray(imu_reading[1:])))


@pytest.mark.thorough("AidedInertialDirect", "AidedInertialFeedforward", "AidedInertialCoupled")
@forms
def test_unaided_errors_grow_as_predicted_polynomials(cls):
    """Bias of a gyro: heading t, velocity t² and position t³ across a force; bias of a force: t, t²."""
    n, f, b, a = 1000, 0.8, 1e-5, np.array([0.02, -0.01])
    x = unaided(to_arrays(cls(noise=MEMS, start=NEAR)), np.tile([b, f + a[0], a[1]], (n + 1, 1))).x
    t = np.arange(1, n + 1) * DT
    np.testing.assert_allclose(x[:, 0], b * t, rtol=1e-11)
    g = f + a[0]  # left out: g b² t³/6 and t⁴/24, below 1e-8
    np.testing.assert_allclose(x[:, 1] - f * t, a[0] * t - a[1] * b * t**2 / 2, atol=1e-8)
    np.testing.assert_allclose(x[:, 2], a[1] * t + g * b * t**2 / 2, atol=1e-8)
    np.testing.assert_allclose(x[:, 3] - f * t**2 / 2, a[0] * t**2 / 2 - a[1] * b * t**3 / 6, atol=1e-8)
    np.testing.assert_allclose(x[:, 4], a[1] * t**2 / 2 + g * b * t**3 / 6, atol=1e-8)
    assert f * b * t[-1] ** 3 / 6 > 3e-4


def test_coupled_covariance_grows_as_predicted_polynomials():
    """Along a force f: heading and gyro bias reach velocity as f t, f t²/2, and position as f t²/2, f t³/6."""
    n, f = 1500, 0.8
    noise = InertialNoise(gyro=1e-30, gyro_walk=0.0, forward=1e-2, starboard=1e-2, force_walk=1e-3)
    form = to_arrays(AidedInertialCoupled(noise=noise, start=NEAR, smoothing=0.0))
    P = unaided(form, np.tile([0.0, f, 0.0], (n + 1, 1))).P
    t = np.arange(1, n + 1) * DT
    h, v, r = (float(getattr(NEAR, f"sigma_{name}")) ** 2 for name in ("heading", "velocity", "position"))
    bg, ba, q = float(NEAR.sigma_gyro_bias) ** 2, float(NEAR.sigma_force_bias) ** 2, 1e-2 * DT
    np.testing.assert_allclose(P[:, 0, 0], h + bg * t**2, rtol=1e-9)
    along = v + ba * t**2 + q * t + 1e-3 * t**3 / 3
    np.testing.assert_allclose(P[:, 1, 1], along, rtol=1e-9)
    np.testing.assert_allclose(P[:, 2, 2], along + f**2 * (h * t**2 + bg * t**4 / 4), rtol=1e-9)
    along = r + v * t**2 + ba * t**4 / 4 + q * t**3 / 3 + 1e-3 * t**5 / 20
    np.testing.assert_allclose(P[:, 3, 3], along, rtol=1e-9)
    np.testing.assert_allclose(P[:, 4, 4], along + f**2 * (h * t**4 / 4 + bg * t**6 / 36), rtol=1e-9)


def course(shape):
    """A lap (2,) of the parameter s from 0 to 1."""
    at = {
        "circle": lambda s: jnp.stack([2 * jnp.cos(2 * jnp.pi * s), 2 * jnp.sin(2 * jnp.pi * s)]),
        "eight": lambda s: jnp.stack([2 * jnp.sin(2 * jnp.pi * s), jnp.sin(4 * jnp.pi * s)]),
    }
    return at[shape]


@pytest.mark.thorough
@forms
@pytest.mark.parametrize("shape", ["circle", "eight"])
def test_perfect_sensors_close_a_lap_between_rests(cls, shape):
    """At the IMU's own tick, spinning three times the while: to 1e-8 m."""
    n = 3000
    T = (n - 1) * DT

    def share(t):
        s = t / T
        return s**6 * (462 - 1980 * s + 3465 * s**2 - 3080 * s**3 + 1386 * s**4 - 252 * s**5)

    lap = course(shape)
    truth = fly(lambda t: 0.4 + 6 * jnp.pi * t / T, lambda t: lap(share(t)), np.arange(n) * DT)
    start = replace(NEAR, heading=0.4, north=float(lap(0.0)[0]), east=float(lap(0.0)[1]))
    x = unaided(to_arrays(cls(noise=MEMS, start=start)), np.asarray(truth.imu_reading)).x
    assert np.abs(x[:, 3:5] - x[-1, 3:5]).max() > 1.5  # it went round
    np.testing.assert_allclose(x[-1, 3:5], truth.position[0], atol=1e-8)
    np.testing.assert_allclose(x[-1, 1:3], 0.0, atol=1e-9)
    assert x[-1, 0] == pytest.approx(0.4 + 6 * np.pi, abs=1e-10)


@pytest.mark.thorough
@pytest.mark.parametrize("shape", ["circle", "eight"])
def test_lap_at_speed_misses_by_the_trapezoidal_error(shape):
    """By dt² T/12 of the force's rate of change where it begins: to close to 1e-8 m it needs a shorter tick."""
    n = 1600
    T = n * DT
    lap = course(shape)
    truth = fly(lambda t: 0.4 + 0.0 * t, lambda t: lap(t / T), np.arange(n + 1) * DT)
    v, r = (np.asarray(a[0]) for a in (truth.velocity, truth.position))
    start = replace(
        NEAR, heading=0.4, velocity_north=float(v[0]), velocity_east=float(v[1]), north=float(r[0]), east=float(r[1])
    )
    x = unaided(to_arrays(AidedInertialFeedback(noise=MEMS, start=start)), np.asarray(truth.imu_reading)).x
    jerk = jax.jacfwd(jax.jacfwd(jax.jacfwd(lambda t: lap(t / T))))(0.0)
    missed = -(DT**2) * T / 12 * np.asarray(jerk)
    np.testing.assert_allclose(x[-1, 3:5] - r, missed, atol=0.01 * np.linalg.norm(missed))
    assert np.linalg.norm(missed) > 1e-8


@pytest.mark.thorough("AidedInertialDirect", "AidedInertialFeedforward", "AidedInertialCoupled")
@forms
def test_lap_with_piecewise_linear_force_closes_exactly(cls):
    """There and back on slopes that bend at samples only: to rounding, however few samples there are."""
    knots = 3.0 * np.array([0, 1, 0, -1, 0, -1, 0, 1, 0])
    for k in (1, 80):
        f = np.interp(np.arange(8 * k + 1) / k, np.arange(9), knots)
        x = unaided(to_arrays(cls(noise=MEMS, start=NEAR)), np.stack([0 * f, f, -0.3 * f], axis=1)).x
        assert np.abs(x[:, 3]).max() > 5.9 * (k * DT) ** 2
        np.testing.assert_allclose(x[-1, 1:5], 0.0, atol=1e-13)
