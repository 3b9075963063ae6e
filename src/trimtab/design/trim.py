"""Trim: states and inputs at which chosen derivatives and outputs have given values, or the reasons for failure.

The method is bounded least squares (trust region reflective) with derivatives by automatic differentiation, followed by
Newton steps down to rounding errors. This code runs offline and uses scipy and LAPACK.

Source: [1] B. L. Stevens, F. L. Lewis, E. N. Johnson, "Aircraft Control and Simulation", Wiley 2015, section 3.6, for
trim as a search; [2] M. A. Branch, T. F. Coleman, Y. Li, SIAM J. Sci. Comput. 21 (1999), for the solver.
"""

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from trimtab.core.errors import InputError
from trimtab.core.units import find_unit
from trimtab.design.model import StateSpaceModel, find_indices, format_combination

RANK_TOLERANCE = 1e-9
"""Largest singular value that counts as zero, as a fraction of the Jacobian's largest singular value."""
AT_BOUND = 1e-9
"""Distance of an unknown from its bound, as a fraction of the unknown's scale, up to which the unknown counts as lying
on the bound."""


class Trim(NamedTuple):
    """Trim point, or the reasons why none was found.

    is_found: True if every equation is satisfied.  x, u: the point (n,), (m,).  residual: equation -> residual, in the
    equation's unit, e.g. "speed'" -> 0.3.  relative: equation -> residual relative to the change of the equation when
    each unknown changes by its scale.  active: unknown -> "low" or "high", for unknowns that lie on a bound.
    powerless_unknowns: unknowns that affect no equation.  undetermined_unknowns: combinations of unknowns that affect
    no equation, so that there are several solutions.  rank: rank of the scaled Jacobian.  singular: singular values of
    the scaled Jacobian.  why: reasons for failure, in words.  taken: values of states and outputs that were assumed by
    default for level flight.
    """

    is_found: bool
    x: Any
    u: Any
    residual: dict[str, float]
    relative: dict[str, float]
    active: dict[str, str]
    powerless_unknowns: tuple[str, ...]
    undetermined_unknowns: tuple[str, ...]
    rank: int
    singular: Any
    why: tuple[str, ...]
    taken: Mapping[str, float] = MappingProxyType({})

    def require_trim(self, part: str = "trim") -> "Trim":
        """Return the trim if it was found; otherwise raise InputError with the reasons."""
        if not self.is_found:
            fix = "free another unknown, widen a bound, or drop a condition"
            raise InputError(part, "no trim was found: " + "; ".join(self.why), fix=fix)
        return self


class _Problem(NamedTuple):
    """Trim problem for the solver.

    residual: function of the unknowns z (k,).  jacobian: function from z to the derivatives of the residual by all
    states and inputs (x, u).  low, high, scale, names: bounds, scales and names of the unknowns.  equations: names of
    the equations.  x, u: states and inputs with the values of the fixed entries.  columns: indices of z in (x, u).
    """

    residual: Any
    jacobian: Any
    low: Any
    high: Any
    scale: Any
    names: tuple[str, ...]
    equations: tuple[str, ...]
    x: Any
    u: Any
    columns: Any


def trim(
    model: StateSpaceModel,
    *,
    free: Iterable[str],
    x: Any = None,
    u: Any = None,
    derivatives: Mapping[str, float] | None = None,
    loose: Iterable[str] = (),
    outputs: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    scales: Mapping[str, float] | None = None,
    starts: int = 8,
    tolerance: float = 1e-10,
) -> Trim:
    """Find the free states and inputs for which x' and y have the required values. All other states and inputs stay
    fixed.

    Args:
        model: the system.
        free: names of the states and inputs to find.
        x: initial guess of free states and values of fixed states: vector, record, or changes to the model's own point.
        u: initial guess of free inputs and values of fixed inputs, in the same forms.
        derivatives: state -> required derivative; default: zero for every state.
        loose: states whose derivative may have any value.
        outputs: output -> required value, as further equations.
        bounds: unknown -> (low, high).
        scales: unknown -> size of a typical change. Default: the width between finite bounds, or the larger of 1 and
            the magnitude of the initial guess.
        starts: maximum number of starts of the search. The first start is at x and u. Random starts follow only if it
            fails.
        tolerance: largest residual at which an equation is satisfied, relative to the change of the equation when each
            unknown changes by its scale.

    Returns: a Trim, with is_found False on failure; `require_trim` converts a failure into an InputError.
    Source: [1] section 3.6.
    """
    ranges = (bounds or {}, scales or {})
    problem, z0 = _build_problem(
        model, list(free), model.point(x, u), dict(derivatives or {}), list(loose), dict(outputs or {}), ranges
    )
    draws, best, best_cost = np.random.default_rng(0), z0, np.inf
    for i in range(max(starts, 1)):
        z, cost = _search_root(problem, z0 if i == 0 else _draw_restart(problem, z0, draws))
        if cost < best_cost:
            best, best_cost = z, cost
        if best_cost <= tolerance:
            break
    return _build_report(problem, best, tolerance)


