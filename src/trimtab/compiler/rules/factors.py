"""Lowering rules for QR factors, eigenvalues, singular values, tridiagonal systems, as JAX programs like those in
`composite`."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.compiler.lower import Rule
from trimtab.compiler.rules.composite import composite, each_matrix, sorting_order
from trimtab.core.errors import InputError


def _geqrf(a: Any, **_: Any) -> Any:
    return each_matrix(_single_geqrf, 2, a)


def _single_geqrf(a: Any) -> Any:
    """Return R with the Householder vectors below its diagonal, and their factors, with the signs of LAPACK."""
    m, n = a.shape
    rows, columns = jnp.arange(m), jnp.arange(n)

    def step(j: Any, carried: Any) -> Any:
        r, factors = carried
        x = jnp.where(rows >= j, r[:, j], 0.0)
        head, rest = r[j, j], jnp.where(rows > j, r[:, j], 0.0)
        size = jnp.max(jnp.abs(x))
        scaled = x / jnp.where(size > 0, size, 1.0).astype(a.dtype)  # against underflow and overflow of squares
        beta = -jnp.copysign(size * jnp.sqrt(jnp.sum(scaled * scaled)), head)
        none = jnp.max(jnp.abs(rest)) == 0
        below = jnp.where(none, 0.0, rest / jnp.where(none, 1.0, head - beta))
        tau = jnp.where(none, 0.0, (beta - head) / jnp.where(none, 1.0, beta))
        v = jnp.where(rows == j, 1.0, below)
        turned = r - tau * v[:, None] * jnp.where(columns >= j, v @ r, 0.0)
        kept = (rows[:, None] > j) & (columns == j)
        return jnp.where(kept, below[:, None], turned).astype(a.dtype), factors.at[j].set(tau)

    k = min(m, n)
    return lax.fori_loop(0, k, step, (a, jnp.zeros(k, a.dtype)))


def _reflect(a: Any, factors: Any, c: Any, backwards: bool) -> Any:
    """Apply Householder reflections to the rows of c, from the first to the last, or backwards."""
    rows, k = jnp.arange(a.shape[0]), factors.shape[0]

    def step(i: Any, c: Any) -> Any:
        j = k - 1 - i if backwards else i
        v = jnp.where(rows == j, 1.0, jnp.where(rows > j, a[:, j], 0.0)).astype(a.dtype)
        return c - factors[j] * v[:, None] * (v @ c)

    return lax.fori_loop(0, k, step, c)


def _householder_product(a: Any, factors: Any, **_: Any) -> Any:
    return each_matrix(lambda a, t: _reflect(a, t, jnp.eye(*a.shape, dtype=a.dtype), True), 2, a, factors)


def _ormqr(a: Any, factors: Any, c: Any, *, left: bool, transpose: bool, **_: Any) -> Any:
    def single(a: Any, factors: Any, c: Any) -> Any:
        return _reflect(a, factors, c, not transpose) if left else _reflect(a, factors, c.T, transpose).T

    return each_matrix(single, 2, a, factors, c)


def _qr(a: Any, *, full_matrices: bool, **_: Any) -> Any:
    return each_matrix(lambda a: _single_qr(a, full_matrices), 2, a)


def _single_qr(a: Any, full: bool) -> Any:
    m, n = a.shape
    r, factors = _single_geqrf(a)
    k = m if full else min(m, n)
    return _reflect(r, factors, jnp.eye(m, k, dtype=a.dtype), True), jnp.triu(r[:k])


SWEEPS = 40
"""Maximum number of sweeps of rotations. The sweeps converge quadratically: up to 100 columns need fewer than ten."""


def _svd(a: Any, *, full_matrices: bool, compute_uv: bool, subset_by_index: Any, **_: Any) -> Any:
    if subset_by_index is not None and tuple(subset_by_index) != (0, min(a.shape[-2:])):
        problem = f"a subset of the singular values ({subset_by_index}) cannot be written as C"
        raise InputError("export", problem, fix="compute all singular values and select some of them")
    s, u, vt = each_matrix(lambda a: _single_svd(a, full_matrices), 2, a)
    return (s, u, vt) if compute_uv else (s,)


def _single_svd(a: Any, full: bool) -> Any:
    """Compute the SVD by Hestenes's method (1958): columns are rotated in pairs until they are orthogonal.

    A QR factorisation of the rotated columns completes the left singular vectors if some columns are zero.
    """
    m, n = a.shape
    if m < n:
        s, u, vt = _single_svd(a.T, full)
        return s, vt.T, u.T
    if m > n:
        q, r = _single_qr(a, full)
        s, u, vt = _single_svd(r[:n], False)
        return s, jnp.concatenate([q[:, :n] @ u, q[:, n:]], axis=1), vt
    tiny = jnp.asarray(jnp.finfo(a.dtype).eps, a.dtype)
    size = jnp.max(jnp.abs(a))
    size = jnp.where((size > 0) & jnp.isfinite(size), size, 1.0).astype(a.dtype)

    def rotate(p: Any, q: Any, w: Any, v: Any) -> Any:
        x, y = w[:, p], w[:, q]
        alpha, beta, gamma = jnp.sum(x * x), jnp.sum(y * y), jnp.sum(x * y)
        wanted = jnp.abs(gamma) > tiny * jnp.sqrt(alpha) * jnp.sqrt(beta)
        c, s = _rotation(alpha, beta, gamma, wanted)
        return _turn_columns(w, p, q, c, s), _turn_columns(v, p, q, c, s), wanted

    w, v = _sweep_pairs(rotate, a / size)
    lengths = jnp.sqrt(jnp.sum(w * w, axis=0))
    order = jnp.argsort(-lengths)
    q, r = _single_qr(w[:, order], False)
    signs = jnp.where(jnp.diagonal(r) < 0, -1.0, 1.0).astype(a.dtype)
    return lengths[order] * size, q * signs, v[:, order].T


def _eigh(a: Any, *, lower: bool, subset_by_index: Any, **_: Any) -> Any:
    if subset_by_index is not None and tuple(subset_by_index) != (0, a.shape[-1]):
        problem = f"a subset of the eigenvalues ({subset_by_index}) cannot be written as C"
        raise InputError("export", problem, fix="compute all eigenvalues and select some of them")
    return each_matrix(lambda a: _single_eigh(a, lower), 2, a)


def _single_eigh(a: Any, lower: bool) -> Any:
    """Return eigenvectors in columns, and sorted eigenvalues, by Jacobi rotations."""
    half = jnp.tril(a) if lower else jnp.triu(a)
    a = half + (jnp.tril(a, -1).T if lower else jnp.triu(a, 1).T)
    tiny = jnp.max(jnp.abs(a)) * float(jnp.finfo(a.dtype).eps) ** 2

    def rotate(p: Any, q: Any, a: Any, v: Any) -> Any:
        wanted = jnp.abs(a[p, q]) > tiny
        c, s = _rotation(a[p, p], a[q, q], a[p, q], wanted)
        a = _turn_columns(_turn_columns(a, p, q, c, s).T, p, q, c, s)
        off = jnp.where(wanted, 0.0, a[p, q]).astype(a.dtype)
        return a.at[p, q].set(off).at[q, p].set(off), _turn_columns(v, p, q, c, s), wanted

    turned, vectors = _sweep_pairs(rotate, a)
    values = jnp.diagonal(turned)
    order = sorting_order((values,), reverse=False)
    return vectors[:, order], values[order]


def _sweep_pairs(rotate: Callable[..., Any], a: Any) -> Any:
    """Apply rotate(p, q, matrix, vectors) to all pairs of columns, until no rotation is needed."""
    n, v = a.shape[1], jnp.eye(a.shape[1], dtype=a.dtype)
    if n < 2:
        return a, v
    first, second = (jnp.asarray(i, jnp.int32) for i in np.triu_indices(n, 1))

    def one(k: Any, carried: Any) -> Any:
        a, v, some = carried
        a, v, wanted = rotate(first[k], second[k], a, v)
        return a, v, some | wanted

    def sweep(carried: Any) -> Any:
        return *lax.fori_loop(0, len(first), one, (*carried[:2], jnp.bool_(False))), carried[3] + 1

    start = a, v, jnp.bool_(True), jnp.int32(0)
    return lax.while_loop(lambda x: x[2] & (x[3] < SWEEPS), sweep, start)[:2]


def _rotation(alpha: Any, beta: Any, gamma: Any, wanted: Any) -> Any:
    """Return cosine and sine of the rotation that diagonalises [alpha, gamma; gamma, beta], or 1 and 0 if `wanted` is
    false."""
    zeta = (beta - alpha) / (2 * jnp.where(wanted, gamma, 1.0))
    t = jnp.where(zeta < 0, -1.0, 1.0) / (jnp.abs(zeta) + jnp.sqrt(1 + zeta * zeta))
    c = jnp.where(wanted, 1 / jnp.sqrt(1 + t * t), 1.0).astype(alpha.dtype)
    return c, (c * jnp.where(wanted, t, 0.0)).astype(alpha.dtype)


def _turn_columns(a: Any, p: Any, q: Any, c: Any, s: Any) -> Any:
    x, y = a[:, p], a[:, q]
    return a.at[:, p].set(c * x - s * y).at[:, q].set(s * x + c * y)


def _tridiagonal_solve(dl: Any, d: Any, du: Any, b: Any, *, perturb_singular: bool, **_: Any) -> Any:
    if perturb_singular:
        raise InputError(
            "export",
            "tridiagonal_solve(perturb_singular=True) cannot be written as C",
            fix="leave out perturb_singular",
        )
    flat = [dl[..., None], d[..., None], du[..., None], b]
    return each_matrix(lambda x, y, z, b: _single_tridiagonal(x[:, 0], y[:, 0], z[:, 0], b), 2, *flat)


def _single_tridiagonal(dl: Any, d: Any, du: Any, b: Any) -> Any:
    """Solve a tridiagonal system by Gaussian elimination with exchange of neighbouring rows, as in LAPACK."""
    zero = jnp.zeros((), d.dtype)

    def eliminate(row: Any, below: Any) -> Any:
        pivot, right, far, value = row
        lower, middle, upper, other = below
        swap = jnp.abs(lower) > jnp.abs(pivot)
        kept = [jnp.where(swap, x, y) for x, y in ((lower, pivot), (middle, right), (upper, far), (other, value))]
        less = [jnp.where(swap, y, x) for x, y in ((middle, right), (upper, far), (other, value))]
        factor = jnp.where(swap, pivot, lower) / kept[0]
        middle, upper, other = (x - factor * y for x, y in zip(less, kept[1:], strict=True))
        return (middle, upper, zero, other), tuple(kept)

    last, rows = lax.scan(eliminate, (d[0], du[0], zero, b[0]), (dl[1:], d[1:], du[1:].at[-1:].set(0.0), b[1:]))

    def substitute(known: Any, row: Any) -> Any:
        first, second = known
        pivot, right, far, value = row
        x = (value - right * first - far * second) / pivot
        return (x, first), x

    end = last[3] / last[0]
    _, found = lax.scan(substitute, (end, jnp.zeros_like(end)), rows, reverse=True)
    return jnp.concatenate([found, end[None]])


RULES: dict[str, Rule] = {
    "eigh": composite(_eigh),
    "geqrf": composite(_geqrf),
    "householder_product": composite(_householder_product),
    "ormqr": composite(_ormqr),
    "qr": composite(_qr),
    "svd": composite(_svd),
    "tridiagonal_solve": composite(_tridiagonal_solve),
}
