"""Lowering rules for primitives that are composed of others: programs in JAX, traced and lowered like user code.

A batch is a loop over single problems. Results agree with JAX's documentation up to rounding.
"""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.compiler import jaxprs
from trimtab.compiler.arrays import Array, constant
from trimtab.compiler.lower import Rule, Site

COUNTED = 40
"""Maximum number of elements that are sorted by counting smaller elements. Longer arrays are sorted by merging."""


def composite(program: Callable[..., Any]) -> Rule:
    """Return a rule for a primitive that is computed by the JAX function program(*operands, **parameters)."""

    def rule(site: Site) -> list[Array]:
        return inline_program(site, lambda *operands: program(*operands, **site.params))

    return rule


def inline_program(site: Site, program: Callable[..., Any]) -> list[Array]:
    """Return the results of a JAX program on the operands of an equation."""
    shapes = [jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in site.equation.invars]
    return site.inline(jax.make_jaxpr(program)(*shapes), site.operands, site.dying)


def each_matrix(single: Callable[..., Any], axes: int, *operands: Any) -> Any:
    """Apply single(...) to the last axes of the operands, for each index of the batch axes in turn."""
    batch = operands[0].shape[:-axes]
    if not batch:
        return single(*operands)
    flat = [x.reshape(math.prod(batch), *x.shape[len(batch) :]) for x in operands]
    return jax.tree.map(lambda y: y.reshape(*batch, *y.shape[1:]), lax.map(lambda some: single(*some), tuple(flat)))


def _permutation(pivots: Any, *, permutation_size: int, **_: Any) -> Any:
    def single(pivots: Any) -> Any:
        def swap(j: Any, order: Any) -> Any:
            p = pivots[j]
            first, other = order[j], order[p]
            return order.at[j].set(other).at[p].set(first)

        return lax.fori_loop(0, pivots.shape[0], swap, jnp.arange(permutation_size, dtype=jnp.int32))

    return each_matrix(single, 1, pivots)


def _each(site: Site) -> list[Array]:
    """Return the results of the primitive, which is applied to the matrices of the batch one by one."""
    primitive, params = site.equation.primitive, site.params
    return inline_program(site, lambda *x: each_matrix(lambda *single: primitive.bind(*single, **params), 2, *x))


def _sort(*operands: Any, dimension: int, num_keys: int, **_: Any) -> Any:
    def single(*rows: Any) -> Any:
        order = sorting_order(rows[:num_keys], reverse=False)
        return tuple(row[order] for row in rows)

    moved = [jnp.moveaxis(x, dimension, -1) for x in operands]
    return [jnp.moveaxis(x, -1, dimension) for x in each_matrix(single, 1, *moved)]


def _top_k(operand: Any, *, k: int, axis: int = -1, **_: Any) -> Any:
    def single(row: Any) -> Any:
        order = sorting_order((_total_order(row),), reverse=True)[:k]
        return row[order], order

    found = each_matrix(single, 1, jnp.moveaxis(operand, axis, -1))
    return [jnp.moveaxis(x, -1, axis) for x in found]


def _total_order(x: Any) -> Any:
    """Return integers that are ordered as top_k orders floats: -NaN, -inf, ..., -0, 0, ..., inf, NaN."""
    if not jnp.issubdtype(x.dtype, jnp.floating):
        return x
    bits = lax.bitcast_convert_type(x, {4: jnp.int32, 8: jnp.int64}[x.dtype.itemsize])
    return jnp.where(bits < 0, bits ^ jnp.iinfo(bits.dtype).max, bits)


def _comes_before(x: tuple[Any, ...], y: tuple[Any, ...]) -> Any:
    """Return True where the keys x sort before the keys y: numbers in order, NaN last."""
    before, equal = jnp.bool_(False), jnp.bool_(True)
    for a, b in zip(x, y, strict=True):
        less = a < b
        same = a == b
        if jnp.issubdtype(a.dtype, jnp.floating):
            less = less | ((a == a) & (b != b))
            same = same | ((a != a) & (b != b))
        before = before | (equal & less)
        equal = equal & same
    return before


def sorting_order(keys: tuple[Any, ...], reverse: bool) -> Any:
    """Return the positions (int32) of the keys in sorted order. Equal keys keep their order."""
    n = keys[0].shape[0]
    places = jnp.arange(n, dtype=jnp.int32)

    def before(x: Any, y: Any) -> Any:
        return _comes_before(y, x) if reverse else _comes_before(x, y)

    if n <= 1:
        return places
    if n <= COUNTED:
        mine, others = tuple(k[:, None] for k in keys), tuple(k[None] for k in keys)
        ties = ~before(mine, others) & (places[None] < places[:, None])
        rank = jnp.sum(before(others, mine) | ties, axis=1, dtype=jnp.int32)
        return jnp.zeros(n, jnp.int32).at[rank].set(places, mode="promise_in_bounds")
    order, width = places, 1
    while width < n:
        order = _merge_runs(order, keys, before, width)
        width *= 2
    return order


