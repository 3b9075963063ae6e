"""Linearisation in the coordinates of the normal form, at a trim, from first derivatives only.

With z = (xi, zeta) = phi(x) and v = w(x, u) the highest derivatives of the outputs, at a point where x' = f = 0

    dz' = Phi (f_x - f_u W_u^-1 W_x) Phi^-1 dz + Phi f_u W_u^-1 dv        Phi = dphi/dx

because the term with the second derivative of phi is multiplied by f. It is what `linearise(normal_form(…).model())`
gives, without the iterations in it, and quick. Offline code: LAPACK.

Source: [1] A. Isidori, "Nonlinear Control Systems", Springer 1995, sections 4.1, 5.1; derived here.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.float64 import jax, jnp
from trimtab.core.once import QUICKLY
from trimtab.design.lie import equilibrated, output_derivatives
from trimtab.design.linearise import Linear
from trimtab.design.model import Model, indices

AT_REST = 1e-8
"""A derivative this small a part of what the states' own sizes make of A counts as zero."""
EARLY = 1e-10
"""An input that enters a derivative by this part of its row's size enters it."""


def linear_normal_form(
    model: Model, degrees: Mapping[str, int], internal: Iterable[str], x: Any = None, u: Any = None
) -> Linear:
    """dz' = A dz + B dv with z = (outputs and their derivatives, internal states) and v the highest derivatives.

    Args:
        model: as many outputs as inputs.
        degrees: output -> relative degree, as `relative_degree` finds it; checked at the point.
        internal: names of the states that complete the coordinates.
        x: a trim: vector, record, or changes to the model's own point.
        u: its input, likewise.
    """
    x0, u0 = model.point(x, u)
    labels = tuple(internal)
    orders, rows = _orders(model, degrees, labels)
    chain = [(i, k) for i, r in enumerate(orders) for k in range(r)]

    def both(a: Any, b: Any) -> tuple[Any, Any, Any]:
        xi = [output_derivatives(model, i, k)(a, b) for i, k in chain]
        w = [output_derivatives(model, i, r)(a, b) for i, r in enumerate(orders)]
        return jnp.stack(xi), jnp.stack(w), model.f(a, b)

    at = (jnp.asarray(x0), jnp.asarray(u0))
    made = jax.jit(lambda a, b: (both(a, b), jax.jacfwd(both, (0, 1))(a, b)), compiler_options=QUICKLY)(*at)
    (xi0, w0, drift), ((xi_x, xi_u), (w_x, w_u), (f_x, f_u)) = jax.tree.map(np.asarray, made)
    _check(model, x0, drift, f_x, xi_x, xi_u, w_u)
    Phi = np.vstack([xi_x, np.eye(len(x0))[rows]])
    singular = np.linalg.svd(equilibrated(Phi), compute_uv=False)
    if not singular[-1] > 1e-10 * singular[0]:
        problem = f"{labels} don't complete the outputs and their derivatives to coordinates"
        raise InputError("linear_normal_form.internal", problem, fix="name other states")
    back, through = np.linalg.inv(Phi), f_u @ np.linalg.inv(w_u)
    A, B = Phi @ (f_x - through @ w_x) @ back, Phi @ through
    states = (*(model.outputs[i] + "'" * k for i, k in chain), *labels)
    virtual = tuple(n + "'" * r for n, r in zip(model.outputs, orders, strict=True))
    A, B = _exact(A, B, chain, orders)
    first = np.array([chain.index((i, 0)) for i in range(len(orders))])
    C, D = np.eye(len(A))[first], np.zeros((len(first), B.shape[1]))
    z0 = np.concatenate([xi0, x0[rows]])
    return Linear(A, B, C, D, z0, w0, z0[first], np.zeros(len(A)), states, virtual, model.outputs)


def _orders(model: Model, degrees: Mapping[str, int], labels: tuple[str, ...]) -> tuple[list[int], list[int]]:
    """Degree of each output, and the places of the internal states."""
    indices("linear_normal_form.degrees", degrees, model.outputs)
    orders = [degrees.get(n, 0) for n in model.outputs]
    if len(model.outputs) != len(model.inputs) or min(orders, default=0) < 1:
        problem = f"{len(model.outputs)} outputs, {len(model.inputs)} inputs, degrees {dict(degrees)}"
        raise InputError("linear_normal_form.degrees", problem, fix="give every output its degree, 1 or more")
    rows = indices("linear_normal_form.internal", labels, model.states)
    if sum(orders) + len(rows) != len(model.states):
        problem = f"{len(labels)} coordinates beside {sum(orders)} of the outputs, of {len(model.states)}"
        raise InputError("linear_normal_form.internal", problem, fix=f"name {len(model.states) - sum(orders)}")
    return orders, rows


def _exact(A: Any, B: Any, chain: list[tuple[int, int]], orders: list[int]) -> tuple[Any, Any]:
    """The rows of the outputs' chains as they are by definition, without rounding."""
    for row, (i, k) in enumerate(chain):
        A[row], B[row] = 0.0, 0.0
        if k + 1 < orders[i]:
            A[row, row + 1] = 1.0
        else:
            B[row, i] = 1.0
    return A, B


def _check(model: Model, x0: Any, drift: Any, f_x: Any, xi_x: Any, xi_u: Any, w_u: Any) -> None:
    around = np.linalg.norm(f_x * np.maximum(1.0, np.abs(x0)), axis=1)
    moving = [n for n, v, s in zip(model.states, drift, around, strict=True) if not abs(v) <= AT_REST * max(s, 1e-9)]
    if moving:
        text = ", ".join(f"{n}' = {drift[model.states.index(n)]:.6g}" for n in moving)
        raise InputError("linear_normal_form", f"no trim: {text}", fix="trim first")
    early = np.abs(xi_u).max(axis=1, initial=0.0) > EARLY * np.abs(xi_x).max(axis=1)
    singular = np.linalg.svd(equilibrated(w_u), compute_uv=False)
    if early.any() or not singular[-1] > 1e-10 * singular[0]:
        problem = "the inputs enter earlier" if early.any() else f"dv/du is singular, {singular[-1]:.3g}"
        raise InputError("linear_normal_form.degrees", problem, fix="take the degrees of `relative_degree`")
