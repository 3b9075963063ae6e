"""Cases of singular values, reflections, three diagonals, special functions, and what equinox raises."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.lax.linalg import ormqr
from jax.scipy import special

from contracts.compiled import Case

rng = np.random.default_rng(15)


def reflections():
    # One use in each program: LAPACK's dorm2r writes ones into what it reads and puts it right again after, while XLA
    # runs beside it what doesn't depend on it.
    uses = {
        "product": lambda packed, factors, c: lax.linalg.householder_product(packed, factors),
        "turned": ormqr,
        "turned back": functools.partial(ormqr, transpose=True),
        "from the right": lambda packed, factors, c: ormqr(packed, factors, c.T, left=False),
        "from the right, back": lambda packed, factors, c: ormqr(packed, factors, c.T, left=False, transpose=True),
    }

    def pieces(use):
        def factor_and_use(a):
            packed, factors = jnp.linalg.qr(a, mode="raw")
            packed = packed.T
            c = jnp.arange(12.0).reshape(4, 3) if a.shape[0] == 4 else jnp.ones((a.shape[0], 2))
            return packed, factors, use(packed, factors, c)

        return factor_and_use

    def bands(dl, d, du, b):
        return lax.linalg.tridiagonal_solve(dl, d, du, b)

    def banded(n, columns):
        dl, d, du = rng.normal(size=(3, n))
        d += 4
        dl[0] = du[-1] = d[n // 2] = 0  # rows are exchanged
        return dl, d, du, rng.normal(size=(n, columns))

    square = rng.normal(size=(4, 4)) + 2 * np.eye(4), np.eye(4), np.zeros((4, 4))
    return [
        *(Case(f"reflections, {name}", pieces(use), [(a,) for a in square], close=1e-12) for name, use in uses.items()),
        *(
            Case(f"tall, {name}", pieces(use), [(rng.normal(size=(6, 3)),) for _ in range(3)], close=1e-12)
            for name, use in uses.items()
        ),
        *(
            Case(
                f"far scales, {name}",
                lambda a, use=uses[name]: pieces(use)(a)[1:],
                [(rng.normal(size=(4, 4)) * [1e-200, 1.0, 1e200, 1e-5],) for _ in range(3)],
                close=1e-11,
            )
            for name in ("product", "turned", "turned back")
        ),
        Case("bands", bands, [banded(7, 2) for _ in range(3)], close=1e-12),
        Case("two bands", jax.vmap(bands), [tuple(np.stack([x] * 2) for x in banded(60, 1))] * 3, close=1e-12),
        Case(
            "one equation", bands, [(np.zeros(1), np.full(1, k), np.zeros(1), np.ones((1, 3))) for k in (2.0, 3.0, 4.0)]
        ),
    ]


def singular():
    tall, wide = rng.normal(size=(5, 3)), rng.normal(size=(3, 5))
    rank = np.outer(np.arange(5.0), np.arange(3.0)) + np.outer(np.ones(5), [0.0, 1.0, -1.0])

    def without_signs(a):
        u, s, vt = jnp.linalg.svd(a, full_matrices=False)
        return s, (u * s) @ vt, u.T @ u, vt @ vt.T

    def full(a):
        u, s, vt = jnp.linalg.svd(a)
        m, n = a.shape
        whole = jnp.zeros((m, n), a.dtype).at[jnp.arange(min(m, n)), jnp.arange(min(m, n))].set(s)
        return u @ whole @ vt, u @ u.T, vt.T @ vt

    def values(a):
        return jnp.linalg.svd(a, compute_uv=False)

    return [
        Case("svd", without_signs, [(tall,), (1e-200 * tall,), (1e200 * tall,)], close=1e-13),
        Case("lower rank", without_signs, [(rank,), (np.zeros((5, 3)),), (np.eye(5, 3),)], close=1e-13),
        Case("wide", without_signs, [(wide,), (-wide,), (rank.T.copy(),)], close=1e-13),
        Case("full", full, [(tall,), (rank,), (np.zeros((5, 3)),)], close=1e-13),
        Case("values", jax.vmap(values), [(rng.normal(size=(2, 6, 6)),) for _ in range(3)], close=1e-13),
        Case(
            "one column",
            without_signs,
            [(tall[:, :1].copy(),), (np.zeros((5, 1)),), (rank[:, 1:2].copy(),)],
            close=1e-13,
        ),
        Case("single precision", values, [(x.astype(np.float32),) for x in (tall, rank, np.eye(5, 3))], close=1e-6),
        Case("pinv", jnp.linalg.pinv, [(tall,), (rank,), (-tall,)], close=1e-12),
    ]


def families():
    x = np.concatenate([[0.0, -0.0, 1e-300, 1e-8, 0.3, 1.0, 1.5, 7.99, 8.0, 8.01, 30.0, 400.0, np.inf, np.nan, -2.0]])
    x = np.tile(np.concatenate([x, np.linspace(0.1, 20, 45)]), 1)
    a = np.resize([0.5, 2.5, 10.0, 300.0, 1e-3, 1.0, 4.0], len(x))
    part = np.clip(np.nan_to_num(x, posinf=3.0) / 20, 0, 1)
    order = np.resize([0.0, 1.0, 2.0, 5.0], len(x))
    positive = np.where(np.isfinite(x) & (x > 0.05), x, 0.7)
    return [
        Case("gamma", lambda a, x: (special.gammainc(a, x), special.gammaincc(a, x)), [(a, x)] * 3, close=1e-13),
        Case("beta", lambda a, x: special.betainc(a, 1.5, x), [(a, part)] * 3, close=1e-13),
        Case("bessel", lambda x: (special.i0e(x), special.i1e(x), special.i1e(-x)), [(x,)] * 3, close=1e-14),
        Case("bessel single", special.i1e, [(x.astype(np.float32),)] * 3, close=1e-6),
        Case("zeta", lambda x, s: special.zeta(s + 1.1, x), [(positive, order)] * 3, close=1e-13),
        Case(
            "zeta's edges",
            special.zeta,
            [(np.array([3.0, 3.0, 2.5, 1.0, 0.5, 2.0]), np.array([-2.0, 0.0, -0.5, 2.0, 1.0, 1.0]))] * 3,
            close=1e-13,
        ),
        Case("polygamma", lambda n, x: special.polygamma(n, x), [(order.astype(int), positive)] * 3, close=1e-13),
        Case(
            "slope in a",
            jax.grad(lambda a, x: special.gammainc(a, x).sum()),
            [(a[20:40], positive[20:40])] * 3,
            close=1e-12,
        ),
        Case(
            "slope of a sample",
            lambda a, x: lax.random_gamma_grad(a, x),
            [(a[20:40], positive[20:40])] * 3,
            close=1e-11,
        ),
        Case(
            "gamma's samples",
            lambda seed, a: jax.random.gamma(jax.random.key(seed), a, (4,)),
            [(k, 0.4 + k) for k in range(3)],
            close=1e-13,
            lanes=False,
        ),
    ]


def raised():
    def error(*_):
        raise RuntimeError

    error.__module__ = "equinox._errors"

    def checked(x):
        def raising(x):
            like = jax.ShapeDtypeStruct(x.shape, x.dtype)
            return jax.pure_callback(error, like, x), jax.pure_callback(error, jax.ShapeDtypeStruct((), int), x)

        return lax.cond(x[0] > 100, raising, lambda x: (x, 3), x)

    return [Case("raised", checked, [(np.arange(3.0) + k,) for k in range(3)])]
