"""Lie derivatives, relative degree and decoupling matrix of any model, by automatic differentiation.

An output is differentiated along x' = f(x, u), with constant input, until the input appears. For a system affine in the
inputs, f(x) + g(x) u, the k-th derivative is L_f^k h, and the decoupling matrix consists of L_g L_f^(r-1) h. If the
system is not affine, the matrix is dv/du at the point, with v the highest derivatives. This code runs offline.

Source: [1] A. Isidori, "Nonlinear Control Systems", Springer 1995, sections 4.1, 5.1, 5.4; [2] H. Nijmeijer, A. van der
Schaft, "Nonlinear Dynamical Control Systems", Springer 1990, chapter 13, for systems that are not affine.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import FAST_COMPILE_OPTIONS
from trimtab.design.model import Function, StateSpaceModel, find_indices, format_combination

ROUNDING = 1e-10
"""Largest magnitude of a sum that counts as zero, as a fraction of the sum of its terms' magnitudes."""
WEAK = 1e-13
"""Relative influence of a state on a function, near the point, below which the influence counts as zero."""
VANISHES = 1e-8
"""Largest length of a row of the decoupling matrix that counts as zero, as a fraction of the row's largest length near
the point. The same fraction of the largest singular value is the limit for singular values."""
Field = Callable[[Any], Any]
"""Function from x (n,) to a vector, traceable by jax."""


class RelativeDegree(NamedTuple):
    """Vector relative degree at a point.

    degrees: output -> number of differentiations until an input appears; None if no input ever does.  matrix:
    decoupling matrix d(highest derivatives)/du at the point (p, m); L_g L_f^(r-1) h for affine systems.  condition:
    condition number of the matrix after rows and columns are scaled to size 1, which removes the units.  determinant:
    determinant of the matrix; NaN if the matrix is not square.  margin: output -> size of its row of the matrix at the
    point, relative to the largest size near the point.  total: sum of the degrees.  is_defined: True if the vector
    relative degree is well defined at the point.  why: reasons, as text, if it is not.
    """

    degrees: dict[str, int | None]
    matrix: Any
    condition: float
    determinant: float
    margin: dict[str, float]
    total: int
    is_defined: bool
    why: tuple[str, ...]


def lie_derivative(h: Field, field: Field, order: int = 1) -> Field:
    """Return the Lie derivative L_field^order h as a function of x. L_field h is dh/dx field(x). Source: [1] section
    1.2."""
    if order == 0:
        return h
    lower = lie_derivative(h, field, order - 1)
    return lambda x: jax.jvp(lower, (x,), (field(x),))[1]


def affine_fields(model: StateSpaceModel, u: Any = None) -> tuple[Field, tuple[Field, ...]]:
    """Return f(x) and the columns g_j(x) of x' = f(x) + sum g_j(x) u_j, expanded about an input u (default: zero)."""
    base = jnp.zeros(len(model.inputs)) if u is None else jnp.asarray(model.point(u=u)[1])

    def column(j: int) -> Field:
        unit = jnp.zeros(len(base)).at[j].set(1.0)
        return lambda x: jax.jvp(lambda w: model.f(x, w), (base,), (unit,))[1]

    columns = tuple(column(j) for j in range(len(base)))
    return lambda x: model.f(x, base) - sum(g(x) * b for g, b in zip(columns, base, strict=True)), columns


def curved_inputs(
    model: StateSpaceModel, x: Any = None, u: Any = None, *, radius: Any = None, samples: int = 32
) -> dict[str, tuple[str, ...]]:
    """Return the inputs in which the model is not affine near a point, each with the states whose derivatives are
    nonlinear in the input."""
    points = sample_neighbourhood(model, x, u, radius, samples)
    slope = jax.jacfwd(model.f, argnums=1)
    both = jax.jit(jax.vmap(lambda a, b: (slope(a, b), jax.jacfwd(slope, 1)(a, b))))
    first, second = (np.abs(np.asarray(d)) for d in both(*points))
    bent = second.max(axis=(0, 2)) > ROUNDING * first.max(axis=0)
    curved = {n: tuple(np.array(model.states)[bent[:, j]].tolist()) for j, n in enumerate(model.inputs)}
    return {n: states for n, states in curved.items() if states}


