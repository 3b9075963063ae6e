"""Cases of primitives that move, reduce, read and write arrays: small ones unrolled, large ones in loops."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax import lax
from jax import numpy as jnp
from jax.extend.core.primitives import empty2_p

from contracts.compiled import LANES, Case

SMALL, LARGE = 3, 7
"""Edges of square arrays: 9 elements are unrolled, 49 are not."""


def quarters(rng: np.random.Generator, *shape: int) -> Any:
    """Floats whose sums and products are exact in any order."""
    return rng.integers(-9, 10, shape) / 4


def sets(make: Callable[..., Any], count: int = LANES, seed: int = 3) -> list[tuple[Any, ...]]:
    """Arguments for each lane."""
    return [make(np.random.default_rng([seed, i])) for i in range(count)]


def _square(name: str, function: Callable[..., Any], **how: Any) -> list[Case]:
    """function(x, k): x square of floats, k an integer that lies in or out of range."""
    return [
        Case(
            f"{name}, {n} x {n}",
            function,
            sets(lambda r, n=n: (quarters(r, n, n), np.int64(r.integers(-n - 2, n + 3)))),
            **how,
        )
        for n in (SMALL, LARGE)
    ]


def moves() -> list[Case]:
    """Shapes, order, parts."""

    def shapes(x: Any, k: Any) -> Any:
        n = x.shape[0]
        return (
            [x.reshape(-1), x.reshape(n, 1, n).squeeze(1), x[None], x.T, jnp.transpose(x[None], (2, 0, 1)), x[:, ::-1]],
            [jnp.broadcast_to(x[0], (3, n)), jnp.broadcast_to(k, (2, n)), jnp.broadcast_to(x[:, :1], (n, n))],
            [x[1:3, 2:], x[::2, 1::3], x[::-2], x[n:], x[1:2, 1:2], jnp.tile(x, (2, 1)), jnp.tile(x[0], 3)],
            [jnp.tile(x[:1], (1, 2, 2)), jnp.repeat(x[0], 2), jnp.roll(x, 2, 1), jnp.flip(x)],
        )

    def parts(x: Any, k: Any) -> Any:
        n = x.shape[0]
        return (
            [jnp.concatenate([x, x[:1] * 2, x[n:]], 0), jnp.concatenate([x[:, :1], x], 1), jnp.stack([x, -x], 1)],
            [jnp.stack([x[0, 0], x[1, 1]]), lax.split(x, (1, n - 1), 1), jnp.unstack(x, axis=1), list(x[0])],
            [jnp.pad(x, 1), jnp.pad(x, ((0, 2), (1, 0)), constant_values=7.0), jnp.pad(x, 2, mode="edge")],
            [lax.pad(x, 0.5, ((-1, 2, 1), (1, -2, 0))), lax.pad(x, k * 1.0, ((0, 0, 2), (-1, -1, 0)))],
            [lax.iota(np.int32, n), lax.broadcasted_iota(np.float64, (n, n), 1), jnp.arange(n) + k],
            [jnp.zeros((0, 3)), jnp.concatenate([x[n:], x[n:]]), x[n:].T, jnp.where(x > 0, x, -x), jnp.eye(n) * x],
        )

    return _square("shapes", shapes) + _square("parts", parts)


def reductions() -> list[Case]:
    """Sums, extremes, positions, along axes and running, with NaN and ties among the numbers; products of matrices."""
    found = []
    for t in ("float64", "int32", "int64", "uint32"):
        found += [_reduced(f"reduced {t}, {n}", n, t) for n in (SMALL, LARGE)]
    found.append(_reduced("reduced int8", LARGE, "int8"))

    def of_truth(x: Any) -> Any:
        total = (jnp.all(x), jnp.any(x, 0), jnp.sum(x, 1), lax.reduce_xor(x, (0,)), jnp.argmax(x, 1), jnp.max(x, 0))
        return (*total, jnp.min(x), jnp.argmin(x, 0))

    for n in (SMALL, LARGE):
        found.append(Case(f"truth {n}", of_truth, sets(lambda r, n=n: (r.random((n, n)) < 0.6,))))

    def with_nan(x: Any) -> Any:
        extremes = [jnp.max(x, 1), jnp.min(x), jnp.argmax(x, 1), jnp.argmin(x, 0), jnp.argmax(x.ravel())]
        return extremes, lax.cummax(x, 1), lax.cummin(x, 0, reverse=True), jnp.sum(x, 0), jnp.cumsum(x, 1)

    def odd(r: np.random.Generator, n: int) -> Any:
        return (np.where(r.random((n, n)) < 0.15, r.choice([np.nan, np.inf, -np.inf], (n, n)), quarters(r, n, n)),)

    found += [Case(f"NaN {n}", with_nan, sets(lambda r, n=n: odd(r, n))) for n in (SMALL, LARGE)]
    found += [_products(n) for n in (SMALL, LARGE)]

    def empty(x: Any) -> Any:
        none = x[:, :0]
        return none.sum(), none.sum(1), none.prod(1), jnp.max(none, 1, initial=-2.0), none @ none.T, none.T @ x[:2].T

    def memory(x: Any) -> Any:
        """Memory that JAX's scans begin with: zeros on CPUs. Programs of JAX 0.10.2 have it, those of 0.10.1 do not."""
        return x + empty2_p.bind(dtype=x.dtype, memory_space=jax.typeof(x).memory_space)

    square = sets(lambda r: (quarters(r, 2, 2),))
    return [*found, Case("empty", empty, square), Case("memory", memory, square)]


