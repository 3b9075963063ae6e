"""Battery: what is drawn now and what has been drawn lower the voltage."""

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


def test_full_and_without_load_it_has_its_voltage():
    assert float(battery.init().voltage) == 7.2
    assert float(Battery().init().voltage) == pytest.approx(7.2 - 0.03 * 3.0)


def test_load_costs_resistance_times_current():
    assert float(drain(battery, np.full(1, 10.0)).voltage[0]) == pytest.approx(7.2 - 0.3, abs=1e-5)


def test_it_is_empty_when_its_capacity_is_drawn_and_stays_so():
    small = replace(battery, capacity=np.float64(2.0), resistance=np.float64(0.0))
    out = drain(small, np.full(3000, 1.0))
    np.testing.assert_allclose(out.voltage[999::1000], [6.7, 6.2, 6.2], rtol=1e-12)
    np.testing.assert_allclose(out.remaining[999::1000], [0.5, 0.0, 0.0], atol=1e-12)


def test_what_is_left_at_the_start_is_left():
    half = replace(battery, initial=np.float64(0.5))
    assert float(half.init().voltage) == pytest.approx(6.7)
    assert float(drain(half, np.zeros(1)).remaining[0]) == pytest.approx(0.5)


def test_lift_fan_and_electronics_draw_too():
    out = drain(to_arrays(Battery()), np.zeros(1000))
    np.testing.assert_allclose(out.current, 3.0)
    assert float(out.remaining[-1]) == pytest.approx(1 - 3.0 / 10800)


def test_without_sag_nothing_lowers_it():
    out = drain(replace(battery, sags=False, capacity=np.float64(1.0)), np.full(3000, 9.0))
    assert (np.asarray(out.voltage) == 7.2).all()


def test_empty_above_full_is_refused():
    with pytest.raises(InputError, match=r"empty: the empty voltage of 8 V must be at most the full voltage, 7\.2 V"):
        Battery(empty=8.0).check()