def extend_inputs(model: StateSpaceModel, names: Sequence[str], order: int = 1) -> StateSpaceModel:
    """Extend the model dynamically: the named inputs become states, and their derivatives become the new inputs.

    The result is affine in the new inputs, for any model. The derivatives of an input "FX" are named "FX'", "FX''", …

    Source: [1] section 5.4.
    """
    if order < 1:
        raise InputError("extend.order", f"must be at least 1, got {order}", fix="order=1")
    picked = np.array(find_indices("extend.inputs", names, model.inputs), int)
    n, k = len(model.states), len(picked)

    def apart(z: Any, w: Any) -> tuple[Any, Any]:
        return z[:n], w.at[picked].set(z[n : n + k])

    def f(z: Any, w: Any) -> Any:
        return jnp.concatenate([model.f(*apart(z, w)), z[n + k :], w[picked]])

    chain = tuple(name + "'" * i for i in range(order) for name in names)
    inputs = tuple(m + "'" * order if j in picked else m for j, m in enumerate(model.inputs))
    x0 = np.concatenate([model.x0, np.asarray(model.u0)[picked], np.zeros(k * (order - 1))])
    u0 = np.array(model.u0, float)
    u0[picked] = 0.0
    states = (*model.states, *chain)
    return StateSpaceModel(f, lambda z, w: model.h(*apart(z, w)), states, inputs, model.outputs, x0, u0)


def output_derivatives(model: StateSpaceModel, output: Any, order: int) -> Function:
    """Return the time derivative, of the given order, of some outputs along f, with u held, as a function of (x, u)."""

    def differentiate(x: Any, u: Any) -> Any:
        return lie_derivative(lambda a: model.h(a, u)[output], lambda a: model.f(a, u), order)(x)

    return differentiate


def sample_neighbourhood(model: StateSpaceModel, x: Any, u: Any, radius: Any, samples: int) -> tuple[Any, Any]:
    """Return the point and samples around it: states (samples + 1, n) and inputs (samples + 1, m)."""
    x0, u0 = model.point(x, u)
    point = np.concatenate([x0, u0])
    size = 0.1 * np.maximum(1.0, np.abs(point))
    if isinstance(radius, Mapping):
        size[find_indices("radius", radius, (*model.states, *model.inputs))] = list(radius.values())
    elif radius is not None:
        size = size * 10 * float(radius)
    if not (np.isfinite(size) & (size > 0)).all():
        raise InputError("radius", f"must be finite and above 0, got {size}", fix="give finite radii above 0")
    draws = np.random.default_rng(0).uniform(-1, 1, (samples + 1, len(size))) * size
    draws[0] = 0.0
    points = point + draws
    return jnp.asarray(points[:, : len(x0)]), jnp.asarray(points[:, len(x0) :])


def relative_degree(
    model: StateSpaceModel, x: Any = None, u: Any = None, *, radius: Any = None, samples: int = 32
) -> RelativeDegree:
    """Compute the vector relative degree at a point, and check that it is well defined there.

    An input appears in a derivative if it appears at the point or at any sample around the point. If an input appears
    only around the point, the relative degree is not well defined, and the result reports this.

    Args:
        model: the system; its outputs are differentiated.
        x: state, as a vector, a record, or changes to the model's own point.
        u: input, in the same forms.
        radius: half widths of the box around the point in which samples are drawn: a mapping from state or input name
            to half width, or one number relative to max(1, |value|). Default: 0.1.
        samples: number of samples.

    Source: [1] section 5.1 (5.2); [2] definition 13.1 if the system is not affine.
    """
    points = sample_neighbourhood(model, x, u, radius, samples)
    degrees: dict[str, int | None] = dict.fromkeys(model.outputs)
    rows = np.zeros((len(points[0]), len(model.outputs), len(model.inputs)))
    left = list(range(len(model.outputs)))
    for order in range(len(model.states) + 1):
        for i, row in zip(left, np.moveaxis(_derivative_rows(model, left, order, points), 1, 0), strict=True):
            if row.any():
                degrees[model.outputs[i]], rows[:, i] = order, row
        left = [i for i in left if degrees[model.outputs[i]] is None]
        if not left:
            break
    return _build_verdict(model, degrees, rows)


