"""Position, velocity and heading out of a few located pings and what the IMU felt between them, in closed form.

With the motion since the first ping integrated in the body's axes of that moment (turn a, velocity dv, displacement
dr), the place of a unit with lever l, seen from the IMU, is linear in what is unknown:

    place = p0 + v0 t + [w, J w] (c, s),    w = dr + R(a) l,   J w = (-w2, w1),   c = cos phi0, s = sin phi0

so pings add up as normal equations of (p0, v0, c, s), and no first guess is needed. Four pings of two units are
enough; one unit with a lever or a force that changes will do; a heading sensor adds c and s themselves.

Source: this module; integration in the body's axes: Lupton, Sukkarieh, IEEE Trans. Robotics 28 (2012).

What a ping does: to a filter that runs, to one that waits for a start, and how the one becomes the other.

Functions of a form (`TightlyCoupled`) and its node. Source: docs page, Tightly coupled ranging.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.linalg import solve_spd
from trimtab.core.record import Scalar, quantity, record, replace
from trimtab.core.rotation import planar, wrap
from trimtab.estimators.inertial.coupled import is_force_significant
from trimtab.estimators.inertial.mechanisation import DIMENSION, mechanise, rotate_lever
from trimtab.estimators.inertial.sensor_watch import increment
from trimtab.estimators.ranging.position import ALL, ONE_REJECTED, RangingPosition
from trimtab.estimators.ranging.range_errors import count_ranges, diagnose_beacons
from trimtab.estimators.ranging.range_model import place_information, update_with_ranges

UNKNOWNS = 6


@record
class RangingStart:
    """Normal equations so far, and the motion since the first located ping. Source: this module."""

    N: Any = quantity("1", "Information of (p0, v0, c, s).", shape=(UNKNOWNS, UNKNOWNS))
    g: Any = quantity("1", "Right-hand side.", shape=(UNKNOWNS,))
    square: Scalar = quantity("1", "Weighted square of what was measured, less that of `centre`.")
    centre: Any = quantity("m", "First place; unknowns count from it.", frame="W", shape=(2,))
    pings: Scalar = quantity("1", "Located pings in it.", kind="count")
    elapsed: Scalar = quantity("s", "Time since the first.")
    turn: Scalar = quantity("rad", "Turned since the first.", kind="angle")
    velocity: Any = quantity("m/s", "Integral of the force, in the first body axes.", shape=(2,))
    position: Any = quantity("m", "Integral of that.", shape=(2,))


class StartSolution(NamedTuple):
    """Heading, velocity and position now (5,), their covariance (5, 5), whether it can be believed, whether it can't.

    refuted: enough pings are in it, and they don't agree with each other.
    """

    x: Any
    P: Any
    usable: Any
    inconsistent: Any


def empty_start() -> RangingStart:
    """Before the first ping."""
    o, two = np.float64(0), np.zeros(2)
    return RangingStart(np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS), o, two, np.int32(0), o, o, two, two)


def propagate_start(start: RangingStart, dt: Any, before: Any, felt: Any, bias: Any) -> RangingStart:
    """A time dt (s) on. before, felt: what the IMU read at both ends (3,); bias: of these (3,)."""
    turn = start.turn + dt * ((before[0] + felt[0]) / 2 - bias[0])
    f0, f1 = planar(start.turn) @ (before[1:] - bias[1:]), planar(turn) @ (felt[1:] - bias[1:])
    velocity, position = mechanise(dt, f0, f1, start.velocity, start.position)
    moved = replace(start, elapsed=start.elapsed + dt, turn=turn, velocity=velocity, position=position)
    return _tree_where(start.pings > 0, moved, start)


def add_unit_position(start: RangingStart, place: Any, lever: Any, W: Any) -> RangingStart:
    """With a unit's place (2,) of information W (2, 2); lever: from the IMU to the unit, in B (2,)."""
    centre = jnp.where(start.pings > 0, start.centre, place)
    w = start.position + rotate_lever(start.turn, lever)[0]
    eye = jnp.eye(2)
    A = jnp.concatenate([eye, start.elapsed * eye, w[:, None], jnp.stack([-w[1], w[0]])[:, None]], axis=1)
    z = place - centre
    moved = replace(start, centre=centre, pings=(start.pings + 1).astype(np.int32))
    return _add_equations(moved, A, z, W)