def _merge_runs(order: Any, keys: tuple[Any, ...], before: Callable[..., Any], width: int) -> Any:
    """Merge sorted runs of this width in pairs. The place of each element in the other run is found by search."""
    n = order.shape[0]

    def key(place: Any) -> tuple[Any, ...]:
        return tuple(k[place] for k in keys)

    def put(i: Any, merged: Any) -> Any:
        begin = i // (2 * width) * (2 * width)
        middle, end = jnp.minimum(begin + width, n), jnp.minimum(begin + 2 * width, n)
        left, mine = i < middle, key(order[i])
        low, high = jnp.where(left, middle, begin), jnp.where(left, end, middle)
        first = low
        for _ in range(width.bit_length()):
            half = (low + high) // 2
            other = key(order[jnp.minimum(half, n - 1)])
            later = jnp.where(left, before(other, mine), ~before(mine, other))
            busy = low < high
            low, high = jnp.where(busy & later, half + 1, low), jnp.where(busy & ~later, half, high)
        own = jnp.where(left, i - begin, i - middle)
        return merged.at[begin + own + low - first].set(order[i], mode="promise_in_bounds")

    return lax.fori_loop(np.int32(0), np.int32(n), put, jnp.zeros(n, jnp.int32))


def _erf_inv(x: Any, **_: Any) -> Any:
    """Compute the inverse of erf: Giles's approximation for single precision, then Halley steps on erf or erfc.

    Beyond the range of this approximation, the first term of the expansion of the tail is used: erfc(y) = exp(-y^2) /
    (y sqrt(pi)).
    Source: Giles, GPU Computing Gems (2011).
    """
    low = (2.81022636e-08, 3.43273939e-07, -3.5233877e-06, -4.39150654e-06, 0.00021858087)
    low += (-0.00125372503, -0.00417768164, 0.246640727, 1.50140941)
    high = (-0.000200214257, 0.000100950558, 0.00134934322, -0.00367342844, 0.00573950773)
    high += (-0.0076224613, 0.00943887047, 1.00167406, 2.83297682)
    a = jnp.abs(x)
    inside = a < 1
    safe = jnp.where(inside, a, 0.0)
    w = -jnp.log1p(-safe * safe) if x.dtype == np.float32 else -jnp.log((1 - safe) * (1 + safe))
    near = w < 5
    z = jnp.where(near, w - 2.5, jnp.sqrt(jnp.maximum(w, 5.0)) - 3.0)
    p, q = jnp.full_like(z, low[0]), jnp.full_like(z, high[0])
    for c, d in zip(low[1:], high[1:], strict=True):
        p, q = c + p * z, d + q * z
    tail = -jnp.log(jnp.where(inside, 1 - a, 1.0))
    far = jnp.sqrt(tail - 0.5 * jnp.log(math.pi * jnp.maximum(tail, 1.0)))
    y = jnp.where(w > 16, far, jnp.where(near, p, q) * safe)
    for _step in range(3 if x.dtype == np.float64 else 1):
        lack = jnp.where(safe < 0.5, lax.erf(y) - safe, (1 - safe) - lax.erfc(y))
        slope = lack * (0.5 * math.sqrt(math.pi)) * jnp.exp(y * y)
        y = y - slope / (1 + y * slope)
    whole = jnp.where(inside, y, jnp.where(a == 1, jnp.inf, jnp.nan))
    return jnp.where(
        safe == 0, jnp.where(inside, x * (0.5 * math.sqrt(math.pi)), whole * jnp.sign(x)), jnp.copysign(whole, x)
    )


LANCZOS = (676.5203681218851, -1259.1392167224028, 771.32342877765313, -176.61502916214059, 12.507343278686905)
LANCZOS += (-0.13857109526572012, 9.9843695780195716e-6, 1.5056327351493116e-7)
"""Lanczos coefficients of the gamma function for g = 7, from the second one on; the first is 0.99999999999980993."""


