"""What is summed up once equals what each filter sums up for itself."""

import jax
import numpy as np
import pytest

from trimtab.compiler.function import lower_function
from trimtab.core.rotation import planar
from trimtab.estimators.inertial.mechanisation import append_sample, empty_imu_history, mechanise, preintegrate

TICK = 65536


def history(n=12, slots=16, seed=0):
    g = np.random.default_rng(seed)
    felt = g.standard_normal((n, 3))
    h = empty_imu_history(slots)
    for k in range(n):
        h = append_sample(h, np.int64(k * TICK), felt[k], np.array([k == 5, False], float))
    return h, felt


def plain(felt, begin, end, phi, v, r, bias):
    """Step by step from a state, in W, with the biases taken off each reading."""
    times = np.arange(len(felt)) * TICK
    at = np.unique(np.concatenate([[begin, end], times[(times > begin) & (times < end)]]))
    f = np.stack([np.interp(at, times, felt[:, j]) for j in range(3)], axis=1) - bias
    for k in range(len(at) - 1):
        dt = (at[k + 1] - at[k]) * 1e-7
        ahead = phi + dt * (f[k, 0] + f[k + 1, 0]) / 2
        v, r = mechanise(dt, planar(phi) @ f[k, 1:], planar(ahead) @ f[k + 1, 1:], v, r)
        phi = ahead
    return phi, np.asarray(v), np.asarray(r)


@pytest.mark.parametrize(("begin", "end"), [(0, 11 * TICK), (int(2.3 * TICK), int(7.8 * TICK)), (100, 200)])
def test_it_is_the_mechanisation(begin, end):
    """Between samples too, with accelerometer biases; exact."""
    h, felt = history()
    m = jax.jit(preintegrate)(h, begin, end)
    phi, v, r, ba = 0.7, np.array([0.3, -0.1]), np.array([1.0, 2.0]), np.array([0.1, -0.2])
    want = plain(felt, begin, end, phi, v, r, np.r_[0.0, ba])
    T, B = float(m.time), np.asarray(planar(phi))
    assert pytest.approx((end - begin) * 1e-7) == T
    np.testing.assert_allclose(phi + m.turn, want[0], atol=1e-14)
    np.testing.assert_allclose(v + B @ (m.velocity - m.D1 @ ba), want[1], atol=1e-13)
    np.testing.assert_allclose(r + v * T + B @ (m.position - m.D2 @ ba), want[2], atol=1e-13)


def test_a_gyro_bias_is_left_out_only_to_second_order():
    """1 deg/s over 0.1 s under 1 m/s^2: 0.1 mm/s."""
    h, felt = history(n=16)
    end = 15 * TICK
    m = jax.jit(preintegrate)(h, 0, end)
    bias = np.deg2rad(1.0)
    want = plain(felt, 0, end, 0.0, np.zeros(2), np.zeros(2), np.r_[bias, 0, 0])
    np.testing.assert_allclose(m.turn - bias * m.time, want[0], atol=1e-12)
    np.testing.assert_allclose(m.velocity, want[1], atol=3e-4)


def test_it_reaches_as_far_as_samples_do_and_tells_doubt():
    h, _ = history(n=20, slots=8)
    m = jax.jit(preintegrate)(h, 0, 30 * TICK)
    assert float(m.time) == pytest.approx(7 * TICK * 1e-7)
    h, _ = history()
    np.testing.assert_array_equal(jax.jit(preintegrate)(h, 0, 11 * TICK).doubt, [1, 0])
    np.testing.assert_array_equal(jax.jit(preintegrate)(h, 7 * TICK, 11 * TICK).doubt, [0, 0])
    assert float(jax.jit(preintegrate)(empty_imu_history(8), 0, TICK).time) == 0.0


def test_it_exports():
    assert lower_function(preintegrate, (history()[0], np.int64(0), np.int64(TICK))).text("f")