def add_heading(start: RangingStart, heading: Any, variance: Any) -> RangingStart:
    """With a heading (rad) of a sensor; nothing before the first ping."""
    a = heading - start.turn
    A = jnp.concatenate([jnp.zeros((2, 4)), jnp.eye(2)], axis=1)
    told = _add_equations(start, A, jnp.stack([jnp.cos(a), jnp.sin(a)]), jnp.eye(2) / variance)
    return _tree_where(start.pings > 0, told, start)


def solve_start(start: RangingStart, sigmas: Any, *, enough: Any, longest: Any, heading_limit: Any) -> StartSolution:
    """What follows from all so far.

    Args:
        start: the equations.
        sigmas: of the biases of gyro and accelerometers (2,): what they do in the elapsed time is added.
        enough: least number of pings; twice as many without an answer refute the start.
        longest: time (s) after which the IMU's errors have made the first ping useless.
        heading_limit: largest sigma of a heading that is believed (rad).
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
    refuted = ~good & ((count >= 2 * enough) | (longest < T))
    return StartSolution(x, P, good, refuted)


def _add_equations(start: RangingStart, A: Any, z: Any, W: Any) -> RangingStart:
    WA = W @ A
    return replace(start, N=start.N + A.T @ WA, g=start.g + WA.T @ z, square=start.square + z @ W @ z)


def _tree_where(condition: Any, a: RangingStart, b: RangingStart) -> RangingStart:
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y), a, b)


def correction_mask(form: Any, node: Any) -> Any:
    """Which states (9 + n,) a range corrects, 1.0, and which are considered, 0.0."""
    n = np.shape(form.beacons)[0]
    vehicle = jnp.ones(DIMENSION)
    if np.shape(form.units)[0] == 1:
        moves = is_force_significant(node.steady, node.P, form.noise, form.rest_smoothing, form.rest_sigmas)
        vehicle = jnp.where((np.arange(DIMENSION) % 5 == 0) & ~moves, 0.0, vehicle)
    own = jnp.where(node.position_fix.moved | (form.errors.survey_errors != "estimate"), 0.0, jnp.ones(n))
    return jnp.concatenate([vehicle, jnp.ones(1), own])


def find_agreeing_ranges(form: Any, node: Any, ranges: Any, unit: Any) -> tuple[Any, Any, Any]:
    """Which ranges (n,) agree with each other, the unit's place (2,), and whether three or more say so."""
    finder = RangingPosition(
        beacons=form.beacons,
        units=form.units,
        down=form.down,
        residual_limit=form.errors.residual,
        cone=form.cone,
    )
    fix, own = node.position_fix, node.x[DIMENSION + 1 :]
    usable = (ranges > 0) & ~(fix.moved & (fix.sigma_error > form.errors.residual))
    near = node.x[3:5] + planar(node.x[0]) @ form.geometry(unit).lever
    r = finder.locate((ranges - own) / (1 + node.x[DIMENSION]), usable, unit, near, fix.tracking)
    good = ((r.mode == ALL) | (r.mode == ONE_REJECTED)) & jnp.all(jnp.isfinite(r.place))
    few = jnp.sum(usable) <= 2
    agree = usable & (jnp.arange(ranges.shape[0]) != r.rejected) & (good | few)
    return agree, jnp.where(good, r.place, near), good


