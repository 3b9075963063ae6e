"""Arrays during lowering. A small array is one scalar per element. A large array is a buffer, processed by loops."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from trimtab.compiler.ir import NAMES, TYPES, Builder
from trimtab.compiler.values import Buffer, Value

UNROLL = 48
"""Number of elements above which an array is kept in a buffer and handled by loops."""
ROW = 24
"""Axis length above which an array is kept in a buffer.

For vectors with one element per beacon, loops are as fast as unrolled code, with far less text."""

Index = list[Value]


class ElementUpdate(NamedTuple):
    """Pending write of an element: row-major position, value, and the condition under which it is written."""

    position: Value
    number: Value
    inside: Value


class Array:
    """Array of one type. Its elements are in `items`, an object array of scalars, or in `buffer`, from `offset` on.

    updates: elements that are not yet written to the buffer. They are written once it is known whether the old elements
    are read later. If the old elements are read later, the updates are written to a copy of the buffer.
    """

    __slots__ = ("buffer", "dtype", "items", "offset", "shape", "updates")

    def __init__(
        self,
        shape: tuple[int, ...],
        dtype: str,
        items: Any = None,
        buffer: Buffer | None = None,
        offset: Any = None,
        updates: tuple[ElementUpdate, ...] = (),
    ) -> None:
        self.shape, self.dtype, self.items, self.buffer, self.offset = shape, dtype, items, buffer, offset
        self.updates = updates

    @property
    def size(self) -> int:
        """Return the number of elements of the array."""
        return math.prod(self.shape)


def type_name(dtype: Any) -> str:
    """Return the compiler's short name of a numpy type, e.g. f64. Raise KeyError for a type that has no C type."""
    return NAMES[np.dtype(dtype)]


def is_small(shape: tuple[int, ...]) -> bool:
    """Return True if an array of this shape is small: the compiler unrolls it into scalars."""
    return math.prod(shape) <= UNROLL and max(shape, default=0) <= ROW


def scalars(values: Sequence[Value], shape: tuple[int, ...], dtype: str) -> Array:
    """Return a small array of values in row-major order."""
    items = np.empty(len(values), object)
    items[:] = values
    return Array(shape, dtype, items.reshape(shape))


def scalar(value: Value) -> Array:
    """Return a scalar value as an array of shape ()."""
    return scalars([value], (), value.dtype)


def constant(b: Builder, data: Any, dtype: str | None = None) -> Array:
    """Return an array of constants."""
    data = np.asarray(data)
    dtype = dtype or type_name(data.dtype)
    if is_small(data.shape):
        return scalars([b.const(n, dtype) for n in data.ravel()], data.shape, dtype)
    return Array(data.shape, dtype, buffer=Buffer(dtype, data.size, "const", data=data.ravel()))


def flat_index(b: Builder, shape: tuple[int, ...], index: Index) -> Value:
    """Return the row-major position of an index into an array of this shape."""
    if all(i.op == "const" for i in index):
        at = 0
        for extent, i in zip(shape, index, strict=True):
            at = at * extent + int(i.const)
        return b.index(at)
    position = b.index(0)
    for extent, i in zip(shape, index, strict=True):
        position = b.op("mul", position, b.index(extent), dtype="i32")
        position = b.op("add", position, i, dtype="i32")
    return position


def read_flat(b: Builder, array: Array, position: Value) -> Value:
    """Return the element of an array at a row-major position."""
    if array.items is not None:
        if position.op == "const":
            return array.items.ravel()[int(position.const)]
        array = store_in_memory(b, array)
    assert array.buffer is not None
    if array.offset is not None:
        position = b.op("add", position, array.offset, dtype="i32")
    return b.load(array.buffer, position)


def read_element(b: Builder, array: Array, index: Index) -> Value:
    """Return the element of an array at an index. On an axis of length 1, the index counts as 0."""
    index = [b.index(0) if n == 1 else i for n, i in zip(array.shape, index, strict=True)]
    return read_flat(b, array, flat_index(b, array.shape, index))