def _derivative_rows(model: StateSpaceModel, outputs: list[int], order: int, points: tuple[Any, Any]) -> Any:
    """Return the derivatives by u, at all points (s, p, m), of the outputs' time derivatives of a given order. Values
    within the rounding error are set to zero."""
    picked = np.array(outputs)
    if order == 0:
        slope = jax.jacfwd(lambda a, b: model.h(a, b)[picked], argnums=1)
        return _require_finite(np.asarray(jax.jit(jax.vmap(slope), compiler_options=FAST_COMPILE_OPTIONS)(*points)))
    lower = output_derivatives(model, picked, order - 1)
    both = jax.vmap(lambda a, b: (jax.jacrev(lower)(a, b), jax.jacfwd(model.f, 1)(a, b)))
    gradient, field = (np.asarray(d) for d in jax.jit(both, compiler_options=FAST_COMPILE_OPTIONS)(*points))
    change = np.nan_to_num(np.abs(gradient)) * np.ptp(np.asarray(points[0]), axis=0)
    gradient = np.where(change > WEAK * change.sum(axis=2, keepdims=True), gradient, 0.0)
    value = _require_finite(np.einsum("spn,snm->spm", gradient, field))
    size = np.einsum("spn,snm->spm", np.abs(gradient), np.abs(field))
    return np.where(np.abs(value) > ROUNDING * np.nan_to_num(size, nan=np.inf), value, 0.0)


def _require_finite(rows: Any) -> Any:
    if not np.isfinite(rows[0]).all():
        raise InputError(
            "relative_degree", "a derivative is not finite", fix="choose a point where the model is smooth"
        )
    return np.nan_to_num(rows, posinf=0.0, neginf=0.0)


def equilibrate(matrix: Any) -> Any:
    """Scale the rows and columns of a matrix alternately to length 1, except those that are zero. Source: Ruiz,
    RAL-TR-2001-034."""
    scaled = np.array(matrix, float)
    for _ in range(20):
        for axis in (1, 0):
            size = np.linalg.norm(scaled, axis=axis, keepdims=True)
            scaled = scaled / np.where(size > 0, size, 1.0)
    return scaled


def _build_verdict(model: StateSpaceModel, degrees: dict[str, int | None], rows: Any) -> RelativeDegree:
    names, m, p = model.outputs, len(model.inputs), len(model.outputs)
    size = np.linalg.norm(rows, axis=2)
    largest = size.max(axis=0)
    margin = np.divide(size[0], largest, out=np.zeros(p), where=largest > 0)
    why = [f"no input affects the output {n}" for n in names if degrees[n] is None]
    for n, share in zip(names, margin, strict=True):
        if degrees[n] is not None and share <= VANISHES:
            why.append(f"inputs affect derivative {degrees[n]} of {n} around the point, but not at the point")
    matrix = rows[0]
    singular = np.linalg.svd(equilibrate(matrix), compute_uv=False)
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0 else float("inf")
    if p > m:
        why.append(f"{p} outputs need at least {p} inputs, the model has {m}")
    elif None not in degrees.values():
        why += _explain_singularity(model, rows, bool(why))
    total = sum(r for r in degrees.values() if r is not None)
    determinant = float(np.linalg.det(matrix)) if p == m else float("nan")
    margins = dict(zip(names, margin.tolist(), strict=True))
    return RelativeDegree(degrees, matrix, condition, determinant, margins, total, not why, tuple(why))


def _explain_singularity(model: StateSpaceModel, rows: Any, explained: bool) -> list[str]:
    """Explain where the decoupling matrix is singular, and which combination of outputs the inputs can't move."""
    values = np.array([np.linalg.svd(equilibrate(r), compute_uv=False) for r in rows])
    singular = values[:, -1] <= VANISHES * values[:, 0]
    if not singular[0] or (explained and not singular.all()):
        return []
    blocked = format_combination(np.linalg.svd(equilibrate(rows[0]))[0][:, -1], model.outputs)
    where = "everywhere near the point" if singular.all() else "at the point only"
    text = f"the decoupling matrix is singular {where}: the inputs can't move {blocked} (scaled)"
    enter = [n for n, c in zip(model.inputs, np.abs(rows).max(axis=(0, 1)), strict=True) if c > 0]
    return [text + (f"; try the dynamic extension of {' or '.join(enter)}" if singular.all() else "")]