def _reduced(name: str, n: int, t: str) -> Case:
    def reduced(x: Any) -> Any:
        found = [jnp.sum(x), jnp.sum(x, 0), jnp.prod(x[:3, :2], 1), jnp.max(x, 1), jnp.min(x), jnp.argmax(x, 1)]
        found += [jnp.argmin(x, 0), jnp.argmax(x.ravel()), lax.argmax(x, 0, np.int32), jnp.cumsum(x, 1), jnp.cumsum(x)]
        found += [lax.cumsum(x, 0, reverse=True), jnp.cumprod(x[:3, :2], 0), lax.cummax(x, 1), lax.cummin(x, 0)]
        if x.dtype.kind != "f":
            found += [
                lax.reduce_and(x, (1,)),
                lax.reduce_or(x, (0,)),
                lax.reduce_xor(x, (0, 1)),
                jnp.bitwise_or.reduce(x),
            ]
        return found

    def make(r: np.random.Generator) -> Any:
        return (
            (quarters(r, n, n) if t == "float64" else r.integers(0, 120, (n, n)) - (60 if t[0] == "i" else 0)).astype(
                t
            ),
        )

    return Case(name, reduced, sets(make), lanes=t != "int8")


def _products(n: int) -> Case:
    def products(a: Any, b: Any, v: Any, i: Any) -> Any:
        batched = jnp.stack([a, b])
        found = [a @ b, a @ v, v @ a, v @ v, a.T @ b, jnp.outer(v, v), jnp.einsum("ij,ij->i", a, b)]
        found += [jnp.einsum("bij,bkj->bik", batched, batched[::-1]), jnp.einsum("bij,j->bi", batched, v)]
        found += [
            lax.dot_general(a, b, (((0,), (1,)), ((), ()))),
            lax.dot_general(batched, batched, (((1, 2), (1, 2)), ((0,), (0,)))),
        ]
        return [*found, i @ i, lax.dot(i, i, preferred_element_type=np.int64), jnp.kron(a[:2, :2], b[:2, :2])]

    def make(r: np.random.Generator) -> Any:
        return *quarters(r, 2, n, n), quarters(r, n), r.integers(-(2**30), 2**30, (n, n)).astype(np.int32)

    return Case(f"products {n}", products, sets(make))


def indexed() -> list[Case]:
    """Reading and writing at computed indices, in range and out of it."""

    def slices(x: Any, k: Any) -> Any:
        row = lax.dynamic_slice(x, (k, k - 1), (2, 3))
        narrow = lax.dynamic_slice(x, (k.astype(np.int32), k.astype(np.int32) + 1), (1, 2))
        updated = lax.dynamic_update_slice(x, x[:2, :2] * 4, (k, 1))
        whole = lax.dynamic_update_slice(x, x.T, (k, k))
        return row, narrow, updated, whole, lax.dynamic_update_slice(x[0], x[1, :1], (k,)), x[k], x[:, k], x[k, k + 1]

    found = _square("dynamic slices", slices)
    for mode, sizes in (("clip", (SMALL,)), ("fill", (LARGE,)), ("promise_in_bounds", (SMALL,))):
        found += [_gathers(n, mode) for n in sizes]
        found += [_scatters(n, mode) for n in sizes]

    def long(table: Any, k: Any) -> Any:
        return lax.dynamic_slice(table, (k,), (2,)), table[k.astype(np.uint8)], table.at[k].get(mode="clip")

    found.append(
        Case("300 by int8", long, sets(lambda r: (quarters(r, 300), np.int8(r.integers(-128, 128)))), lanes=False)
    )
    return found + _tables()


def _indices(r: np.random.Generator, n: int, mode: str) -> Any:
    wide = 0 if mode == "promise_in_bounds" else n + 3
    return quarters(r, n, n), r.integers(-wide, n + wide, 6), r.integers(0, n + wide, 3).astype(np.uint32)


