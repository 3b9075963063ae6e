"""The gyro's dynamics and their inverse against [1] table 6.5.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal

from studies.hovercraft2006.gyro_compensation import TABLE_6_5
from trimtab.core.time import ms
from trimtab.sensors.gyro_dynamics import DelayedGyro, IdentifiedGyro, frequency_response

DT = 0.0065536
TABLE = np.array(TABLE_6_5)


def followed(model, u):
    """What a model says to the rates u (n,), settled at the first."""
    run = jax.jit(lambda m, u: jax.lax.scan(m.respond, m.start(u[0]), u)[1])
    return np.asarray(run(model, jnp.asarray(u)))


def test_identified_gyro_matches_equation_6_2():
    """Poles 0.490 ± 0.222 i, gain at rest 1.046; the step response is scipy's."""
    section = IdentifiedGyro(normalised=False).section()
    poles = np.roots([1, section.a1, section.a2])
    np.testing.assert_allclose(sorted(poles, key=np.imag), [0.490 - 0.222j, 0.490 + 0.222j], atol=1e-3)
    assert section.gain() == pytest.approx(1.046, abs=5e-4)
    u = np.append(0.0, np.ones(30))
    wanted = signal.lfilter([0.3236], [1, -0.9805, 0.2898], u)
    np.testing.assert_allclose(followed(IdentifiedGyro(normalised=False), u), wanted, atol=1e-14)
    assert followed(IdentifiedGyro(), u)[-1] == pytest.approx(1, abs=1e-6)


def test_delayed_gyro_matches_gains_of_table_6_5():
    """[1] table 6.5: gains within 0.05 at all seven frequencies, as far as the table's two digits tell (0.005).

    The phase is within 0.05 rad at 5 and 15 Hz, and lags by 0.3, 0.5 and 1.0 rad too much at 20, 30 and 50 Hz.
    """
    H = frequency_response(*DelayedGyro().coefficients(), TABLE[:, 0], DT)
    np.testing.assert_allclose(np.abs(H), TABLE[:, 1], rtol=0, atol=0.05 + 0.005)
    lag = np.unwrap(np.angle(H)) - TABLE[:, 2]
    np.testing.assert_allclose(lag[[0, 2]], 0, atol=0.05)
    np.testing.assert_allclose(lag[[3, 4, 6]], [-0.3, -0.5, -1.0], atol=0.05)


def test_delayed_gyro_matches_analogue_low_pass_with_delay():
    f = np.linspace(0.5, 50, 60)
    b, a = signal.butter(2, 2 * np.pi * 30, analog=True)
    wanted = signal.freqs(b, a, 2 * np.pi * f)[1] * np.exp(-2j * np.pi * f * 2 * DT)
    H = frequency_response(*DelayedGyro().coefficients(), f, DT)
    np.testing.assert_allclose(np.abs(H), np.abs(wanted), rtol=0, atol=0.006)
    np.testing.assert_allclose(np.angle(H / wanted), 0, atol=0.006)


def test_delayed_gyro_sine_response_matches_frequency_response():
    """Fed with a sine, after the transient: amplitude and phase by projection."""
    model, f = DelayedGyro(), 15.0
    t = np.arange(600) * DT
    y = followed(model, np.sin(2 * np.pi * f * t))
    late = slice(300, None)
    basis = np.stack([np.sin(2 * np.pi * f * t), np.cos(2 * np.pi * f * t)], 1)[late]
    a, b = np.linalg.lstsq(basis, y[late], rcond=None)[0]
    assert a + 1j * b == pytest.approx(complex(frequency_response(*model.coefficients(), f, DT)), abs=1e-6)


def test_models_start_in_steady_state():
    for model in (IdentifiedGyro(), DelayedGyro()):
        np.testing.assert_allclose(followed(model, np.full(20, 0.7)), 0.7, atol=1e-12)
    assert DelayedGyro().sampling == ms("6.5536")
