import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.imperfections import without
from trimtab.core.rng import key
from trimtab.core.signals import Motion
from trimtab.core.time import ms
from trimtab.loop.structure import strengthen_types
from trimtab.sensors.heading import Compass, HeadingSensor
from trimtab.sensors.late_fix import LateFix
from trimtab.sensors.magnetometer import Magnetometer


def motion(t, heading, roll=0.0, pitch=0.0):
    o = jnp.zeros(3)
    return Motion(t, o, jnp.stack([jnp.asarray(roll), jnp.asarray(pitch), jnp.asarray(heading)]), o, o, o, o)


def flown(sensor, n, rate=2.0):
    """Samples while the heading turns at a rate (rad/s)."""
    now = jnp.arange(n, dtype=np.int64) * sensor.period
    step = lambda s, t: sensor.step(t, s, motion(t, rate * t * 1e-7))  # noqa: E731
    first = strengthen_types(sensor.init(key(3)))
    return np.asarray(now), jax.tree.map(np.asarray, jax.lax.scan(step, first, now)[1])


def test_late_heading_lags_by_rate_times_latency():
    sensor = HeadingSensor(noise=0.0, timing=LateFix(latency=0.087, stamped="arrival"))
    now, out = flown(sensor, 1000)
    lag = 2.0 * now[out.fresh] * 1e-7 - out.value.heading[out.fresh]
    np.testing.assert_allclose(lag, 2.0 * 0.087, atol=1e-12)
    prompt = flown(without(sensor, "heading-latency"), 1000)
    np.testing.assert_allclose(prompt[1].value.heading[prompt[1].fresh], 2.0 * prompt[0][prompt[1].fresh] * 1e-7)


def test_noise_has_given_deviation_independent_of_latency():
    slow = flown(HeadingSensor(noise=0.1, timing=LateFix(latency=0.005, interval=ms(10))), 40000, rate=0.0)[1]
    fast = flown(HeadingSensor(noise=0.1, timing=LateFix(interval=ms(10))), 40000, rate=0.0)[1]
    errors = fast.value.heading[fast.fresh]
    assert errors.std() == pytest.approx(0.1, rel=4 / np.sqrt(2 * len(errors)))
    np.testing.assert_array_equal(slow.value.heading[slow.fresh], errors[: slow.fresh.sum()])


@pytest.mark.thorough
def test_compass_heading_has_the_published_variance():
    """[1] section 6.2.1: R1 = 1.6e-4 rad²."""
    _, out = flown(Compass(), 4000)
    error = np.angle(np.exp(1j * (out.value.heading - 2.0 * out.t * 1e-7)))
    assert error.var() == pytest.approx(1.6e-4, rel=0.1)
    perfect = Compass(magnetometer=Magnetometer())
    for heading in (-3.0, 0.0, 0.7, 2.9):
        assert perfect.measure(motion(0, heading)).heading == pytest.approx(heading, abs=1e-12)


def test_roll_shifts_compass_heading_by_tangent_of_dip():
    """Rolled while it points along the level field: tan(heading error) = tan(roll) tan(dip), to first order."""
    field = np.array([2e-5, 0.0, 4e-5])
    compass = Compass(magnetometer=Magnetometer(earth_field=field))
    got = float(compass.measure(motion(0, 0.0, roll=0.01)).heading)
    assert abs(got) == pytest.approx(0.01 * 2.0, rel=0.01)
