"""Lowering rule for products of arrays: small ones term by term, large ones by loops that a C compiler vectorises.

The terms of every element are added in the order of their index, whatever the order of the loops.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from trimtab.compiler.arrays import (
    Array,
    Index,
    build_array,
    constant,
    element_list,
    flat_index,
    is_small,
    loop_over_indices,
    read_element,
    scalars,
)
from trimtab.compiler.ir import is_float
from trimtab.compiler.lower import Rule, Site
from trimtab.compiler.rules.reduce import accumulate
from trimtab.compiler.values import Value

WIDTH = 8
"""Number of neighbouring elements of a result that are summed together."""
DEPTH = 16
"""Number of terms added before each store of a result, if there are too many terms to unroll the whole sum."""
PANEL = 1024
"""Minimum size of a factor whose neighbouring columns are copied to contiguous memory before use for all rows."""
PACK = 4
"""Minimum number of rows for which a factor is transposed first, so that its elements for one row are contiguous."""


Read = Callable[[Index, Value], Value]


class _Factor:
    """Array in a product. Axes are: batch (in both factors), along (summed over), free (only in this factor)."""

    def __init__(self, array: Array, along: tuple[int, ...], batch: tuple[int, ...]) -> None:
        self.array, self.along, self.batch = array, along, batch
        self.free = tuple(a for a in range(len(array.shape)) if a not in along and a not in batch)

    @property
    def extents(self) -> tuple[int, ...]:
        """Return the lengths of the free axes."""
        return tuple(self.array.shape[a] for a in self.free)

    def is_contiguous(self) -> bool:
        """Return True if elements along the last free axis are next to each other in memory."""
        return all(self.array.shape[a] == 1 for a in range(self.free[-1] + 1, len(self.array.shape)))

    def read(self, site: Site, batch: Index, along: Index, free: Index) -> Value:
        """Return an element of the factor, converted to the type of the result."""
        axes = [*zip(self.batch, batch, strict=True), *zip(self.along, along, strict=True)]
        places = dict([*axes, *zip(self.free, free, strict=True)])
        value = read_element(site.b, self.array, [places[a] for a in range(len(places))])
        return site.b.op("convert", value, dtype=site.dtype)

    @property
    def is_known(self) -> bool:
        """Return True if the factor's numbers are constants, or scalar values that are not in memory."""
        return self.array.buffer is None or self.array.buffer.data is not None

    @property
    def is_constant(self) -> bool:
        """Return True if nothing writes to the factor's buffer."""
        return self.array.buffer is not None and self.array.buffer.is_read_only and self.array.offset is None

    def pack(self, site: Site) -> "_Factor":
        """Return the factor with its axes in the order batch, along, free.

        Constants are reordered here, not in C. A read-only input is reordered once, before all loops.
        """
        order = [*self.batch, *self.along, *self.free]
        places = [int(a) for a in np.argsort(order)]
        array, b = self.array, site.b
        shape = tuple(array.shape[a] for a in order)

        def move() -> Array:
            if array.buffer is not None and array.buffer.data is not None:
                return constant(b, np.reshape(array.buffer.data, array.shape).transpose(order), array.dtype)
            return build_array(b, shape, array.dtype, lambda at: read_element(b, array, [at[k] for k in places]))

        if array.items is not None:
            packed = Array(shape, array.dtype, array.items.transpose(order))
        elif self.is_constant:
            # The key contains everything on which the copy depends. The same numbers reshaped are another matrix.
            packed = b.before_all(("packed", array.buffer, array.shape, array.dtype, tuple(order)), move)
        else:
            packed = move()
        first, last = len(self.batch), len(self.batch) + len(self.along)
        return _Factor(packed, tuple(range(first, last)), tuple(range(first)))


