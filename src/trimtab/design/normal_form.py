"""Normal form of a system with a relative degree: external coordinates, internal dynamics, and inputs for given v.

    xi = (y1, y1', …, y1^(r1-1), y2, …)        y_i^(r_i) = v_i        zeta' = Psi(xi, zeta, v)

Here r_i is the relative degree of the output y_i. Coordinates and inputs are found by Newton's iteration and
differentiated by the implicit function theorem. This works also for systems that are not affine in their inputs.

`linear_normal_form` linearises the normal form at a trim, where x' = f = 0, from first derivatives only. With z = (xi,
zeta) = phi(x), and with the highest derivatives of the outputs v = w(x, u), the linear model is

    dz' = Phi (f_x - f_u W_u^-1 W_x) Phi^-1 dz + Phi f_u W_u^-1 dv        Phi = dphi/dx

because the term with the second derivative of phi is multiplied by f. The result equals
`linearise(normal_form(…).model())`, but needs no iterations. This code runs offline and uses LAPACK.

Source: [1] A. Isidori, "Nonlinear Control Systems", Springer 1995, sections 4.1, 4.3, 5.1; the linearisation: derived
here.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import qr

from trimtab.core.errors import InputError
from trimtab.core.record import FAST_COMPILE_OPTIONS
from trimtab.design.lie import RelativeDegree, equilibrate, output_derivatives, relative_degree
from trimtab.design.linearise import LinearModel
from trimtab.design.model import StateSpaceModel, find_indices, model_of_functions

AT_REST = 1e-8
"""Largest state derivative that counts as zero at a trim, as a fraction of the length of the state's row in A, with
columns of A multiplied by the states' sizes."""
EARLY = 1e-10
"""Sensitivity of an output's time derivative to an input, as a fraction of its largest sensitivity to a state, above
which the input counts as affecting this time derivative."""
SINGULAR = 1e-10
"""Ratio of smallest to largest singular value up to which a matrix, scaled to unit rows and columns, counts as
singular."""
ROUNDING = 1e-13
"""Largest influence of a state on an output's derivative that counts as zero, as a fraction of the largest influence of
any state on this derivative."""
STEPS = 50
"""Maximum number of Newton steps."""
SETTLED = 1e-9
"""Size of a Newton step, relative to max(1, |value|), at which the iteration has converged. One last step follows."""


class NormalForm(NamedTuple):
    """Normal form around a point: coordinates, and the functions between them, all traceable by jax.

    forward: x -> (xi, zeta).  backward: (xi, zeta) -> x.  invert: (x, v) -> u.  internal: (xi, zeta, v) -> zeta'.
    backward and invert search near the point, and return NaN if no solution is found.  external: names of xi, e.g.
    ("h", "h'", "V").  internals: names of zeta.  virtual: names of v, e.g. ("h''", "V'").  xi0, zeta0, v0, x0, u0: the
    point.  degree: relative degree at the point.  jacobian: dPsi/dzeta at the point (k, k), with v held. condition:
    condition number of the scaled d(xi, zeta)/dx.  inputs_enter: internal coordinates whose derivatives contain the
    inputs (possible for states chosen as zeta).
    """

    forward: Callable[[Any], tuple[Any, Any]]
    backward: Callable[[Any, Any], Any]
    invert: Callable[[Any, Any], Any]
    internal: Callable[[Any, Any, Any], Any]
    external: tuple[str, ...]
    internals: tuple[str, ...]
    virtual: tuple[str, ...]
    xi0: Any
    zeta0: Any
    v0: Any
    x0: Any
    u0: Any
    degree: RelativeDegree
    jacobian: Any
    condition: float
    inputs_enter: tuple[str, ...]

    def model(self) -> StateSpaceModel:
        """Return the model in normal form: states (xi, zeta), inputs v, outputs y."""
        orders = [r for r in self.degree.degrees.values() if r is not None]
        total, ends = sum(orders), np.cumsum(orders, dtype=int)
        differentiated = np.flatnonzero(orders)
        first = (ends - orders)[differentiated]

        def f(z: Any, v: Any) -> Any:
            xi, zeta = z[:total], z[total:]
            chain = jnp.append(xi[1:], jnp.zeros(min(total, 1))).at[ends[differentiated] - 1].set(v[differentiated])
            return jnp.concatenate([chain, self.internal(xi, zeta, v)])

        def h(z: Any, v: Any) -> Any:
            return v.at[differentiated].set(z[first])

        states, z0 = (*self.external, *self.internals), np.concatenate([self.xi0, self.zeta0])
        outputs = tuple(self.degree.degrees)
        return model_of_functions(f, states, self.virtual, h=h, outputs=outputs, x0=z0, u0=self.v0)