def element_list(b: Builder, array: Array) -> list[Value]:
    """Return all elements of a small array, in row-major order."""
    if array.items is not None:
        return list(array.items.ravel())
    return [read_flat(b, array, b.index(i)) for i in range(array.size)]


def element_array(b: Builder, array: Array) -> Any:
    """Return all elements of a small array, as an object array of the same shape."""
    if array.items is not None:
        return array.items
    return scalars(element_list(b, array), array.shape, array.dtype).items


def store_in_memory(b: Builder, array: Array) -> Array:
    """Return the array in a read-only buffer. All reads at computed indices use the same buffer."""
    if array.items is None:
        return array
    elements = tuple(array.items.ravel())
    buffer = b.memoise(("stored", array.dtype, elements), lambda: _make_buffer(b, array.dtype, elements))
    return Array(array.shape, array.dtype, buffer=buffer)


def _make_buffer(b: Builder, dtype: str, elements: tuple[Value, ...]) -> Buffer:
    if all(v.op == "const" for v in elements):
        return Buffer(dtype, len(elements), "const", data=np.array([v.const for v in elements], TYPES[dtype]))
    made = b.local_buffer(dtype, len(elements))
    for i, v in enumerate(elements):
        b.store(made, b.index(i), v)
    return made


def loop_over_indices(b: Builder, shape: tuple[int, ...], body: Callable[[Index], None]) -> None:
    """Write nested loops over all indices of a shape."""

    def nest(index: Index) -> None:
        if len(index) == len(shape):
            body(index)
        elif shape[len(index)] == 1:
            nest([*index, b.index(0)])
        else:
            b.repeat(shape[len(index)], lambda i: nest([*index, i]))

    nest([])


def build_array(b: Builder, shape: tuple[int, ...], dtype: str, element: Callable[[Index], Value]) -> Array:
    """Return the array with element(index) at each index. A small array is unrolled; loops fill a large one."""
    if is_small(shape):
        found = [element([b.index(i) for i in index]) for index in np.ndindex(*shape)]
        return scalars(found, shape, dtype)
    made = Array(shape, dtype, buffer=b.local_buffer(dtype, math.prod(shape)))

    def write(index: Index) -> None:
        assert made.buffer is not None
        b.store(made.buffer, flat_index(b, shape, index), element(index))

    loop_over_indices(b, shape, write)
    return made


def copy_into(b: Builder, target: Buffer, source: Array) -> None:
    """Write all elements of an array into a buffer of the same size."""
    if source.items is not None:
        for i, v in enumerate(source.items.ravel()):
            b.store(target, b.index(i), v)
    elif source.size:
        b.repeat(source.size, lambda i: b.store(target, i, read_flat(b, source, i)))


def copy_array(b: Builder, array: Array) -> Array:
    """Return the array in a new buffer that has no other references."""
    made = b.local_buffer(array.dtype, array.size)
    copy_into(b, made, array)
    return Array(array.shape, array.dtype, buffer=made)


def apply_updates(b: Builder, array: Array, in_place: bool) -> Array:
    """Return the array with its pending updates written: into the array's own buffer if `in_place`, else into a
    copy."""
    plain = Array(array.shape, array.dtype, buffer=array.buffer)
    target = plain if in_place else copy_array(b, plain)
    write_updates(b, target, array.updates)
    return target


def write_updates(b: Builder, array: Array, updates: Iterable[ElementUpdate]) -> None:
    """Write the updates into an array's buffer, one after the other."""
    buffer = array.buffer
    assert buffer is not None
    for position, number, inside in updates:
        known = inside.op == "const" and inside.const
        new = number if known else b.op("select", inside, number, b.load(buffer, position), dtype=array.dtype)
        b.store(buffer, position, new)
