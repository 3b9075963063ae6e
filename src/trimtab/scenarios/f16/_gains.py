"""Trim and gains of the F-16's load-factor control, from the vehicle itself.

Source: [1] P. Heidlauf, A. Collins, M. Bolender, S. Bak, "Verification challenges in F-16 ground collision avoidance
and other automated maneuvers", ARCH 2018, for the form, the place of the accelerometers and the weights of the
longitudinal regulator; its authors' programs AeroBenchVV print the gains.
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
"""Speed and altitude at which [1] trims and linearises."""
STATION = 15 * FOOT
"""Distance of the accelerometers ahead of the centre of mass (m)."""
WEIGHTS = {
    "published": ((1000.0, 0.0, 1500.0), (0.0, 0.0, 0.0, 115_000.0, 8_100.0)),
    "actuators": ((500.0, 100.0, 200.0), (1000.0, 0.0, 1000.0, 2000.0, 8_100.0)),
}
"""Weights of angle of attack (1/rad²), pitch rate, integral of load factor (1/s²); of sideslip, roll and yaw rate, the
integrals of roll rate and of side load with yaw rate. Surfaces have weight 1 in degrees.

published: AeroBenchVV, BuildLongitudinalLqrCtrl; lateral ones, rounded, from its gains, as integrals alone give
Q = K'R K: the 1200 and 3000 beside them are not theirs. actuators: chosen, for surfaces that lag, and for delay.
"""


class LoadFactorDesign(NamedTuple):
    """level: the trim.  linear: the model there.  along: elevator gain.  aside: aileron, rudder gain; u = K x (rad)."""

    level: Trim
    linear: LinearModel
    along: Lqr
    aside: Lqr


def model_at(craft: F16FlatEarth, x: F16State, u: F16Controls) -> StateSpaceModel:
    """Return the vehicle with load factors at STATION, and rates, as outputs."""

    def load(axis: int, sign: float) -> Any:
        def at(x: F16State, u: F16Controls) -> Any:
            f = craft.loads(x, u)
            swing = jnp.cross(f.turn, jnp.array([STATION, 0.0, 0.0]))
            return sign * (f.wrench.force / craft.mass + swing)[axis] / craft.gravity

        return at

    outputs = {"normal_load": load(2, -1.0), "side_load": load(1, 1.0)}
    return model_of_vehicle(craft, x, u, outputs=outputs)


def level_flight(craft: F16FlatEarth, speed: float, altitude: float) -> Trim:
    """Return straight and level flight, heading north: angle of attack, throttle and elevator are found."""
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
    """Return trim, model and gains at SPEED and ALTITUDE, for the vehicle as shipped, with one of WEIGHTS."""
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
    """Return the weights of the states and of the integrals of the outputs; surfaces weigh 1 per degree."""
    n, k = len(A), len(C)
    longer = np.block([[A, np.zeros((n, k))], [C, np.zeros((k, k))]])
    return lqr(longer, np.vstack([B, D]), np.diag(weights), np.eye(B.shape[1]) / DEG**2)
