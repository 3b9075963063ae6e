"""Allocation to a one-way propeller and rudders: demands within reach are met exactly, others by stated priorities."""

import jax
import numpy as np
import pytest

from trimtab.actuators.rudder_allocation import RudderAllocation
from trimtab.core.record import replace, to_arrays
from trimtab.core.signals import PlanarForce
from trimtab.vehicles.rudder_hovercraft import RudderHovercraft

ALLOCATION, CRAFT = RudderAllocation(), RudderHovercraft()
PSI_MAX, T_MAX = 0.42, 1.6


@jax.jit
def _through(allocation, FX, FY):
    def one(FX, FY):
        _, u = allocation.step(np.int64(0), (), PlanarForce(FX, FY))
        return u, CRAFT.force(u)

    return jax.vmap(one)(FX, FY)


def force_of(FX, FY, allocation=ALLOCATION):
    """Command and force for demands (n,)."""
    return _through(to_arrays(allocation), np.atleast_1d(FX) * 1.0, np.atleast_1d(FY) * 1.0)


def test_demands_within_reach_are_met_exactly() -> None:
    rng = np.random.default_rng(1)
    T, psi = rng.uniform(0.02, T_MAX, 1000), rng.uniform(-PSI_MAX, PSI_MAX, 1000)
    FX, FY = T * np.cos(psi), -T * np.sin(psi)
    _, f = force_of(FX, FY)
    np.testing.assert_allclose(f.FX, FX, atol=1e-9)
    np.testing.assert_allclose(f.FY, FY, atol=1e-9)


def test_side_force_without_push_gives_the_least_push() -> None:
    FY = np.linspace(-0.6, 0.6, 25)
    FY = FY[abs(FY) > 0.02]
    u, f = force_of(np.zeros_like(FY), FY)
    np.testing.assert_allclose(f.FY, FY, atol=1e-9)
    np.testing.assert_allclose(f.FX, abs(FY) / np.tan(PSI_MAX), rtol=1e-9)
    np.testing.assert_allclose(abs(u.rudder), 0.6, rtol=1e-9)


@pytest.mark.parametrize("FX", [0.0, -0.5, -5.0])
def test_demands_to_push_backward_stop_the_propeller(FX: float) -> None:
    u, _ = force_of(FX, 0.0)
    assert float(u.throttle[0]) == float(u.rudder[0]) == 0.0


def test_side_force_has_priority_over_push_at_full_thrust() -> None:
    _, f = force_of(5.0, -0.5)
    assert float(f.FY[0]) == pytest.approx(-0.5, abs=1e-9)
    assert float(f.FX[0]) == pytest.approx(np.sqrt(T_MAX**2 - 0.25), abs=1e-9)


def test_no_demand_leaves_the_limits() -> None:
    rng = np.random.default_rng(2)
    limited = replace(ALLOCATION, throttle_max=0.7)
    u, _ = force_of(rng.normal(0, 3, 2000), rng.normal(0, 3, 2000), limited)
    assert np.all((u.throttle >= 0) & (u.throttle <= 0.7))
    assert np.all(abs(u.rudder) <= 0.6 + 1e-12)


def test_small_side_force_at_rest_causes_no_thrust() -> None:
    u, _ = force_of(0.0, 0.009)
    assert float(u.throttle[0]) == 0.0


def test_linear_thrust_curve_is_inverted() -> None:
    craft = replace(CRAFT, thrust_linear=2.0, thrust_quadratic=0.0)
    u, _ = force_of(1.0, 0.0, replace(ALLOCATION, model=craft))
    assert float(u.throttle[0]) == pytest.approx(0.5, rel=1e-12)
