"""Two necessary conditions for a smooth state feedback that stabilises an equilibrium, checked numerically.

A system that violates a condition is not stabilisable by such a feedback. A system that satisfies both conditions may
still not be stabilisable. This code runs offline and uses automatic derivatives, LAPACK and scipy.

Source: [2] C. I. Byrnes, A. Isidori, "On the attitude stabilization of rigid spacecraft", Automatica 27 (1991);
[3] R. W. Brockett, "Asymptotic stability and feedback stabilization", in Differential Geometric Control Theory,
Birkhäuser 1983; as used in [1] Z. Kulis, University of Maryland, 2006, section 2.3.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

from trimtab.design.model import StateSpaceModel

jax.config.update("jax_enable_x64", True)

RANK_TOLERANCE = 1e-9
"""Largest singular value that counts as zero, as a fraction of the matrix's largest singular value."""


class ByrnesIsidori(NamedTuple):
    """Result of the test of Byrnes and Isidori (`byrnes_isidori`).

    h1: True if f2 = 0 only at x1 = 0 near the origin.  h2: True if df2/dx1 has full column rank n1 at the origin.
    rank_f2: rank of df2/dx1.  rank_inputs: number of independent inputs m'.  n1: size of x1.
    is_excluded: True if no continuously differentiable feedback can stabilise the origin; if False, the question stays
    open.
    """

    h1: bool
    h2: bool
    rank_f2: int
    rank_inputs: int
    n1: int
    is_excluded: bool


class Brockett(NamedTuple):
    """Result of the test of Brockett's conditions (`brockett`).

    uncontrollable_unstable: uncontrollable eigenvalues with positive real part; if the list is not empty, condition (i)
        is violated.
    controllability_rank: rank of the linearisation's controllability matrix; n if the linearisation is controllable.
    is_onto: True if f reaches every tried right-hand side (condition (iii)).
    missed_targets: (k, n) right-hand sides that f does not reach.
    is_excluded: True if no continuously differentiable feedback can stabilise the origin; if False, the question stays
        open.
    """

    uncontrollable_unstable: tuple[complex, ...]
    controllability_rank: int
    is_onto: bool
    missed_targets: Any
    is_excluded: bool


def numerical_rank(A: Any) -> int:
    """Return the number of singular values of a matrix (n, m) that exceed RANK_TOLERANCE times the largest."""
    s = np.linalg.svd(np.asarray(A), compute_uv=False)
    return int((s > RANK_TOLERANCE * max(s.max(initial=0.0), np.finfo(float).tiny)).sum())


def byrnes_isidori(
    f1: Callable[[Any, Any], Any],
    f2: Callable[[Any, Any], Any],
    n1: int,
    n2: int,
    m: int,
    *,
    radius: float = 0.5,
    samples: int = 50,
) -> ByrnesIsidori:
    """Check x1' = f1(x1, u) = a(x1) + B u, x2' = f2(x1, x2) at the origin, where f1(0, 0) = 0 and f2(0, x2) = 0.

    If H1 (f2 = 0 only at x1 = 0) and H2 (df2/dx1 has rank n1) are true and there are fewer than n1 independent inputs,
    no continuously differentiable feedback stabilises the origin. The reason: with an asymptotically stable origin, the
    right-hand side would have to reach (b, 0) for every small b. f2 = 0 implies x1 = 0, so that B u = b would have to
    be solvable for every b.

    Args:
        f1: (x1 (n1,), u (m,)) -> (n1,), traceable by jax.
        f2: (x1 (n1,), x2 (n2,)) -> (n2,), traceable by jax.
        n1: size of x1.
        n2: size of x2.
        m: size of u.
        radius: distance from the origin within which H1 is sampled.
        samples: number of points x2 at which f2(0, x2) = 0 and the rank of df2/dx1 are tested. By the implicit function
            theorem, H1 follows near these points.

    Source: [2], as stated in [1] section 2.3.
    """
    x1, x2, u = jnp.zeros(n1), jnp.zeros(n2), jnp.zeros(m)
    slope = jax.jit(jax.jacfwd(f2))
    rank_f2 = numerical_rank(slope(x1, x2))
    rank_inputs = numerical_rank(jax.jacfwd(f1, argnums=1)(x1, u))
    points = np.random.default_rng(0).uniform(-radius, radius, (samples, n2))
    rests = not np.any(np.abs(f1(x1, u)) > RANK_TOLERANCE)
    h1 = all(np.abs(f2(x1, p)).max() <= RANK_TOLERANCE and numerical_rank(slope(x1, p)) == n1 for p in points)
    h2 = rank_f2 == n1
    return ByrnesIsidori(h1, h2, rank_f2, rank_inputs, n1, bool(rests and h1 and h2 and rank_inputs < n1))


