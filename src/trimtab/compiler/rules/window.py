"""Lowering rules for convolutions, and for sums, minima and maxima over windows. Operands are padded, so windows fit.

A padded element adds nothing to a convolution, even if the kernel is infinite there (0 times infinity would be NaN).
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.compiler.arrays import Array, Index, build_array, read_element, store_in_memory
from trimtab.compiler.lower import Rule, Site
from trimtab.compiler.rules.composite import inline_program
from trimtab.compiler.rules.reduce import accumulate, neutral_element
from trimtab.compiler.values import Value


def _inline_on(site: Site, program: Callable[..., Any], operands: list[Array], avals: list[Any]) -> Array:
    shapes = [jax.ShapeDtypeStruct(a.shape, a.dtype) for a in avals]
    return site.inline(jax.make_jaxpr(program)(*shapes), operands)[0]


def _window_place(site: Site, at: Value, step: int, inner: Value, dilation: int) -> Value:
    """Return the position of an element of a window: at * step + inner * dilation."""
    b = site.b
    start, offset = b.op("mul", at, b.index(step), dtype="i32"), b.op("mul", inner, b.index(dilation), dtype="i32")
    return b.op("add", start, offset, dtype="i32")


def _conv(site: Site) -> list[Array]:
    b, p = site.b, site.params
    numbers, groups = p["dimension_numbers"], p["feature_group_count"]
    batches = p["batch_group_count"]
    left, right = (v.aval for v in site.equation.invars)
    rank = len(left.shape) - 2
    spread = [(lo, hi, d - 1) for (lo, hi), d in zip(p["padding"], p["lhs_dilation"], strict=True)]

    def arrange(x: Any) -> Any:
        """Return the operand, padded and dilated, with the axes batch, features, positions in space."""
        x = jnp.transpose(x, numbers.lhs_spec)
        x = lax.pad(x, x.dtype.type(0), [(0, 0, 0)] * 2 + spread)
        if batches > 1:  # turn groups of the batch into groups of features
            x = jnp.moveaxis(x.reshape(batches, -1, *x.shape[1:]), 0, 1)
            x = x.reshape(x.shape[0], -1, *x.shape[3:])
        return x

    image = store_in_memory(b, _inline_on(site, arrange, [site.operands[0]], [left]))
    kernel = store_in_memory(
        b, _inline_on(site, lambda w: jnp.transpose(w, numbers.rhs_spec), [site.operands[1]], [right])
    )
    places_given = tuple(left.shape[a] for a in numbers.lhs_spec[2:])
    given = None
    if any(s != (0, 0, 0) for s in spread) and jnp.issubdtype(right.dtype, jnp.inexact):
        mask = np.asarray(lax.pad(np.ones(places_given, bool), np.zeros((), bool), spread))
        given = store_in_memory(b, _inline_on(site, lambda: jnp.asarray(mask), [], []))
    groups *= batches
    outputs, inputs = kernel.shape[0], kernel.shape[1]
    back = [int(a) for a in np.argsort(numbers.out_spec)]
    plain = [site.shape[a] for a in numbers.out_spec]
    each = outputs // groups

    def element(index: Index) -> Value:
        n, o, *places = index
        group = b.op("mul", b.op("div", o, b.index(each), dtype="i32"), b.index(inputs), dtype="i32")

        def add(inner: Index, carried: list[Value]) -> list[Value]:
            i, *offsets = inner
            feature = b.op("add", group, i, dtype="i32")
            where = [
                _window_place(site, at, s, k, d)
                for at, s, k, d in zip(places, p["window_strides"], offsets, p["rhs_dilation"], strict=True)
            ]
            x, w = read_element(b, image, [n, feature, *where]), read_element(b, kernel, [o, i, *offsets])
            x, w = (b.op("convert", v, dtype=site.dtype) for v in (x, w))
            term = b.op("mul", x, w, dtype=site.dtype)
            if given is not None:
                term = b.op("select", read_element(b, given, where), term, b.const(0, site.dtype), dtype=site.dtype)
            return [b.op("add", carried[0], term, dtype=site.dtype)]

        return accumulate(b, kernel.shape[1:], [b.const(0, site.dtype)], add)[0]

    made = build_array(b, tuple(plain), site.dtype, element)
    aval = jax.ShapeDtypeStruct(tuple(plain), site.equation.outvars[0].aval.dtype)
    assert rank == len(plain) - 2
    return [_inline_on(site, lambda x: jnp.transpose(x, back), [made], [aval])]


def _reduce_window(op: str) -> Rule:
    def rule(site: Site) -> list[Array]:
        b, p = site.b, site.params
        [aval] = [v.aval for v in site.equation.invars]
        window, steps, spread = p["window_dimensions"], p["window_strides"], p["window_dilation"]
        neutral = np.asarray(neutral_element(op, site.dtype)).astype(aval.dtype)
        config = [(lo, hi, d - 1) for (lo, hi), d in zip(p["padding"], p["base_dilation"], strict=True)]
        padded = store_in_memory(b, inline_program(site, lambda x: lax.pad(x, neutral, config))[0])

        def element(index: Index) -> Value:
            def add(inner: Index, carried: list[Value]) -> list[Value]:
                where = [
                    _window_place(site, at, s, k, d) for at, s, k, d in zip(index, steps, inner, spread, strict=True)
                ]
                return [b.op(op, carried[0], read_element(b, padded, where), dtype=site.dtype)]

            return accumulate(b, tuple(window), [b.const(neutral, site.dtype)], add)[0]

        return [build_array(b, site.shape, site.dtype, element)]

    return rule


RULES: dict[str, Rule] = {
    "conv_general_dilated": _conv,
    "reduce_window_max": _reduce_window("max"),
    "reduce_window_min": _reduce_window("min"),
    "reduce_window_sum": _reduce_window("add"),
}
