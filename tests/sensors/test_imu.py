"""The inertial unit against mechanics differentiated automatically, and each of its errors against its definition."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.imperfections import imperfections, without
from trimtab.core.interfaces import Sensor
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import key
from trimtab.core.rotation import from_euler, from_rotation_vector
from trimtab.core.signals import Motion
from trimtab.core.time import ms
from trimtab.environment.geodetic import earth_rate
from trimtab.sensors.gyro_dynamics import DelayedGyro, IdentifiedGyro
from trimtab.sensors.imu import AccelerometerErrors, GyroErrors, Imu

TICK = ms("6.5536")
DT = 0.0065536
G = 9.8
DEG = np.pi / 180


def path(s):
    return jnp.stack([2 * jnp.sin(0.7 * s), 0.5 * s * s, -0.3 * jnp.cos(s)])


def attitude(s):
    return jnp.stack([0.3 * jnp.sin(s), -0.2 * jnp.cos(2 * s), 0.9 * s])


@jax.jit
def spin(s):
    """w_WB_B from R' = R [w ×]."""
    S = from_euler(*attitude(s)).T @ jax.jacfwd(lambda s: from_euler(*attitude(s)))(s)
    return jnp.stack([S[2, 1], S[0, 2], S[1, 0]])


@jax.jit
def motion(s):
    R = from_euler(*attitude(s))
    v, a = jax.jacfwd(path)(s), jax.jacfwd(jax.jacfwd(path))(s)
    return Motion(s * 1e7, path(s), attitude(s), R.T @ v, spin(s), R.T @ a, jax.jacfwd(spin)(s))


def still(roll=0.0, pitch=0.0, yaw=0.0, rate=(0.0, 0.0, 0.0)):
    o = jnp.zeros(3)
    return Motion(0, o, jnp.array([roll, pitch, yaw]), o, jnp.array(rate), o, o)


@jax.jit
def _logged(imu, seeds, rates):
    def run(seed):
        def body(state, both):
            k, rate = both
            state, sample = imu.step(k * TICK, state, replace(still(), w_WB_B=rate))
            return state, sample.value

        return jax.lax.scan(body, imu.init(replace(key(0), seed=seed)), (jnp.arange(len(rates)), rates))[1]

    return jax.vmap(run)(seeds)


def logged(imu, rates, seeds=(0,)):
    """Readings (seeds, n, …) of a unit that stands level and turns at rates (n, 3); compiled once for each shape."""
    return jax.tree.map(np.asarray, _logged(to_arrays(imu), np.asarray(seeds, np.uint32), np.asarray(rates, float)))


N = 60
COUNT = np.arange(N)
YAW = np.array([0.0, 0.0, 1.0])


@pytest.mark.thorough
def test_specific_force_includes_the_lever_arm():
    """Lever arm and gravity: the place l of the body, followed along a path in space and differentiated twice."""
    arm, s = np.array([0.4, -0.3, 0.2]), 1.3
    imu = Imu(lever_arm=arm, gravity=(0.0, 0.0, G))

    def place(s):
        return path(s) + from_euler(*attitude(s)) @ arm

    felt = from_euler(*attitude(s)).T @ (jax.jit(jax.jacfwd(jax.jacfwd(place)))(s) - np.array([0, 0, G]))
    reading = jax.jit(imu.measure)(motion(s))
    np.testing.assert_allclose(reading.specific_force, felt, atol=1e-12)
    np.testing.assert_allclose(reading.angular_rate, spin(s), atol=1e-14)


def test_specific_force_at_rest_is_minus_gravity():
    reading = Imu(gravity=(0.0, 0.0, G)).measure(still(pitch=0.1, yaw=2.0))
    np.testing.assert_allclose(reading.specific_force, [G * np.sin(0.1), 0, -G * np.cos(0.1)], atol=1e-14)


@pytest.mark.thorough
def test_mounting_rotates_force_and_rate():
    mounted = Imu(mounting=(0.0, 0.0, 0.3)).measure(motion(0.7))
    plain = Imu().measure(motion(0.7))
    for name in ("specific_force", "angular_rate"):
        R = from_euler(0.0, 0.0, 0.3)
        np.testing.assert_allclose(R @ getattr(mounted, name), getattr(plain, name), atol=1e-13)


