"""The gyro's inverse against [1] table 6.5 and against the gyro itself.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from studies.hovercraft2006.gyro_compensation import TABLE_6_5
from trimtab.compiler.function import lower_function
from trimtab.estimators.inertial.gyro_compensated import GyroCompensator
from trimtab.sensors.gyro_dynamics import IdentifiedGyro

DT = 0.0065536
TABLE = np.array(TABLE_6_5)


def compensated(compensator, y):
    run = jax.jit(lambda c, y: jax.lax.scan(c.compensate, c.start(y[0]), y)[1])
    return np.asarray(run(compensator, jnp.asarray(y)))


def measured_response(compensator, f):
    """Complex gain at f (Hz): the compensator fed with a sine, projected on sine and cosine."""
    t = np.arange(400) * DT
    u = compensated(compensator, np.sin(2 * np.pi * f * t))
    basis = np.stack([np.sin(2 * np.pi * f * t), np.cos(2 * np.pi * f * t)], 1)[10:]
    a, b = np.linalg.lstsq(basis, u[10:], rcond=None)[0]
    return a + 1j * b


def test_check_19_table_6_5_is_the_inverse_of_the_identified_gyro():
    """Compensated over uncompensated: gain 1 %, phase 0.006 rad, delay within 0.01 rad/w. [1] table 6.5, eq. 6.2."""
    f, gain, phase, after, phase_after, delay = TABLE.T
    got = np.array([measured_response(GyroCompensator(normalised=False), x) for x in f])
    np.testing.assert_allclose(np.abs(got), after / gain, rtol=0.01)
    np.testing.assert_allclose(np.angle(got), phase_after - phase, atol=0.006)
    assert (np.abs(-np.angle(got) / (2 * np.pi * f) - delay * 1e-3) <= 0.01 / (2 * np.pi * f)).all()


def test_it_undoes_the_identified_gyro_exactly():
    u = np.cumsum(np.random.default_rng(0).normal(size=200))
    for normalised in (True, False):
        gyro = IdentifiedGyro(normalised=normalised)
        y = jax.lax.scan(gyro.respond, gyro.start(u[0]), jnp.asarray(u))[1]
        compensator = GyroCompensator(normalised=normalised)
        # Both start settled; without normalisation the gyro rests at 1.046 u.
        np.testing.assert_allclose(compensated(compensator, y), u, atol=1e-12)


def test_both_carry_the_same_numbers():
    """Sensors and estimators import nothing of each other: the identified numbers stand in both."""
    gyro, compensator = IdentifiedGyro(), GyroCompensator()
    for name in (f.name for f in dataclasses.fields(GyroCompensator)):
        assert getattr(gyro, name) == getattr(compensator, name)


def test_it_raises_noise_sevenfold_at_half_the_sampling_rate():
    alternating = np.tile([1.0, -1.0], 20)
    assert np.abs(compensated(GyroCompensator(normalised=False), alternating))[10:].max() == pytest.approx(
        7.02, abs=0.01
    )


def test_exportable():
    compensator = GyroCompensator()
    lower_function(lambda c, s, y: c.compensate(s, y), (compensator, compensator.start(jnp.zeros(3)), jnp.zeros(3)))