def _build_problem(
    model: StateSpaceModel,
    free: list[str],
    point: tuple[Any, Any],
    derivatives: dict[str, float],
    loose: list[str],
    outputs: dict[str, float],
    ranges: tuple[Any, Any],
) -> tuple[_Problem, Any]:
    x0, u0 = point
    both = (*model.states, *model.inputs)
    if len(set(both)) != len(both):
        twice = [n for n in model.states if n in model.inputs]
        raise InputError(
            "trim", f"{twice} are names of both states and inputs", fix="give the entries of the model different names"
        )
    if not free:
        raise InputError(
            "trim.free",
            "no state or input is free",
            choices=both,
            fix="name the states and inputs that trim may change",
        )
    columns = np.array(find_indices("trim.free", free, both))
    find_indices("trim.derivatives", derivatives, model.states)
    away = find_indices("trim.loose", loose, model.states)
    rows = np.array([i for i in range(len(x0)) if i not in away], int)
    more = np.array(find_indices("trim.outputs", outputs, model.outputs), int)
    conflict = set(loose) & set(derivatives)
    if conflict:
        raise InputError(
            "trim.loose",
            f"{sorted(conflict)} are loose, but also have a required derivative",
            fix="remove each from loose or from derivatives",
        )
    wanted = np.array([*(derivatives.get(model.states[i], 0.0) for i in rows), *outputs.values()], float)
    equations = (*(model.states[i] + "'" for i in rows), *outputs)
    if not len(wanted) or not np.isfinite(wanted).all():
        problem = f"at least one derivative or output must be given, and all must be finite, got {wanted}"
        raise InputError("trim", problem, fix="outputs={NAME: VALUE}")
    fixed, n = np.concatenate([x0, u0]), len(x0)

    def point_at(z: Any) -> tuple[Any, Any]:
        whole = fixed.copy()
        whole[columns] = z
        return whole[:n], whole[n:]

    def value(z: Any) -> Any:
        rates, y = model.evaluate(*point_at(z))
        return np.concatenate([rates[rows], y[more]]) - wanted

    def slope(z: Any) -> Any:
        A, B, C, D = model.slopes(*point_at(z))
        return np.concatenate([np.hstack([A, B])[rows], np.hstack([C, D])[more]])

    z0 = fixed[columns]
    low, high, scale = _unknown_ranges(free, z0, *ranges)
    start = np.clip(z0, low, high)
    bad = [n for n, v in zip(equations, np.asarray(value(start)), strict=True) if not np.isfinite(v)]
    if bad:
        raise InputError(
            "trim",
            f"{', '.join(bad)} must be finite at the start point",
            fix="give x and u at which the model is defined",
        )
    return _Problem(value, slope, low, high, scale, tuple(free), equations, x0, u0, columns), start


def _unknown_ranges(free: list[str], z0: Any, bounds: Any, scales: Any) -> tuple[Any, Any, Any]:
    find_indices("trim.bounds", bounds, free)
    find_indices("trim.scales", scales, free)
    pairs = np.array([bounds.get(n, (-np.inf, np.inf)) for n in free], float)
    low, high = pairs[:, 0], pairs[:, 1]
    for name, a, b in zip(free, low, high, strict=True):
        if not a < b:
            fix = "give the lower bound first; to fix an unknown, remove it from free"
            raise InputError(f"trim.bounds.{name}", f"the lower bound must be below the upper, got ({a}, {b})", fix=fix)
    width = high - low
    usual = np.where(np.isfinite(width), width, np.maximum(1.0, np.abs(z0)))
    scale = np.array([scales.get(n, s) for n, s in zip(free, usual, strict=True)], float)
    for name, s in zip(free, scale, strict=True):
        if not 0 < s < np.inf:
            raise InputError(f"trim.scales.{name}", f"must be finite and above 0, got {s}", fix="give e.g. 1.0")
    return low, high, scale


def _draw_restart(p: _Problem, z0: Any, draws: np.random.Generator) -> Any:
    z = z0 + p.scale * draws.uniform(-1, 1, len(z0))
    inside = draws.uniform(0.02, 0.98, len(z0))
    bounded = np.isfinite(p.low) & np.isfinite(p.high)
    within = np.where(bounded, p.low, 0.0) + inside * np.where(bounded, p.high - p.low, 0.0)
    return np.clip(np.where(bounded, within, z), p.low, p.high)


def _scale_equations(p: _Problem, z: Any) -> tuple[Any, Any, Any]:
    """Return residual and Jacobian for scaled equations and unknowns, and the scales of the equations."""
    r, slopes = p.residual(z), p.jacobian(z)
    J, whole = slopes[:, p.columns] * p.scale, np.linalg.norm(slopes, axis=1)
    size = np.linalg.norm(J, axis=1)
    size = np.where(size > RANK_TOLERANCE * whole, size, whole)  # don't scale up rounding errors
    size = np.where(size > 0, size, 1.0)
    return r / size, J / size[:, None], size


