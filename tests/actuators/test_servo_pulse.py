"""Pulses against numpy's interpolation, their steps against rounding, and the table of an actuator bank."""

import jax
import numpy as np
import pytest

from trimtab.actuators.bank import ActuatorBank
from trimtab.actuators.lag import FirstOrderLag
from trimtab.actuators.rotor_allocation import RotorDrive
from trimtab.actuators.servo_pulse import ServoPulse, linear_pulse
from trimtab.core.errors import InputError
from trimtab.core.imperfections import without
from trimtab.core.record import replace
from trimtab.core.signals import PlanarForce

CURVED = ServoPulse(values=np.array([-0.5, -0.1, 0.2, 1.0]), widths=np.array([2.1e-3, 1.6e-3, 1.5e-3, 0.9e-3]))


def test_pulse_table_and_inverse_match_numpy_interpolation():
    values = np.linspace(-1.0, 1.5, 101)
    np.testing.assert_allclose(CURVED.width(values), np.interp(values, CURVED.values, CURVED.widths), rtol=1e-14)
    widths = np.linspace(0.8e-3, 2.2e-3, 101)
    rising = np.interp(widths, CURVED.widths[::-1], CURVED.values[::-1])
    np.testing.assert_allclose(CURVED.value(widths), rising, rtol=1e-12, atol=1e-15)


def test_output_is_quantised_to_timer_steps():
    values = np.random.default_rng(1).uniform(-0.5, 1.0, 200)
    _, out = jax.jit(lambda v: CURVED.step((), v, 0.01))(values)
    counts = CURVED.width(out.value) / 0.5e-6
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    slopes = np.abs(np.diff(CURVED.values) / np.diff(CURVED.widths))
    error = np.abs(out.value - values)
    assert 0 < error.max() <= 0.25e-6 * slopes.max() * (1 + 1e-9)
    assert not out.limited
    _, exact = without(CURVED, "pulse-steps").step((), values, 0.01)
    np.testing.assert_allclose(exact.value, values, rtol=1e-12, atol=1e-15)


def test_values_beyond_the_table_are_clipped_and_flagged():
    _, out = CURVED.step((), np.array([0.1, 7.0]), 0.01)
    assert float(out.value[1]) == 1.0
    assert out.limited


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"values": np.array([0.0, 1.0])}, "shape"),
        ({"values": np.array([0.0, 1.0, 1.0, 2.0])}, "values must increase"),
        ({"widths": np.array([1e-3, 1.5e-3, 1.2e-3, 2e-3])}, "must be strictly monotonic"),
        ({"widths": np.array([1e-3, 1.2e-3, 1.4e-3, 2.5e-3])}, r"0\.8 to 2\.2 ms"),
    ],
)
def test_rejects_invalid_pulse_tables(changed, words):
    with pytest.raises(InputError, match=words):
        replace(CURVED, **changed).check()


def test_bank_declares_pulses_of_fields_with_stops():
    slow = FirstOrderLag(time_constant=0.1, low=-3.0, high=6.0)
    tight = FirstOrderLag(time_constant=0.0, low=-9.0, high=2.0)
    bank = ActuatorBank(PlanarForce(0.0, 0.0), {"FX": (slow, tight), "FY": (CURVED, slow)})
    found = bank.pulses()
    np.testing.assert_array_equal(found["FX"].values, [-3.0, 2.0])
    np.testing.assert_array_equal(found["FX"].widths, [1e-3, 2e-3])
    assert found["FY"] is CURVED
    assert ActuatorBank(PlanarForce(0.0, 0.0), {"FX": FirstOrderLag()}).pulses() == {}
    np.testing.assert_array_equal(RotorDrive(most=500.0).pulses()["speed"].values, [0.0, 500.0])
    np.testing.assert_array_equal(linear_pulse(-1, 2).values, [-1.0, 2.0])
