"""The mechanisation against exact integrals, and laps that close."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from estimators.flights import DT, fly

from trimtab.compiler.function import lower_function
from trimtab.core.rotation import planar
from trimtab.estimators.inertial.mechanisation import (
    InertialStart,
    LeverArms,
    append_sample,
    empty_imu_history,
    mechanise,
    preintegrate,
    rotate_lever,
)

TICK = 65536
mechanised, preintegrated, appended = map(jax.jit, (mechanise, preintegrate, append_sample))


def turned(phi):
    """Return the rotation matrix of a heading."""
    return np.array([[np.cos(phi), -np.sin(phi)], [np.sin(phi), np.cos(phi)]])


def navigate(truth, dt):
    """Heading, velocity, position (n, ...) by trapezoid from the first truth and the felt samples alone."""

    def step(c, imu_reading):
        phi, v, r, last = c
        new = phi + dt / 2 * (imu_reading[0] + last[0])
        v, r = mechanise(dt, planar(phi) @ last[1:], planar(new) @ imu_reading[1:], v, r)
        return (new, v, r, imu_reading), (new, v, r)

    start = truth.heading[0], truth.velocity[0], truth.position[0], truth.imu_reading[0]
    return jax.jit(lambda: jax.lax.scan(step, start, truth.imu_reading[1:])[1])()


def test_mechanisation_is_exact_for_linear_force():
    """f = a + b t: v and r are polynomials, also over one long step."""
    a, b, v0, r0 = np.array([0.3, -1.0]), np.array([2.0, 0.7]), np.array([0.1, 0.2]), np.array([5.0, -3.0])
    for T in (0.01, 3.0):
        v, r = mechanise(T, a, a + b * T, v0, r0)
        np.testing.assert_allclose(v, v0 + a * T + b * T**2 / 2, rtol=1e-14)
        np.testing.assert_allclose(r, r0 + v0 * T + a * T**2 / 2 + b * T**3 / 6, rtol=1e-14)


@pytest.mark.thorough
def test_perfect_sensors_close_a_lap_between_rests():
    """A circle of 2 m, spinning the while, at the IMU's own tick: to 1e-8 m."""
    n = 3000
    T = (n - 1) * DT

    def along(t):
        s = t / T
        return 2 * jnp.pi * s**6 * (462 - 1980 * s + 3465 * s**2 - 3080 * s**3 + 1386 * s**4 - 252 * s**5)

    truth = fly(
        lambda t: 0.4 + 2 * jnp.pi / T * 3 * t,
        lambda t: 2.0 * jnp.stack([jnp.cos(along(t)), jnp.sin(along(t))]),
        np.arange(n) * DT,
    )
    phi, v, r = navigate(truth, DT)
    assert np.abs(np.asarray(r) - 2.0).max() > 1.9  # it went round
    np.testing.assert_allclose(r[-1], [2.0, 0.0], atol=1e-8)
    np.testing.assert_allclose(v[-1], 0.0, atol=1e-9)
    assert phi[-1] == pytest.approx(0.4 + 6 * np.pi, abs=1e-10)


@pytest.mark.parametrize(("samples", "largest"), [(958, None), (65536, 1e-8)])
def test_perfect_sensors_close_a_lap_at_speed(samples, largest):
    """A circle at 1 rad/s misses by 2 pi R (W dt)^2/12, the trapezoid's error; 0.1 ms brings it below 1e-8."""
    t = np.linspace(0, 2 * np.pi, samples + 1)
    truth = fly(lambda t: t + np.pi / 2, lambda t: jnp.stack([jnp.cos(t), jnp.sin(t)]), t)
    _, _, r = navigate(truth, t[1])
    miss = np.linalg.norm(np.asarray(r[-1]) - [1.0, 0.0])
    assert miss == pytest.approx(2 * np.pi * t[1] ** 2 / 12, rel=1e-3, abs=1e-10)
    assert largest is None or miss < largest


def test_lever_arm_rotates_with_the_heading():
    arm = np.array([0.3, -0.1])
    turned, slope = rotate_lever(0.7, arm)
    c, s = np.cos(0.7), np.sin(0.7)
    np.testing.assert_allclose(turned, [c * 0.3 + s * 0.1, s * 0.3 - c * 0.1], rtol=1e-14)
    np.testing.assert_allclose(slope, jax.jit(jax.jacfwd(lambda p: rotate_lever(p, arm)[0]))(0.7), rtol=1e-14)
    np.testing.assert_array_equal(
        LeverArms(imu=np.array([0.1, 0.0]), aiding=arm).imu_to_aided_point(), arm - [0.1, 0.0]
    )


