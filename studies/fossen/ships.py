"""Ships: Nomoto models of the Mariner's steering, and CyberShip II."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from studies.fossen._pictures import draw_turning
from trimtab.study import Row, within
from trimtab.vehicles.surface_vessel import TURN, SurfaceVessel, VesselState

SECTION = "[2] tables 1, 2 and 4; [3] Nomoto's models; [4]"
LENGTH, SPEED = 160.93, 7.7175
"""Length of the Mariner (m), and 15 knots (m/s)."""
MASS, INERTIA, CENTRE = 798e-5, 39.2e-5, -0.023
Y = {"v'": -748e-5, "r'": -9.354e-5, "v": -1160e-5, "r": -499e-5, "d": 278e-5}
N = {"v'": 4.646e-5, "r'": -43.8e-5, "v": -264e-5, "r": -166e-5, "d": -139e-5}
"""Non-dimensional derivatives of the Mariner, scaled by length and speed: [4]."""


class Nomoto(NamedTuple):
    """Nomoto model r/delta = K (1 + T3 s)/((1 + T1 s)(1 + T2 s)): K (1/s), T (s)."""

    K: float
    T1: float
    T2: float
    T3: float


def mariner_steering() -> Nomoto:
    """Eliminate sway from M (v', r') + N (v, r) = b delta. A positive rudder turns to starboard, as in [3]."""
    M = np.array([[MASS - Y["v'"], MASS * CENTRE - Y["r'"]], [MASS * CENTRE - N["v'"], INERTIA - N["r'"]]])
    D = -np.array([[Y["v"], Y["r"]], [N["v"], N["r"]]])
    b = -np.array([Y["d"], N["d"]])
    middle = M[0, 0] * D[1, 1] + M[1, 1] * D[0, 0] - M[0, 1] * D[1, 0] - M[1, 0] * D[0, 1]
    T2, T1 = sorted(-1 / np.roots([np.linalg.det(M), middle, np.linalg.det(D)]))
    slope, constant = M[0, 0] * b[1] - M[1, 0] * b[0], D[0, 0] * b[1] - D[1, 0] * b[0]
    second = LENGTH / SPEED
    return Nomoto(constant / np.linalg.det(D) / second, T1 * second, T2 * second, slope / constant * second)


@cache
def cybership_straight(rpm: float) -> tuple[float, np.ndarray]:
    """Return the speed (m/s) at which thrust equals resistance, and the roots (1/s) of sway and yaw at it."""
    vessel, n = SurfaceVessel(), rpm / 60 * TURN
    surge = jax.jit(lambda u: vessel.accelerations(VesselState(surge_velocity=u, shaft_speed=n))[0])
    u, low, high = 1.5, 0.0, 3.0
    for _ in range(60):
        u = (low + high) / 2
        low, high = (u, high) if float(surge(u)) > 0 else (low, u)

    def rates(z: jax.Array) -> jax.Array:
        x = VesselState(surge_velocity=u, sway_velocity=z[0], yaw_rate=z[1], shaft_speed=n)
        return jnp.stack(vessel.accelerations(x)[1:])

    return u, np.sort(np.linalg.eigvals(np.asarray(jax.jacfwd(rates)(jnp.zeros(2)))).real)


def rows() -> Iterator[Row]:
    """Yield the Mariner's Nomoto constants, printed in [3], and CyberShip II's speed and roots, not printed."""
    model, place = mariner_steering(), "[3] Nomoto's models of the Mariner and a tanker, also in its toolbox, exNomoto"
    yield within("mariner/K", "Mariner, gain K", 0.185, model.K, place, tolerance=5e-4, unit="1/s")
    yield within("mariner/T1", "Mariner, T1", 118.0, model.T1, place, tolerance=0.5, unit="s")
    yield within("mariner/T2", "Mariner, T2", 7.8, model.T2, place, tolerance=0.05, unit="s")
    yield within("mariner/T3", "Mariner, T3", 18.5, model.T3, place, tolerance=0.05, unit="s")
    computed = "not printed; computed by tests/oracles/marine.py"
    for rpm, speed, root in ((1000, 0.58180, 0.77399), (2000, 1.00876, 1.40646)):
        u, roots = cybership_straight(rpm)
        yield within(
            f"cybership/speed-{rpm}", f"CyberShip II, speed at {rpm} rpm", speed, u, computed, tolerance=1e-5,
            unit="m/s", basis="reference",
        )  # fmt: skip
        yield within(
            f"cybership/root-{rpm}", f"CyberShip II, unstable root of sway and yaw at {rpm} rpm", root, roots[1],
            computed, tolerance=1e-5, unit="1/s", basis="reference",
        )  # fmt: skip


def figures(folder: Path) -> Iterator[Path]:
    """Plot turning circles of CyberShip II."""
    yield draw_turning(folder / "turning.png")
