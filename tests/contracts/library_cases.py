"""Cases of primitives that are programs of others: factors, orders, windows, random numbers, special functions."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.random import threefry_2x32, threefry_prng_impl
from jax.scipy import linalg, special

from contracts.compiled import Case

rng = np.random.default_rng(14)


def _even(*cases):
    """Each with three sets of arguments."""
    return [c._replace(sets=[c.sets[i % len(c.sets)] for i in range(3)]) for c in cases]


def _matrices(*shape):
    return [(rng.normal(size=shape) + 2 * np.eye(shape[-1]),) for _ in range(3)]


def factors():
    ones = _matrices(4, 4)
    pairs = [(a, rng.normal(size=4)) for (a,) in ones]
    pivots = [(np.array(p, np.int32),) for p in ([2, 1, 4], [0, 1, 2], [4, 4, 4])]
    singular = [(np.outer(np.arange(3.0), np.arange(3.0)),), (np.zeros((3, 3)),)]

    def symmetric(a):
        values, vectors = jnp.linalg.eigh(a + a.T)
        return values, vectors @ jnp.diag(values) @ vectors.T

    def positive(a):
        return jnp.linalg.cholesky(a @ jnp.swapaxes(a, -1, -2) + jnp.eye(3))

    return _even(
        Case("lu", lax.linalg.lu, [*ones, *_matrices(4, 4)], close=1e-13),
        Case("pivots", lambda p: lax.linalg.lu_pivots_to_permutation(p, 5), pivots),
        Case("lu of large", lax.linalg.lu, _matrices(9, 9), close=1e-12, lanes=False),
        Case("singular lu", lambda a: lax.linalg.lu(a)[1:], singular),
        Case("solve", jnp.linalg.solve, pairs, close=1e-12, lanes=False),
        Case("inv", jnp.linalg.inv, _matrices(7, 7), close=1e-12, lanes=False),
        Case("slogdet", jnp.linalg.slogdet, ones, close=1e-12, lanes=False),
        Case("expm", linalg.expm, ones, close=1e-12, lanes=False),
        Case("qr", jnp.linalg.qr, [*ones, (np.eye(4),)], close=1e-12, lanes=False),
        Case("tall qr", jnp.linalg.qr, [(rng.normal(size=(9, 3)),) for _ in range(3)], close=1e-12, lanes=False),
        Case(
            "full qr",
            lambda a: jnp.linalg.qr(a, mode="complete"),
            [(rng.normal(size=(5, 3)),)] * 2,
            close=1e-12,
            lanes=False,
        ),
        Case("eigh", symmetric, [*ones, (np.zeros((4, 4)),)], close=1e-12, lanes=False),
        Case(
            "batch of solves",
            jax.vmap(jnp.linalg.solve),
            [(_matrices(3, 3, 3)[0][0], np.ones((3, 3)))],
            close=1e-12,
            lanes=False,
        ),
        Case("batch of factors", positive, [(rng.normal(size=(2, 5, 3, 3)),)], close=1e-12, lanes=False),
        Case("derivative", jax.grad(lambda a: jnp.linalg.inv(a).sum()), ones, close=1e-11, lanes=False),
        Case(
            "conjugate", lambda a: jax.scipy.sparse.linalg.cg(lambda x: a @ a.T @ x, jnp.ones(4))[0], ones, close=1e-9
        ),
    )


def orders():
    some = [np.array([3.0, np.nan, -0.0, 0.0, -np.inf, 3.0, np.inf, 1.0]), np.arange(8.0)[::-1].copy()]
    many = [rng.normal(size=300).round(1) for _ in range(2)]
    return _even(
        Case("sort", lambda x: (jnp.sort(x), jnp.argsort(x), jnp.argsort(x, descending=True)), [(x,) for x in some]),
        Case("sort many", lambda x: (jnp.sort(x), jnp.argsort(x)), [(x,) for x in many], lanes=False),
        Case("sort whole", jnp.sort, [(np.array([3, -1, 2**62, 0, 3]),)]),
        Case("axis", lambda x: jnp.sort(x.reshape(3, 4, 25), 1), [(x,) for x in many], lanes=False),
        Case("two keys", lambda x: lax.sort((jnp.round(x), x, -x), num_keys=2), [(x,) for x in many], lanes=False),
        Case("top", lambda x: lax.top_k(x, 3), [(rng.normal(size=9),) for _ in range(2)]),
        Case("top of zeros", lambda x: lax.top_k(x, 3), [(np.array([-0.0, -1.0, 0.0, -0.0, 0.0]),)]),
        Case("quantiles", lambda x: (jnp.median(x), jnp.percentile(x, 30.0)), [(x,) for x in many], ulp=4, lanes=False),
        Case(
            "derivative", jax.grad(lambda x: (jnp.sort(x) * jnp.arange(8.0)).sum()), [(np.sin(some[1]),)], lanes=False
        ),
    )


def windows():
    image, kernel = rng.normal(size=(2, 4, 7, 6)), rng.normal(size=(6, 2, 3, 2))

    def grouped(x, w):
        options = {"window_strides": (2, 1), "padding": [(2, 1), (0, 3)], "lhs_dilation": (1, 2)}
        return lax.conv_general_dilated(x, w, rhs_dilation=(2, 1), feature_group_count=2, **options)

    def batched(x, w):
        return lax.conv_general_dilated(x.reshape(4, 2, 7, 6), w, (1, 1), "SAME", batch_group_count=2)

    def pooled(x):
        shape, spread = (1, 1, 2, 3), (1, 1, 2, 1)
        most = lax.reduce_window(x, -jnp.inf, lax.max, shape, spread, "SAME")
        least = lax.reduce_window(x, jnp.inf, lax.min, shape, spread, "VALID", window_dilation=(1, 1, 2, 1))
        return most, least, lax.reduce_window(x, 0.0, lax.add, shape, spread, "SAME")

    def network(x, w):
        hidden = jax.nn.relu(lax.conv_general_dilated(x[:, :2], w, (1, 1), "VALID"))
        return jax.nn.softmax(lax.reduce_window(hidden, -jnp.inf, lax.max, (1, 1, 5, 5), (1, 1, 5, 5), "VALID").ravel())

    both = [(image, kernel), (image[::-1].copy(), 2 * kernel)]
    return _even(
        Case("grouped", grouped, both, close=1e-13, lanes=False),
        Case("batch groups", batched, both, close=1e-13, lanes=False),
        Case("pooled", pooled, [(image,)], close=1e-13, lanes=False),
        Case("network", network, both, close=1e-13),
        Case("of the kernel", jax.grad(lambda x, w: (grouped(x, w) ** 2).sum(), 1), both, close=1e-12, lanes=False),
        Case("convolve", jnp.convolve, [(np.arange(5.0), np.arange(1.0, 4.0))], close=1e-13),
    )


def randoms():
    seeds = [(3,), (0,), (2**40 + 1,)]

    def typed(seed):
        keys = jax.random.split(jax.random.key(seed), 5)
        more = jax.vmap(lambda k: jax.random.uniform(k, (2,)))(keys[1:3])
        return more, jax.random.randint(jax.random.fold_in(keys[0], 7), (4,), -5, 90)

    def walk(seed):
        def step(c, _):
            key, x = c
            key, now = jax.random.split(key)
            return (key, x + jax.random.normal(now)), x

        (_, x), path = lax.scan(step, (jax.random.key(seed), 0.0), length=6)
        return x, path

    def old(seed):
        key = jax.random.PRNGKey(seed)
        bits = jax.random.bits(key, (3,), "uint64"), jax.random.bernoulli(key, 0.3, (9,))
        return bits, jax.random.permutation(key, 7), jax.random.exponential(key, (2,))

    def hashed(seed):
        words = jnp.stack([seed, seed + 1]).astype(jnp.uint32)
        return threefry_2x32(words, jnp.arange(10, dtype=jnp.uint32)), threefry_prng_impl.random_bits(words, 32, (5,))

    return _even(
        Case("hashed", hashed, seeds),
        Case("typed", typed, seeds, lanes=False),
        Case("walk", walk, seeds, close=1e-14, lanes=False),
        Case("old", old, seeds, close=1e-15, lanes=False),
    )


def functions():
    # more than 48 numbers, so that they get loops: unrolled, the text would be long
    x = np.concatenate([np.linspace(-0.999, 0.999, 60), [0.0, -0.0, 1.0, -1.0, 2.0, 1e-300, 1 - 1e-16]])
    z = np.array([0.3, 1.0, 2.5, 50.0, -0.7, -3.2, 170.0, 1e-8, np.inf, np.nan])
    z = np.tile(z, 6)
    return _even(
        Case("erf_inv", special.erfinv, [(x,)], ulp=16),
        Case("erf_inv single", special.erfinv, [(x[:60].astype(np.float32),)], ulp=16),
        Case("lgamma", special.gammaln, [(z,)], close=1e-14),
        Case("digamma", special.digamma, [(z[np.isfinite(z)],)], close=1e-13),
        Case("logs", lambda x: lax.cumlogsumexp(x, reverse=True), [(np.arange(6.0),)], ulp=4),
        Case("platform", lambda x: lax.platform_dependent(x, tpu=jnp.cos, default=jnp.sin), [(0.3,)], ulp=2),
    )