class _Product:
    """Product written as loops. Neighbours in a row of the result share elements of `rows` and differ in `columns`."""

    def __init__(self, site: Site, rows: _Factor, columns: _Factor, swapped: bool) -> None:
        self.site, self.b, self.rows, self.columns, self.swapped = site, site.b, rows, columns, swapped
        self.batch = tuple(rows.array.shape[a] for a in rows.batch)
        self.along = tuple(rows.array.shape[a] for a in rows.along)
        buffer = self.b.local_buffer(site.dtype, math.prod(site.shape))
        self.buffer, self.result = buffer, Array(site.shape, site.dtype, buffer=buffer)
        # -0 + x is x, also for x = -0, so the sum equals the unrolled sum, which starts with the first product
        zero = -0.0 if is_float(site.dtype) and is_small(self.along) else 0
        self.zero = self.b.const(zero, site.dtype)

    def position(self, batch: Index, row: Index, column: Index) -> Value:
        """Return the row-major position of an element of the result."""
        own = [*column, *row] if self.swapped else [*row, *column]
        return flat_index(self.b, self.site.shape, [*batch, *own])

    def add_term(self, total: Value, p: Value, q: Value) -> Value:
        return self.b.op("add", total, self.b.op("mul", p, q, dtype=self.site.dtype), dtype=self.site.dtype)

    def for_each_tile(self, body: Any) -> None:
        """Run body(batch, row, head, first, width, read) for `width` neighbours in a row of the result from `first` on.

        read(along, j) returns the element of the factor `columns` for neighbour j.
        """
        b, n = self.b, self.columns.extents[-1]
        whole = math.prod(self.rows.extents) == 1 and self.columns.is_contiguous()
        width = n if whole or n <= 2 * WIDTH else WIDTH

        def tiles(batch: Index, head: Index, first: Value, count: int) -> None:
            read = self.reader(batch, head, first)
            if width < n and math.prod(self.along) * n > PANEL:
                read = self.copy_panel(read, count)
            loop_over_indices(b, self.rows.extents, lambda row: body(batch, row, head, first, count, read))

        def columns(batch: Index, head: Index) -> None:
            if width < n:
                b.repeat(n // width, lambda k: tiles(batch, head, b.op("mul", k, b.index(width), dtype="i32"), width))
            else:
                tiles(batch, head, b.index(0), n)
            if n % width:
                tiles(batch, head, b.index(n - n % width), n % width)

        heads = self.columns.extents[:-1]
        loop_over_indices(b, self.batch, lambda batch: loop_over_indices(b, heads, lambda head: columns(batch, head)))

    def reader(self, batch: Index, head: Index, first: Value) -> Read:
        """Return a function that reads the factor `columns` in place."""

        def read(along: Index, j: Value) -> Value:
            column = [*head, self.b.op("add", first, j, dtype="i32")]
            return self.columns.read(self.site, batch, along, column)

        return read

    def copy_panel(self, read: Read, width: int) -> Read:
        """Return a function that reads a contiguous copy, because rows far apart in memory evict each other from the
        cache."""
        b, size = self.b, math.prod(self.along) * width
        panel = Array((*self.along, width), self.site.dtype, buffer=b.local_buffer(self.site.dtype, size))

        def copy(index: Index) -> None:
            assert panel.buffer is not None
            b.store(panel.buffer, flat_index(b, panel.shape, index), read(index[:-1], index[-1]))

        loop_over_indices(b, panel.shape, copy)
        return lambda along, j: read_element(b, panel, [*along, j])

    def sum_neighbours(self, batch: Index, row: Index, head: Index, first: Value, width: int, read: Read) -> None:
        """Sum neighbours side by side. The loop over neighbours is the innermost, so that it is vectorised."""
        b = self.b

        def column(j: Value) -> Index:
            return [*head, b.op("add", first, j, dtype="i32")]

        def add_block(terms: list[Index], begin: bool) -> None:
            factors = [self.rows.read(self.site, batch, k, row) for k in terms]

            def one(j: Value) -> None:
                place = self.position(batch, row, column(j))
                total = self.zero if begin else b.load(self.buffer, place)
                for p, k in zip(factors, terms, strict=True):
                    total = self.add_term(total, p, read(k, j))
                b.store(self.buffer, place, total)

            b.repeat(width, one)

        if is_small(self.along):
            add_block([[b.index(i) for i in index] for index in np.ndindex(*self.along)], True)
            return
        b.repeat(width, lambda j: b.store(self.buffer, self.position(batch, row, column(j)), self.zero))
        n = self.along[-1]

        def add_all(outer: Index) -> None:
            def terms(start: Value, count: int) -> list[Index]:
                return [[*outer, b.op("add", start, b.index(i), dtype="i32")] for i in range(count)]

            b.repeat(n // DEPTH, lambda k: add_block(terms(b.op("mul", k, b.index(DEPTH), dtype="i32"), DEPTH), False))
            if n % DEPTH:
                add_block(terms(b.index(n - n % DEPTH), n % DEPTH), False)

        loop_over_indices(b, self.along[:-1], add_all)

    def sum_together(self, batch: Index, row: Index, head: Index, first: Value, width: int, read: Read) -> None:
        """Sum neighbours that are apart in memory. One loop carries all sums, so that no sum waits for another."""
        b = self.b
        columns = [[*head, b.op("add", first, b.index(j), dtype="i32")] for j in range(width)]

        def step(inner: Index, carried: list[Value]) -> list[Value]:
            p = self.rows.read(self.site, batch, inner, row)
            return [self.add_term(total, p, read(inner, b.index(j))) for j, total in enumerate(carried)]

        totals = accumulate(b, self.along, [self.zero] * width, step, unroll=DEPTH)
        for column, total in zip(columns, totals, strict=True):
            b.store(self.buffer, self.position(batch, row, column), total)


def _dot_general(site: Site) -> list[Array]:
    (along_x, along_y), (batch_x, batch_y) = site.params["dimension_numbers"]
    x = _Factor(site.operands[0], tuple(along_x), tuple(batch_x))
    y = _Factor(site.operands[1], tuple(along_y), tuple(batch_y))
    along = tuple(site.operands[0].shape[a] for a in along_x)
    if 0 in (*along, *site.shape) or (is_small(site.shape) and is_small(along)) or not (x.free or y.free):
        return [_sum_each(site, x, y, along)]
    swapped = math.prod(y.extents) < PACK <= math.prod(x.extents) or not y.free
    rows, columns = (y, x) if swapped else (x, y)
    often = math.prod(rows.extents) >= PACK or (columns.is_constant and site.b.is_in_loop)
    if not columns.is_contiguous() and (columns.is_known or often):
        columns = columns.pack(site)
    product = _Product(site, rows, columns, swapped)
    product.for_each_tile(product.sum_neighbours if columns.is_contiguous() else product.sum_together)
    if is_small(site.shape):
        return [scalars(element_list(site.b, product.result), site.shape, site.dtype)]
    return [product.result]


def _sum_each(site: Site, x: _Factor, y: _Factor, along: tuple[int, ...]) -> Array:
    """Return a small product: the terms of each element are summed separately."""
    b = site.b

    def element(index: Index) -> Value:
        n, m = len(x.batch), len(x.batch) + len(x.free)
        batch, left, right = index[:n], index[n:m], index[m:]

        def step(inner: Index, carried: list[Value]) -> list[Value]:
            p, q = x.read(site, batch, inner, left), y.read(site, batch, inner, right)
            product = b.op("mul", p, q, dtype=site.dtype)
            return [b.op("add", carried[0], product, dtype=site.dtype)] if carried else [product]

        start = [] if is_small(along) and 0 not in along else [b.const(0, site.dtype)]
        return accumulate(b, along, start, step)[0]

    return build_array(b, site.shape, site.dtype, element)


RULES: dict[str, Rule] = {"dot_general": _dot_general}