def normal_form(
    model: StateSpaceModel,
    x: Any = None,
    u: Any = None,
    *,
    internal: Iterable[str] | Mapping[str, Callable[[Any], Any]] | None = None,
    radius: Any = None,
) -> NormalForm:
    """Compute coordinates (xi, zeta) around a point at which the vector relative degree is well defined.

    Args:
        model: model with as many outputs as inputs.
        x: state, as a vector, a record, or changes to the model's own point.
        u: input, in the same forms.
        internal: names of the states that form zeta, or name -> function of x (n,). Default: the states that, together
            with xi, are the best conditioned coordinates.
        radius: as in `relative_degree`.

    Source: [1] propositions 4.1.3 and 5.1.2.
    """
    x0, u0 = model.point(x, u)
    degree = relative_degree(model, x0, u0, radius=radius)
    reasons = list(degree.why)
    if len(model.outputs) != len(model.inputs):
        reasons = [f"the model must have as many outputs as inputs, got {len(model.outputs)} and {len(model.inputs)}"]
    if reasons:
        fix = "choose other outputs or another point, or extend the model"
        raise InputError("normal_form", "no relative degree is defined at this point: " + "; ".join(reasons), fix=fix)
    orders = {n: r for n, r in degree.degrees.items() if r is not None}
    external = tuple(n + "'" * k for n, r in orders.items() for k in range(r))
    virtual = tuple(n + "'" * r for n, r in orders.items())

    def xi(a: Any) -> Any:
        b = jnp.asarray(u0)
        chain = [output_derivatives(model, i, k)(a, b) for i, r in enumerate(orders.values()) for k in range(r)]
        return jnp.stack(chain) if chain else jnp.zeros(0)

    def highest(a: Any, b: Any) -> Any:
        return jnp.stack([output_derivatives(model, i, r)(a, b) for i, r in enumerate(orders.values())])

    def at_point(a: Any, b: Any) -> Any:
        return xi(a), highest(a, b), jax.jacfwd(xi)(a), jax.jacfwd(highest, (0, 1))(a, b)

    values = jax.jit(at_point, compiler_options=FAST_COMPILE_OPTIONS)(jnp.asarray(x0), jnp.asarray(u0))
    xi0, v0, slope, slopes = jax.tree.map(np.asarray, values)
    share = np.abs(slope) * np.maximum(1.0, np.abs(x0))
    slope = np.where(share > ROUNDING * share.max(axis=1, keepdims=True, initial=0.0), slope, 0.0)
    labels, zeta = _choose_internal(model, slope, internal)
    jacobian, condition, enter = _linearise_internal(model, zeta, labels, slope, slopes, (x0, u0))
    functions = _coordinate_functions(model, xi, zeta, highest, jnp.asarray(x0), jnp.asarray(u0))
    point = (xi0, np.asarray(zeta(jnp.asarray(x0))), v0, x0, u0)
    return NormalForm(*functions, external, labels, virtual, *point, degree, jacobian, condition, enter)


def _coordinate_functions(
    model: StateSpaceModel, xi: Any, zeta: Any, highest: Any, a0: Any, b0: Any
) -> tuple[Any, Any, Any, Any]:
    def forward(a: Any) -> tuple[Any, Any]:
        return xi(a), zeta(a)

    def backward(e: Any, z: Any) -> Any:
        return solve_root(lambda a: jnp.concatenate([xi(a) - e, zeta(a) - z]), a0)

    def invert(a: Any, v: Any) -> Any:
        return solve_root(lambda b: highest(a, b) - v, b0)

    def internal(e: Any, z: Any, v: Any) -> Any:
        a = backward(e, z)
        return jax.jvp(zeta, (a,), (model.f(a, invert(a, v)),))[1]

    return forward, backward, invert, internal


def _linearise_internal(
    model: StateSpaceModel, zeta: Any, labels: Any, slope: Any, slopes: Any, point: Any
) -> tuple[Any, float, Any]:
    """Return dPsi/dzeta at the point, the condition number of the coordinates, and the internal coordinates whose
    derivatives contain the inputs.

    slope: dxi/dx.  slopes: dv/dx and dv/du. With xi and v held, dx = S dzeta and du = -(dv/du)^-1 dv/dx dx.
    """

    def rate(a: Any, b: Any) -> Any:
        return jax.jvp(zeta, (a,), (model.f(a, b),))[1]

    slopes_of_zeta = (jax.jacfwd(zeta)(jnp.asarray(point[0])), *jax.jacfwd(rate, (0, 1))(*map(jnp.asarray, point)))
    inner, by_state, by_input = (np.asarray(d) for d in slopes_of_zeta)
    whole = np.vstack([slope, inner])
    fix = "name other states, or leave out the argument internal"
    condition = _condition_of_coordinates("normal_form.internal", whole, labels, fix)
    S = np.linalg.solve(whole, np.eye(len(whole))[:, len(slope) :])
    jacobian = by_state @ S - by_input @ np.linalg.solve(slopes[1], slopes[0] @ S)
    enter = tuple(n for n, row in zip(labels, by_input, strict=True) if row.any())
    return jacobian, condition, enter