def _gathers(n: int, mode: str) -> Case:
    def gathers(x: Any, i: Any, u: Any) -> Any:
        at = {"mode": mode}
        found = [x.at[i].get(**at), x.at[:, i].get(**at), x.at[i, i[::-1]].get(**at), x.at[u, 1:].get(**at)]
        found += [x.at[jnp.array([0, 2]), 1].get(**at), x.at[i[:2, None], i[None, :2]].get(**at)]
        found += [jax.vmap(lambda a, j: a.at[j].get(**at))(x[:3], i[:3]), x.at[i[0], :2].get(**at)]
        whole = (x * 4).astype(np.int64)
        found += [whole.at[i].get(**at), whole.astype(np.uint32).at[i].get(**at), (x > 0).at[i].get(**at)]
        return [*found, x.at[i].get(mode=mode, fill_value=-1.0), jnp.take(x, i, axis=1, mode="clip")]

    return Case(f"gather {mode} {n}", gathers, sets(lambda r: _indices(r, n, mode)))


def _scatters(n: int, mode: str) -> Case:
    def scatters(x: Any, i: Any, u: Any) -> Any:
        at, row = {"mode": mode}, x[0]
        # where an index comes twice, the last write to it is the one that stays only by chance: values are equal
        found = [x.at[i].set(2.5, **at), x.at[:, i].add(x[:, :1], **at), x.at[i, i[::-1]].max(0.25, **at)]
        found += [
            row.at[i].add(1.5, **at),
            row.at[u].multiply(2.0, **at),
            x.at[i].min(row, **at),
            x.at[1:3, u].set(7.0, **at),
        ]
        found += [row.at[i[0]].set(5.0, **at), row.at[1].set(x[1, 1]), x.at[0, 1].add(x[1, 0]), x.at[:, 2].set(x[0])]
        found += [jax.vmap(lambda a, j: a.at[j].add(1.25, **at))(x[:3], i[:3]), row.at[i].subtract(0.25, **at)]
        found += [
            row.at[i[:1]].apply(lambda y: y * 3 + 1, **at),
            row.at[2].apply(jnp.abs),
            x.at[i[0], :2].set(9.0, **at),
        ]
        found += [row.at[1].divide(4.0), row.at[i[0]].power(2, **at)]
        whole = (x * 4).astype(np.int32)
        return [*found, whole.at[i].add(3, **at), whole.at[i, 0].mul(3, **at), (x > 0).at[i].set(True, **at)]

    return Case(f"scatter {mode} {n}", scatters, sets(lambda r: _indices(r, n, mode)))


def _tables() -> list[Case]:
    """Tables of constants, and the look-ups of jax.numpy."""
    table = np.arange(60.0) ** 2

    def tables(x: Any, k: Any) -> Any:
        few = jnp.array([1.0, 4.0, 9.0])
        axis = jnp.arange(7) * 2.0
        found = [jnp.asarray(table)[k], few[k], jnp.array([True, False, True])[k], jnp.asarray(table).at[k].set(1.0)]
        found += [jnp.searchsorted(axis, x[0]), jnp.searchsorted(jnp.asarray(table), x[0], side="right")]
        return [*found, jnp.interp(x[0, 0], axis, axis * 0.5), jnp.digitize(x[0], axis)]

    return _square("tables", tables)


def matrices() -> list[Case]:
    """Cholesky factors and triangular solves."""
    found = []
    for n in (1, 3, 9):

        def make(r: np.random.Generator, n: int = n) -> Any:
            a = r.normal(size=(n, n))
            bad = a + a.T - np.eye(n)
            bad[0, 0] = np.nan if r.random() < 0.2 else bad[0, 0]
            return a @ a.T + n * np.eye(n), bad, np.tril(a) + 4 * np.eye(n), r.normal(size=(n, n + 1))

        found.append(
            Case(
                f"cholesky {n}",
                lambda a, bad, t, b: (jnp.linalg.cholesky(a), jnp.linalg.cholesky(bad)),
                sets(make),
                close=1e-13,
            )
        )
        found.append(Case(f"solves {n}", _solves, sets(make), close=1e-12))
    return found


def _solves(a: Any, bad: Any, t: Any, b: Any) -> Any:
    found = [jax.scipy.linalg.cho_solve((t, True), b)]
    for left in (True, False):
        for lower in (True, False):
            for transposed in (True, False):
                for unit in (True, False):
                    how = {"left_side": left, "lower": lower, "transpose_a": transposed, "unit_diagonal": unit}
                    m = (t if lower else t.T) * (0.25 if unit else 1)
                    found.append(lax.linalg.triangular_solve(m, b if left else b.T, **how))
    return found