@pytest.mark.thorough
def test_readings_include_earth_rate_and_coriolis():
    """Coriolis and earth rate: in a frame that does not turn, the path's second derivative is all there is.

    The centrifugal acceleration is part of gravity, and put there.
    """
    W, s = np.array([0.03, -0.02, 0.05]), 0.9  # a fast earth, for the digits

    def turned(s):
        return from_rotation_vector(jnp.asarray(W) * s)

    inertial = jax.jit(jax.jacfwd(jax.jacfwd(lambda s: turned(s) @ path(s))))(s)
    in_body = from_euler(*attitude(s)).T @ (turned(s).T @ inertial)
    centrifugal = -np.cross(W, np.cross(W, path(s)))
    reading = Imu(earth_rate=W, gravity=centrifugal).measure(motion(s))
    np.testing.assert_allclose(reading.specific_force, in_body, atol=1e-10)
    np.testing.assert_allclose(reading.angular_rate, spin(s) + from_euler(*attitude(s)).T @ W, atol=1e-13)
    assert np.linalg.norm(earth_rate(0.68)) == pytest.approx(15.04 * DEG / 3600, rel=1e-3)


@pytest.mark.thorough
def test_microstrain_3dm_gx1_has_the_published_errors():
    """The 3DM-GX1: 0.72 deg/s and 0.082 m/s² a sample, 0.7 deg/s and 10 mg of bias, ±300 deg/s and ±1.7 g, tick."""
    imu = Imu.microstrain_3dm_gx1()
    assert isinstance(imu, Sensor)
    imu.check()
    assert imu.period == 65536
    values = logged(without(imu, "imu-bias-walk"), np.zeros((200, 3)), range(60))
    rate, force = np.asarray(values.angular_rate), np.asarray(values.specific_force)
    assert np.std(rate - rate.mean(1, keepdims=True)) / DEG == pytest.approx(0.72, rel=0.02)
    assert np.std(force - force.mean(1, keepdims=True)) == pytest.approx(0.082, rel=0.02)
    # 180 biases: the standard error of their deviation is 5 %
    assert np.std(rate.mean(1)) / DEG == pytest.approx(0.7, rel=0.16)
    assert np.std(force[..., :2].mean(1)) == pytest.approx(0.010 * 9.80665, rel=0.25)
    assert imu.gyro.range / DEG == pytest.approx(300)
    assert imu.accelerometer.range == pytest.approx(1.7 * 9.80665)


@pytest.mark.thorough
def test_bias_walk_variance_grows_with_time():
    """After n ticks the bias has the variance K² n dt; different seeds, axes alike."""
    K, n = 0.01, 400
    imu = Imu(gyro=GyroErrors(bias_walk=K))
    end = np.asarray(logged(imu, np.zeros((n, 3)), range(200)).angular_rate)[:, -1]
    assert np.std(end) == pytest.approx(K * np.sqrt((n - 1) * DT), rel=0.1)
    assert np.abs(end).max() < 5 * K * np.sqrt(n * DT)


@pytest.mark.thorough
def test_scale_and_misalignment_are_drawn_per_run():
    imu = Imu(gyro=GyroErrors(scale_factor=0.01, misalignment=0.02), gravity=(0.0, 0.0, 0.0))

    columns = logged(imu, [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0]], range(300)).angular_rate
    diagonal = columns[:, [0, 1, 2], [0, 1, 2]] - 1
    assert np.std(diagonal) == pytest.approx(0.01, rel=0.1)
    assert np.std(columns[:, 0, 1:]) == pytest.approx(0.02, rel=0.12)
    np.testing.assert_allclose(columns[:, 3], columns[:, 0] + columns[:, 1], atol=1e-14)


@pytest.mark.thorough
def test_saturation_is_flagged_only_for_the_gyro():
    imu = without(without(without(Imu.microstrain_3dm_gx1(), "imu-noise"), "imu-turn-on-bias"), "imu-scale-factor")
    imu = without(without(without(imu, "imu-misalignment"), "imu-bias-walk"), "imu-quantisation")
    rates = YAW * 6.4 * COUNT[:, None] / 59
    values = logged(imu, rates)
    rate, full = np.asarray(values.angular_rate)[0, :, 2], np.asarray(values.gyro_saturated)[0]
    assert rate.max() == pytest.approx(300 * DEG, abs=1e-15)
    np.testing.assert_array_equal(full, rate >= 300 * DEG)
    assert full[-1]
    assert not full[:20].any()
    assert not np.asarray(values.accelerometer_saturated).any()
    free = logged(without(imu, "imu-saturation"), rates)
    assert np.asarray(free.angular_rate).max() > 6
    assert not np.asarray(free.gyro_saturated).any()


