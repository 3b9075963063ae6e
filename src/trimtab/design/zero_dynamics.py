"""Zeros and zero dynamics at an equilibrium, with a verdict: minimum phase, non-minimum phase, or marginal.

The results of two methods are compared: the invariant zeros of the linearisation (reduction of the scaled Rosenbrock
matrix), and the eigenvalues of the internal dynamics of the normal form. This code runs offline and uses LAPACK.

Source: [1] A. Emami-Naeini, P. Van Dooren, "Computation of zeros of linear multivariable systems", Automatica 18
(1982); [2] A. Isidori, "Nonlinear Control Systems", Springer 1995, sections 4.3, 6.1.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import eig, svd

from trimtab.core.errors import InputError
from trimtab.design.linearise import LinearModel, linearise
from trimtab.design.model import StateSpaceModel, find_indices
from trimtab.design.normal_form import normal_form
from trimtab.design.poles import balance_matrix, format_pole, participation

RANK_TOLERANCE = 1e-10
"""Largest singular value that counts as zero, as a fraction of the norm of the scaled system matrix."""
AGREE = 1e-3
"""Relative difference between invariant zeros and poles of the zero dynamics above which a warning is added."""


class Zeros(NamedTuple):
    """Invariant zeros of a linear model.

    zeros: (k,), by falling real part.  states (k, n), inputs (k, m): zero directions, i.e. motions proportional to
    exp(zero t) for which the output stays zero, scaled to a largest entry of 1.  dominant: names of the dominant states
    of each zero.  size: norm of the matrix whose eigenvalues are the zeros, as a measure of rounding errors.
    """

    zeros: Any
    states: Any
    inputs: Any
    dominant: tuple[str, ...]
    size: float


class ZeroDynamics(NamedTuple):
    """Zero dynamics at an equilibrium.

    verdict: "minimum phase", "non-minimum phase" or "marginal"; "undecided" if the linearisation has only stable zeros
    but the relative degree is not well defined.  offending_zeros: zeros with a real part above the tolerance; if there
    are no such zeros, those with a real part within the tolerance.  zeros: invariant zeros of the linearisation.
    jacobian: Jacobian of the zero dynamics (k, k); None if the relative degree is not well defined.  poles: eigenvalues
    of the Jacobian.  internals: names of the internal coordinates.  tolerance: largest real part that counts as zero
    (1/s).  why: remarks, e.g. offending zeros with their states, or the reason for a missing Jacobian.
    """

    verdict: str
    offending_zeros: Any
    zeros: Zeros
    jacobian: Any
    poles: Any
    internals: tuple[str, ...]
    tolerance: float
    why: tuple[str, ...]


def transmission_zeros(linear: LinearModel) -> Zeros:
    """Compute the invariant zeros s of (A, B, C, D), at which [[A - s I, B], [C, D]] loses its normal rank.

    For a minimal realisation these are the transmission zeros; otherwise uncontrollable and unobservable modes are
    included. The matrices are scaled first, so that the choice of units does not affect the ranks. If the transfer
    function is not square, or not of full rank, only the finite zeros are returned.

    Source: [1].
    """
    A, B, C, D, (a, b) = scale_system(linear)
    Ar, Br, Cr, Dr = _reduce_system(A, B, C, D)
    At, Ct, Bt, Dt = (M.T for M in _reduce_system(Ar.T, Cr.T, Br.T, Dr.T))
    k = len(At)
    if not k:
        zeros, size = np.zeros(0, complex), 0.0
    elif not Dt.size:
        zeros, size = np.linalg.eigvals(At), np.linalg.norm(At)
    else:
        W = svd(np.hstack([Ct, Dt]))[2].T  # basis of the states and inputs for which the outputs are zero
        W = W[:, len(Dt) :]
        M, N = np.hstack([At, Bt]) @ W, W[:k]
        zeros: Any = eig(M, N, right=False)
        size = np.linalg.norm(np.linalg.lstsq(N, M, rcond=None)[0])
    zeros = _sort_by_real_part(zeros)
    directions = [_zero_direction(A, B, C, D, s) for s in zeros]
    states = np.array([d[: len(A)] * a for d in directions]).reshape(len(zeros), len(A))
    inputs = np.array([d[len(A) :] * b for d in directions]).reshape(len(zeros), len(b))
    dominant = tuple(_dominant_states(d[: len(A)], linear.states) for d in directions)
    return Zeros(zeros, states, inputs, dominant, float(size))


def zero_dynamics(
    model: StateSpaceModel,
    x: Any = None,
    u: Any = None,
    *,
    internal: Iterable[str] | None = None,
    loose: Iterable[str] = (),
    tolerance: float | None = None,
    radius: Any = None,
) -> ZeroDynamics:
    """Check if the outputs can be held at their equilibrium values without a diverging internal state.

    Args:
        model: model with as many outputs as inputs.
        x: an equilibrium, as a vector, a record, or changes to the model's own point.
        u: input at the equilibrium, in the same forms.
        internal: names of the states that form the internal coordinates, as in `normal_form`.
        loose: states that may change at the equilibrium, because no other derivative depends on them.
        tolerance: largest real part (1/s) that counts as zero; default: estimated rounding error.
        radius: as in `relative_degree`.
    """
    linear = linearise(model, x, u)
    _check_rest(model, linear, list(loose))
    zeros = transmission_zeros(linear)
    limit = 1e-7 * max(zeros.size, np.finfo(float).tiny) if tolerance is None else tolerance
    jacobian, poles, internals, why = None, None, (), ()
    try:
        form = normal_form(model, linear.x0, linear.u0, internal=internal, radius=radius)
    except InputError as refused:
        if internal is not None and refused.part == "normal_form.internal":
            raise
        why = (f"only zeros of the linearisation were computed: {refused.problem}",)
    else:
        internals, jacobian = form.internals, form.jacobian
        poles = _sort_by_real_part(np.linalg.eigvals(jacobian))
        if len(poles) != len(zeros.zeros) or np.abs(poles - zeros.zeros).max(initial=0.0) > AGREE * zeros.size:
            why = (f"zeros {zeros.zeros} and poles of the zero dynamics {poles} differ; check the scaling",)
    names = zeros.dominant if jacobian is None or why else _dominant_coordinates(jacobian, internals, zeros)
    verdict, offending, words = _build_verdict(zeros.zeros, limit, names)
    if jacobian is None and verdict == "minimum phase":
        verdict = "undecided"
    return ZeroDynamics(verdict, offending, zeros, jacobian, poles, internals, limit, (*words, *why))


def _build_verdict(zeros: Any, limit: float, living: tuple[str, ...]) -> tuple[str, Any, tuple[str, ...]]:
    right, on = zeros.real > limit, np.abs(zeros.real) <= limit
    if right.any():
        verdict, which = "non-minimum phase", right
    elif on.any():
        verdict, which = "marginal", on
    else:
        return "minimum phase", zeros[:0], ()
    words = tuple(
        f"zero {format_pole(z)}, in {names}"
        for z, names, bad in zip(zeros, living, which, strict=True)
        if bad and z.imag >= 0
    )
    return verdict, zeros[which], words


def _check_rest(model: StateSpaceModel, linear: LinearModel, loose: list[str]) -> None:
    away = find_indices("zero_dynamics.loose", loose, model.states)
    around = np.linalg.norm(linear.A * np.maximum(1.0, np.abs(linear.x0)), axis=1)
    around = around + np.linalg.norm(linear.B * np.maximum(1.0, np.abs(linear.u0)), axis=1)
    moving = np.abs(linear.drift) > 1e-6 * np.where(around > 0, around, 1.0)
    moving[away] = False
    if moving.any():
        pairs = zip(model.states, linear.drift, moving, strict=True)
        text = ", ".join(f"{n}' = {v:.6g}" for n, v, m in pairs if m)
        raise InputError(
            "zero_dynamics",
            f"the point is not an equilibrium: {text}",
            fix="find a trim with trimtab.design.trim, or name in loose the states that may change",
        )
    depends = [model.states[i] for i in away if np.abs(np.delete(linear.A, away, axis=0)[:, i]).any()]
    if depends:
        raise InputError(
            "zero_dynamics.loose",
            f"other states depend on {', '.join(depends)}",
            fix="remove the state from loose, and trim it",
        )


def scale_system(linear: LinearModel) -> tuple[Any, Any, Any, Any, tuple[Any, Any]]:
    """Return A, B, C, D scaled to rows and columns of similar size, and the sizes of states and inputs."""
    n, m = linear.B.shape
    whole = np.block([[linear.A, linear.B], [linear.C, linear.D]])
    a, b, c = np.ones(n), np.ones(m), np.ones(len(linear.C))
    for _ in range(50):
        now = np.abs(whole) / np.concatenate([a, c])[:, None] * np.concatenate([a, b])
        off = now.copy()
        off[np.arange(n), np.arange(n)] = 0.0  # diagonal entries of A do not depend on the units of the states
        rows, columns = off.max(axis=1), off.max(axis=0)
        rows, columns = (np.where(v > 0, v, 1.0) for v in (rows, columns))
        both = (off.max(axis=1)[:n] > 0) & (off.max(axis=0)[:n] > 0)
        a = a * np.where(both, np.sqrt(rows[:n] / columns[:n]), 1.0)
        b, c = b / np.sqrt(columns[n:]), c * np.sqrt(rows[n:])
    a, b, c = (np.exp2(np.round(np.log2(v))) for v in (a, b, c))  # powers of two avoid rounding
    scaled = linear.rescale(a, b, c)
    return scaled.A, scaled.B, scaled.C, scaled.D, (a, b)


def _reduce_system(A: Any, B: Any, C: Any, D: Any) -> tuple[Any, Any, Any, Any]:
    """Return a system with the same finite zeros and D of full row rank. Source: [1] section 3, procedure REDUCE."""
    size = max(np.linalg.norm(np.block([[A, B], [C, D]]), 2), np.finfo(float).tiny)
    while len(C):
        U, s, _ = svd(D) if D.size else (np.eye(len(C)), np.zeros(0), None)
        sigma = int((s > RANK_TOLERANCE * size).sum())
        C, D = U.T @ C, U.T @ D
        C2 = C[sigma:]
        C, D = C[:sigma], D[:sigma]
        if not len(C2) or not len(A):
            break
        _, s, V = svd(C2)
        rho = int((s > RANK_TOLERANCE * size).sum())
        if not rho:
            break
        V = np.vstack([V[rho:], V[:rho]])  # unobservable states first
        A, B, C, k = V @ A @ V.T, V @ B, C @ V.T, len(A) - rho
        C, D = np.vstack([A[k:, :k], C[:, :k]]), np.vstack([B[k:], D])
        A, B = A[:k, :k], B[:k]
    return A, B, C, D


def _zero_direction(A: Any, B: Any, C: Any, D: Any, s: complex) -> Any:
    """Return state and input for which motion proportional to exp(s t) keeps the output zero; real if s is real."""
    whole: Any = np.block([[A - s * np.eye(len(A)), B], [C, D]])
    v = np.linalg.svd(whole if s.imag else whole.real)[2][-1].conj()
    return v / v[np.abs(v).argmax()]


def _dominant_coordinates(jacobian: Any, internals: tuple[str, ...], zeros: Zeros) -> tuple[str, ...]:
    """Return the names of the dominant internal coordinates of each zero, by participation."""
    balanced = balance_matrix(jacobian)
    return tuple(_dominant_states(participation(balanced, s, 1e-6 * zeros.size), internals) for s in zeros.zeros)


def _dominant_states(direction: Any, names: tuple[str, ...]) -> str:
    """Return the names of the states whose entries exceed a tenth of the largest entry, largest first."""
    size = np.abs(direction)
    return ", ".join(names[i] for i in np.argsort(-size, kind="stable") if size[i] > 0.1 * size.max(initial=0.0))


def _sort_by_real_part(values: Any) -> Any:
    """Sort complex values by falling real part. Real parts that differ only by rounding count as equal."""
    values = np.asarray(values, complex)
    parts: Any = values / (np.abs(values).max(initial=0.0) or 1.0)
    return values[np.lexsort((-np.round(np.imag(parts), 9), -np.round(np.real(parts), 9)))]
