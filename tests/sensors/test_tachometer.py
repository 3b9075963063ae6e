import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal

from trimtab.core.errors import InputError
from trimtab.core.imperfections import imperfections, without
from trimtab.core.interfaces import Sensor
from trimtab.core.rng import key
from trimtab.core.signals import Motion
from trimtab.core.time import ms
from trimtab.sensors.encoder import BESSEL4, Tachometer, bessel4


def followed(tachometer, rates, seed=0):
    o = jnp.zeros(3)

    def one(state, both):
        k, r = both
        m = Motion(0, o, o, o, jnp.array([0.0, 0.0, 1.0]) * r, o, o)
        state, sample = tachometer.step(k * tachometer.period, state, m)
        return state, sample.value.yaw_rate

    u = jnp.asarray(rates)
    return np.asarray(jax.jit(lambda u: jax.lax.scan(one, tachometer.init(key(seed)), (jnp.arange(len(u)), u))[1])(u))


def test_filter_sections_match_scipy_bessel():
    """Poles of the analogue prototype normed to -3 dB, and the digital response within 0.2 % below 25 Hz at 1 ms."""
    poles = signal.besselap(4, norm="mag")[1]
    found = sorted({(round(abs(p), 9), round(abs(p) / (-2 * p.real), 9)) for p in poles})
    np.testing.assert_allclose(sorted(BESSEL4), found, atol=1e-9)
    f = np.linspace(0.1, 25, 50)
    H = np.ones(50, complex)
    for s in bessel4(5.0, 1e-3):
        H *= signal.freqz([s.b0, s.b1, s.b2], [1, s.a1, s.a2], f, fs=1000)[1]
    b, a = signal.bessel(4, 2 * np.pi * 5, analog=True, norm="mag")
    np.testing.assert_allclose(H, signal.freqs(b, a, 2 * np.pi * f)[1], atol=2e-3)


def test_gain_at_the_bandwidth_is_minus_3_db():
    t = np.arange(1500) * 1e-3
    y = followed(without(Tachometer(), "tachometer-noise"), np.sin(2 * np.pi * 5 * t))
    basis = np.stack([np.sin(2 * np.pi * 5 * t), np.cos(2 * np.pi * 5 * t)], 1)[700:]
    assert np.linalg.norm(np.linalg.lstsq(basis, y[700:], rcond=None)[0]) == pytest.approx(np.sqrt(0.5), abs=1e-3)


def test_scale_offset_and_noise_have_the_given_sizes():
    tachometer = Tachometer(scale_factor=0.01, offset=0.02, noise=0.05)
    assert isinstance(tachometer, Sensor)
    y = followed(tachometer, np.full(3000, 2.0), seed=4)
    assert y.mean() == pytest.approx(2.04, abs=4 * 0.05 / np.sqrt(3000))
    assert y.std() == pytest.approx(0.05, rel=0.06)
    clean = tachometer
    for name in imperfections(Tachometer()):
        clean = without(clean, name)
    u = np.sin(np.arange(50.0))
    np.testing.assert_allclose(followed(clean, u), u, atol=1e-15)


def test_rejects_wide_bandwidth_and_unknown_imperfection():
    with pytest.raises(InputError, match="too wide"):
        Tachometer(bandwidth=40.0, period=ms(10)).check()
    Tachometer().check()
    with pytest.raises(InputError, match="no imperfection"):
        without(Tachometer(), "ripple")
