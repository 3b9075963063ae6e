"""Random functions of random trees of arrays, for `trimtab.compile`: Python text made from a number.

Axes have 0 to 130 elements, some thousands, so that arrays are single variables, memory and workspace in turn. Floats
are sums of what is given, or rough (see `contracts.array_expressions`).
"""

import functools
import re
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import lax
from jax import numpy as jnp

from contracts.array_expressions import FAMILIES, ROUGH

jax.config.update("jax_enable_x64", True)  # before the first function is made

WIDE = ["float64", "float64", "float64", "float32", "float32", "int32", "int32", "int64", "int64", "uint32", "bool"]
NARROW = [*WIDE, "int8", "int16", "uint8", "uint16", "uint64", "uint64"]
KINDS = {"f": "f", "F": "f", "i": "iu", "n": "fiu", "b": "b", "x": "fiub", "X": "fiub"}
LEAVES = 40
"""Leaves that a function does not read, in some trees: more than a call has room for on its stack."""
MOST = 4000
"""Elements of an array, but for one."""


def tamed(x: Any) -> Any:
    """Numbers up to 8, infinities and NaN: their sums and products round, but never overflow."""
    return jnp.where(jnp.isfinite(x), jnp.clip(x, -8, 8), x)


def finite(x: Any) -> Any:
    """Numbers up to 8 only."""
    return jnp.where(jnp.isfinite(x), jnp.clip(x, -8, 8), 1)


def positive(x: Any) -> Any:
    """A positive definite matrix with some of these numbers."""
    a = jnp.resize(finite(x).ravel(), (3, 3)) / 8
    return a @ a.T + 3 * jnp.eye(3, dtype=x.dtype)


def lowest(x: Any) -> Any:
    """The least number of the type."""
    return np.asarray(-np.inf if x.dtype.kind == "f" else np.iinfo(x.dtype).min, x.dtype)


def zero(x: Any) -> Any:
    """Zero of the type."""
    return np.zeros((), x.dtype)


def unsigned(x: Any) -> Any:
    """Numbers, and NaN without a sign: top_k depends on the sign of a NaN, which is not promised."""
    return jnp.where(x != x, jnp.abs(x), x) if x.dtype.kind == "f" else x


def table(x: Any, dtype: str = "") -> Any:
    """A table of small numbers in the shape of x: one object for each shape and type, as a function's own table is."""
    return _table(x.shape, dtype or str(x.dtype))


@functools.cache
def _table(shape: tuple[int, ...], dtype: str) -> Any:
    numbers = np.arange(np.prod(shape, dtype=int)) * 5 % 7
    with jax.ensure_compile_time_eval():  # it outlives the tracing that asks for it first
        return jnp.asarray(numbers.reshape(shape) - (0 if dtype[0] in "ub" else 3), dtype)


class Named(NamedTuple):
    """A named tuple of arrays."""

    first: Any
    others: Any


SPACE = {"jnp": jnp, "lax": lax, "jax": jax, "T": tamed, "C": finite, "S": positive, "L": lowest, "Z": zero}
SPACE |= {"U": unsigned, "K": table}


class Variable(NamedTuple):
    """rough: a float that is not JAX's to the bit."""

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    rough: bool = False


class RandomCall(NamedTuple):
    """A function in text, and its arguments."""

    seed: int
    inputs: list[Variable]
    statements: list[tuple[str, str]]
    outputs: list[Variable]

    def text(self) -> str:
        """The function in Python."""
        names = ", ".join(v.name for v in self.inputs)
        lines = [f"def call(tree):\n    {names}, *_ = jax.tree.leaves(tree)"]
        lines += [f"    {name} = {text}" for name, text in self.statements]
        a, *rest = [v.name for v in self.outputs]
        return "\n".join([*lines, f"    return {{'first': {a}, 'rest': [({', '.join(rest)},), None]}}"])

    def function(self) -> Callable[..., Any]:
        """The function."""
        space: dict[str, Any] = dict(SPACE)
        exec(self.text(), space)
        return space["call"]

    def arguments(self, k: int, tiny: bool = False) -> Any:
        """The tree of set k. tiny: subnormal numbers too, which JAX takes as zero."""
        rng = np.random.default_rng([self.seed, k])
        arrays = [random_array(rng, v.shape, v.dtype, tiny) for v in self.inputs]
        half = len(arrays) // 2
        many = [float(n) for n in range(LEAVES)]
        kinds = [tuple(arrays), {"a": arrays[:half], "b": tuple(arrays[half:])}, [arrays[0], None, tuple(arrays[1:])]]
        kinds += [Named(arrays[0], arrays[1:]), [*arrays, *many]]
        return kinds[self.seed % len(kinds)]


def random_array(rng: np.random.Generator, shape: tuple[int, ...], dtype: Any, tiny: bool) -> Any:
    """An array with odd numbers among plain ones."""
    dtype = np.dtype(dtype)
    if dtype.kind == "b":
        return np.asarray(rng.random(shape) < 0.5)
    if dtype.kind == "f":
        x = np.where(rng.random(shape) < 0.5, rng.integers(-32, 33, shape) / 4, rng.normal(size=shape) * 3)
        odd = [np.nan, np.inf, -np.inf, -0.0, 0.0, 1e30, -1e30, 1e-30, 2.0**31, -(2.0**63), 0.5, 2.5]
        odd += [float(np.finfo(dtype).smallest_subnormal), -float(np.finfo(dtype).tiny) / 3] * (3 * tiny)
        return np.asarray(np.where(rng.random(shape) < rng.choice([0.0, 0.15]), rng.choice(odd, shape), x), dtype)
    limits = np.iinfo(dtype)
    small = rng.integers(0 if dtype.kind == "u" else -6, 7, shape).astype(dtype)
    large = rng.integers(limits.min, limits.max, shape, dtype=dtype, endpoint=True)
    ends = rng.choice(np.array([limits.min, limits.max, limits.max - 1, 1], dtype), shape)
    u = rng.random(shape)
    return np.asarray(np.where(u < 0.7, small, np.where(u < 0.85, large, ends)), dtype)