@pytest.mark.thorough
def test_gyro_output_is_rounded_to_the_resolution():
    step = 0.01
    imu = Imu(gyro=GyroErrors(resolution=step))
    wanted = np.array([0.1, -0.1, 0.003]) * (COUNT - 20)[:, None]
    got = logged(imu, wanted).angular_rate[0]
    np.testing.assert_allclose(got / step, np.round(got / step), atol=1e-9)
    assert np.abs(got - wanted).max() <= step / 2 + 1e-12


@pytest.mark.thorough
def test_bandwidth_is_the_3_db_frequency():
    """A sine at the bandwidth, after its transient: projected on sine and cosine."""
    phase = 2 * np.pi * 12.0 * np.arange(400) * DT
    y = logged(Imu(gyro=GyroErrors(bandwidth=12.0)), YAW * np.sin(phase)[:, None]).angular_rate[0, 200:, 2]
    basis = np.stack([np.sin(phase), np.cos(phase)], 1)[200:]
    assert np.linalg.norm(np.linalg.lstsq(basis, y, rcond=None)[0]) == pytest.approx(np.sqrt(0.5), abs=1e-6)


@pytest.mark.thorough
@pytest.mark.parametrize("response", [IdentifiedGyro(), DelayedGyro()], ids=["identified", "delayed"])
def test_gyro_dynamics_replace_the_low_pass(response):
    u = np.sin(0.3 * COUNT)
    got = logged(Imu(gyro=GyroErrors(response=response)), YAW * u[:, None])
    wanted = jax.lax.scan(response.respond, response.start(0.0), jnp.asarray(u))[1]
    np.testing.assert_allclose(got.angular_rate[0, :, 2], wanted, atol=1e-12)


@pytest.mark.thorough
def test_switching_one_error_off_leaves_the_others_unchanged():
    imu, turning = without(Imu.microstrain_3dm_gx1(), "imu-quantisation"), np.tile(0.5 * YAW, (N, 1))
    whole, less = (logged(i, turning).angular_rate[0] for i in (imu, without(imu, "imu-turn-on-bias")))
    np.testing.assert_allclose(whole - less, np.tile((whole - less)[0], (N, 1)), atol=1e-13)
    assert np.abs(whole - less).max() > 1e-4
    clean = imu
    for name in imperfections(Imu()):
        clean = without(clean, name)
    reading = logged(clean, turning)
    np.testing.assert_allclose(reading.specific_force[0], np.tile([0, 0, -9.80665], (N, 1)), atol=1e-13)
    np.testing.assert_allclose(reading.angular_rate[0], turning, atol=1e-13)
    with pytest.raises(InputError, match="no imperfection 'rust'"):
        without(imu, "rust")


def test_rejects_bandwidth_and_response_unsuited_to_the_period():
    with pytest.raises(InputError, match="80 Hz") as error:
        Imu(accelerometer=AccelerometerErrors(bandwidth=80.0)).check()
    assert error.value.part == "accelerometer.bandwidth"
    with pytest.raises(InputError, match=r"gyro\.response"):
        Imu(gyro=GyroErrors(response=DelayedGyro()), period=ms(6)).check()


@pytest.mark.thorough
def test_measurement_jacobian_matches_finite_differences():
    """The derivative of h by the attitude against central differences."""

    def force(a):
        return Imu().measure(replace(motion(0.3), attitude=a)).specific_force

    at, h = attitude(0.3), 1e-6
    slope = jax.jit(jax.jacfwd(force))(at)
    ends = jax.jit(jax.vmap(force))(jnp.concatenate([at + h * jnp.eye(3), at - h * jnp.eye(3)]))
    np.testing.assert_allclose(slope, (ends[:3] - ends[3:]).T / (2 * h), atol=1e-7)
