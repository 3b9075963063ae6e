"""Trim, internal dynamics and tables of internal states for the hypersonic vehicle.

A table contains the internal states (angle of attack, pitch rate, bending) during a climb, and is computed before a
run. It is the bounded solution of the exact or of the linearised internal dynamics.

Source: [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eq. 7, for the internal dynamics. The linearisation that this module computes
differs from the linearisation printed in the paper. The paper does not state how tables are computed. The method used
here is that of S. Devasia, D. Chen, B. Paden, IEEE Transactions on Automatic Control 41(7), 1996.
"""

import math
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import block_diag

from trimtab.core.errors import InputError
from trimtab.core.record import FAST_COMPILE_OPTIONS, replace
from trimtab.design.model import StateSpaceModel, model_of_vehicle
from trimtab.design.stable_inversion import (
    BoundedSolution,
    bounded_residual,
    bounded_solution,
    exosystem_matrix,
    solve_steady_response,
)
from trimtab.design.trim import Trim, trim
from trimtab.laws.internal_states import (
    FIRST_ALPHA,
    FadingModes,
    InternalTable,
    PreviewInternal,
    SylvesterInternal,
    solve_quasi_static,
)
from trimtab.laws.path_command import FilteredClimb, PathPoint
from trimtab.laws.path_inversion import InputLimits, internal_rates, invert_path
from trimtab.laws.stable_inversion import INTERNAL_SIZES
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput, HypersonicState

SEARCH_ITERATIONS = 8
"""Number of Newton iterations that compute the angle of attack of quasi-static flight before a run."""
FREE_VARIABLES = ("alpha", "theta", "eta1", "eta2", "Phi", "delta_e")
ANGLES = {"alpha": (-0.1, 0.1), "theta": (-0.1, 0.1)}
SCALES = np.array(INTERNAL_SIZES)
"""Typical sizes of the internal states (alpha, Q, eta1, eta1', eta2, eta2')."""
BEYOND = 8.0
"""Time (s) by which the computed solution extends beyond the end of a table.

The effect of an error in the final boundary value decays backwards in time, by a factor of e^-26 until the end of the
table.
"""
LEAST_BEYOND = 3.0
"""Minimum time (s) by which the solution must extend beyond the end of a table. An error in the final boundary value
decays by a factor of e^-10 in this time."""


class LevelTrim(NamedTuple):
    """Trimmed level flight.

    h: altitude (ft).  V: speed (ft/s).  zeta: internal states (alpha, Q, eta1, eta1', eta2, eta2').  u: constant input.
    """

    h: float
    V: float
    zeta: Any
    u: HypersonicInput


class InternalLinear(NamedTuple):
    """Internal dynamics, linearised about level flight: zeta' = A21 (xi - xi0) + A22 (zeta - zeta0) + B2 v.

    zeta: internal states.  xi = (h, h', V).  v = (h'', V').  xi0, zeta0: values in level flight.
    """

    trim: LevelTrim
    A21: Any
    A22: Any
    B2: Any


def level_trim(craft: Hypersonic, h: float, V: float, limits: InputLimits | None = None) -> LevelTrim:
    """Return the vehicle's trimmed level flight at altitude h (ft) and speed V (ft/s).

    Raise InputError, with the reason, if no trim is found.
    """
    zeta, u, settled = quasi_static_states(craft, level_points(np.array([h]), np.array([V])))
    return _accept_trim(craft, h, V, zeta[:, 0], u[:, 0], settled[0], InputLimits() if limits is None else limits)


def design_model(craft: Hypersonic, h: float, V: float) -> StateSpaceModel:
    """Return a model of the vehicle near level flight, with altitude h (ft) and speed V (ft/s) as outputs."""
    x = HypersonicState(h, V, FIRST_ALPHA, FIRST_ALPHA, 0.0, 0.0, 0.0, 0.0, 0.0)
    return model_of_vehicle(craft, x, HypersonicInput(0.2, 0.1), outputs=("h", "V"))


def find_trim(model: StateSpaceModel, limits: InputLimits, part: str) -> Trim:
    """Return the level-flight trim of a `design_model`, found by a thorough search. part: name for error messages."""
    return trim(model, free=FREE_VARIABLES, bounds=_trim_bounds(limits)).require_trim(part)