@lru_cache(maxsize=8)
def _compile_function(f: Callable[[Any, Any], Any], n: int) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """Return f as a compiled function of the stacked (x, u), and its compiled derivative."""

    def stack_arguments(z: Any) -> Any:
        return f(z[:n], z[n:])

    return jax.jit(stack_arguments), jax.jit(jax.jacfwd(stack_arguments))


def is_reachable(
    f: Callable[[Any, Any], Any], b: Any, m: int, *, radius: float = 1.0, starts: int = 8, tolerance: float = 1e-9
) -> bool:
    """Return True if f(x, u) = b has a solution with every |x_i|, |u_i| < radius.

    The solution is searched by least squares from several starts. b counts as reached if the residual is below
    tolerance * |b|.

    Args:
        f: (x (n,), u (m,)) -> (n,), traceable by jax.
        b: right-hand side (n,), not zero.
        m: size of u.
        radius: half the side of the box in which solutions are searched. Far from the origin, even a nearly singular
            system reaches almost every b.
        starts: number of starting points of the search; the first is near the origin.
        tolerance: relative residual that counts as zero.
    """
    b = np.asarray(b, float)
    n = b.size
    value, slope = _compile_function(f, n)
    draws = np.random.default_rng(1)
    for i in range(starts):
        z = draws.uniform(-0.9, 0.9, n + m) * radius * (0.01 if i == 0 else 1.0)
        nearest = least_squares(
            lambda z: np.asarray(value(z)) - b,
            z,
            jac=lambda z: np.asarray(slope(z)),  # pyright: ignore[reportArgumentType]
            bounds=(-radius, radius),
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
        )
        if np.linalg.norm(nearest.fun) <= tolerance * np.linalg.norm(b):
            return True
    return False


def controllability_rank(A: Any, B: Any) -> int:
    """Return the rank of [B, A B, ..., A^(n-1) B] for A (n, n), B (n, m). Source: Kalman's rank condition.

    Directions are added one by one, and each is made orthogonal to the earlier directions. Powers of A would lose weak
    directions to rounding.
    """
    A, pending = np.asarray(A, float), list(np.asarray(B, float).T)
    basis = np.zeros((0, len(A)))
    while pending:
        vector = pending.pop(0)
        left = vector
        for _ in range(2):  # twice, because the first pass leaves rounding errors
            left = left - basis.T @ (basis @ left)
        size = np.linalg.norm(left)
        if size > RANK_TOLERANCE * np.linalg.norm(vector):
            basis = np.vstack([basis, left / size])
            pending.append(A @ (left / size))
    return len(basis)


def uncontrollable_eigenvalues(A: Any, B: Any) -> tuple[complex, ...]:
    """Return the eigenvalues s of A that are uncontrollable by B: rank [s I - A, B] < n.

    Source: Popov, Belevitch, Hautus.
    """
    A, B = np.asarray(A), np.asarray(B)
    n = len(A)
    return tuple(complex(s) for s in np.linalg.eigvals(A) if numerical_rank(np.hstack([s * np.eye(n) - A, B])) < n)


def brockett(
    f: Callable[[Any, Any], Any], n: int, m: int, *, size: float = 1e-3, radius: float = 1.0, samples: int = 8
) -> Brockett:
    """Check Brockett's conditions (i) and (iii) for x' = f(x, u) at the origin, an equilibrium.

    (i) The linearisation has no uncontrollable eigenvalue with positive real part. (ii) For every nearby state, some
    input drives the state to the origin. (iii) (x, u) -> f(x, u) reaches every small right-hand side. Condition (ii) is
    not checked. Condition (iii) is true if df/d(x, u) has rank n. Otherwise right-hand sides outside the range of
    df/d(x, u), and random right-hand sides, are tried.

    Args:
        f: (x (n,), u (m,)) -> (n,), traceable by jax.
        n: size of x.
        m: size of u.
        size: length of the tried right-hand sides.
        radius: half the side of the box in which solutions are searched.
        samples: number of random right-hand sides.

    Source: [3] theorem 1.
    """
    A, B = (np.asarray(d) for d in jax.jacfwd(f, argnums=(0, 1))(jnp.zeros(n), jnp.zeros(m)))
    unstable = tuple(s for s in uncontrollable_eigenvalues(A, B) if s.real > RANK_TOLERANCE)
    slope = np.hstack([A, B])
    left = np.linalg.svd(slope)[0][:, numerical_rank(slope) :]
    missed = np.zeros((0, n))
    if left.size:
        random = np.random.default_rng(2).standard_normal((samples, n))
        tried = np.vstack([left.T, -left.T, random / np.linalg.norm(random, axis=1, keepdims=True)]) * size
        missed = np.array([b for b in tried if not is_reachable(f, b, m, radius=radius)]).reshape(-1, n)
    onto = not len(missed)
    return Brockett(unstable, controllability_rank(A, B), onto, missed, bool(unstable) or not onto)


