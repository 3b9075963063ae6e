"""Lowering rules for reductions along axes: sum, product, minimum, maximum and its position, also cumulative."""

import math
from collections.abc import Callable

import numpy as np

from trimtab.compiler.arrays import (
    UNROLL,
    Array,
    Index,
    build_array,
    flat_index,
    is_small,
    loop_over_indices,
    read_element,
)
from trimtab.compiler.ir import TYPES, Builder, is_float
from trimtab.compiler.lower import Rule, Site
from trimtab.compiler.values import Value

OPERATIONS = {
    "reduce_sum": "add",
    "reduce_prod": "mul",
    "reduce_max": "max",
    "reduce_min": "min",
    "reduce_and": "and",
    "reduce_or": "or",
    "reduce_xor": "xor",
}
RUNNING_OPERATIONS = {"cumsum": "add", "cumprod": "mul", "cummax": "max", "cummin": "min"}


def neutral_element(op: str, dtype: str) -> object:
    """Return the neutral element of an operation: the result of a reduction of no elements."""
    if op in ("add", "or", "xor"):
        return 0
    if op == "mul":
        return 1
    if op == "and":
        return True if dtype == "bool" else -1
    if is_float(dtype):
        return -np.inf if op == "max" else np.inf
    if dtype == "bool":
        return op == "min"
    limits = np.iinfo(TYPES[dtype])
    return limits.min if op == "max" else limits.max


def _merge_indices(index: Index, inner: Index, axes: tuple[int, ...]) -> Index:
    """Return the index of the operand, merged from the index of the result and the index along the reduced axes."""
    rest, along = iter(index), iter(inner)
    return [next(along) if a in axes else next(rest) for a in range(len(index) + len(inner))]


def accumulate(
    b: Builder,
    shape: tuple[int, ...],
    starts: list[Value],
    step: Callable[[Index, list[Value]], list[Value]],
    *,
    unroll: int = UNROLL,
) -> list[Value]:
    """Carry values over all indices of a shape in row-major order. More than `unroll` indices become loops."""
    if math.prod(shape) <= unroll:
        for index in np.ndindex(*shape):
            starts = step([b.index(i) for i in index], starts)
        return starts

    def nest(index: Index, carried: list[Value]) -> list[Value]:
        if len(index) == len(shape):
            return step(index, carried)
        return b.loop(shape[len(index)], carried, lambda i, inner: nest([*index, i], inner))

    return nest([], starts)


def _reduce(op: str) -> Rule:
    def rule(site: Site) -> list[Array]:
        b, array, axes = site.b, site.operands[0], tuple(site.params["axes"])
        along = tuple(array.shape[a] for a in axes)

        def element(index: Index) -> Value:
            def step(inner: Index, carried: list[Value]) -> list[Value]:
                value = read_element(b, array, _merge_indices(index, inner, axes))
                return [b.op(op, carried[0], value, dtype=site.dtype)] if carried else [value]

            start = [] if is_small(along) and 0 not in along else [b.const(neutral_element(op, site.dtype), site.dtype)]
            return accumulate(b, along, start, step)[0]

        return [build_array(b, site.shape, site.dtype, element)]

    return rule


def _extreme_position(better: str) -> Rule:
    """Return the rule of argmax or argmin. The first of equal numbers is chosen. NaN takes precedence over any
    number."""

    def rule(site: Site) -> list[Array]:
        b, array, axes = site.b, site.operands[0], tuple(site.params["axes"])
        along = tuple(array.shape[a] for a in axes)

        def element(index: Index) -> Value:
            def step(inner: Index, carried: list[Value]) -> list[Value]:
                value = read_element(b, array, _merge_indices(index, inner, axes))
                here = b.op("convert", flat_index(b, along, inner), dtype=site.dtype)
                if not carried:
                    return [value, here]
                best, where = carried
                wins = b.op(better, value, best, dtype="bool")
                if is_float(value.dtype):
                    first = b.op("eq", best, best, dtype="bool")
                    nan = b.op("and", b.op("ne", value, value, dtype="bool"), first, dtype="bool")
                    wins = b.op("or", wins, nan, dtype="bool")
                new = b.op("select", wins, value, best, dtype=value.dtype)
                return [new, b.op("select", wins, here, where, dtype=site.dtype)]

            zero = [b.index(0)] * len(along)
            start = [] if is_small(along) else step(zero, [])
            return accumulate(b, along, start, step)[1]

        return [build_array(b, site.shape, site.dtype, element)]

    return rule


def _running_reduction(op: str) -> Rule:
    def rule(site: Site) -> list[Array]:
        b, array = site.b, site.operands[0]
        axis, backwards = site.params["axis"], site.params["reverse"]
        n = array.shape[axis]
        rest = tuple(1 if a == axis else m for a, m in enumerate(array.shape))
        made = Array(site.shape, site.dtype, buffer=b.local_buffer(site.dtype, array.size))

        def lane(index: Index) -> None:
            def step(i: Value, carried: list[Value]) -> list[Value]:
                j = b.op("sub", b.index(n - 1), i, dtype="i32") if backwards else i
                here = [j if a == axis else k for a, k in enumerate(index)]
                value = b.op(op, carried[0], read_element(b, array, here), dtype=site.dtype)
                assert made.buffer is not None
                b.store(made.buffer, flat_index(b, site.shape, here), value)
                return [value]

            b.loop(n, [b.const(neutral_element(op, site.dtype), site.dtype)], step)

        loop_over_indices(b, rest, lane)
        return [made]

    return rule


RULES: dict[str, Rule] = {name: _reduce(op) for name, op in OPERATIONS.items()}
RULES |= {name: _running_reduction(op) for name, op in RUNNING_OPERATIONS.items()}
RULES |= {"argmax": _extreme_position("gt"), "argmin": _extreme_position("lt")}