def _trim_bounds(limits: InputLimits) -> dict[str, tuple[float, float]]:
    """Return the bounds for the trim search: input limits, and angles for which the vehicle's curves are valid
    (rad)."""
    return {**ANGLES, "Phi": (limits.Phi_low, limits.Phi_high), "delta_e": (limits.delta_low, limits.delta_high)}


def level_points(h: Any, V: Any) -> PathPoint:
    """Return path points of level flight at altitudes h (ft) and speeds V (ft/s)."""
    still = np.zeros(np.shape(h))
    return PathPoint(h, still, still, still, V, still, still)


def internal_linear(craft: Hypersonic, at: LevelTrim) -> InternalLinear:
    """Return the internal dynamics, linearised about trimmed level flight."""
    A21, A22, B2 = _differentiate_rates(craft, np.array([at.h, 0.0, at.V]), at.zeta, np.zeros(2))
    return InternalLinear(at, np.asarray(A21), np.asarray(A22), np.asarray(B2))


def quasi_static_states(craft: Hypersonic, points: PathPoint) -> Any:
    """Return the quasi-static flight at n path points.

    The result is the internal states zeta (6, n), the inputs Phi and delta_e (2, n), and a flag (n,), which is True
    where the search converged.
    """
    return jax.tree.map(np.asarray, _search_states(craft, points))


def _accept_trim(
    craft: Hypersonic, h: float, V: float, zeta: Any, u: Any, settled: Any, limits: InputLimits
) -> LevelTrim:
    """Return the trim found by the quick search if it converged within all limits, else that of a thorough search.

    zeta, u, settled: result of the quick search. Raise InputError, with the reason, if the thorough search fails too.
    """
    bounds = _trim_bounds(limits)
    values = {"alpha": zeta[0], "Phi": u[0], "delta_e": u[1]}
    if settled and all(bounds[n][0] <= v <= bounds[n][1] for n, v in values.items()):
        return LevelTrim(h, V, zeta, HypersonicInput(float(u[0]), float(u[1])))
    model = design_model(craft, h, V)
    searched = find_trim(model, limits, f"level trim at {h:g} ft, {V:g} ft/s")
    x, u = model.state(searched.x), model.input(searched.u)
    return LevelTrim(h, V, np.array([x.alpha, 0.0, x.eta1, 0.0, x.eta2, 0.0]), u)


@partial(jax.jit, compiler_options=FAST_COMPILE_OPTIONS)
def _differentiate_rates(craft: Any, xi: Any, zeta: Any, v: Any) -> Any:
    def rates(xi: Any, zeta: Any, v: Any) -> Any:
        return jnp.stack(internal_rates(craft, xi[0], xi[1], xi[2], v[0], v[1], zeta))

    return jax.jacfwd(rates, (0, 1, 2))(xi, zeta, v)


@partial(jax.jit, compiler_options=FAST_COMPILE_OPTIONS)
def _search_states(craft: Any, p: Any) -> Any:
    zeta, settled = solve_quasi_static(craft, p, jnp.full_like(p.h, FIRST_ALPHA), SEARCH_ITERATIONS)
    u = invert_path(craft, p.h, p.h_rate, p.V, zeta[0], p.h_acceleration, p.V_rate).u
    return jnp.stack(zeta), jnp.stack([u.Phi, u.delta_e]), settled


class TableReport(NamedTuple):
    """Accuracy of a table of internal states. All errors are relative to the typical sizes in SCALES.

    solution: complete solution on the fine time grid.  residual: largest difference between the derivative of the
    solution, by central differences, and the internal dynamics (1/s).  left, right: difference between the solution and
    trimmed level flight, at the start and at the end. `right` is large if the climb is not finished at the end.
    interpolation: largest interpolation error between the nodes of the table (6,).
    """

    solution: BoundedSolution
    residual: float
    left: float
    right: float
    interpolation: Any


