"""Lowering rules for random keys (jax.random). A key is two 32-bit words, in the last axis. Random bits equal JAX's."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.compiler import jaxprs
from trimtab.compiler.arrays import Array
from trimtab.compiler.lower import Rule, Site


def _words(program: Callable[..., Any], keys: bool = True) -> Rule:
    """Return the rule that applies program(generator, words of a key, *other operands, **parameters) to each key."""

    def rule(site: Site) -> list[Array]:
        params = {k: v for k, v in site.params.items() if k != "impl"}
        shape = site.equation.invars[0].aval.shape
        implementation = jaxprs.key_implementation(site.equation)

        def one(words: Any, *others: Any) -> Any:
            return program(implementation, words, *others, **params)

        # seeds, and the second operand of fold_in, have the same batch axes as the keys
        for _ in shape:
            one = jax.vmap(one)
        shapes = [
            jax.ShapeDtypeStruct(a.shape, jaxprs.physical_type(v.aval))
            for a, v in zip(site.operands, site.equation.invars, strict=True)
        ]
        return site.inline(jax.make_jaxpr(one)(*shapes), site.operands, site.dying)

    return rule


def _same(site: Site) -> list[Array]:
    return [*site.operands]


def key_rule(rule: Rule) -> Rule:
    """Return a rule that also accepts keys as operands: the primitive is then applied to each word of the keys."""

    def either(site: Site) -> list[Array]:
        if not any(jaxprs.is_key(v.aval) for v in site.equation.invars):
            return rule(site)
        avals = [v.aval for v in site.equation.invars]
        axes = tuple(-1 if jaxprs.is_key(a) else None for a in avals)
        shapes = [
            jax.ShapeDtypeStruct(x.shape, jaxprs.physical_type(a)) for x, a in zip(site.operands, avals, strict=True)
        ]

        def words(*operands: Any) -> Any:
            return site.equation.primitive.bind(*operands, **site.params)

        return site.inline(jax.make_jaxpr(jax.vmap(words, axes, -1))(*shapes), site.operands, site.dying)

    return either


def _pair_of_counts(site: Site) -> list[Array]:
    """Return the row-major position of each element, as an array of high words and an array of low words."""
    shape = site.params["shape"]

    def program() -> Any:
        count = jnp.arange(math.prod(shape), dtype=jnp.uint64).reshape(shape)
        return (count >> np.uint64(32)).astype(jnp.uint32), count.astype(jnp.uint32)

    return site.inline(jax.make_jaxpr(program)(), [])


RULES: dict[str, Rule] = {
    "iota_2x32_shape": _pair_of_counts,
    "random_seed": _words(lambda of, seed: of.seed(seed)),
    "random_bits": _words(lambda of, words, bit_width, shape: of.random_bits(words, bit_width, shape)),
    "random_split": _words(lambda of, words, shape: of.split(words, shape)),
    "random_fold_in": _words(lambda of, words, data: of.fold_in(words, data)),
    "random_wrap": _same,
    "random_unwrap": _same,
}
OF_KEYS = (
    "slice",
    "squeeze",
    "reshape",
    "broadcast_in_dim",
    "concatenate",
    "transpose",
    "dynamic_slice",
    "gather",
    "rev",
)
OF_KEYS += ("select_n", "stack", "unstack", "dynamic_update_slice", "scatter", "expand_dims", "split")
"""Primitives that move keys in the same way as numbers."""
