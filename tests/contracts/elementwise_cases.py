"""Cases of primitives that work element by element: every pair of edge values in loops, random ones unrolled."""

import itertools
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax import lax
from jax import numpy as jnp
from jax.ad_checkpoint import checkpoint_name

from contracts.compiled import LANES, Case

FLOATS = [np.nan, np.inf, -np.inf, 0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 1.5, -2.5, 3.75, 1e-150, 1e200, -1e200]
FLOATS += [0.49999999999999994, 4503599627370497.0, -200.5, 300.0]
LIMITS = [2.0**31, -(2.0**31), -(2.0**31) - 1, 2.0**31 - 0.5, 2.0**32, 2.0**63, -(2.0**63), 2.0**64, 1e19, -1e19]
INTEGERS = ("i32", "i64", "u32", "u64", "i8", "i16", "u8", "u16")
SOME = ("i32", "i64", "u32", "u64", "i8", "u16")
NARROW = ("i8", "i16", "u8", "u16", "f32")
NUMPY = {"bool": "bool", "f64": "float64", "f32": "float32"}
NUMPY |= {t: t.replace("u", "uint") if t[0] == "u" else t.replace("i", "int") for t in INTEGERS}
UNROLLED = 3


def edges(t: str) -> Any:
    """Values of a type that are apt to go wrong."""
    if t == "bool":
        return np.array([False, True])
    if t[0] == "f":
        return np.array(FLOATS if t == "f64" else FLOATS[:12], NUMPY[t])
    limits = np.iinfo(NUMPY[t])
    few = [limits.min, limits.max, limits.max // 3, 0, 1, 2, 3, 7, 31, 32, 63, 64, 100]
    few += [-1, -2, -7, -33, limits.min + 1] if t[0] == "i" else [limits.max - 1]
    return np.unique(np.array([n for n in few if limits.min <= n <= limits.max], NUMPY[t]))


def spread(name: str, function: Callable[..., Any], arrays: list[Any], **how: Any) -> list[Case]:
    """Two cases: all combinations of these edges, turned from lane to lane; and few random ones, unrolled."""
    grid = [np.array(column) for column in zip(*itertools.product(*arrays), strict=True)]
    grid = [g.astype(a.dtype) for g, a in zip(grid, arrays, strict=True)]
    repeats = -(-50 // len(grid[0]))
    large = [np.tile(g, repeats) for g in grid]
    rng = np.random.default_rng(len(name))
    picks = [rng.integers(len(grid[0]), size=UNROLLED) for _ in range(LANES)]
    loops = Case(f"{name}, loops", function, [tuple(np.roll(g, 3 * i) for g in large) for i in range(LANES)], **how)
    if not loops.lanes:
        return [loops]
    return [loops, Case(f"{name}, unrolled", function, [tuple(g[p] for g in grid) for p in picks], **how)]


def _same(t: str, count: int) -> list[Any]:
    return [edges(t)] * count


def _typed(name: str, function: Callable[..., Any], count: int, types: tuple[str, ...]) -> list[Case]:
    found = []
    for t in types:
        found += spread(f"{name} {t}", function, _same(t, count), lanes=t not in NARROW)
    return found


def arithmetic() -> list[Case]:
    """Arithmetic, bits and comparisons: exact in every type."""
    found = []
    numbers = ("f64", *INTEGERS, "f32")
    for op in (lax.add, lax.sub, lax.mul, lax.div, lax.rem, lax.max, lax.min):
        found += _typed(op.__name__, op, 2, numbers)
    for op in (lax.bitwise_and, lax.bitwise_or, lax.bitwise_xor):
        found += _typed(op.__name__, op, 2, ("bool", *SOME))
    for op in (lax.shift_left, lax.shift_right_logical, lax.shift_right_arithmetic):
        found += _typed(op.__name__, op, 2, INTEGERS)
    for op in (lax.eq, lax.ne, lax.lt, lax.le, lax.gt, lax.ge):
        found += _typed(op.__name__, op, 2, ("bool", "f64", *SOME))
    one_zero = edges("f64")[~np.signbit(edges("f64")) | (edges("f64") != 0)]
    for values in (one_zero, edges("i32"), edges("u32")):
        for op in (lax.lt_to_p, lax.le_to_p, lax.eq_to_p):
            found += spread(f"{op} {values.dtype}", lambda x, y, op=op: op.bind(x, y), [values, values])
    found += _typed("max of bools", lambda x, y: (lax.max(x, y), lax.min(x, y)), 2, ("bool",))
    return found + [c for t in INTEGERS for c in _known_operands(t)]


def _known_operands(t: str) -> list[Case]:
    """Divisors and amounts of shift that are known beforehand have texts of their own."""
    bits = int(t[1:])

    def known(x: Any) -> Any:
        one = jnp.asarray(1, x.dtype)
        shifts = [lax.shift_left, lax.shift_right_logical, lax.shift_right_arithmetic]
        amounts = [0, 1, bits - 1, bits]
        return (
            [lax.div(x, one * k) for k in (3, 0)],
            [lax.rem(x, one * k) for k in (3, 1, 0)],
            [s(x, jnp.full_like(x, k)) for s in shifts for k in amounts],
            [lax.max(x, one), lax.min(one, x), lax.mul(x, one * 0), lax.sub(x, one * 0)],
        )

    return spread(f"known operands {t}", known, [edges(t)], lanes=t not in NARROW)


def unary() -> list[Case]:
    """One operand, exact."""
    numbers = ("f64", *INTEGERS, "f32")
    found = []
    for op in (lax.neg, lax.sign):
        found += _typed(op.__name__, op, 1, numbers)
    found += _typed("abs", lax.abs, 1, ("f64", "i32", "i64", "i8", "i16", "f32"))
    found += _typed("not", lax.bitwise_not, 1, ("bool", *INTEGERS))
    for op in (lax.clz, lax.population_count):
        found += _typed(op.__name__, op, 1, INTEGERS)
    for op in (lax.floor, lax.ceil, lax.sqrt, lax.is_finite, lax.square):
        found += _typed(op.__name__, op, 1, ("f64", "f32"))
    for method in (lax.RoundingMethod.TO_NEAREST_EVEN, lax.RoundingMethod.AWAY_FROM_ZERO):
        found += _typed(f"round {method.name}", lambda x, m=method: lax.round(x, m), 1, ("f64", "f32"))
    for y in (0, 1, 2, 3, 7, -1, -3):
        found += _typed(f"integer_pow {y}", lambda x, y=y: lax.integer_pow(x, y), 1, ("f64",))
    found += _typed("integer_pow 3", lambda x: lax.integer_pow(x, 3), 1, ("i32", "i64"))
    found += _typed("nextafter", lax.nextafter, 2, ("f64", "f32"))
    return found + _folded()


def _folded() -> list[Case]:
    """Identities that look safe and are not, and known floats with floats."""

    def identities(x: Any) -> Any:
        known = [lax.rem(np.float64(a), np.float64(b)) for a, b in ((5.5, 2.0), (-5.5, 2.0), (1.0, 0.0))]
        return x + 0.0, x - 0.0, 0.0 - x, x * 0.0, x * 1.0, x / 1.0, 0.0 / x, x - x, x / x, jnp.stack(known)

    return spread("identities", identities, [edges("f64")])


def elementary() -> list[Case]:
    """Elementary functions, to a few units in the last place."""
    values = np.array([*FLOATS, *np.random.default_rng(1).normal(0, 3, 40), 0.7, -0.3, 1e5, 20.0, -30.0, 1e-9])
    found = []
    for op, ulp in ULP.items():
        found += spread(op.__name__, op, [values], ulp=ulp)
        if op not in (lax.logistic, lax.rsqrt):
            found += spread(f"{op.__name__} f32", op, [np.float32(values[5:12])], ulp=8, lanes=False)
    some = np.array([*FLOATS, 0.7, -3.0, 2.0, -8.0, 1 / 3, 17.25])
    found += spread("pow", lax.pow, [some, some], ulp=2)
    found += spread("pow of integer", lax.pow, [some, np.arange(-3, 4, dtype=np.int32)], ulp=4)
    return found + spread("atan2", lax.atan2, [some, some], ulp=2)


ULP = {
    lax.exp: 2,
    lax.exp2: 128,
    lax.expm1: 2,
    lax.log: 2,
    lax.log1p: 2,
    lax.sin: 2,
    lax.cos: 2,
    lax.tan: 4,
    lax.asin: 4,
    lax.acos: 4,
    lax.atan: 4,
    lax.sinh: 128,
    lax.cosh: 128,
    lax.tanh: 4,
    lax.asinh: 4,
    lax.acosh: 4,
    lax.atanh: 4,
    lax.erf: 4,
    lax.erfc: 4,
    lax.logistic: 4,
    lax.cbrt: 2,
    lax.rsqrt: 2,
}
"""Units in the last place between this JAX and ours. JAX gives exp2(-30), sinh, cosh of large numbers less exactly."""


def conversions() -> list[Case]:
    """Every type to every other; bits seen as numbers."""
    types = ("bool", "f64", "f32", *INTEGERS)
    found = []
    for source in types:
        for to in types:
            lanes = not {source, to} & set(NARROW)
            values = np.append(edges(source), np.array(LIMITS, NUMPY[source])) if source[0] == "f" else edges(source)

            def convert(x: Any, to: str = to) -> Any:
                return lax.convert_element_type(x, NUMPY[to])

            found += spread(f"{source} to {to}", convert, [values], lanes=lanes)
    for source, to in itertools.permutations(("f64", "i64", "u64"), 2):
        found += spread(f"bits {source} {to}", lambda x, to=to: lax.bitcast_convert_type(x, NUMPY[to]), [edges(source)])
    for source, to in itertools.permutations(("f32", "i32", "u32"), 2):
        wide = "f32" not in (source, to)
        function = lambda x, to=to: lax.bitcast_convert_type(x, NUMPY[to])  # noqa: E731
        found += spread(f"bits {source} {to}", function, [edges(source)], lanes=wide)
    return found


def choices() -> list[Case]:
    """select_n, clamp, and what only passes an array on."""
    f, i, truth = edges("f64"), np.array([0, 1, 2], np.int32), edges("bool")
    found = spread("select", lambda c, x: lax.select_n(c, x, -x), [truth, f])
    found += spread("select of three", lambda c, x: lax.select_n(c, x, -x, x * 2), [i, f])
    found += spread("select of bools", lambda c, x, y: lax.select_n(c, x, y), [truth, truth, truth])
    found += spread("select of known", lambda c: lax.select_n(c, jnp.ones_like(c), jnp.zeros_like(c)), [truth])
    found += spread("clamp", lambda x: lax.clamp(-1.0, x, 2.0), [f])
    found += spread("clamp by arrays", lambda x, y: lax.clamp(-jnp.abs(y), x, y), [f, f])
    found += spread("clamp i32", lambda x: lax.clamp(np.int32(-3), x, np.int32(9)), [edges("i32")])
    found += spread("selects of u32", lambda c, x: jnp.where(c, x, x + 1), [truth, edges("u32")])

    def passed(x: Any) -> Any:
        named = checkpoint_name(lax.stop_gradient(jnp.copy(x)), "here")
        return lax.optimization_barrier(jax.device_put(named)) + 1, -x

    return found + spread("passed on", passed, [f])