def noncausal_table(
    craft: Hypersonic, climb: Any, seconds: float, dt: float = 0.005, keep: float = 0.1, beyond: float = BEYOND
) -> tuple[InternalTable, TableReport]:
    """Return a table of the internal states along a climb, from time 0 to `seconds`, and the table's accuracy.

    The table contains the bounded solution of the exact internal dynamics. Its boundary values are the trim at time 0
    and the quasi-static solution at the end. If the climb is finished at the end, the quasi-static solution equals the
    trim. Otherwise it is more accurate than the trim.

    Args:
        craft: vehicle model.
        climb: object with a method `at(t)` that returns a PathPoint. The path must be level at time 0.
        seconds: last time in the table (s).
        dt: time step of the solution (s).
        keep: time between the nodes of the table (s), a multiple of dt.
        beyond: time by which the solution extends beyond `seconds` (s).
    """
    t, path = _time_grid(climb, seconds, dt, keep, beyond)
    ends, guess = _boundaries_and_guess(craft, t, path)
    solution = bounded_solution(
        lambda zeta: np.asarray(_rates(craft, path, zeta)),
        internal_linear(craft, ends[0]).A22,
        guess,
        dt,
        left=ends[0].zeta,
        right=guess[-1],
        scales=SCALES,
    )
    return _make_table(solution, t, dt, keep, seconds, ends[0].zeta, ends[1].zeta)


def linear_table(
    craft: Hypersonic, climb: Any, seconds: float, dt: float = 0.005, keep: float = 0.1, beyond: float = BEYOND
) -> tuple[InternalTable, TableReport]:
    """Return a table as `noncausal_table` does, but for internal dynamics linearised about the initial trim, as in [1].

    The table is accurate for small climbs only.
    """
    t, path = _time_grid(climb, seconds, dt, keep, beyond)
    linear = internal_linear(craft, level_trim(craft, float(path.h[0]), float(path.V[0])))
    xi = np.stack([path.h - linear.trim.h, path.h_rate, path.V - linear.trim.V], axis=1)
    v = np.stack([path.h_acceleration, path.V_rate], axis=1)
    drive, zeta0 = xi @ linear.A21.T + v @ linear.B2.T, linear.trim.zeta
    rest = zeta0 - np.linalg.solve(linear.A22, drive[-1])
    solution = bounded_solution(
        lambda zeta: drive + (zeta - zeta0) @ linear.A22.T,
        linear.A22,
        np.broadcast_to(zeta0, (len(t), len(zeta0))),
        dt,
        left=zeta0,
        right=rest,
        scales=SCALES,
    )
    table, report = _make_table(solution, t, dt, keep, seconds, zeta0, rest)
    return replace(table, exact=False), report


def sylvester_internal(craft: Hypersonic, climb: FilteredClimb) -> SylvesterInternal:
    """Return the causal linear solution for the internal states during a climb, linearised about the initial trim."""
    linear = internal_linear(craft, level_trim(craft, float(climb.h0), float(climb.V0)))
    S: Any = block_diag(exosystem_matrix(float(climb.wh), 4), exosystem_matrix(float(climb.wV), 3))
    G = np.zeros((len(linear.trim.zeta), len(S)))
    G[:, [0, 1, 4]] = linear.A21
    G[:, [2, 5]] += linear.B2
    rest = np.linalg.solve(linear.A22, linear.A21)
    return SylvesterInternal(X=solve_steady_response(linear.A22, S, G), rest=rest, zeta_0=linear.trim.zeta)


def preview_internal(craft: Hypersonic, at: LevelTrim, horizon: float = 4.0, intervals: int = 40) -> PreviewInternal:
    """Return the part that computes the internal states in flight from the future command.

    The part uses the modes of the internal dynamics at the trim `at`. horizon: time of the future command (s).
    """
    A22 = internal_linear(craft, at).A22
    scaled = A22 * SCALES / SCALES[:, None]
    eigen: Any = np.linalg.eig(scaled)
    poles, vectors = eigen
    inverse: Any = np.linalg.inv(vectors)
    weight = np.where(poles.imag > 0, 2.0, 1.0)
    right, left = vectors * weight * SCALES[:, None], inverse / SCALES

    def modes(chosen: Any, sign: float) -> FadingModes:
        rows = np.flatnonzero(chosen & (poles.imag >= 0))
        L, R, of = left[rows], right[:, rows], sign * poles[rows]
        return FadingModes(of.real, of.imag, np.stack([L.real, L.imag]), np.stack([R.real, R.imag]))

    form = PreviewInternal(
        A22=A22,
        past=modes(poles.real < 0, 1.0),
        future=modes(poles.real > 0, -1.0),
        craft=craft,
        horizon=horizon,
        alpha=float(at.zeta[0]),
        intervals=intervals,
    )
    form.check()
    return form