def _search_root(p: _Problem, z: Any) -> tuple[Any, float]:
    """Search a trim from z by least squares and Newton's method; return its unknowns and largest relative residual."""
    if not (np.isfinite(p.residual(z)).all() and np.isfinite(p.jacobian(z)).all()):
        return z, np.inf
    size = _scale_equations(p, z)[2]
    inner = np.clip(z, np.nextafter(p.low, np.inf), np.nextafter(p.high, -np.inf))
    try:
        nearest = least_squares(
            lambda s: p.residual(s * p.scale) / size,
            inner / p.scale,
            jac=lambda s: p.jacobian(s * p.scale)[:, p.columns] * p.scale / size[:, None],  # pyright: ignore[reportArgumentType]
            bounds=(p.low / p.scale, p.high / p.scale),
            x_scale="jac",
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
            max_nfev=500,
        )
    except (ValueError, np.linalg.LinAlgError):  # the search left the range in which the model is finite
        return z, np.inf
    return _refine_newton(p, np.clip(nearest.x * p.scale, p.low, p.high))


def _refine_newton(p: _Problem, z: Any) -> tuple[Any, float]:
    r, J, _ = _scale_equations(p, z)
    for _ in range(20):
        step = np.linalg.lstsq(J, -r, rcond=RANK_TOLERANCE)[0] * p.scale
        next_z = np.clip(z + step, p.low, p.high)
        next_r, next_J, _ = _scale_equations(p, next_z)
        if not np.abs(next_r).max() < np.abs(r).max() or not np.isfinite(next_J).all():
            break
        z, r, J = next_z, next_r, next_J
    return z, float(np.abs(r).max())


def _build_report(p: _Problem, z: Any, tolerance: float) -> Trim:
    r, J, size = _scale_equations(p, z)
    left, singular, right = np.linalg.svd(J)
    rank = int((singular > RANK_TOLERANCE * max(singular.max(initial=0.0), np.finfo(float).tiny)).sum())
    active = {
        n: side
        for n, v, s, a, b in zip(p.names, z, p.scale, p.low, p.high, strict=True)
        for side, edge in (("low", a), ("high", b))
        if abs(v - edge) <= AT_BOUND * s
    }
    powerless = tuple(n for n, c in zip(p.names, np.abs(J).max(axis=0), strict=True) if c <= RANK_TOLERANCE)
    undetermined = tuple(format_combination(v, p.names) for v in right[rank:])
    missing = left[:, rank:].T
    holds = bool(np.abs(r).max() <= tolerance)
    point = np.concatenate([p.x, p.u])
    point[p.columns] = z
    x, u = np.split(point, [len(p.x)])
    residual = dict(zip(p.equations, (r * size).tolist(), strict=True))
    relative = dict(zip(p.equations, r.tolist(), strict=True))
    report = Trim(holds, x, u, residual, relative, active, powerless, undetermined, rank, singular, ())
    return report if holds else report._replace(why=_explain_failure(p, report, missing, r, tolerance))


def _explain_failure(p: _Problem, miss: Trim, missing: Any, r: Any, tolerance: float) -> tuple[str, ...]:
    """Return the reasons why no trim was found, the most important first."""
    off = miss.relative
    worst = sorted((n for n in off if abs(off[n]) > tolerance), key=lambda n: -abs(off[n]))
    reasons = ["not satisfied: " + ", ".join(f"{n} (error {miss.residual[n]:.6g})" for n in worst)]
    edges = {"low": dict(zip(p.names, p.low, strict=True)), "high": dict(zip(p.names, p.high, strict=True))}
    if miss.active:
        reasons.append("at a bound: " + ", ".join(f"{n} ({s}, {edges[s][n]:.6g})" for n, s in miss.active.items()))
    stuck = [format_combination(v, p.equations) for v in missing if abs(v @ r) > tolerance]
    reasons += [f"no unknown affects {c} to first order" for c in stuck]
    if miss.powerless_unknowns:
        reasons.append(f"unknowns without effect at this point: {', '.join(miss.powerless_unknowns)}")
    if len(reasons) == 1:
        reasons.append("the search ended in a local minimum of the least squares")
    return tuple(reasons)


def idle_states(model: StateSpaceModel, units: Mapping[str, str] = MappingProxyType({})) -> set[str]:
    """Return the idle states, on which the rest of the model does not depend.

    No derivative depends on an idle state. The exception is an idle state that is a length or an angle: derivatives of
    other idle states may depend on it.
    """
    around = np.random.default_rng(0).uniform(-0.1, 0.1, (3, len(model.x0)))
    size = np.zeros((len(model.x0), len(model.x0)))
    for shift in (0 * around[0], *around):
        there = np.abs(model.slopes(model.x0 + shift, model.u0)[0])
        size = np.maximum(size, np.where(np.isfinite(there), there, 0.0))
    idle: set[str] = set()
    while True:
        rows = [n not in idle for n in model.states]
        more = {
            n
            for n, column in zip(model.states, size.T, strict=True)
            if not column.any() or (_is_configuration(units.get(n, "")) and not column[rows].any())
        }
        if more <= idle:
            return idle
        idle |= more


def _is_configuration(unit: str) -> bool:
    return unit == "rad" or is_length(unit)


def is_length(unit: str) -> bool:
    """Return True if a unit is a unit of length."""
    try:
        return unit != "" and find_unit("unit", unit).name == "m"
    except InputError:
        return False
