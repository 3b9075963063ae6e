"""Position, velocity and heading from a few position fixes of ultrasonic units and the IMU readings in between.

The solution has a closed form.

The motion since the first ping is integrated in the body's axes at the first ping (turn a, velocity dv, displacement
dr). The position of an ultrasonic unit with the lever arm l from the IMU is then linear in the unknowns:

    place = p0 + v0 t + [w, J w] (c, s),    w = dr + R(a) l,   J w = (-w2, w1),   c = cos phi0, s = sin phi0

Each ping with a position is therefore added to the normal equations of (p0, v0, c, s), and no first guess is needed.
Four pings of two units are enough. A single unit is enough if it has a lever arm or the specific force changes. A
heading sensor measures c and s directly.

Source: this module; integration in the body's axes: Lupton, Sukkarieh, IEEE Trans. Robotics 28 (2012).
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from trimtab.core.linalg import solve_spd
from trimtab.core.record import Scalar, quantity, record, replace, tree_where
from trimtab.core.rotation import planar
from trimtab.estimators.inertial.mechanisation import mechanise, rotate_lever

UNKNOWNS = 6


@record
class RangingStart:
    """Normal equations of the initial state, and the motion since the first ping used. Source: this module."""

    N: Any = quantity("1", "Information matrix of the unknowns (p0, v0, c, s).", shape=(UNKNOWNS, UNKNOWNS))
    g: Any = quantity("1", "Right-hand side of the normal equations.", shape=(UNKNOWNS,))
    square: Scalar = quantity("1", "Weighted sum of squares of the measurements, relative to the first position.")
    centre: Any = quantity(
        "m", "First position found from ranges. The equations measure all positions from it.", frame="W", shape=(2,)
    )
    pings: Scalar = quantity(
        "1", "Number of pings for which a position of the ultrasonic unit was found and used.", kind="count"
    )
    elapsed: Scalar = quantity("s", "Time since the first ping used.")
    turn: Scalar = quantity("rad", "Angle turned since the first ping used.", kind="angle")
    velocity: Any = quantity("m/s", "Integral of the specific force, in the body axes at the first ping.", shape=(2,))
    position: Any = quantity(
        "m", "Double integral of the specific force, in the body axes at the first ping.", shape=(2,)
    )


class StartSolution(NamedTuple):
    """Initial state found from pings.

    x: heading, velocity and position at present (5,).  P: covariance (5, 5).  usable: True if x can be trusted.
    inconsistent: True if there are enough pings, or enough time has passed, but the pings don't agree with each other.
    """

    x: Any
    P: Any
    usable: Any
    inconsistent: Any


def empty_start() -> RangingStart:
    """Return the normal equations before the first ping."""
    o, two = np.float64(0), np.zeros(2)
    return RangingStart(np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS), o, two, np.int32(0), o, o, two, two)


def propagate_start(start: RangingStart, dt: Any, before: Any, imu_reading: Any, bias: Any) -> RangingStart:
    """Propagate the motion since the first ping by dt (s).

    before, imu_reading: IMU readings at the start and end of the step (3,).  bias: biases of the IMU (3,).
    """
    turn = start.turn + dt * ((before[0] + imu_reading[0]) / 2 - bias[0])
    f0, f1 = planar(start.turn) @ (before[1:] - bias[1:]), planar(turn) @ (imu_reading[1:] - bias[1:])
    velocity, position = mechanise(dt, f0, f1, start.velocity, start.position)
    carried = replace(start, elapsed=start.elapsed + dt, turn=turn, velocity=velocity, position=position)
    return tree_where(start.pings > 0, carried, start)


def add_unit_position(start: RangingStart, place: Any, lever: Any, W: Any) -> RangingStart:
    """Add the position (2,) of an ultrasonic unit to the normal equations.

    lever: vector in B from the IMU to the unit (2,).  W: information matrix of the position (2, 2).
    """
    centre = jnp.where(start.pings > 0, start.centre, place)
    w = start.position + rotate_lever(start.turn, lever)[0]
    eye = jnp.eye(2)
    A = jnp.concatenate([eye, start.elapsed * eye, w[:, None], jnp.stack([-w[1], w[0]])[:, None]], axis=1)
    z = place - centre
    one_more = replace(start, centre=centre, pings=(start.pings + 1).astype(np.int32))
    return _add_equations(one_more, A, z, W)


def add_heading(start: RangingStart, heading: Any, variance: Any) -> RangingStart:
    """Add a sensor's heading (rad) to the normal equations. The heading has no effect before the first ping."""
    a = heading - start.turn
    A = jnp.concatenate([jnp.zeros((2, 4)), jnp.eye(2)], axis=1)
    informed = _add_equations(start, A, jnp.stack([jnp.cos(a), jnp.sin(a)]), jnp.eye(2) / variance)
    return tree_where(start.pings > 0, informed, start)


def solve_start(start: RangingStart, sigmas: Any, *, enough: Any, longest: Any, heading_limit: Any) -> StartSolution:
    """Return the solution of the normal equations.

    Args:
        start: the normal equations.
        sigmas: standard deviations of the biases of gyro and accelerometers (2,). The effect of the biases over the
            elapsed time is added to the covariance.
        enough: smallest number of pings; twice as many pings without a usable solution count as inconsistent.
        longest: longest time (s) since the first ping; after it, pings without a usable solution count as inconsistent.
        heading_limit: largest accepted standard deviation of the heading (rad).
    """
    count = start.pings
    both = solve_spd(start.N, jnp.concatenate([jnp.eye(UNKNOWNS), start.g[:, None]], axis=1))
    C, u = both[:, :-1], both[:, -1]
    c, s = u[4], u[5]
    m = c * c + s * s
    phi = jnp.arctan2(s, c)
    T, one = start.elapsed, jnp.eye(2)
    (v, v_slope), (p, p_slope) = (rotate_lever(phi, x) for x in (start.velocity, start.position))
    turned = jnp.stack([-s, c]) / m
    J = jnp.concatenate(
        [
            jnp.concatenate([jnp.zeros(4), turned])[None],
            jnp.concatenate([0 * one, one, v_slope[:, None] * turned[None]], axis=1),
            jnp.concatenate([one, T * one, p_slope[:, None] * turned[None]], axis=1),
        ]
    )
    drift = jnp.concatenate([(sigmas[0] * T)[None], jnp.ones(2) * sigmas[1] * T, jnp.ones(2) * sigmas[1] * T * T / 2])
    P = J @ C @ J.T + jnp.diag(drift**2)
    x = jnp.concatenate([(phi + start.turn)[None], u[2:4] + v, start.centre + u[:2] + T * u[2:4] + p])
    dof = jnp.maximum(2.0 * count - UNKNOWNS, 1.0)
    residual = start.square - start.g @ u
    length = jnp.abs(m - 1) <= 8 * jnp.sqrt(jnp.maximum(u[4:] @ C[4:, 4:] @ u[4:], 0.0))
    good = (residual <= dof + 4 * jnp.sqrt(2 * dof)) & length & (P[0, 0] <= heading_limit**2)
    good = good & jnp.all(jnp.isfinite(x)) & jnp.all(jnp.isfinite(P)) & (count >= enough)
    inconsistent = ~good & ((count >= 2 * enough) | (longest < T))
    return StartSolution(x, P, good, inconsistent)


def _add_equations(start: RangingStart, A: Any, z: Any, W: Any) -> RangingStart:
    WA = W @ A
    return replace(start, N=start.N + A.T @ WA, g=start.g + WA.T @ z, square=start.square + z @ W @ z)
