"""Trim point and gains of the F-16's load-factor control, computed from the vehicle model.

Source: [1] P. Heidlauf, A. Collins, M. Bolender, S. Bak, "Verification challenges in F-16 ground collision avoidance
and other automated maneuvers", ARCH 2018, for the form, the position of the accelerometers and the weights of the
longitudinal regulator. The gains are printed in AeroBenchVV, the program of the authors of [1].
"""

from functools import lru_cache
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from trimtab.core.rotation import DEG
from trimtab.design.linearise import LinearModel, linearise
from trimtab.design.lqr import Lqr, lqr
from trimtab.design.model import StateSpaceModel, model_of_vehicle
from trimtab.design.trim import Trim, trim
from trimtab.vehicles.f16 import F16Controls
from trimtab.vehicles.f16_flat_earth import F16FlatEarth, F16State
from trimtab.vehicles.imperial import FOOT

SPEED, ALTITUDE = 502 * FOOT, 1000 * FOOT
"""Speed (m/s) and altitude (m) at which [1] trims and linearises the F-16."""
STATION = 15 * FOOT
"""Distance of the accelerometers ahead of the centre of mass (m)."""
WEIGHTS = {
    "published": ((1000.0, 0.0, 1500.0), (0.0, 0.0, 0.0, 115_000.0, 8_100.0)),
    "actuators": ((500.0, 100.0, 200.0), (1000.0, 0.0, 1000.0, 2000.0, 8_100.0)),
}
"""Name of a set of LQR weights -> longitudinal weights and lateral weights. A surface deflection of one degree has
weight 1.

Longitudinal states: angle of attack (1/rad²), pitch rate, integral of load factor (1/s²). Lateral states: sideslip,
roll rate, yaw rate, integral of roll rate, integral of the sum of side load and yaw rate.

published: longitudinal weights of AeroBenchVV, BuildLongitudinalLqrCtrl. The lateral weights are computed from the
lateral gains of AeroBenchVV by Q = K'R K, with weights on the integrals only, and rounded, because the gains of
AeroBenchVV do not follow from the lateral weights 1200 and 3000 in that program. actuators: weights chosen for surfaces
with lag and for a loop with delay.
"""


class LoadFactorDesign(NamedTuple):
    """Result of the gain design. level: trim point.  linear: vehicle model, linearised at the trim point.

    along: LQR design of the elevator.  aside: LQR design of aileron and rudder. The gains are K in u = K x (rad).
    """

    level: Trim
    linear: LinearModel
    along: Lqr
    aside: Lqr


def model_at(craft: F16FlatEarth, x: F16State, u: F16Controls) -> StateSpaceModel:
    """Return the vehicle model with two outputs: normal and lateral load factor at the accelerometers (STATION)."""

    def load(axis: int, sign: float) -> Any:
        def at(x: F16State, u: F16Controls) -> Any:
            f = craft.loads(x, u)
            swing = jnp.cross(f.turn, jnp.array([STATION, 0.0, 0.0]))
            return sign * (f.wrench.force / craft.mass + swing)[axis] / craft.gravity

        return at

    outputs = {"normal_load": load(2, -1.0), "side_load": load(1, 1.0)}
    return model_of_vehicle(craft, x, u, outputs=outputs)


def level_flight(craft: F16FlatEarth, speed: float, altitude: float) -> Trim:
    """Return the trim point of straight, level flight to the north: angle of attack, throttle and elevator."""
    zero, alpha = 0.0, 0.04
    x = F16State(speed, alpha, zero, zero, alpha, zero, zero, zero, zero, zero, zero, altitude, 0.1)
    model = model_of_vehicle(
        craft, x, F16Controls(-0.01, zero, zero, 0.15), outputs={"path": lambda x, u: x.pitch - x.alpha}
    )
    return trim(
        model,
        free=["alpha", "pitch", "power", "elevator", "throttle"],
        loose=["north"],
        outputs={"path": 0.0},
        bounds={"throttle": (0.0, 0.77), "elevator": (-25 * DEG, 25 * DEG), "alpha": (-10 * DEG, 45 * DEG)},
    ).require_trim()


@lru_cache(maxsize=4)
def design_load_factor_control(weights: str = "published") -> LoadFactorDesign:
    """Return trim point, linear model and gains of the default F-16 at SPEED and ALTITUDE.

    weights: name of a set of LQR weights in WEIGHTS.
    """
    along_weights, aside_weights = WEIGHTS[weights]
    craft = F16FlatEarth()
    level = level_flight(craft, SPEED, ALTITUDE)
    zero = np.zeros(13)
    x, u = F16State(*zero), F16Controls(*zero[:4])
    linear = linearise(model_at(craft, x, u), level.x, level.u)
    along = linear.part(["alpha", "pitch_rate"], ["elevator"], ["normal_load"])
    aside = linear.part(["beta", "roll_rate", "yaw_rate"], ["aileron", "rudder"], ["side_load"])
    alpha = level.x[1]
    rolls = np.array([[0.0, 1.0, alpha]])
    yaws = aside.C + np.array([[0.0, 0.0, 1.0]])
    return LoadFactorDesign(
        level,
        linear,
        _regulator(along.A, along.B, along.C, along.D, along_weights),
        _regulator(
            aside.A,
            aside.B,
            np.vstack([rolls, yaws]),
            np.vstack([np.zeros((1, 2)), aside.D]),
            aside_weights,
        ),
    )


def _regulator(A: Any, B: Any, C: Any, D: Any, weights: Any) -> Lqr:
    """Return the LQR design of the system (A, B, C, D), with the integrals of the outputs as additional states.

    weights: diagonal of the weight matrix of states and integrals. A surface deflection of one degree has weight 1.
    """
    n, k = len(A), len(C)
    longer = np.block([[A, np.zeros((n, k))], [C, np.zeros((k, k))]])
    return lqr(longer, np.vstack([B, D]), np.diag(weights), np.eye(B.shape[1]) / DEG**2)