def _condition_of_coordinates(part: str, Phi: Any, labels: tuple[str, ...], fix: str) -> float:
    """Return the condition number of the scaled d(xi, zeta)/dx; raise InputError if this matrix is singular."""
    singular = np.linalg.svd(equilibrate(Phi), compute_uv=False)
    if not singular[-1] > SINGULAR * singular[0]:
        problem = f"{labels} depend on the outputs and their derivatives, so they are not independent coordinates"
        raise InputError(part, problem, fix=fix)
    return float(singular[0] / singular[-1])


def _choose_internal(model: StateSpaceModel, slope: Any, choice: Any) -> tuple[tuple[str, ...], Any]:
    """Return the names of the internal coordinates, and the function from x to zeta. slope: dxi/dx."""
    total, size = len(slope), len(model.states) - len(slope)
    if choice is None:
        free = np.linalg.svd(equilibrate(slope))[2][total:]  # directions in which xi does not change
        pivoted: Any = qr(free, pivoting=True) if size else (None, None, [])
        choice = tuple(model.states[i] for i in sorted(pivoted[2][:size]))
    labels = tuple(choice)
    if isinstance(choice, Mapping):
        functions = tuple(choice.values())

        def zeta(a: Any) -> Any:
            return jnp.stack([jnp.asarray(function(a), jnp.float64) for function in functions])
    else:
        rows = np.array(find_indices("normal_form.internal", labels, model.states), int)

        def zeta(a: Any) -> Any:
            return a[rows]

    if len(labels) != size:
        problem = f"number of names must be {size} ({len(model.states)} states minus relative degree {total})"
        problem += f", got {len(labels)}"
        raise InputError("normal_form.internal", problem, choices=model.states, fix=f"number of names to give: {size}")
    return labels, zeta


def solve_root(equation: Callable[[Any], Any], start: Any) -> Any:
    """Find the root of a function of a vector near `start`, by Newton's method; NaN if the iteration does not converge.

    By the implicit function theorem, the result is differentiable in all variables that `equation` closes over.
    """

    def newton(g: Any, z0: Any) -> Any:
        def go(carry: Any) -> Any:
            z, _, k = carry
            step = jnp.linalg.solve(jax.jacfwd(g)(z), g(z))
            return z - step, jnp.abs(step) / jnp.maximum(1.0, jnp.abs(z)), k + 1

        def on(carry: Any) -> Any:
            return (carry[2] < STEPS) & (carry[1].max(initial=0.0) > SETTLED)

        z, moved, _ = jax.lax.while_loop(on, go, (z0, jnp.full_like(z0, jnp.inf), 0))
        step = jnp.linalg.solve(jax.jacfwd(g)(z), g(z))  # one last step, down to rounding errors
        return jnp.where(moved.max(initial=0.0) <= SETTLED, z - step, jnp.nan)

    def tangent(g: Any, y: Any) -> Any:
        return jnp.linalg.solve(jax.jacfwd(g)(jnp.zeros_like(y)), y)

    return jax.lax.custom_root(equation, start, newton, tangent)


