"""Trims whose answer is known analytically, and trims that do not exist, with the reasons."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import fsolve

from trimtab.core.errors import InputError
from trimtab.core.signals import PlanarForce
from trimtab.design.model import model_of_functions, model_of_vehicle
from trimtab.design.trim import trim
from trimtab.vehicles.hovercraft import Friction, Hovercraft, HovercraftState

G = 9.81
SPEEDS = ("surge_velocity", "sway_velocity", "yaw_rate")
PLACE = ("north", "east", "heading")
CRAFT = Hovercraft(friction=Friction(force_viscous=0.8, force_quadratic=0.3, torque_viscous=0.05))


def hovercraft(**outputs):
    return model_of_vehicle(CRAFT, HovercraftState(), PlanarForce(0.0, 0.0), outputs=outputs or None)


def vtol(eps):
    """Planar VTOL of Hauser, Sastry, Meyer, Automatica 28 (1992), eq. 2.1, forces per mass and inertia."""

    def f(x, u):
        _, vx, _, vy, th, w = x
        s, c = jnp.sin(th), jnp.cos(th)
        return jnp.stack([vx, -u[0] * s + eps * u[1] * c, vy, u[0] * c + eps * u[1] * s - G, w, u[1]])

    return model_of_functions(f, ("x", "vx", "y", "vy", "theta", "w"), ("u1", "u2"))


@pytest.mark.thorough
def test_straight_run_thrust_equals_drag():
    found = trim(hovercraft(), x={"surge_velocity": 0.5}, free=("FX", "FY"), loose=PLACE)
    assert found.is_found
    assert found.why == ()
    np.testing.assert_allclose(found.u, [0.8 * 0.5 + 0.3 * 0.25, 0.0], rtol=1e-13, atol=1e-13)
    assert found.require_trim() is found


def test_steady_turn_matches_scipy_solution():
    speed = {"speed": lambda x, u: jnp.hypot(x.surge_velocity, x.sway_velocity)}
    model = hovercraft(**speed)
    free = ("surge_velocity", "sway_velocity", "FX", "FY")
    start = {"yaw_rate": 0.3, "surge_velocity": 1.0}
    found = trim(model, x=start, free=free, loose=PLACE, outputs={"speed": 1.2}).require_trim()
    m, J, d = CRAFT.mass, CRAFT.inertia, CRAFT.arm

    def plain(z):
        u, v, FX, FY = z
        s, r = np.hypot(u, v), 0.3
        drag = 0.8 + 0.3 * s
        return [v * r + (FX - drag * u) / m, -u * r + (FY - drag * v) / m, (-d * FY - 0.05 * r) / J, s - 1.2]

    want = fsolve(plain, [1.0, -0.2, 1.0, 0.0], xtol=1e-13)
    np.testing.assert_allclose([*found.x[:2], *found.u], want, rtol=1e-9)
    assert max(abs(v) for v in found.residual.values()) < 1e-12


def test_hover_and_accelerated_climb_match_analytic_trim():
    hover = trim(vtol(0.1), x={"theta": 0.3}, free=("theta", "u1", "u2")).require_trim()
    np.testing.assert_allclose([hover.x[4], *hover.u], [0.0, G, 0.0], atol=1e-12)
    climb = trim(vtol(0.1), free=("theta", "u1", "u2"), derivatives={"vy": 2.0, "vx": -1.0}).require_trim()
    np.testing.assert_allclose([climb.x[4], climb.u[0]], [np.arctan2(1.0, G + 2), np.hypot(1.0, G + 2)], rtol=1e-12)


def test_reports_active_bound_without_trim():
    found = trim(hovercraft(), x={"surge_velocity": 0.5}, free=("FX", "FY"), loose=PLACE, bounds={"FX": (-0.1, 0.4)})
    assert not found.is_found
    assert found.active == {"FX": "high"}
    np.testing.assert_allclose(found.residual["surge_velocity'"], (0.4 - 0.475) / 2.6, rtol=1e-6)
    with pytest.raises(InputError, match=r"surge_velocity' \(error -0\.0288.*at a bound: FX \(high, 0\.4\)"):
        found.require_trim("hovercraft")


@pytest.mark.thorough
def test_sideways_force_alone_has_no_trim():
    """Kulis 2006, section 2.3: sway and yaw accelerations have the fixed ratio -J/(m d)."""
    found = trim(hovercraft(), free=("FX", "FY"), derivatives={"sway_velocity": 0.1}, loose=PLACE)
    assert not found.is_found
    assert found.rank == 2
    assert any("no unknown affects" in w and "sway_velocity'" in w and "yaw_rate'" in w for w in found.why)
    ratio = trim(
        hovercraft(),
        free=("FX", "FY"),
        derivatives={"sway_velocity": 0.1, "yaw_rate": -0.1 * 2.6 * 0.32 / 0.096},
        loose=PLACE,
    )
    assert ratio.is_found
    np.testing.assert_allclose(ratio.u, [0.0, 0.26], atol=1e-12)


@pytest.mark.thorough
def test_reports_powerless_and_undetermined_unknowns():
    found = trim(hovercraft(), free=("FX", "FY", "north", "east"), x={"north": 3.0}, loose=())
    assert found.is_found
    assert found.powerless_unknowns == ("north", "east")
    assert len(found.undetermined_unknowns) == 2
    wrong = trim(hovercraft(), free=("north",), x={"surge_velocity": 0.5}, loose=("north",))
    assert not wrong.is_found
    assert any("unknowns without effect at this point: north" in w for w in wrong.why)


def test_further_starts_escape_a_local_minimum():
    cubic = model_of_functions(
        lambda x, u: x**3 - 3 * x + 4.0, ("x",), ("u",), x0=[1.5]
    )  # minimum at 1, root near -2.2
    alone = trim(cubic, free=("x",), starts=1)
    assert not alone.is_found
    assert any("local minimum of the least squares" in w or "no unknown affects" in w for w in alone.why)
    several = trim(cubic, free=("x",), bounds={"x": (-4.0, 4.0)}).require_trim()
    np.testing.assert_allclose(several.x, min(np.roots([1, 0, -3, 4]).real), rtol=1e-12)


def test_ignores_equation_affected_only_by_rounding():
    """north' = u cos(heading): at a quarter turn it is 6e-17 u, which is no reason to stop."""
    model = hovercraft(surge=lambda x, u: x.surge_velocity)
    start = {"surge_velocity": 0.5, "heading": np.pi / 2}
    free, wanted = ("FX", "FY", "surge_velocity"), {"surge": 0.7}
    found = trim(model, x=start, free=free, loose=("east", "heading"), outputs=wanted).require_trim()
    np.testing.assert_allclose(found.x[0], 0.7, rtol=1e-12)
    turned = trim(model, x=start, free=(*free, "heading"), loose=("east",), outputs=wanted, starts=1)
    np.testing.assert_allclose(np.cos(turned.x[5]), 0.0, atol=1e-12)


def test_rejects_invalid_arguments():
    model = hovercraft()
    with pytest.raises(InputError, match="unknown name 'FZ'"):
        trim(model, free=("FZ",))
    with pytest.raises(InputError, match="no state or input is free"):
        trim(model, free=())
    with pytest.raises(InputError, match=r"bounds\.FX: .*got \(1\.0, -1\.0\)"):
        trim(model, free=("FX",), bounds={"FX": (1.0, -1.0)})
    with pytest.raises(InputError, match=r"scales\.FX"):
        trim(model, free=("FX",), scales={"FX": 0.0})
    with pytest.raises(InputError, match="also have a required derivative"):
        trim(model, free=("FX",), derivatives={"north": 1.0}, loose=("north",))
    with pytest.raises(InputError, match="must be finite at the start point"):
        trim(model_of_functions(lambda x, u: jnp.log(x), ("x",), ("u",)), free=("x",))
    with pytest.raises(InputError, match="at least one derivative or output"):
        trim(model, free=("FX",), outputs={"north": np.inf})