def random_call(seed: int, narrow: bool = False) -> RandomCall:
    """The function of a number. narrow: with types that are not carried in lanes."""
    return _Maker(seed, NARROW if narrow else WIDE).make()


class _Maker:
    def __init__(self, seed: int, types: list[str]) -> None:
        self.seed, self.types = seed, types
        self.rng = np.random.default_rng([seed, 14])
        lengths = [0, 1, 2, 3, 3, 4, 5, 7, 12, 47, 48, 49, 60, 130]
        self.axes = [int(n) for n in self.rng.choice(lengths, 3)]
        self.shapes = [self.shape() for _ in range(4)] + [(), (self.axes[0],)]
        if seed % 50 == 0:
            self.shapes.append((int(self.rng.choice([3000, 9000, 20_000])),))
        self.env: list[Variable] = []
        self.statements: list[tuple[str, str]] = []

    def one(self, choices: Any) -> Any:
        return choices[int(self.rng.integers(len(choices)))]

    def shape(self) -> tuple[int, ...]:
        while True:
            shape = tuple(self.one(self.axes) for _ in range(self.one([0, 1, 1, 2, 2, 3, 4])))
            if np.prod(shape, dtype=int) <= MOST:
                return shape

    def make(self) -> RandomCall:
        kinds = ["float64", "int32", "bool", *(self.one(self.types) for _ in range(self.one([2, 3, 5])))]
        given = [Variable(f"a{k}", self.one(self.shapes), np.dtype(t)) for k, t in enumerate(kinds)]
        given.append(Variable(f"a{len(given)}", (), np.dtype(self.one(["int32", "int64"]))))
        self.env = list(given)
        tries, wanted = 0, len(given) + self.one([3, 5, 8])
        while tries < 60 and len(self.env) < wanted:
            tries += 1
            self.add_statement(given)
        outputs = self.env[len(given) :][-6:] or given[:2]
        return RandomCall(self.seed, given, self.statements, outputs)

    def add_statement(self, given: list[Variable]) -> None:
        family = self.one(FAMILIES)
        chosen: dict[str, Variable] = {}
        text = self.fill(self.one(family), chosen, given)
        if text is None:
            return
        used = {v.name: v for v in chosen.values()}
        used |= {v.name: v for v in self.env if re.search(rf"\b{v.name}\b", text)}
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                like = jax.eval_shape(
                    lambda *values: eval(text, {**SPACE, **dict(zip(used, values, strict=True))}),
                    *(jax.ShapeDtypeStruct(v.shape, v.dtype) for v in used.values()),
                )
        except (TypeError, ValueError, IndexError, NotImplementedError, ZeroDivisionError, OverflowError):
            return  # shapes that do not fit
        if not isinstance(like, jax.ShapeDtypeStruct) or like.size > 30_000 or str(like.dtype) not in self.types:
            return
        rough = like.dtype.kind == "f" and (family is ROUGH or any(v.rough for v in used.values()))
        name = f"v{len(self.statements)}"
        self.statements.append((name, text))
        self.env.append(Variable(name, like.shape, like.dtype, rough))

    def fill(self, template: str, chosen: dict[str, Variable], given: list[Variable]) -> str | None:
        """The template with variables in it; None where there are none of that kind."""
        pieces = re.split(r"\{(\w+(?:~\w+)?)\}", template)
        for k in range(1, len(pieces), 2):
            text = self.name(pieces[k], chosen, given)
            if text is None:
                return None
            pieces[k] = text
        return "".join(pieces)

    def name(self, place: str, chosen: dict[str, Variable], given: list[Variable]) -> str | None:
        whole = [v.name for v in given if v.dtype.kind in "iu" and v.shape == ()]
        if place == "axis":
            return str(self.one(["None", "0", "-1"]))
        if place == "type":
            return str(self.one(self.types))
        if place == "number":
            return str(self.one([-2, -1, 0, 1, 3]))
        if place == "index":
            return f"{self.one(whole)}.astype('int32')"
        if place == "bit":
            return f"({self.one(whole)} > 0)"
        if place == "given":  # a divisor that XLA knows to be zero brings its compiler down
            like = chosen["i0"]
            fits = [v.name for v in given if v.dtype == like.dtype and v.shape in (like.shape, ())]
            return f"jnp.broadcast_to({self.one(fits)}, {like.shape})" if fits else None
        key, _, model = place.partition("~")
        if key not in chosen:
            fits = [v for v in self.env if v.dtype.kind in KINDS[key[0]] and (not v.rough or key[0] in "FX")]
            if model:
                like = chosen[model]
                fits = [v for v in fits if v.dtype == like.dtype and v.shape == like.shape]
            if not fits:
                return None
            chosen[key] = self.one(fits)
        return chosen[key].name
