"""Output inversion: states and inputs for which a vehicle's outputs follow a trajectory exactly, even if the vehicle is
non-minimum phase.

In the normal form, the outputs and their derivatives are given. The internal dynamics zeta' = Psi(xi, zeta, v) are
solved for their bounded solution. In this solution, stable modes depend on the past. Unstable modes depend on the
future, so that the vehicle moves before its outputs do. Positions (e.g. north, east), on which no other derivative
depends, are integrated from their initial value. All other modes, even slow ones, are part of the bounded solution. The
result is a feedforward for use with a feedback. This code runs offline.

Source: S. Devasia, D. Chen, B. Paden, "Nonlinear inversion-based output tracking", IEEE Transactions on Automatic
Control 41(7), 1996.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import FAST_COMPILE_OPTIONS
from trimtab.design.model import StateSpaceModel
from trimtab.design.normal_form import NormalForm, normal_form
from trimtab.design.poles import balance_matrix, participation
from trimtab.design.stable_inversion import ON_AXIS, BoundedSolution, bounded_solution, find_places


class Course(NamedTuple):
    """Desired trajectory of outputs. times: (k,) (s).  derivatives: output -> value and derivatives (order + 1, k)."""

    times: Any
    derivatives: Mapping[str, Any]


class Inversion(NamedTuple):
    """State and input along an output trajectory. times: (k,) (s).  x: states (k, n).  u: inputs (k, m).

    internal: bounded solution of the internal dynamics.  form: normal form.
    """

    times: Any
    x: Any
    u: Any
    internal: BoundedSolution
    form: NormalForm


class InternalMode(NamedTuple):
    """Mode of the internal dynamics. pole: (1/s).  states: names of the states that participate, as text."""

    pole: complex
    states: str


def internal_modes(form: NormalForm) -> tuple[tuple[str, ...], tuple[InternalMode, ...]]:
    """Return the names of the positions among a normal form's internal coordinates, and the modes of the other
    coordinates.

    A position is a coordinate, e.g. north, that enters no derivative except those of other positions.

    Raises: InputError if a mode lies on the imaginary axis, because the bounded solution is then not unique.
    """
    places = find_places(form.jacobian)
    rest = [i for i in range(len(form.internals)) if i not in places]
    inner, names = form.jacobian[np.ix_(rest, rest)], [form.internals[i] for i in rest]
    poles = np.linalg.eigvals(inner) if rest else np.zeros(0, complex)
    largest, balanced = np.abs(poles).max(initial=0.0), balance_matrix(inner)
    modes = []
    for pole in poles:
        share = np.abs(participation(balanced, pole, 1e-6 * largest))
        modes.append(InternalMode(complex(pole), ", ".join(names[i] for i in np.argsort(-share) if share[i] > 0.3)))
    neutral = [m for m in modes if abs(m.pole.real) <= ON_AXIS * largest]
    if neutral:
        words = "; ".join(f"{m.pole:.3g} 1/s, in {m.states}" for m in neutral)
        problem = f"the internal dynamics have modes that neither decay nor grow: {words}"
        raise InputError("inversion", problem, fix="choose another output, or add an output and an input")
    return tuple(form.internals[i] for i in places), tuple(modes)


def smooth_course(
    times: Any, changes: Mapping[str, tuple[float, float]], begin: float, end: float, order: int
) -> Course:
    """Create output trajectories that change from one value to another between two times, with `order` continuous
    derivatives.

    Args:
        times: (k,) (s), evenly spaced.
        changes: output -> (initial value, final value).
        begin, end: times (s) at which the change begins and ends.
        order: number of derivatives, at least the relative degree of each output.
    """
    times = np.asarray(times, float)
    if not times[0] <= begin < end <= times[-1]:
        raise InputError(
            "course",
            f"begin and end must lie within the grid, with begin before end; got {begin} and {end} s",
            fix="choose begin and end between the first and the last of `times`",
        )
    q = order + 1  # the integral of t^q (1 - t)^q has q derivatives that vanish at t = 0 and t = 1
    shape = np.polynomial.Polynomial([0.0] * q + [1.0]) * np.polynomial.Polynomial([1.0, -1.0]) ** q
    rise = shape.integ()
    rise = rise / rise(1.0)
    s = np.clip((times - begin) / (end - begin), 0.0, 1.0)
    rows = [rise.deriv(k)(s) / (end - begin) ** k if k else rise(s) for k in range(order + 1)]
    derivatives = {
        n: np.array([first + (last - first) * rows[0], *((last - first) * row for row in rows[1:])])
        for n, (first, last) in changes.items()
    }
    return Course(times, derivatives)


def invert_output(
    model: StateSpaceModel, course: Course, *, end: tuple[Any, Any] | None = None, tolerance: float = 1e-9
) -> Inversion:
    """Compute the state and input for which all outputs follow a trajectory.

    Args:
        model: model with as many inputs as outputs; its point is the equilibrium at the beginning of the trajectory.
        course: trajectory of all outputs at evenly spaced times, each with at least as many derivatives as its relative
            degree.
        end: x (n,) and u (m,) at the equilibrium after the trajectory. Default: the internal coordinates return to
            their initial values.
        tolerance: as in `bounded_solution`.

    Raises: InputError if the model has no well-defined relative degree, or if the iteration does not converge.
    Source: as for this module.
    """
    form = normal_form(model)
    internal_modes(form)
    degrees = [(n, r or 0) for n, r in form.degree.degrees.items()]
    short = [n for n, r in degrees if n not in course.derivatives or len(course.derivatives[n]) <= r]
    if short:
        need = ", ".join(f"{n}: {r}" for n, r in degrees)
        raise InputError(
            "course",
            f"the trajectory needs more derivatives of {short[0]}",
            fix=f"give at least as many derivatives as the relative degree, {need}",
        )
    xi = np.concatenate([np.asarray(course.derivatives[n])[:r] for n, r in degrees]).T
    v = np.stack([np.asarray(course.derivatives[n])[r] for n, r in degrees], axis=1)
    across = jax.jit(jax.vmap(form.internal), compiler_options=FAST_COMPILE_OPTIONS)
    dt = float(course.times[1] - course.times[0])
    right = form.zeta0 if end is None else np.asarray(form.forward(jnp.asarray(end[0]))[1])
    start = form.zeta0 + np.linspace(0, 1, len(v))[:, None] * (right - form.zeta0)
    solution = bounded_solution(
        lambda zeta: np.asarray(across(jnp.asarray(xi), jnp.asarray(zeta), jnp.asarray(v))),
        form.jacobian,
        start,
        dt,
        left=form.zeta0,
        right=right,
        scales=np.maximum(np.abs(form.zeta0), 1.0),
        tolerance=tolerance,
    )

    def state_and_input(xi: Any, zeta: Any, v: Any) -> Any:
        x = form.backward(xi, zeta)
        return x, form.invert(x, v)

    both = jax.jit(jax.vmap(state_and_input), compiler_options=FAST_COMPILE_OPTIONS)
    x, u = (np.asarray(a) for a in both(jnp.asarray(xi), jnp.asarray(solution.zeta), jnp.asarray(v)))
    if not (np.isfinite(x).all() and np.isfinite(u).all()):
        raise InputError(
            "inversion",
            "no state near the model's point has these outputs and derivatives",
            fix="make the change slower or smaller",
        )
    return Inversion(np.asarray(course.times), x, u, solution, form)
