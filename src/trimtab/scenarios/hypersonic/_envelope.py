"""Over a grid of the envelope: is the inversion of the hypersonic vehicle well-posed, and how wrong can its gains be?

Grid: 80-95 kft, 7-9 kft/s, alpha 0-4 deg, gamma -1 to 1 deg, delta_e -20 to 25.8 deg.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, assumption 1.
"""

import itertools
import math
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.record import FAST_COMPILE_OPTIONS
from trimtab.design.certificate import RecordedNumber
from trimtab.laws.path_inversion import invert_path
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput, HypersonicState

DEG = math.pi / 180
GRID = tuple(
    itertools.product(
        (80e3, 85e3, 90e3, 95e3),
        (7e3, 7.5e3, 8e3, 8.5e3, 9e3),
        tuple(a * DEG for a in (0.0, 1.0, 2.0, 3.0, 4.0)),
        (-DEG, 0.0, DEG),
        tuple(d * DEG for d in (-20.0, -10.0, 0.0, 10.0, 20.0, 25.8)),
    )
)
"""h (ft), V (ft/s), alpha, gamma, delta_e (rad)."""
GRID_DESCRIPTION = (
    f"{len(GRID)} points of the envelope: 80-95 kft, 7-9 kft/s, alpha 0-4, gamma +-1, elevator -20 to 25.8 deg"
)
WANTED_ACCELERATIONS = (2.0, -2.0)
"""Accelerations h'', V' (ft/s^2) that the inversion is asked for."""


def accelerations(craft: Hypersonic, x: HypersonicState, u: Any) -> Any:
    """v = (h'', V') (ft/s^2) of the input u = (Phi, delta_e)."""
    along, normal = craft.path_accelerations(0.0, x, HypersonicInput(u[0], u[1]))
    gamma = x.theta - x.alpha
    return jnp.stack([along * jnp.sin(gamma) + normal * jnp.cos(gamma), along])


def recorded_numbers(craft: Hypersonic, plant: Hypersonic) -> dict[str, RecordedNumber]:
    """kappa_G, the least |det dv/du|, and the worst residual of the inversion that the law flies.

    Args:
        craft: the vehicle the law believes in.
        plant: the vehicle that flies.
    """
    kappa, determinant, residual = _worst_values(craft, plant)
    kappa_how = f"largest |(G_plant - G) G^-1|, {GRID_DESCRIPTION}" + ("; no parameter error" if plant == craft else "")
    return {
        "kappa_G": RecordedNumber(kappa, 0.0, 1.0, kappa_how),
        "least |det dv/du|": RecordedNumber(determinant, 1.0, 1e9, GRID_DESCRIPTION),
        "residual of the inversion": RecordedNumber(
            residual, 0.0, 1e-9, f"v = {WANTED_ACCELERATIONS} ft/s^2, {GRID_DESCRIPTION}"
        ),
    }


@lru_cache(maxsize=8)
def _worst_values(craft: Hypersonic, plant: Hypersonic) -> tuple[float, float, float]:
    v = jnp.array(WANTED_ACCELERATIONS)

    def at(point: Any) -> tuple[Any, Any, Any]:
        h, V, alpha, gamma, delta_e = point
        x = HypersonicState(h, V, alpha, alpha + gamma, 0.0, 0.0, 0.0, 0.0, 0.0)
        start = jnp.stack([0.3 * jnp.ones_like(h), delta_e])
        slope = jax.jacfwd(lambda w: accelerations(craft, x, w))
        G = slope(start)
        apart = jax.jacfwd(lambda w: accelerations(plant, x, w))(start) - G
        found = invert_path(craft, h, V * jnp.sin(gamma), V, alpha, v[0], v[1]).u
        u = jnp.stack([found.Phi, found.delta_e])
        inverse = jnp.array([[G[1, 1], -G[0, 1]], [-G[1, 0], G[0, 0]]]) / _determinant(G)
        return apart @ inverse, _determinant(G), accelerations(craft, x, u) - v

    errors, dets, left = jax.jit(jax.vmap(at), compiler_options=FAST_COMPILE_OPTIONS)(jnp.array(GRID))
    kappa = np.linalg.norm(np.asarray(errors), 2, axis=(1, 2)).max()
    return float(kappa), float(np.abs(dets).min()), float(np.abs(left).max())


def _determinant(G: Any) -> Any:
    return G[0, 0] * G[1, 1] - G[0, 1] * G[1, 0]
