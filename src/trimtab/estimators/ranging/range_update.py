"""The ranges of one ping, one after the other, into a state of vehicle, scale and beacons' errors.

Source: [4] Bar-Shalom, Li, Kirubarajan, "Estimation with applications to tracking and navigation", Wiley 2001, sections
5.2 and 10.3 (second order); Schmidt 1966 for considered states.
"""

from typing import Any, NamedTuple

import jax
import numpy as np
from jax import lax

from trimtab.core.float64 import jnp
from trimtab.estimators.inertial.mechanisation import DIMENSION, turned_lever
from trimtab.estimators.kalman import update
from trimtab.estimators.ranging.range_errors import RangeErrorModel
from trimtab.estimators.ranging.range_model import predicted

POSE = np.array([0, 3, 4])
"""Heading and position among the states: what a range depends on."""


class Geometry(NamedTuple):
    """Beacons (n, 3) in W; lever of the unit from the navigated point, in B (2,); its down coordinate; cone error."""

    beacons: Any
    lever: Any
    down: Any
    cone: bool


class Linear(NamedTuple):
    """A range at a state: value, derivative (k,), and what curvature adds to mean and variance."""

    range: Any
    H: Any
    mean: Any
    variance: Any


class Swept(NamedTuple):
    """State and covariance after a ping; innovation, its variance and NIS of each range, and which were used (n,)."""

    x: Any
    P: Any
    innovation: Any
    variance: Any
    nis: Any
    accepted: Any


def linearised(x: Any, P: Any, i: Any, g: Geometry) -> Linear:
    """The range to beacon i at a state (9 + n,): Belief.x, scale, errors of the beacons.

    With Hessian A in (heading, north, east) and the covariance S of these, a Gaussian state adds tr(A S)/2 to the mean
    and tr(A S A S)/2 to the variance ([4] section 10.3.3).
    """
    n = g.beacons.shape[0]
    arm, slope = turned_lever(x[0], g.lever)
    at = predicted(jnp.asarray(g.beacons)[i], x[3:5] + arm, g.down, cone=g.cone)
    T = jnp.concatenate([slope[:, None], jnp.eye(2)], axis=1)
    by_pose = at.slope @ T
    grows = 1 + x[DIMENSION]
    none = jnp.zeros(3)
    own = (jnp.arange(n) == i).astype(np.float64)
    H = jnp.concatenate([grows * by_pose[:1], none[:2], grows * by_pose[1:], none, at.range[None], own])
    swing = jnp.where(np.arange(9).reshape(3, 3) == 0, -(at.slope @ arm), 0.0)
    A = (T.T @ at.curvature @ T + swing) @ P[POSE][:, POSE]
    mean, variance = (A[0, 0] + A[1, 1] + A[2, 2]) / 2, jnp.sum(A * A.T) / 2
    return Linear(grows * at.range + x[DIMENSION + 1 + i], H, mean, variance)


def swept(x: Any, P: Any, ranges: Any, usable: Any, g: Geometry, errors: RangeErrorModel, learns: Any) -> Swept:
    """A ping's ranges (n,), each linearised anew, those that are usable (n,); learns (9 + n,): 0 where considered."""

    def one(carry: Any, row: Any) -> Any:
        x, P = carry
        i, z, use = row
        at = linearised(x, P, i, g)
        extra = at.variance if errors.second_order else 0.0
        y = z - at.range - (at.mean if errors.second_order else 0.0)
        gate = jnp.where(use, errors.gate, -1.0)
        R = jnp.reshape(errors.noise**2 + extra, (1, 1))
        done = update(x, P, y[None], at.H[None], R, gate=gate, consider=learns)
        told = jnp.where(use, done.innovation[0], 0.0), done.S[0, 0], jnp.where(use, done.nis, 0.0), done.accepted
        return (done.x, done.P), told

    rows = jnp.arange(ranges.shape[0]), ranges, usable
    (x, P), (y, S, nis, accepted) = lax.scan(one, (x, P), rows)
    return Swept(x, P, y, S, nis, accepted)


def place_information(place: Any, used: Any, g: Geometry, sigma: Any) -> Any:
    """Information (2, 2) about a unit's place (2,) in the ranges used (n,), each of this sigma."""
    slopes = jax.vmap(lambda b: predicted(b, place, g.down, cone=g.cone).slope)(g.beacons)
    slopes = jnp.where(used[:, None], slopes, 0.0)
    return slopes.T @ slopes / sigma**2