class Cascade(NamedTuple):
    """Cascade x1' = a(x1) + B u, x2' = f2(x1, x2) of a model. x1, x2: indices of the states in each part."""

    x1: tuple[int, ...]
    x2: tuple[int, ...]


class SmoothFeedback(NamedTuple):
    """Result of both tests of smooth stabilisability (`smooth_feedback`).

    brockett: test of the whole model.  cascade: the model as a cascade; None if it is not a cascade.  byrnes_isidori:
    test of the cascade; None if the model is not a cascade.  is_excluded: True if one of the two tests shows that no
    continuously differentiable feedback stabilises the equilibrium; if False, the question stays open.
    """

    brockett: Brockett
    byrnes_isidori: ByrnesIsidori | None
    cascade: Cascade | None
    is_excluded: bool


def find_cascade(model: StateSpaceModel, *, samples: int = 20) -> Cascade | None:
    """Find the cascade of a model: the smallest set x1 of states that contains all states driven by inputs, and whose
    derivatives depend only on x1 and u.

    The decision uses derivatives at sampled points around the model's own point. The result is None if x1 contains all
    states, or if the inputs enter x1 with varying coefficients.
    """
    draws = np.random.default_rng(4)
    x0, u0 = model.point()
    size = [np.maximum(1.0, np.abs(v)) for v in (x0, u0)]
    points = [v + s * draws.uniform(-0.5, 0.5, (samples, len(v))) for v, s in zip((x0, u0), size, strict=True)]
    A, B = (np.asarray(d) for d in jax.jit(jax.vmap(jax.jacfwd(model.f, argnums=(0, 1))))(*points))
    largest = max(np.abs(A).max(), np.abs(B).max())
    depends, enters = (np.abs(M).max(axis=0) > RANK_TOLERANCE * largest for M in (A, B))
    inner = enters.any(axis=1)
    while (depends[inner].any(axis=0) & ~inner).any():
        inner = inner | depends[inner].any(axis=0)
    if inner.all() or not inner.any() or np.ptp(B[:, inner], axis=0).max() > RANK_TOLERANCE * largest:
        return None
    x1, x2 = (tuple(np.flatnonzero(chosen).tolist()) for chosen in (inner, ~inner))
    return Cascade(x1, x2)


def smooth_feedback(model: StateSpaceModel) -> SmoothFeedback:
    """Test if a smooth feedback can stabilise a model at its own point, which must be an equilibrium.

    The conditions are those of Brockett, and those of Byrnes and Isidori.

    States and inputs are scaled by their size at the point, if it is not zero.
    """
    x0, u0 = model.point()
    n, m = len(x0), len(u0)
    a, b = (np.where(v != 0, np.abs(v), 1.0) for v in (x0, u0))

    def scale_rates(z: Any, w: Any) -> Any:
        return (model.f(x0 + a * z, u0 + b * w) - model.f(jnp.asarray(x0), jnp.asarray(u0))) / a

    image, cascade = brockett(scale_rates, n, m), find_cascade(model)
    if cascade is None:
        return SmoothFeedback(image, None, None, image.is_excluded)
    x1, x2 = (jnp.array(places) for places in cascade)
    zero = jnp.zeros(n)
    ranks = byrnes_isidori(
        lambda y, w: scale_rates(zero.at[x1].set(y), w)[x1],
        lambda y, z: scale_rates(zero.at[x1].set(y).at[x2].set(z), jnp.zeros(m))[x2],
        len(x1),
        len(x2),
        m,
    )
    return SmoothFeedback(image, ranks, cascade, image.is_excluded or ranks.is_excluded)
