"""The receiver of fixes: position and velocity of the antenna, sizes of the errors, outages."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.rng import Key, key
from trimtab.core.signals import Motion, no_motion
from trimtab.core.time import ms, seconds
from trimtab.sensors.gnss import Gnss, Outages
from trimtab.sensors.late_fix import LateFix

QUIET = Gnss(noise=0.0, noise_down=0.0, velocity_noise=0.0, velocity_noise_down=0.0)


def moving():
    v = [np.array(a) for a in ((10.0, -4.0, -50.0), (0.4, -0.3, 2.0), (20.0, 1.0, -2.0), (0.5, -0.2, 0.8))]
    return Motion(np.int64(0), *v, np.zeros(3), np.zeros(3))


def samples(gnss, n, motion=None, seed=0):
    """n steps of the sensor's period under one motion: samples with a leading axis."""
    still = no_motion() if motion is None else motion

    def step(state, i):
        t = i * gnss.period
        return gnss.step(t, state, replace(still, t=t))

    return jax.jit(lambda: jax.lax.scan(step, gnss.init(key(seed)), jnp.arange(n)))()[1]


def test_measures_position_and_velocity_of_the_antenna():
    """Against SciPy's rotations; the velocity is the derivative of the place."""
    arm, motion = np.array([0.5, -0.2, -0.3]), moving()
    reading = replace(QUIET, lever_arm=arm).measure(motion)
    R = Rotation.from_euler("ZYX", motion.attitude[::-1]).as_matrix()
    np.testing.assert_allclose(reading.position, motion.p_WB + R @ arm, atol=1e-12)
    h = 1e-6
    later = R @ Rotation.from_rotvec(motion.w_WB_B * h).as_matrix()
    moved = motion.p_WB + R @ motion.v_WB_B * h + later @ arm
    np.testing.assert_allclose(reading.velocity, (moved - reading.position) / h, atol=1e-5)


def test_fix_is_late_and_stamped_with_measurement_time():
    s = samples(QUIET, 100)
    fresh = np.flatnonzero(s.fresh)
    np.testing.assert_array_equal(np.asarray(s.t)[fresh], np.arange(5) * ms(200))
    np.testing.assert_array_equal(fresh * ms(10), np.arange(5) * ms(200) + ms(120))


def test_white_noise_deviations_differ_for_the_down_axis():
    s = samples(
        Gnss(noise=0.5, noise_down=1.5, velocity_noise=0.1, velocity_noise_down=0.3, lever_arm=np.zeros(3)), 40_000
    )
    fresh = np.asarray(s.fresh)
    got = np.asarray(s.value.position)[fresh].std(0), np.asarray(s.value.velocity)[fresh].std(0)
    np.testing.assert_allclose(got, [[0.5, 0.5, 1.5], [0.1, 0.1, 0.3]], rtol=0.06)


def test_correlated_error_has_given_deviation_and_correlation_time():
    """Over 40 receivers: its deviation from the first fix on; the correlation at one correlation time is 1/e."""
    gnss = replace(
        QUIET,
        correlated=2.0,
        correlation_time=4.0,
        lever_arm=np.zeros(3),
        period=ms(200),
        timing=LateFix(interval=ms(200)),
    )

    def errors(run):
        start = gnss.init(Key(np.uint32(1), run, 5))
        return jax.lax.scan(lambda s, i: gnss.step(i * ms(200), s, no_motion()), start, jnp.arange(400))[
            1
        ].value.position

    e = np.asarray(jax.jit(jax.vmap(errors))(np.arange(40, dtype=np.uint32)))
    assert e[:, 0].std() == pytest.approx(2.0, rel=0.15)
    assert e.std() == pytest.approx(2.0, rel=0.1)
    assert (e[:, 20:] * e[:, :-20]).mean() / e.var() == pytest.approx(np.exp(-1), abs=0.1)


@pytest.mark.thorough
def test_no_fix_is_received_in_an_outage():
    s = samples(replace(QUIET, outages=Outages(start=seconds(2), length=seconds(1), interval=seconds(5))), 1000)
    made = np.asarray(s.t)[np.asarray(s.fresh)] / seconds(1)
    inside = ((made - 2.0) % 5.0 < 1.0) & (made >= 2.0)
    assert not inside.any()
    assert len(made) == 40  # of 50 until 9.8 s, ten hidden
    once = samples(replace(QUIET, outages=Outages(start=seconds(2), length=seconds(1))), 1000)
    assert np.asarray(once.fresh).sum() == 45


def test_rejects_period_that_misses_fixes():
    with pytest.raises(InputError, match="missed"):
        replace(QUIET, period=ms(30)).check()