def test_start_variances_follow_the_state_order():
    sigmas = {"heading": 1.0, "gyro_bias": 2.0, "velocity": 3.0, "position": 4.0, "force_bias": 5.0}
    s = InertialStart(**{f"sigma_{name}": value for name, value in sigmas.items()})
    np.testing.assert_array_equal(s.heading_variances(), [1, 4])
    np.testing.assert_array_equal(s.motion_variances(), [9, 9, 16, 16, 25, 25])
    s = InertialStart(north=1.0, east=2.0, velocity_north=3.0, velocity_east=4.0)
    np.testing.assert_array_equal([s.position(), s.velocity()], [[1, 2], [3, 4]])


@pytest.mark.thorough
def test_mechanisation_lowers_to_generated_c():
    v = np.zeros(2)
    assert lower_function(mechanise, (0.1, v, v, v, v)).text("f")


def history(n=12, slots=16, seed=0):
    g = np.random.default_rng(seed)
    imu_reading = g.standard_normal((n, 3))
    h = jax.tree.map(jnp.asarray, empty_imu_history(slots))
    for k in range(n):
        h = appended(h, np.int64(k * TICK), imu_reading[k], np.array([k == 5, False], float))
    return h, imu_reading


def plain(imu_reading, begin, end, phi, v, r, bias):
    """Step by step from a state, in W, with the biases taken off each reading."""
    times = np.arange(len(imu_reading)) * TICK
    at = np.unique(np.concatenate([[begin, end], times[(times > begin) & (times < end)]]))
    f = np.stack([np.interp(at, times, imu_reading[:, j]) for j in range(3)], axis=1) - bias
    for k in range(len(at) - 1):
        dt = (at[k + 1] - at[k]) * 1e-7
        ahead = phi + dt * (f[k, 0] + f[k + 1, 0]) / 2
        v, r = mechanised(dt, turned(phi) @ f[k, 1:], turned(ahead) @ f[k + 1, 1:], v, r)
        phi = ahead
    return phi, np.asarray(v), np.asarray(r)


@pytest.mark.parametrize(("begin", "end"), [(0, 11 * TICK), (int(2.3 * TICK), int(7.8 * TICK)), (100, 200)])
def test_preintegration_matches_the_mechanisation(begin, end):
    """Between samples too, with accelerometer biases; exact."""
    h, imu_reading = history()
    m = preintegrated(h, begin, end)
    phi, v, r, ba = 0.7, np.array([0.3, -0.1]), np.array([1.0, 2.0]), np.array([0.1, -0.2])
    want = plain(imu_reading, begin, end, phi, v, r, np.r_[0.0, ba])
    T, B = float(m.time), np.asarray(planar(phi))
    assert pytest.approx((end - begin) * 1e-7) == T
    np.testing.assert_allclose(phi + m.turn, want[0], atol=1e-14)
    np.testing.assert_allclose(v + B @ (m.velocity - m.D1 @ ba), want[1], atol=1e-13)
    np.testing.assert_allclose(r + v * T + B @ (m.position - m.D2 @ ba), want[2], atol=1e-13)


def test_preintegration_neglects_gyro_bias_only_to_second_order():
    """1 deg/s over 0.1 s under 1 m/s^2: 0.1 mm/s."""
    h, imu_reading = history(n=16)
    end = 15 * TICK
    m = preintegrated(h, 0, end)
    bias = np.deg2rad(1.0)
    want = plain(imu_reading, 0, end, 0.0, np.zeros(2), np.zeros(2), np.r_[bias, 0, 0])
    np.testing.assert_allclose(m.turn - bias * m.time, want[0], atol=1e-12)
    np.testing.assert_allclose(m.velocity, want[1], atol=3e-4)


def test_preintegration_is_limited_to_samples_and_reports_untrusted():
    h, _ = history(n=20, slots=8)
    m = preintegrated(h, 0, 30 * TICK)
    assert float(m.time) == pytest.approx(7 * TICK * 1e-7)
    h, _ = history()
    np.testing.assert_array_equal(preintegrated(h, 0, 11 * TICK).untrusted, [1, 0])
    np.testing.assert_array_equal(preintegrated(h, 7 * TICK, 11 * TICK).untrusted, [0, 0])
    assert float(preintegrated(empty_imu_history(8), 0, TICK).time) == 0.0


@pytest.mark.thorough
def test_preintegration_lowers_to_generated_c():
    assert lower_function(preintegrate, (history()[0], np.int64(0), np.int64(TICK))).text("f")
