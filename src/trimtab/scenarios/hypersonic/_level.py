"""Level flight of the hypersonic vehicle, and its internal dynamics about it.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eq. 7: the internal dynamics; their linearisation is not that printed there.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.record import FAST_COMPILE_OPTIONS
from trimtab.design.model import model_of_vehicle
from trimtab.design.trim import trim
from trimtab.laws.internal_quasi_static import solve_quasi_static
from trimtab.laws.path_command import PathPoint
from trimtab.laws.path_inversion import InputLimits, internal_rates, invert_path
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput, HypersonicState

FIRST_ALPHA = 0.03
"""Angle of attack (rad) at which searches start."""
SEARCH_ITERATIONS = 8
"""Newton steps for the angle of attack offline."""
FREE_VARIABLES = ("alpha", "theta", "eta1", "eta2", "Phi", "delta_e")
ANGLES = {"alpha": (-0.1, 0.1), "theta": (-0.1, 0.1)}


class LevelTrim(NamedTuple):
    """Level flight at h (ft) and V (ft/s): zeta (6,) and the input that holds it."""

    h: float
    V: float
    zeta: Any
    u: HypersonicInput


class InternalLinear(NamedTuple):
    """zeta' = A21 (xi - xi0) + A22 (zeta - zeta0) + B2 v about a trim; xi = (h, h', V), v = (h'', V')."""

    trim: LevelTrim
    A21: Any
    A22: Any
    B2: Any


def level_trim(craft: Hypersonic, h: float, V: float, limits: InputLimits | None = None) -> LevelTrim:
    """The craft's own trim at h (ft), V (ft/s), level; InputError with the reason where there is none."""
    zeta, u, found = quasi_static_states(craft, level_points(np.array([h]), np.array([V])))
    return accept_trim(craft, h, V, zeta[:, 0], u[:, 0], bool(found[0]), InputLimits() if limits is None else limits)


def trim_bounds(limits: InputLimits) -> dict[str, tuple[float, float]]:
    """What a trim may use: the limits of the inputs, and angles of attack at which the fit still means something."""
    return {**ANGLES, "Phi": (limits.Phi_low, limits.Phi_high), "delta_e": (limits.delta_low, limits.delta_high)}


def level_points(h: Any, V: Any) -> PathPoint:
    """Level flight at altitudes h (ft) and speeds V (ft/s)."""
    still = np.zeros(np.shape(h))
    return PathPoint(h, still, still, still, V, still, still)


def internal_linear(craft: Hypersonic, at: LevelTrim) -> InternalLinear:
    """The internal dynamics linearised about a level trim."""
    A21, A22, B2 = _differentiate_rates(craft, np.array([at.h, 0.0, at.V]), at.zeta, np.zeros(2))
    return InternalLinear(at, np.asarray(A21), np.asarray(A22), np.asarray(B2))


def quasi_static_states(craft: Hypersonic, wanted: PathPoint) -> tuple[Any, Any, Any]:
    """Quasi-static zeta (6, n), Phi and delta_e (2, n), and whether they were found (n,)."""
    zeta, u, found = _search_states(craft, wanted)
    return np.asarray(zeta), np.asarray(u), np.asarray(found)


def accept_trim(
    craft: Hypersonic, h: float, V: float, zeta: Any, u: Any, found: bool, limits: InputLimits
) -> LevelTrim:
    """What the quick search found if it is within all limits, else what the thorough one finds, or its reasons."""
    bounds = trim_bounds(limits)
    values = {"alpha": zeta[0], "Phi": u[0], "delta_e": u[1]}
    if found and all(bounds[n][0] <= v <= bounds[n][1] for n, v in values.items()):
        return LevelTrim(h, V, zeta, HypersonicInput(float(u[0]), float(u[1])))
    model = model_of_vehicle(
        craft, HypersonicState(h, V, FIRST_ALPHA, FIRST_ALPHA, *5 * (0.0,)), HypersonicInput(0.2, 0.1)
    )
    searched = trim(model, free=FREE_VARIABLES, bounds=bounds).require_trim(f"level trim at {h:g} ft, {V:g} ft/s")
    x, u = model.state(searched.x), model.input(searched.u)
    return LevelTrim(h, V, np.array([x.alpha, 0.0, x.eta1, 0.0, x.eta2, 0.0]), u)


@partial(jax.jit, compiler_options=FAST_COMPILE_OPTIONS)
def _differentiate_rates(craft: Any, xi: Any, zeta: Any, v: Any) -> Any:
    def rates(xi: Any, zeta: Any, v: Any) -> Any:
        return jnp.stack(internal_rates(craft, xi[0], xi[1], xi[2], v[0], v[1], zeta))

    return jax.jacfwd(rates, (0, 1, 2))(xi, zeta, v)


@partial(jax.jit, compiler_options=FAST_COMPILE_OPTIONS)
def _search_states(craft: Any, p: Any) -> Any:
    zeta, found = solve_quasi_static(craft, p, jnp.full_like(p.h, FIRST_ALPHA), SEARCH_ITERATIONS)
    u = invert_path(craft, p.h, p.h_rate, p.V, zeta[0], p.h_acceleration, p.V_rate).u
    return jnp.stack(zeta), jnp.stack([u.Phi, u.delta_e]), found
