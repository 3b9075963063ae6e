"""Allocation: polar form, dead zone, stops, and commands back to the force that the drive then really produces.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trimtab.actuators.allocation import ThrustVectorAllocation, to_polar
from trimtab.actuators.drive import FanDrive
from trimtab.actuators.rudder import DEG
from trimtab.actuators.thruster import Thruster
from trimtab.core.errors import InputError
from trimtab.core.imperfections import imperfections, without
from trimtab.core.interfaces import Allocation
from trimtab.core.record import replace, to_arrays
from trimtab.core.signals import PlanarForce, new_sample

ALLOCATION, DRIVE = ThrustVectorAllocation(), FanDrive()
MOST = 5000
"""Number of demands of each call: calls with the same parts share a program."""
FAULTS = ("saturation", "dead-zone", "braking", "lookup-table")


@jax.jit
def _chain(allocation, drive, FX, FY):
    """Command and drive output for demands (n,), each from rest at t = 0."""

    def one(FX, FY):
        _, command = allocation.step(np.int64(0), (), PlanarForce(FX, FY))
        _, out = drive.step(np.int64(0), drive.init(None), new_sample(np.int64(0), command))
        return command, out

    return jax.vmap(one)(FX, FY)


def _through(FX, FY, *names):
    allocation, drive = ALLOCATION, DRIVE
    for name in names:
        allocation = without(allocation, name) if name in imperfections(allocation) else allocation
        drive = without(drive, name) if name in imperfections(drive) else drive
    FX, FY = np.atleast_1d(FX) * 1.0, np.atleast_1d(FY) * 1.0
    all_of_them = (np.pad(f, (0, MOST - len(FX))) for f in (FX, FY))
    out = _chain(to_arrays(allocation), to_arrays(drive), *all_of_them)
    return jax.tree.map(lambda v: np.asarray(v)[: len(FX)], out)


def _demands(n, size, seed=0):
    """Forces of sizes in a range, in directions that the rudder can give, both ways round."""
    rng = np.random.default_rng(seed)
    f = rng.uniform(*size, n) * rng.choice([-1, 1], n)
    psi = rng.uniform(-20.9, 25.3, n) * DEG
    return f * np.cos(psi), -f * np.sin(psi)


@pytest.mark.thorough
@settings(deadline=None)
@given(st.floats(-2, 2), st.floats(-2, 2))
def test_polar_form_matches_the_thesis_and_inverts(FX, FY):
    f, psi = to_polar(PlanarForce(jnp.float64(FX), jnp.float64(FY)))
    assert abs(float(psi)) <= np.pi / 2
    if abs(FX) > 1e-100 and abs(FY) < 1e200 * abs(FX):
        assert float(f) == pytest.approx(np.sign(FX) * np.hypot(FX, FY), rel=1e-12, abs=1e-150)
        assert float(psi) == pytest.approx(-np.arctan(FY / FX), abs=1e-12)
    back = [float(f * jnp.cos(psi)), float(-f * jnp.sin(psi))]
    assert back == pytest.approx([FX, FY], abs=1e-12 * np.hypot(FX, FY) + 1e-150)


def test_command_matches_analytical_formula():
    """Pulse and speed computed analytically, with the formula in place of the table."""
    rng = np.random.default_rng(2)
    FX, FY = rng.uniform(-0.5, 0.9, 200), rng.uniform(-0.4, 0.4, 200)
    command, _ = _through(FX, FY, "lookup-table", "dead-zone")
    psi = -np.arctan(FY / FX)
    theta = np.clip(0.566 - 1.40 * np.degrees(psi), -35, 30)
    x = np.linspace(-1, 1, 21)
    pulse = np.interp(theta, 35 * np.sin(72 * DEG * x) / np.sin(72 * DEG), 1.5e-3 + 0.5e-3 * x)
    speed = np.clip(Thruster().speed_rpm(np.sign(FX) * np.hypot(FX, FY), theta * DEG), -12000, 12000)
    assert np.allclose(command.rudder_pulse, pulse, atol=1e-12)
    assert np.allclose(command.speed_rpm, speed, atol=1e-6)
    assert (np.abs(theta) > 29.9).any()
    assert (np.abs(theta) < 29).any()


@pytest.mark.parametrize("faults", [("dead-zone",), ("lookup-table", "dead-zone")])
def test_excessive_demand_commands_top_speed(faults):
    """From the table as from the formula, whose speed rises without end."""
    command, _ = _through(np.array([3.0, -3.0, 0.1]), np.zeros(3), *faults)
    assert np.asarray(command.speed_rpm)[:2] == pytest.approx([12000, -12000], abs=1e-9)
    assert 0 < command.speed_rpm[2] < 12000
    free, _ = _through(np.array([3.0, -3.0]), np.zeros(2), *faults, "saturation")
    assert (np.abs(free.speed_rpm) > 15000).all()


def test_feasible_demand_is_met_within_interpolation_error():
    """[1] chapter 4: both tables in series; off the grid at most 0.0062 N, 0.0008 N above 0.1 N."""
    for size, worst in (((0.1, 0.55), 0.0008), ((0.05, 0.1), 0.0062)):
        FX, FY = _demands(5000, size)
        _, out = _through(FX, FY)
        error = np.hypot(out.u.FX - FX, out.u.FY - FY)
        assert error.max() < worst
        assert not np.asarray(out.rudder_saturated | out.speed_saturated).any()


def test_feasible_demand_is_exact_without_tables():
    FX, FY = _demands(2000, (0.051, 0.59))
    _, out = _through(FX, FY, "lookup-table")
    assert np.allclose(out.u.FX, FX, atol=1e-12)
    assert np.allclose(out.u.FY, FY, atol=1e-12)


def test_any_demand_is_exact_without_imperfections():
    """Sideways and far too large ones included: rudder and fan have no limits on either side."""
    rng = np.random.default_rng(3)
    FX, FY = rng.normal(size=3000) * 3, rng.normal(size=3000) * 3
    FX[:4], FY[:4] = [0, 0, 1, -1], [5, -5, 0, 0]
    for tables in ((), ("lookup-table",)):
        _, out = _through(FX, FY, "saturation", "dead-zone", *tables)
        assert np.allclose(out.u.FX, FX, atol=1e-9)
        assert np.allclose(out.u.FY, FY, atol=1e-9)
        assert not np.asarray(out.rudder_saturated | out.speed_saturated).any()


def test_pure_sideways_demand_produces_mostly_surge_force():
    """[1] section 6.1: a pure FY demand comes out at |psi| <= 25 deg, with a large FX whose sign jumps."""
    FX = np.array([1e-9, 1e-9, -1e-9, -1e-9, 0.0, 0.0])
    FY = np.array([0.5, -0.5, 0.5, -0.5, 0.5, -0.5])
    _, out = _through(FX, FY)
    psi = np.degrees(np.arctan2(np.abs(out.u.FY), np.abs(out.u.FX)))
    right, left = 25.404, 21.024
    assert np.allclose(
        psi,
        [
            right * (y < 0) + left * (y > 0) if x >= 0 else right * (y > 0) + left * (y < 0)
            for x, y in zip(FX, FY, strict=True)
        ],
        atol=0.01,
    )
    assert np.array_equal(np.sign(out.u.FX), [1, 1, -1, -1, 1, 1])
    assert np.array_equal(np.sign(out.u.FY), np.sign(FY))
    assert np.allclose(np.hypot(out.u.FX, out.u.FY), 0.5, atol=1e-3), "the size is kept"
    assert (np.abs(out.u.FX) > 0.45).all()
    assert np.asarray(out.rudder_saturated).all()


def test_excessive_demand_saturates_at_top_speed():
    _, out = _through([1.9, 50.0, -0.9, -50.0], [0.0, 0.0, 0.0, 0.0])
    assert np.array_equal(out.speed_rpm, [12000, 12000, -12000, -12000])
    assert np.asarray(out.speed_saturated).all()
    assert np.allclose(out.u.FX, [1.6, 1.6, -0.742, -0.742], atol=2e-3)


def test_dead_zone_applies_to_force_magnitude():
    """[1] section 6.1, +-0.05 N; the rudder still follows."""
    size = np.array([0.0, 0.01, 0.049, 0.05, 0.051])
    command, out = _through(size * np.cos(0.2), -size * np.sin(0.2))
    assert np.array_equal(np.asarray(command.speed_rpm) > 0, [False, False, False, False, True])
    assert np.array_equal(np.asarray(out.thrust) > 0, [False, False, False, False, True])
    assert np.allclose(np.degrees(out.rudder)[1:], 0.566 - 1.40 * np.degrees(0.2))
    dead, _ = _through(size, 0 * size, "dead-zone")
    assert np.array_equal(np.asarray(dead.speed_rpm) > 0, [False, True, True, True, True])


@pytest.mark.thorough
def test_zero_demand_gives_zero_thrust_and_finite_jacobian():
    for faults in ((), FAULTS):
        _, out = _through(0.0, 0.0, *faults)
        assert out.u.FX == out.u.FY == 0
    for faults in ((), ("lookup-table",), ("saturation",)):
        allocation = ALLOCATION
        for name in faults:
            allocation = without(allocation, name)

        def commanded(x, allocation=allocation):
            _, c = allocation.step(0, (), PlanarForce(x[0], x[1]))
            return jnp.stack([c.rudder_pulse, c.speed_rpm])

        slopes = jax.jit(jax.vmap(jax.jacfwd(commanded)))(np.array([[0, 0], [0, 0.5], [0.3, 0], [-0.3, 0.1]]))
        assert np.isfinite(slopes).all()


def test_rejects_foreign_table_and_unknown_imperfection():
    assert isinstance(ALLOCATION, Allocation)
    ALLOCATION.check()
    with pytest.raises(InputError, match="another thruster"):
        replace(ALLOCATION, thruster=Thruster(coefficient=0.012)).check()
    replace(ALLOCATION, thruster=Thruster(coefficient=0.012), table=None).check()
    with pytest.raises(InputError, match="no imperfection 'braking'"):
        without(ALLOCATION, "braking")
