"""Lowering rules for primitives that only move elements. Small arrays cost nothing at run time, large ones a loop."""

import math
from collections.abc import Callable

import numpy as np

from trimtab.compiler.arrays import (
    Array,
    Index,
    build_array,
    element_array,
    flat_index,
    is_small,
    loop_over_indices,
    read_element,
)
from trimtab.compiler.lower import Rule, Site
from trimtab.compiler.values import Value


def _rearrange(site: Site, array: Array, shape: tuple[int, ...], from_: Callable[[Index], Index]) -> Array:
    return build_array(site.b, shape, array.dtype, lambda index: read_element(site.b, array, from_(index)))


def _strided_index(site: Site, i: Value, start: int, step: int = 1) -> Value:
    b = site.b
    if i.op == "const":
        return b.index(int(i.const) * step + start)
    return b.op("add", b.op("mul", i, b.index(step), dtype="i32"), b.index(start), dtype="i32")


def reshape_array(array: Array, shape: tuple[int, ...]) -> Array:
    """Return the same elements in another shape. The new array uses the same buffer."""
    if array.items is not None:
        return Array(shape, array.dtype, array.items.reshape(shape))
    return Array(shape, array.dtype, buffer=array.buffer, offset=array.offset)


def _squeeze(site: Site) -> list[Array]:
    return [reshape_array(site.operands[0], site.shape)]


def _reshape(site: Site) -> list[Array]:
    """Return the elements in another shape, read in the order of the parameter `dimensions`."""
    array, axes = site.operands[0], site.params["dimensions"]
    if axes is not None:
        order = [int(a) for a in np.argsort(axes)]
        shape = tuple(array.shape[a] for a in axes)
        array = _rearrange(site, array, shape, lambda index: [index[a] for a in order])
    return [reshape_array(array, site.shape)]


def _broadcast(site: Site) -> list[Array]:
    axes = site.params["broadcast_dimensions"]
    return [_rearrange(site, site.operands[0], site.shape, lambda index: [index[a] for a in axes])]


def _transpose(site: Site) -> list[Array]:
    order = [int(a) for a in np.argsort(site.params["permutation"])]
    return [_rearrange(site, site.operands[0], site.shape, lambda index: [index[a] for a in order])]


def _slice(site: Site) -> list[Array]:
    start = site.params["start_indices"]
    step = site.params["strides"] or (1,) * len(start)

    def from_(index: Index) -> Index:
        # an axis of length 1 in the result may start anywhere in the operand
        return [_strided_index(site, i, s, d) for i, s, d in zip(index, start, step, strict=True)]

    return [_rearrange(site, site.operands[0], site.shape, from_)]


def _split(site: Site) -> list[Array]:
    axis, found, start = site.params["axis"], [], 0
    for var in site.equation.outvars:
        at = start

        def from_(index: Index, at: int = at) -> Index:
            return [_strided_index(site, i, at) if a == axis else i for a, i in enumerate(index)]

        found.append(_rearrange(site, site.operands[0], var.aval.shape, from_))
        start += var.aval.shape[axis]
    return found


def _concatenate(site: Site) -> list[Array]:
    axis = site.params["dimension"]
    return [concatenate_arrays(site, site.operands, axis)]


def concatenate_arrays(site: Site, parts: list[Array], axis: int) -> Array:
    """Return arrays concatenated along an axis, with the shape of the equation's result."""
    if is_small(site.shape):
        joined = np.concatenate([element_array(site.b, p) for p in parts], axis)
        return Array(site.shape, site.dtype, joined)
    b, made, start = site.b, site.lowering.b.local_buffer(site.dtype, math.prod(site.shape)), 0

    def write_part(part: Array, start: int) -> Callable[[Index], None]:
        def write(index: Index) -> None:
            to = [_strided_index(site, i, start) if a == axis else i for a, i in enumerate(index)]
            b.store(made, flat_index(b, site.shape, to), read_element(b, part, index))

        return write

    for part in parts:
        write = write_part(part, start)
        if part.items is None:
            loop_over_indices(b, part.shape, write)
        else:
            for index in np.ndindex(*part.shape):
                write([b.index(i) for i in index])
        start += part.shape[axis]
    return Array(site.shape, site.dtype, buffer=made)


def _stack(site: Site) -> list[Array]:
    axis = site.params["axis"]
    widened = [reshape_array(a, (*a.shape[:axis], 1, *a.shape[axis:])) for a in site.operands]
    return [concatenate_arrays(site, widened, axis)]


def _unstack(site: Site) -> list[Array]:
    axis, b = site.params["axis"], site.b

    def part(k: int) -> Array:
        return _rearrange(site, site.operands[0], site.shape, lambda index: [*index[:axis], b.index(k), *index[axis:]])

    return [part(k) for k in range(len(site.equation.outvars))]


def _tile(site: Site) -> list[Array]:
    array, b = site.operands[0], site.b
    shape = (1,) * (len(site.shape) - len(array.shape)) + array.shape

    def from_(index: Index) -> Index:
        return [b.op("rem", i, b.index(max(n, 1)), dtype="i32") for i, n in zip(index, shape, strict=True)]

    return [_rearrange(site, reshape_array(array, shape), site.shape, from_)]


def _rev(site: Site) -> list[Array]:
    axes = site.params["dimensions"]

    def from_(index: Index) -> Index:
        return [_strided_index(site, i, site.shape[a] - 1, -1) if a in axes else i for a, i in enumerate(index)]

    return [_rearrange(site, site.operands[0], site.shape, from_)]


def _pad(site: Site) -> list[Array]:
    array, fill = site.operands
    b, config = site.b, site.params["padding_config"]

    def element(index: Index) -> Value:
        inside = b.const(1, "bool")
        origin: Index = []
        for i, n, (low, _, interior) in zip(index, array.shape, config, strict=True):
            step = b.index(interior + 1)
            shifted = _strided_index(site, i, -low)
            within = b.op("ge", shifted, b.index(0), dtype="bool")
            position = b.op("div", shifted, step, dtype="i32")
            exact = b.op("eq", b.op("rem", shifted, step, dtype="i32"), b.index(0), dtype="bool")
            below = b.op("lt", position, b.index(n), dtype="bool")
            for test in (within, exact, below):
                inside = b.op("and", inside, test, dtype="bool")
            origin.append(position)
        if inside.op == "const":
            return read_element(b, array, origin) if inside.const else read_element(b, fill, [])
        return b.branch(inside, lambda: read_element(b, array, origin), lambda: read_element(b, fill, []))

    return [build_array(b, site.shape, site.dtype, element)]


RULES: dict[str, Rule] = {
    "reshape": _reshape,
    "squeeze": _squeeze,
    "broadcast_in_dim": _broadcast,
    "transpose": _transpose,
    "slice": _slice,
    "split": _split,
    "concatenate": _concatenate,
    "stack": _stack,
    "unstack": _unstack,
    "tile": _tile,
    "rev": _rev,
    "pad": _pad,
}
