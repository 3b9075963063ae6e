"""Battery: present current and drawn charge lower the voltage."""

import jax
import numpy as np
import pytest

from trimtab.actuators.battery import Battery
from trimtab.core.errors import InputError
from trimtab.core.record import replace, to_arrays

battery = to_arrays(Battery(other=0.0))


@jax.jit
def drain(battery, currents):
    return jax.lax.scan(lambda x, i: battery.step(np.int64(0), x, i), battery.init(), currents)[1]


def test_full_battery_without_load_has_nominal_voltage():
    assert float(battery.init().voltage) == 7.2
    assert float(Battery().init().voltage) == pytest.approx(7.2 - 0.03 * 3.0)


def test_voltage_drop_is_resistance_times_current():
    assert float(drain(battery, np.full(1, 10.0)).voltage[0]) == pytest.approx(7.2 - 0.3, abs=1e-5)


def test_battery_is_empty_after_its_capacity_is_drawn():
    small = replace(battery, capacity=np.float64(2.0), resistance=np.float64(0.0))
    out = drain(small, np.full(3000, 1.0))
    np.testing.assert_allclose(out.voltage[999::1000], [6.7, 6.2, 6.2], rtol=1e-12)
    np.testing.assert_allclose(out.remaining[999::1000], [0.5, 0.0, 0.0], atol=1e-12)


def test_starts_with_the_initial_charge():
    half = replace(battery, initial=np.float64(0.5))
    assert float(half.init().voltage) == pytest.approx(6.7)
    assert float(drain(half, np.zeros(1)).remaining[0]) == pytest.approx(0.5)


def test_lift_fan_and_electronics_draw_current():
    out = drain(to_arrays(Battery()), np.zeros(1000))
    np.testing.assert_allclose(out.current, 3.0)
    assert float(out.remaining[-1]) == pytest.approx(1 - 3.0 / 10800)


def test_voltage_is_constant_without_sag():
    out = drain(replace(battery, sags=False, capacity=np.float64(1.0)), np.full(3000, 9.0))
    assert (np.asarray(out.voltage) == 7.2).all()


def test_rejects_empty_voltage_above_full():
    with pytest.raises(InputError, match=r"empty: the empty voltage of 8 V must be at most the full voltage, 7\.2 V"):
        Battery(empty=8.0).check()
