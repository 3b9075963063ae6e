import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.imperfections import without
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import key
from trimtab.core.time import ms
from trimtab.loop.structure import strengthen_types
from trimtab.sensors.encoder import Encoder
from trimtab.sensors.late_fix import LateFix
from trimtab.sensors.position import EncoderPosition, PositionSensor
from trimtab.vehicles.rotating_platform import PlatformDrive, RotatingPlatform

RIG = RotatingPlatform()
REST = to_arrays(RIG.rest_state())


def at(t, rate=2.0):
    """The platform's motion at a constant rate, arm north at first."""
    heading = np.pi / 2 + rate * t * 1e-7
    return RIG.motion(t, replace(REST, heading=heading, yaw_rate=jnp.asarray(rate)), PlatformDrive(rate))


def flown(sensor, n):
    now = jnp.arange(n, dtype=np.int64) * sensor.period
    first = strengthen_types(sensor.init(key(5)))
    out = jax.lax.scan(lambda s, t: sensor.step(t, s, at(t)), first, now)[1]
    return np.asarray(now), jax.tree.map(np.asarray, out)


@pytest.mark.parametrize("inward", [0.0, 0.2])
def test_late_fix_gives_the_position_before_the_latency(inward):
    sensor = PositionSensor(noise=0.0, lever_arm=(0.0, inward, 0.0), timing=LateFix(latency=0.05, interval=ms(100)))
    now, out = flown(sensor, 1000)
    angle = 2.0 * (now[out.fresh] - ms(50)) * 1e-7
    R = RIG.arm - inward
    np.testing.assert_allclose(out.value.north[out.fresh], R * np.cos(angle), atol=1e-12)
    np.testing.assert_allclose(out.value.east[out.fresh], R * np.sin(angle), atol=1e-12)


@pytest.mark.thorough
def test_noise_of_both_coordinates_has_the_given_deviation():
    clean, noisy = (PositionSensor(noise=s, timing=LateFix(interval=ms(5))) for s in (0.0, 0.02))
    a, b = flown(clean, 20000)[1], flown(noisy, 20000)[1]
    for name in ("north", "east"):
        error = (getattr(b.value, name) - getattr(a.value, name))[b.fresh]
        assert error.std() == pytest.approx(0.02, rel=4 / math.sqrt(2 * len(error)))
    assert (flown(without(noisy, "position-noise"), 50)[1].value.north == a.value.north[:50]).all()


def test_encoder_position_is_accurate_to_half_a_count():
    sensor = EncoderPosition(encoder=Encoder(zero=math.pi / 2, period=ms(7)))
    now, out = flown(sensor, 400)
    angle = 2.0 * now * 1e-7
    off = np.hypot(out.value.north - RIG.arm * np.cos(angle), out.value.east - RIG.arm * np.sin(angle))
    half = RIG.arm * math.pi / 4096
    assert 0.7 * half < off.max() < half * (1 + 1e-9)