def linear_normal_form(
    model: StateSpaceModel, degrees: Mapping[str, int], internal: Iterable[str], x: Any = None, u: Any = None
) -> LinearModel:
    """Compute the linear normal form dz' = A dz + B dv at a trim.

    z contains the outputs, their derivatives and the internal states; v contains the highest derivatives.

    Args:
        model: model with as many outputs as inputs.
        degrees: output -> relative degree, from `relative_degree`; checked at the trim.
        internal: names of the internal states, which complete the coordinates.
        x: a trim, as a vector, a record, or changes to the model's own point.
        u: the input at the trim, in the same forms.
    """
    x0, u0 = model.point(x, u)
    labels = tuple(internal)
    orders, rows = _output_orders(model, degrees, labels)
    chain = [(i, k) for i, r in enumerate(orders) for k in range(r)]

    def both(a: Any, b: Any) -> tuple[Any, Any, Any]:
        xi = [output_derivatives(model, i, k)(a, b) for i, k in chain]
        w = [output_derivatives(model, i, r)(a, b) for i, r in enumerate(orders)]
        return jnp.stack(xi), jnp.stack(w), model.f(a, b)

    all_at = jax.jit(lambda a, b: (both(a, b), jax.jacfwd(both, (0, 1))(a, b)), compiler_options=FAST_COMPILE_OPTIONS)
    values, slopes = jax.tree.map(np.asarray, all_at(jnp.asarray(x0), jnp.asarray(u0)))
    (xi0, w0, drift), ((xi_x, xi_u), (w_x, w_u), (f_x, f_u)) = values, slopes
    _check_normal_form(model, x0, drift, f_x, xi_x, xi_u, w_u)
    Phi = np.vstack([xi_x, np.eye(len(x0))[rows]])
    _condition_of_coordinates("linear_normal_form.internal", Phi, labels, "name other states")
    back, through = np.linalg.inv(Phi), f_u @ np.linalg.inv(w_u)
    A, B = Phi @ (f_x - through @ w_x) @ back, Phi @ through
    states = (*(model.outputs[i] + "'" * k for i, k in chain), *labels)
    virtual = tuple(n + "'" * r for n, r in zip(model.outputs, orders, strict=True))
    A, B = _exact_chain_rows(A, B, chain, orders)
    first = np.array([chain.index((i, 0)) for i in range(len(orders))])
    C, D = np.eye(len(A))[first], np.zeros((len(first), B.shape[1]))
    z0 = np.concatenate([xi0, x0[rows]])
    return LinearModel(A, B, C, D, z0, w0, z0[first], np.zeros(len(A)), states, virtual, model.outputs)


def _output_orders(
    model: StateSpaceModel, degrees: Mapping[str, int], labels: tuple[str, ...]
) -> tuple[list[int], list[int]]:
    """Return the relative degree of each output, and the indices of the internal states."""
    find_indices("linear_normal_form.degrees", degrees, model.outputs)
    orders = [degrees.get(n, 0) for n in model.outputs]
    if len(model.outputs) != len(model.inputs) or min(orders, default=0) < 1:
        problem = f"outputs: {len(model.outputs)}, inputs: {len(model.inputs)}, degrees: {dict(degrees)}"
        raise InputError(
            "linear_normal_form.degrees",
            problem,
            fix="give as many outputs as inputs, and for each output a degree of at least 1",
        )
    rows = find_indices("linear_normal_form.internal", labels, model.states)
    if sum(orders) + len(rows) != len(model.states):
        size, total = len(model.states) - sum(orders), sum(orders)
        problem = f"number of names must be {size} ({len(model.states)} states minus relative degree {total})"
        problem += f", got {len(labels)}"
        fix = f"number of names to give: {size}"
        raise InputError("linear_normal_form.internal", problem, fix=fix)
    return orders, rows


def _exact_chain_rows(A: Any, B: Any, chain: list[tuple[int, int]], orders: list[int]) -> tuple[Any, Any]:
    """Return A and B with exact zeros and ones in the rows of outputs and their derivatives (integrator chains)."""
    for row, (i, k) in enumerate(chain):
        A[row], B[row] = 0.0, 0.0
        if k + 1 < orders[i]:
            A[row, row + 1] = 1.0
        else:
            B[row, i] = 1.0
    return A, B


def _check_normal_form(model: StateSpaceModel, x0: Any, drift: Any, f_x: Any, xi_x: Any, xi_u: Any, w_u: Any) -> None:
    around = np.linalg.norm(f_x * np.maximum(1.0, np.abs(x0)), axis=1)
    moving = [n for n, v, s in zip(model.states, drift, around, strict=True) if not abs(v) <= AT_REST * max(s, 1e-9)]
    if moving:
        text = ", ".join(f"{n}' = {drift[model.states.index(n)]:.6g}" for n in moving)
        raise InputError(
            "linear_normal_form",
            f"the point is not a trim: {text}",
            fix="find a trim with trimtab.design.trim, and give its x and u",
        )
    early = np.abs(xi_u).max(axis=1, initial=0.0) > EARLY * np.abs(xi_x).max(axis=1)
    singular = np.linalg.svd(equilibrate(w_u), compute_uv=False)
    if early.any() or not singular[-1] > SINGULAR * singular[0]:
        problem = (
            "an input affects a derivative of an order below the degree"
            if early.any()
            else f"dv/du is singular ({singular[-1]:.3g})"
        )
        raise InputError("linear_normal_form.degrees", problem, fix="use the degrees from `relative_degree`")
