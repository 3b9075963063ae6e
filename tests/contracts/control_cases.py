"""Cases of branches and loops, and of arrays changed in place: whoever reads the old array must still find it."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax import lax
from jax import numpy as jnp
from jax.extend.core import jaxpr_as_fun
from jax.extend.core.primitives import closed_call_p
from jax.extend.linear_util import wrap_init

from contracts.array_cases import quarters, sets
from contracts.compiled import Case

SIZES = (6, 60)


def _cases(*functions: Callable[..., Any], **how: Any) -> list[Case]:
    """function(x, y, k, n): x, y of floats, k in range of them, n from -1 to 6; each for small and large arrays."""

    def make(r: np.random.Generator, size: int) -> Any:
        return *quarters(r, 2, size), np.int32(r.integers(0, size)), np.int64(r.integers(-1, 7))

    return [
        Case(f"{f.__name__.strip('_')}, {size}", f, sets(lambda r, size=size: make(r, size), seed=11), **how)
        for f in functions
        for size in SIZES
    ]


def closed_call(program: Any, x: Any) -> Any:
    """A call as JAX makes it of derivatives with rules of their own."""
    wrapped = wrap_init(jaxpr_as_fun(program), debug_info=program.jaxpr.debug_info)
    return closed_call_p.bind(x, subfuns=(wrapped,), call_jaxpr=program)


def calls() -> list[Case]:
    """Programs that are merely called."""

    def called(x: Any, y: Any, k: Any, n: Any) -> Any:
        doubled = jax.custom_vjp(lambda a: a * 2)
        doubled.defvjp(lambda a: (a * 2, None), lambda _, g: (g * 2,))
        inner = jax.make_jaxpr(lambda a: a + 1)(x)
        return (
            [jax.jit(lambda a: a.at[k].set(1.0))(x), x, jax.nn.relu(y), doubled(x), jax.checkpoint(jnp.abs)(x)],
            [closed_call(inner, x), jnp.where(y > 0, y, x)],
        )

    return _cases(called)


def old_arrays() -> list[Case]:
    """The old array is read after an update, under its own or another name."""

    def _read_after(x: Any, y: Any, k: Any, n: Any) -> Any:
        z = x * 2
        w = z.at[k].set(9.0)
        return w, z, z.at[0].add(1.0), w.at[k].add(z[k]), z[k] + w[0]

    def _other_names(x: Any, y: Any, k: Any, n: Any) -> Any:
        z = x + y
        seen = z.reshape(2, -1)
        first = z.at[k].set(9.0)
        again = first.reshape(2, -1)
        second = again.at[1, 0].set(-3.0)
        return seen.sum(), first[k], second, again

    def _by_itself(x: Any, y: Any, k: Any, n: Any) -> Any:
        z = (jnp.abs(x) * 4).astype(np.int32) % x.shape[0]
        w = z + 1
        shifted = lax.dynamic_update_slice(z * 2, (z * 2)[1:4], (k,))
        same = w.at[z % 3].max(w)
        u = z * 3 % x.shape[0]
        places = u.astype(np.uint32) + 0
        numbers = lax.ScatterDimensionNumbers((), (0,), (0,))
        added = lax.scatter_add(places, lax.reshape(places, (len(x), 1)), places, numbers, mode="clip")
        itself = (u + 1).at[z].add(u + 1)
        return shifted, same, u.at[u].add(1), lax.dynamic_update_slice(u, u, (k,)), added, itself

    def _chain(x: Any, y: Any, k: Any, n: Any) -> Any:
        z = x - 1
        for i in range(4):
            z = z.at[i].set(z[i + 1] + z[k])
        return z

    return _cases(_read_after, _other_names, _by_itself, _chain)


def branches() -> list[Case]:
    """cond and switch, on data that differ from lane to lane."""

    def _updates(x: Any, y: Any, k: Any, n: Any) -> Any:
        z, w = x + 1, y + 1
        a = lax.cond(n > 2, lambda z: z.at[k].set(5.0), lambda z: z, z)
        b, c = lax.cond(x[0] > 0, lambda z, w: (w, z), lambda z, w: (z.at[k].set(1.0), w), z, w)
        d = lax.cond(n > 3, lambda z: z.at[0].set(1.0), lambda z: z.at[k].add(2.0), w * 1)
        e, f = lax.cond(k > 2, lambda p, q: (p.at[1].set(q[0]), q), lambda p, q: (q, p * 3), w, w)
        return a, b, c, d, e, f, z, w

    def _switches(x: Any, y: Any, k: Any, n: Any) -> Any:
        paths = [lambda z: z, lambda z: z.at[k].set(n * 1.0), lambda z: z[::-1], lambda z: z * z[0]]
        return lax.switch(n, paths, x + y), lax.switch(jnp.clip(k, 0, 1), paths[:2], x * 2), lax.switch(n, paths[:1], x)

    def _nested(x: Any, y: Any, k: Any, n: Any) -> Any:
        def inner(z: Any) -> Any:
            z = z.at[k].add(1.0)
            return lax.cond(z[0] > 0, lambda z: z.at[0].set(-z[k]), lambda z: lax.fori_loop(0, n, turn, z), z)

        def turn(i: Any, z: Any) -> Any:
            return lax.cond(z[i % 3] < y[i], lambda z: z.at[i].add(y[k]), lambda z: z, z)

        return lax.cond(n > 1, inner, lambda z: z + 1, x * 2), x

    def _only_one_side(x: Any, y: Any, k: Any, n: Any) -> Any:
        # the side that is not taken would divide by zero, or read far out of range
        a = lax.cond(n > 0, lambda: (k + 100) // n, lambda: n * 0)
        table = jnp.arange(70.0) + x[0]
        return a, lax.cond(n >= 0, lambda: table[n * 10], lambda: -1.0), lax.cond(True, lambda: x, lambda: y)

    return _cases(_updates, _switches, _nested, _only_one_side)


def scans() -> list[Case]:
    """Scans: carried arrays changed in place, slices, results; forwards and backwards."""

    def _carried(x: Any, y: Any, k: Any, n: Any) -> Any:
        z = x * 2

        def turn(c: Any, u: Any) -> Any:
            a, s = c
            b = a.at[k].add(u)
            return (b, s + a[k]), (a[0] + b[0], b[:2])

        return lax.scan(turn, (z, 0.0), y), lax.scan(turn, (z, n * 1.0), y, reverse=True), z

    def _its_own_slices(x: Any, y: Any, k: Any, n: Any) -> Any:
        z, w = x + y, x - y

        def turn(a: Any, u: Any) -> Any:
            a = a.at[k].add(u)
            return a.at[0].add(a[-1]), u

        return lax.scan(turn, z, z), lax.scan(lambda a, u: (a.at[k].set(w[k] + u), a[0]), w, y)

    def _swapped(x: Any, y: Any, k: Any, n: Any) -> Any:
        def turn(c: Any, u: Any) -> Any:
            a, b, _ = c
            return (b.at[k].add(u), a, a), b[0]

        z = x + 1
        return lax.scan(turn, (z, z, y * 2), y[:5])

    def _rows(x: Any, y: Any, k: Any, n: Any) -> Any:
        grid = x[:, None] * y[None, :]

        def turn(a: Any, row: Any) -> Any:
            inner, _ = lax.scan(lambda s, u: (s + u, None), 0.0, row)
            return a.at[k].add(inner), (row * 2, inner, a)

        none = lax.scan(lambda c, u: (c + 1, u), 0, jnp.zeros((0, 3)))
        return lax.scan(turn, x, grid), none, lax.scan(lambda c, _: (c * 2, c), x[0], None, length=3)

    def _table(x: Any, y: Any, k: Any, n: Any) -> Any:
        few = x[:5] * 2
        return lax.fori_loop(0, 20, lambda i, s: s + few[(i * k) % 5], 0.0), lax.fori_loop(
            2, 5, lambda i, a: a.at[i].set(a[i - 1]), x
        )

    return _cases(_carried, _its_own_slices, _swapped, _rows, _table)


def whiles() -> list[Case]:
    """While loops that end in another turn in each lane, also under branches."""

    def _arrays(x: Any, y: Any, k: Any, n: Any) -> Any:
        z = x + 1

        def turn(c: Any) -> Any:
            i, a = c
            return i + 1, a.at[i % 3].add(a[k])

        return lax.while_loop(lambda c: c[0] < n, turn, (0, z)), z, lax.while_loop(lambda c: False, turn, (0, z))

    def _test_reads(x: Any, y: Any, k: Any, n: Any) -> Any:
        z = jnp.abs(x)

        def test(c: Any) -> Any:
            a, _b, i = c
            return (a.sum() < 60.0) & (i < 9 + n)

        return lax.while_loop(test, lambda c: (c[1].at[k].add(z[k] + 1.0), c[0], c[2] + 1), (z, z * 2, 0)), z

    def _under_branches(x: Any, y: Any, k: Any, n: Any) -> Any:
        def climb(z: Any) -> Any:
            return lax.while_loop(lambda c: c[0] < 3 * n, lambda c: (c[0] + 1 + k % 3, c[1].at[k].add(1.0)), (0, z))[1]

        def outer(c: Any) -> Any:
            i, z = c
            return i + 1, lax.cond(z[0] > i, climb, lambda z: z.at[0].add(0.75), z)

        return lax.cond(k % 2 == 0, lambda z: lax.while_loop(lambda c: c[0] < n, outer, (0, z))[1], lambda z: -z, x + y)

    def _batched(x: Any, y: Any, k: Any, n: Any) -> Any:
        ends = jnp.arange(3) + n
        return jax.vmap(lambda m: lax.while_loop(lambda c: c[0] < m, lambda c: (c[0] + 1, c[1] * 0.5), (0, x[0])))(ends)

    return _cases(_arrays, _test_reads, _under_branches, _batched)


def derivatives() -> list[Case]:
    """Forward and reverse derivatives of covered programs."""

    def program(x: Any, y: Any, k: Any, n: Any) -> Any:
        z, ys = lax.scan(lambda c, u: (c * 0.5 + u * u, c * u), x[0], x[:8])
        w = lax.cond(n > 2, lambda a: a.at[k].set(z), lambda a: a * y, x)
        return jnp.sum(w * w) + ys.sum() + jnp.sin(z) + x[k] ** 3 + lax.dynamic_slice(x * y, (k,), (2,)).sum()

    def _forward(x: Any, y: Any, k: Any, n: Any) -> Any:
        loop = lambda a: lax.while_loop(lambda c: c[0] < n, lambda c: (c[0] + 1, jnp.tanh(c[1]) + a), (0, a))[1]  # noqa: E731
        return jax.jvp(lambda x: program(x, y, k, n), (x,), (y,)), jax.jvp(loop, (x,), (y,))

    def _reverse(x: Any, y: Any, k: Any, n: Any) -> Any:
        return jax.grad(program)(x, y, k, n), jax.vjp(lambda x: jnp.cumsum(x)[k] * x, x)[1](y)

    return _cases(_forward, _reverse, close=1e-13)