def _lgamma(x: Any, **_: Any) -> Any:
    """Return the log of the gamma function by Lanczos's formula, with the reflection formula below 1/2."""
    below = x < 0.5
    z = jnp.where(below, -x, x - 1)
    total = 0.99999999999980993 + sum(c / (z + (i + 1)) for i, c in enumerate(LANCZOS))
    t = z + 7.5
    log_t = math.log(7.5) + jnp.log1p(z / 7.5)
    y = 0.5 * math.log(2 * math.pi) + (z + 0.5 - t / log_t) * log_t + jnp.log(total)
    part = jnp.abs(x) - jnp.floor(jnp.abs(x))
    turned = jnp.log(jnp.sin(math.pi * jnp.where(part > 0.5, 1 - part, part)))
    reflected = jnp.where(jnp.isfinite(turned), math.log(math.pi) - turned - y, -turned)
    return jnp.where(jnp.isinf(x), jnp.inf, jnp.where(below, reflected, y))


def _digamma(x: Any, **_: Any) -> Any:
    """Return the derivative of the log of the gamma function."""
    below = x < 0.5
    z = jnp.where(below, -x, x - 1)
    up, down = jnp.zeros_like(z), jnp.full_like(z, 0.99999999999980993)
    for i, c in enumerate(LANCZOS):
        up, down = up - c / ((z + (i + 1)) * (z + (i + 1))), down + c / (z + (i + 1))
    y = math.log(7.5) + jnp.log1p(z / 7.5) + up / down - 7 / (z + 7.5)
    part = math.pi * (x + jnp.abs(jnp.floor(x + 0.5)))
    reflected = y - math.pi * jnp.cos(part) / jnp.sin(part)
    return jnp.where((x <= 0) & (x == jnp.floor(x)), jnp.nan, jnp.where(below, reflected, y))


def _threefry(k1: Any, k2: Any, x1: Any, x2: Any, **_: Any) -> Any:
    """Compute threefry2x32: 20 rounds on two words.

    Source: Salmon et al., "Parallel random numbers: as easy as 1, 2, 3" (2011).
    """
    turns = ((13, 15, 26, 6), (17, 29, 16, 24))
    keys = (k1, k2, k1 ^ k2 ^ np.uint32(0x1BD11BDA))
    x, y = x1 + keys[0], x2 + keys[1]
    for i in range(5):
        for by in turns[i % 2]:
            x = x + y
            y = x ^ ((y << np.uint32(by)) | (y >> np.uint32(32 - by)))
        x, y = x + keys[(i + 1) % 3], y + keys[(i + 2) % 3] + np.uint32(i + 1)
    return x, y


def _cumlogsumexp(x: Any, *, axis: int, reverse: bool) -> Any:
    return lax.associative_scan(jnp.logaddexp, x, reverse=reverse, axis=axis)


def _custom_linear_solve(site: Site) -> list[Array]:
    program, first, last = jaxprs.linear_solution(site.equation)
    at = len(site.operands) - jaxprs.right_side_count(site.equation)
    return site.inline(program, [*site.operands[first:last], *site.operands[at:]])


def _platform(site: Site) -> list[Array]:
    return inline_program(site, lambda *_: jnp.int32(jaxprs.platform_position(site.equation)))


def _error_value(site: Site) -> list[Array]:
    """Return the result of equinox.error_if with EQX_ON_ERROR=nan: NaN, the largest integer or True, by type."""
    if not jaxprs.raises_of_equinox(site.equation):
        raise site.lowering.refusal("pure_callback")

    def value(aval: Any) -> Any:
        kind = np.dtype(aval.dtype).kind
        worst = np.nan if kind == "f" else kind == "b" or np.iinfo(aval.dtype).max
        return constant(site.b, np.full(aval.shape, worst, aval.dtype), site.lowering.type_name(aval.dtype))

    return [value(v.aval) for v in site.equation.outvars]


RULES: dict[str, Rule] = {
    "lu_pivots_to_permutation": composite(_permutation),
    "sort": composite(_sort),
    "top_k": composite(_top_k),
    "erf_inv": composite(_erf_inv),
    "threefry2x32": composite(_threefry),
    "lgamma": composite(_lgamma),
    "digamma": composite(_digamma),
    "cumlogsumexp": composite(_cumlogsumexp),
    "custom_linear_solve": _custom_linear_solve,
    "platform_index": _platform,
    "pure_callback": _error_value,
}


def one_or_each(one: Rule, each: Rule) -> Rule:
    """Return a rule that uses the rule `one` for a single matrix, and the rule `each` for a batch of matrices."""
    return lambda site: (one if all(len(a.shape) == 2 for a in site.operands) else each)(site)


EACH: dict[str, Rule] = dict.fromkeys(("cholesky", "lu", "triangular_solve"), _each)
"""Rules for batches of matrices. The rules in `linalg` handle single matrices."""
