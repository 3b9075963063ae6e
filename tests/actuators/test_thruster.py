"""Fan: the thrust law in both directions, its inverse, and the lag.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from trimtab.actuators.rudder import DEG
from trimtab.actuators.thruster import Thruster
from trimtab.core.errors import InputError
from trimtab.core.record import replace, to_arrays

FAN = to_arrays(Thruster())
STRAIGHT = 0.566 * DEG
force = jax.jit(FAN.force)
speed_rpm = jax.jit(FAN.speed_rpm)


def _oracle(n, theta):
    """The law as the source states it, n in krpm."""
    if n >= 0:
        share = 1.0
    else:
        m = min(max(-n, 6.0), 12.0)
        share = 9.734e-4 * m**3 - 3.277e-2 * m**2 + 3.833e-1 * m - 1.099
    return np.sign(n) * 1.6 / 144 * n**2 * share * np.cos(theta - STRAIGHT)


@pytest.mark.parametrize(("n", "y"), [(6, 0.2313), (8, 0.3685), (10, 0.4304), (12, 0.4638), (3, 0.2313), (1, 0.2313)])
def test_reverse_thrust_ratio_matches_equation_4_4(n, y):
    """[1] eq. 4.4; held below 6 krpm, where the cubic loses its meaning."""
    assert FAN.ratio(np.float64(1000 * n)) == pytest.approx(y, abs=5e-5)


def test_thrust_matches_reconstructed_forces():
    assert FAN.force(np.array([3000.0, 12000.0, -12000.0]), STRAIGHT) == pytest.approx([0.10, 1.6, -0.742], abs=5e-4)
    assert FAN.eta(-35 * DEG) == pytest.approx(np.cos(35.566 * DEG))


def test_thrust_law_matches_the_thesis():
    rng = np.random.default_rng(0)
    n, theta = rng.uniform(-14, 14, 300), rng.uniform(-35, 30, 300) * DEG
    wanted = [_oracle(a, b) for a, b in zip(n, theta, strict=True)]
    assert np.allclose(force(n * 1e3, theta), wanted, atol=1e-13)
    assert np.allclose(FAN.force(n * 1e3, theta), wanted, atol=1e-13)


def test_inverse_is_the_root_of_the_law():
    rng = np.random.default_rng(1)
    wanted, theta = rng.uniform(-0.9, 1.9, 200), rng.uniform(-35, 30, 200) * DEG
    roots = [
        brentq(lambda n, f=f, b=b: _oracle(n, b) - f, -20, 20, xtol=1e-13) for f, b in zip(wanted, theta, strict=True)
    ]
    assert np.allclose(np.asarray(speed_rpm(wanted, theta)) * 1e-3, roots, atol=1e-9)
    assert np.allclose(FAN.speed_rpm(wanted, theta) * 1e-3, roots, atol=1e-9)


def test_inverse_is_exact_over_the_reverse_range():
    """The fixed number of Newton steps is enough everywhere, kinks at 6 and 12 krpm included."""
    n = -np.linspace(0, 15000, 30001)
    assert np.abs(FAN.speed_rpm(FAN.force(n, 0.1), 0.1) - n).max() < 1e-8


@settings(deadline=None)
@given(st.floats(-1e3, 1e3), st.floats(-2.5, 2.5))
def test_any_force_is_realised_at_any_rudder_angle(wanted, theta):
    assert float(force(speed_rpm(wanted, theta), theta)) == pytest.approx(wanted, rel=1e-11, abs=1e-15)


@pytest.mark.thorough
def test_inverse_is_differentiable_at_zero_force():
    for wanted in (-0.3, -0.05, 0.0, 0.2):
        slopes = jax.grad(lambda f: FAN.speed_rpm(f, 0.1))(wanted)
        assert np.isfinite(slopes)
        if wanted:
            there = jax.grad(lambda n: FAN.force(n, 0.1))(speed_rpm(wanted, 0.1))
            assert slopes * there == pytest.approx(1, rel=1e-6)


def test_thrust_law_works_in_numpy_and_jax():
    assert isinstance(FAN.force(np.ones(3), 0.1), np.ndarray)
    traced = jax.jit(lambda fan: fan.speed_rpm(np.float64(0.3), 0.1))(FAN)
    assert isinstance(traced, jax.Array)
    assert traced == pytest.approx(FAN.speed_rpm(np.float64(0.3), 0.1))


def test_speed_lag_is_exact_and_off_by_default():
    assert FAN.follow_speed(100.0, 5000.0, 1e-3) == 5000.0
    slow = replace(FAN, time_constant=0.2)
    speed = 0.0
    for _ in range(200):
        speed = slow.follow_speed(speed, 5000.0, 1e-3)
    assert speed == pytest.approx(5000 * (1 - np.exp(-1.0)), rel=1e-12)
    assert jnp.isfinite(jax.grad(lambda c: replace(FAN, time_constant=c).follow_speed(1.0, 2.0, 1e-3))(0.2))


def test_rejects_invalid_reverse_maps():
    Thruster().check()
    with pytest.raises(InputError, match="reverse_ratio: reverse thrust must be positive"):
        Thruster(reverse_low_rpm=4000.0).check()
    with pytest.raises(InputError, match="reverse_low_rpm"):
        Thruster(reverse_low_rpm=13000.0).check()