def update_running(form: Any, node: Any, ranges: Any, unit: Any, agree: Any) -> Any:
    """After a ping of a running filter."""
    heard = ranges > 0
    done = update_with_ranges(
        node.x, node.P, ranges, heard & agree, form.geometry(unit), form.errors, correction_mask(form, node)
    )
    fix = count_ranges(node.position_fix, heard, done, form.errors)
    moved, forgiven, lost = diagnose_beacons(fix, form.errors)
    P = _inflate_beacon_errors(done.P, moved, forgiven, form.errors)
    fix = replace(
        fix,
        moved=(fix.moved | moved) & ~forgiven,
        agreed_in_a_row=jnp.where(moved | forgiven, 0, fix.agreed_in_a_row).astype(np.int32),
        refused_in_a_row=jnp.where(moved | lost, 0, fix.refused_in_a_row).astype(np.int32),
        mostly_refused=jnp.where(lost, 0, fix.mostly_refused).astype(np.int32),
        tracking=~lost,
    )
    P = jnp.where(lost, _replace_pose_covariance(jnp.diag(form.start_variances()[:5]), P), P)
    start = tree_where(lost, empty_start(), node.start)
    return _record_range_errors(replace(node, x=done.x, P=P, start=start, position_fix=fix))


def update_starting(form: Any, node: Any, unit: Any, agree: Any, place: Any, good: Any) -> Any:
    """After a ping of a filter that waits for a start."""
    g = form.geometry(unit)
    with_it = add_unit_position(node.start, place, g.lever, place_information(place, agree, g, form.start_sigma))
    start = tree_where(good, with_it, node.start)
    biases = jnp.sqrt(jnp.stack([node.P[5, 5], jnp.maximum(node.P[6, 6], node.P[7, 7])]))
    limits = {"longest": form.start_time, "heading_limit": form.start_heading}
    new = solve_start(start, biases, enough=4, **limits)
    heading = node.x[0] + wrap(new.x[0] - node.x[0])
    x = jnp.concatenate([heading[None], new.x[1:], node.x[5:]])
    fix = node.position_fix
    used = (fix.used + jnp.sum(agree & good)).astype(np.int32)
    fix = replace(fix, used=used, tracking=new.usable, starts=increment(fix.starts, new.usable))
    return _record_range_errors(
        replace(
            node,
            x=jnp.where(new.usable, x, node.x),
            P=jnp.where(new.usable, _replace_pose_covariance(new.P, node.P), node.P),
            start=tree_where(new.usable | new.inconsistent, empty_start(), start),
            position_fix=fix,
        )
    )


def _inflate_beacon_errors(P: Any, moved: Any, forgiven: Any, errors: Any) -> Any:
    """P with the errors of moved beacons (n,) grown, and those of forgiven ones as at first, known to nothing else."""
    none = jnp.zeros(DIMENSION + 1)
    wider = jnp.concatenate([none, jnp.where(moved, errors.moved**2, 0.0)])
    cut = jnp.concatenate([none, jnp.where(forgiven, 1.0, 0.0)]) > 0
    own = jnp.where(cut, errors.variances(moved.shape[0])[-1], wider)
    P = jnp.where(cut[:, None] | cut[None, :], 0.0, P)
    return P + jnp.where(np.eye(P.shape[0], dtype=bool), own[:, None], 0.0)


def _replace_pose_covariance(own: Any, P: Any) -> Any:
    """P with a new covariance (5, 5) of heading, velocity and position that nothing else knows of."""
    across = jnp.zeros((5, P.shape[0] - 5))
    return jnp.concatenate([jnp.concatenate([own, across], axis=1), jnp.concatenate([across.T, P[5:, 5:]], axis=1)])


def _record_range_errors(node: Any) -> Any:
    """With what the fix tells of scale and beacons."""
    n = node.x.shape[0] - DIMENSION
    sigma = jnp.sqrt(jnp.maximum(jnp.stack([node.P[DIMENSION + i, DIMENSION + i] for i in range(n)]), 0.0))
    x = node.x[DIMENSION:]
    told = {"scale": x[0], "error": x[1:], "sigma_scale": sigma[0], "sigma_error": sigma[1:]}
    return replace(node, position_fix=replace(node.position_fix, **told))


def tree_where(condition: Any, a: Any, b: Any) -> Any:
    """The tree a where a condition holds, else b."""
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y), a, b)
