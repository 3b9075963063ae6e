"""The F-16: its tables, its signs, and its trim against published values."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from studies.nesc2015._autopilot import move
from studies.nesc2015._jet import JET, KITTY_HAWK, NORTH_EAST, trim
from trimtab.core.record import replace
from trimtab.core.rotation import DEG
from trimtab.environment.atmosphere import standard_atmosphere
from trimtab.vehicles.f16 import F16Controls, coefficients, engine_thrust, flow_angles, interpolate_plane
from trimtab.vehicles.f16_tables import ALPHA, CM, ELEVATOR
from trimtab.vehicles.imperial import FOOT, POUND_FORCE
from trimtab.vehicles.rigid_body import Airflow

CENTRED = F16Controls(0.0, 0.0, 0.0, 0.0)


def flow_at(alpha, beta, rate=(0.0, 0.0, 0.0), speed=172.0):
    way = np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
    return Airflow(jnp.asarray(speed * way), speed, jnp.asarray(rate), standard_atmosphere(3000.0))


def test_table_interpolation_matches_scipy_and_holds_end_values():
    theirs = RegularGridInterpolator((ELEVATOR, ALPHA), CM)
    for y, x in np.random.default_rng(1).uniform([-30, -15], [30, 50], (50, 2)):
        inside = np.clip(y, -24, 24), np.clip(x, -10, 45)
        ours = interpolate_plane(y, x, ELEVATOR, ALPHA, CM[..., None])[0]
        np.testing.assert_allclose(ours, theirs(inside).item(), atol=1e-15)


def test_flow_angles_match_and_are_finite_at_rest():
    np.testing.assert_allclose(flow_angles(flow_at(0.2, -0.1)), (0.2, -0.1), atol=1e-15)
    assert np.isfinite(flow_angles(flow_at(0.0, 0.0, speed=0.0))).all()


def test_coefficients_are_symmetric_left_to_right():
    """But for the tables of the ailerons and the rudder over sideslip, which are as the wind tunnel had them."""
    one = np.asarray(coefficients(flow_at(0.1, 0.15, rate=(0.2, 0.1, -0.05)), CENTRED))
    other = np.asarray(coefficients(flow_at(0.1, -0.15, rate=(-0.2, 0.1, 0.05)), CENTRED))
    np.testing.assert_allclose(other, one * np.array([1, -1, 1, -1, 1, -1]), atol=1e-15)


def test_control_surfaces_have_the_correct_signs():
    base = np.asarray(coefficients(flow_at(0.05, 0.0), CENTRED))

    def change(**moved):
        controls = replace(CENTRED, **{name: angle * DEG for name, angle in moved.items()})
        return np.asarray(coefficients(flow_at(0.05, 0.0), controls)) - base

    assert change(elevator=5)[4] < 0, "trailing edge down puts the nose down"
    assert change(aileron=5)[3] < 0, "rolls to the left"
    assert change(rudder=5)[5] < 0, "trailing edge left puts the nose to the left"
    stick = move(0.1, 0.1, 0.1, 0.2)
    assert stick.elevator < 0
    assert change(aileron=stick.aileron / DEG)[3] > 0
    assert change(rudder=stick.rudder / DEG)[5] > 0


@pytest.mark.parametrize(
    ("throttle", "mach", "altitude", "pounds"),
    [(0.0, 0.0, 0.0, 1060.0), (0.5, 0.0, 0.0, 12680.0), (1.0, 0.0, 0.0, 20000.0), (0.25, 0.0, 0.0, 6870.0)],
)
def test_thrust_matches_the_engine_table(throttle, mach, altitude, pounds):
    """F16_prop.dml: idle, military, full, and half of the dry range."""
    assert float(engine_thrust(throttle, mach, altitude * FOOT)) == pytest.approx(pounds * POUND_FORCE, rel=1e-12)


@pytest.mark.parametrize(("throttle", "mach"), [(0.1, 0.45), (0.9, 0.7)])
def test_thrust_slope_is_continuous_at_sea_level(throttle, mach):
    """The book's program extrapolates its table below sea level, so a linear model exists there."""
    above, here, below = (float(engine_thrust(throttle, mach, h)) for h in (300.0, 0.0, -300.0))
    assert above != here
    assert here - below == pytest.approx(above - here, rel=1e-9)


@pytest.mark.thorough
def test_level_trim_matches_nasa_simulations():
    """Pitch, elevator, throttle of the trim: README of NASA's F-16 package, table 11, with a constant gravitation."""
    level = trim(KITTY_HAWK, NORTH_EAST)
    assert level.pitch / DEG == pytest.approx(2.6538, abs=0.02)
    assert -25 * level.stick == pytest.approx(-3.2410, abs=0.01)
    assert level.throttle == pytest.approx(0.139019, abs=4e-4)
    d = JET.dynamics(0.0, level.state, move(level.stick, 0.0, 0.0, level.throttle))
    np.testing.assert_allclose(d.rate[1], 0, atol=1e-9)


def test_moments_account_for_the_centre_of_mass():
    """Ten per cent of the chord ahead of the reference: what lifts there pitches the nose down."""
    flow = flow_at(0.05, 0.02)
    here, there = (replace(JET, centre=c).air_wrench(flow, CENTRED) for c in (0.25, 0.35))
    arm = np.array([-0.1 * 11.32 * FOOT, 0.0, 0.0])
    np.testing.assert_allclose(here.force, there.force)
    np.testing.assert_allclose(here.moment - there.moment, np.cross(arm, here.force), rtol=1e-12)


@pytest.mark.thorough
def test_derivatives_are_continuous_at_zero_sideslip():
    """Of roll and yaw over sideslip, by automatic differentiation where the tables are mirrored."""

    def moments(beta):
        level = flow_at(0.05, 0.0)
        flow = level._replace(velocity=level.velocity + jnp.array([0.0, 172.0, 0.0]) * jnp.sin(beta))
        return coefficients(flow, CENTRED)[jnp.array([3, 5])]

    at, beside = jax.jacfwd(moments)(0.0), jax.jacfwd(moments)(0.01)
    np.testing.assert_allclose(at, beside, rtol=1e-3)