@partial(jax.jit, compiler_options=FAST_COMPILE_OPTIONS)
def _rates(craft: Any, p: Any, zeta: Any) -> Any:
    return jnp.stack(internal_rates(craft, p.h, p.h_rate, p.V, p.h_acceleration, p.V_rate, zeta.T), axis=1)


@partial(jax.jit, compiler_options=FAST_COMPILE_OPTIONS)
def _path_points(climb: Any, t: Any) -> Any:
    return climb.at(t)


@partial(jax.jit, compiler_options=FAST_COMPILE_OPTIONS)
def _interpolate(table: InternalTable, t: Any) -> Any:
    return jax.vmap(table.at)(t)


def _time_grid(climb: Any, seconds: float, dt: float, keep: float, beyond: float) -> tuple[Any, PathPoint]:
    """Return the time grid of the solution (s), and the points of the climb's path at these times."""
    every = round(keep / dt) if dt > 0 else 0
    if every < 1 or abs(every * dt - keep) > 1e-9 * keep or not seconds >= keep:
        problem = f"got a duration of {seconds:g} s, {keep:g} s between nodes, and a step of {dt:g} s"
        raise InputError("internal table", problem, fix="choose keep as a multiple of dt, and seconds of at least keep")
    if not beyond >= LEAST_BEYOND:
        problem = f"the solution extends only {beyond:g} s beyond the table, which is too short for the unstable mode"
        raise InputError("internal table.beyond", problem, fix=f"choose at least {LEAST_BEYOND:g} s")
    nodes = math.ceil(seconds / keep - 1e-9) * every
    t = dt * np.arange(nodes + math.ceil(beyond / dt) + 1)
    path = jax.tree.map(np.asarray, _path_points(climb, t))
    start = [float(leaf[0]) for leaf in (path.h_rate, path.h_acceleration, path.V_rate)]
    if not np.abs(start).max() < 1e-9:
        problem = f"the climb is not level at time 0: h' = {start[0]:g}, h'' = {start[1]:g}, V' = {start[2]:g}"
        raise InputError("internal table.climb", problem, fix="start the climb after time 0")
    return t, path


def _boundaries_and_guess(craft: Hypersonic, t: Any, path: PathPoint) -> tuple[list[LevelTrim], Any]:
    """Return the level trims at the start and at the end of a path, and the quasi-static states at all times (n, 6)."""
    ends = level_points(path.h[[0, -1]], path.V[[0, -1]])
    zeta, u, settled = quasi_static_states(craft, jax.tree.map(lambda *several: np.concatenate(several), path, ends))
    n, limits = len(t), InputLimits()
    points = [(i, float(ends.h[i - n]), float(ends.V[i - n])) for i in (n, n + 1)]
    trims = [_accept_trim(craft, h, V, zeta[:, i], u[:, i], settled[i], limits) for i, h, V in points]
    if not settled[:n].all():
        problem = f"at {t[int(np.argmin(settled))]:g} s, the search found no angle of attack without pitching moment"
        raise InputError("internal table.climb", problem, fix="make the climb slower or smaller")
    return trims, zeta[:, :n].T


def _make_table(
    solution: BoundedSolution, t: Any, dt: float, keep: float, seconds: float, left: Any, right: Any
) -> tuple[InternalTable, TableReport]:
    every = round(keep / dt)
    last = math.ceil(seconds / keep - 1e-9) * every
    rows = slice(0, last + 1, every)
    table = InternalTable(nodes=solution.zeta[rows], rates=solution.rates[rows], first=0.0, spacing=keep)
    table.check()
    between = _interpolate(table, t[: last + 1])
    report = TableReport(
        solution=solution,
        residual=float(np.abs(bounded_residual(solution, dt) / SCALES).max()),
        left=float(np.abs((solution.zeta[0] - left) / SCALES).max()),
        right=float(np.abs((solution.zeta[-1] - right) / SCALES).max()),
        interpolation=np.abs((np.asarray(between) - solution.zeta[: last + 1]) / SCALES).max(axis=0),
    )
    return table, report
