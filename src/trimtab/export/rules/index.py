"""Rules for reading and writing at computed indices: slices, gathers (lookup tables), updates, scatters."""

import numpy as np
from jax import lax

from trimtab.export.arrays import (
    Array,
    Index,
    at,
    build,
    constant,
    copied,
    every,
    items,
    linear,
    read,
    scalars,
    small,
    values,
)
from trimtab.export.ir import Value, is_float
from trimtab.export.lower import Rule, Site

MODE = lax.GatherScatterMode


def clamped(site: Site, start: Value, extent: int, window: int) -> Value:
    """A start index brought into range, so that the window fits, as an int32."""
    b = site.b
    most = extent - window
    if most == 0:
        return b.index(0)
    if start.dtype[0] == "u":
        high = b.op("min", start, b.const(most, start.dtype), dtype=start.dtype)
        return b.op("convert", high, dtype="i32")
    low = b.op("max", start, b.const(0, start.dtype), dtype=start.dtype)
    return b.op("convert", b.op("min", low, b.const(most, start.dtype), dtype=start.dtype), dtype="i32")


def _starts(site: Site, array: Array, window: tuple[int, ...], given: list[Array]) -> Index:
    found = [values(site.b, s)[0] for s in given]
    return [clamped(site, s, n, w) for s, n, w in zip(found, array.shape, window, strict=True)]


def _plus(site: Site, starts: Index, index: Index) -> Index:
    return [site.b.op("add", s, i, dtype="i32") for s, i in zip(starts, index, strict=True)]


def _dynamic_slice(site: Site) -> list[Array]:
    array = site.operands[0]
    starts = _starts(site, array, site.shape, site.operands[1:])
    return [sliced(site, array, starts)]


def sliced(site: Site, array: Array, starts: Index) -> Array:
    """A window of the site's shape from in-range starts; small arrays are read by selects or a table."""
    return build(site.b, site.shape, array.dtype, lambda index: read(site.b, array, _plus(site, starts, index)))


def writable(site: Site, which: int) -> Array:
    """Operand `which` in a buffer that may be written: its own where nobody reads it afterwards, else a copy."""
    array = site.operands[which]
    if array.items is None and site.dying[which] and array.offset is None:
        return array
    return copied(site.b, array)


def _dynamic_update_slice(site: Site) -> list[Array]:
    b, (array, update) = site.b, site.operands[:2]
    starts = _starts(site, array, update.shape, site.operands[2:])
    if small(array.shape) and array.items is not None and all(s.op == "const" for s in starts):
        new = array.items.copy()
        window = tuple(slice(int(s.const), int(s.const) + n) for s, n in zip(starts, update.shape, strict=True))
        new[window] = items(b, update)
        return [Array(array.shape, array.dtype, new)]
    if small(array.shape) and array.items is not None and update.size == 1:
        return [_replaced(site, array, starts, values(b, update)[0])]
    update = _apart(site, update, array)
    target = writable(site, 0)
    buffer = target.buffer
    assert buffer is not None

    def write(index: Index) -> None:
        b.store(buffer, linear(b, array.shape, _plus(site, starts, index)), read(b, update, index))

    if small(update.shape):
        for index in np.ndindex(*update.shape):
            write([b.index(i) for i in index])
    else:
        every(b, update.shape, write)
    return [target]


def _apart(site: Site, update: Array, array: Array) -> Array:
    """The update where it shares no memory with what is written."""
    if update.items is None and update.buffer is array.buffer:
        return copied(site.b, update)
    return update


def _replaced(site: Site, array: Array, starts: Index, value: Value) -> Array:
    """A small array with one element replaced: a select for each, no memory."""
    b, where = site.b, linear(site.b, array.shape, starts)
    new = [
        b.op("select", b.op("eq", where, b.index(i), dtype="bool"), value, old, dtype=array.dtype)
        for i, old in enumerate(values(b, array))
    ]
    return scalars(new, array.shape, array.dtype)


class Windows:
    """Where the windows of a gather or scatter lie: from its dimension numbers and its array of indices."""

    def __init__(self, site: Site, array: Array, indices: Array, sizes: tuple[int, ...], to: tuple[int, ...]) -> None:
        self.site, self.array, self.indices, self.sizes, self.to = site, array, indices, sizes, to

    def starts(self, batch: Index, paired: dict[int, int]) -> tuple[Index, Value]:
        """Start of the window of one batch index, brought into range, and whether it was in range already."""
        b, array = self.site.b, self.array
        found: Index = [b.index(0)] * len(array.shape)
        inside = b.const(1, "bool")
        for k, axis in enumerate(self.to):
            start = read(b, self.indices, [*batch, b.index(k)])
            most = array.shape[axis] - self.sizes[axis]
            for test, limit in (("ge", 0), ("le", most)):
                if test == "ge" and start.dtype[0] == "u":
                    continue
                within = b.op(test, start, b.const(limit, start.dtype), dtype="bool")
                inside = b.op("and", inside, within, dtype="bool")
            found[axis] = clamped(self.site, start, array.shape[axis], self.sizes[axis])
        for axis, of_batch in paired.items():
            found[axis] = batch[of_batch]
        return found, inside


def _gather(site: Site) -> list[Array]:
    b, (array, indices) = site.b, site.operands
    numbers, mode = site.params["dimension_numbers"], site.params["mode"]
    sizes = site.params["slice_sizes"]
    windows = Windows(site, array, indices, sizes, numbers.start_index_map)
    paired = dict(zip(numbers.operand_batching_dims, numbers.start_indices_batching_dims, strict=True))
    gone = {*numbers.collapsed_slice_dims, *numbers.operand_batching_dims}
    kept = [a for a in range(len(array.shape)) if a not in gone]
    fill = _fill(site, array)

    def element(index: Index) -> Value:
        batch = [i for a, i in enumerate(index) if a not in numbers.offset_dims]
        inner = [index[a] for a in numbers.offset_dims]
        starts, inside = windows.starts(batch, paired)
        place = list(starts)
        for a, i in zip(kept, inner, strict=True):
            place[a] = b.op("add", starts[a], i, dtype="i32")
        value = read(b, array, place)
        if mode in (MODE.CLIP, MODE.PROMISE_IN_BOUNDS):
            return value
        return b.op("select", inside, value, fill, dtype=array.dtype)

    return [build(b, site.shape, array.dtype, element)]


def _fill(site: Site, array: Array) -> Value:
    given = site.params["fill_value"]
    if given is None:
        if is_float(array.dtype):
            given = np.nan
        elif array.dtype == "bool":
            given = True
        else:
            limits = np.iinfo(np.dtype(array.dtype.replace("i", "int").replace("u", "uint").replace("uuint", "uint")))
            given = limits.min if array.dtype[0] == "i" else limits.max
    return values(site.b, constant(site.b, np.asarray(given), array.dtype))[0]


def _scatter(combine: str | None) -> Rule:
    def rule(site: Site) -> list[Array]:
        b, (array, indices, updates) = site.b, site.operands
        numbers, mode = site.params["dimension_numbers"], site.params["mode"]
        gone = {*numbers.inserted_window_dims, *numbers.operand_batching_dims}
        kept = [a for a in range(len(array.shape)) if a not in gone]
        extents = [updates.shape[a] for a in numbers.update_window_dims]
        sizes = [1] * len(array.shape)
        for a, n in zip(kept, extents, strict=True):
            sizes[a] = n
        windows = Windows(site, array, indices, tuple(sizes), numbers.scatter_dims_to_operand_dims)
        paired = dict(zip(numbers.operand_batching_dims, numbers.scatter_indices_batching_dims, strict=True))
        updates = _apart(site, updates, array)
        target = writable(site, 0)
        buffer = target.buffer
        assert buffer is not None

        def write(index: Index) -> None:
            batch = [i for a, i in enumerate(index) if a not in numbers.update_window_dims]
            starts, inside = windows.starts(batch, paired)
            place = list(starts)
            for a, i in zip(kept, [index[a] for a in numbers.update_window_dims], strict=True):
                place[a] = b.op("add", starts[a], i, dtype="i32")
            where = linear(b, array.shape, place)
            value, old = read(b, updates, index), b.load(buffer, where)
            new = value if combine is None else b.op(combine, old, value, dtype=array.dtype)
            if mode not in (MODE.CLIP, MODE.PROMISE_IN_BOUNDS):
                new = b.op("select", inside, new, old, dtype=array.dtype)
            b.store(buffer, where, new)

        if small(updates.shape):
            for index in np.ndindex(*updates.shape):
                write([b.index(i) for i in index])
        else:
            every(b, updates.shape, write)
        return [_unrolled(site, target)]

    return rule


def _unrolled(site: Site, array: Array) -> Array:
    """A small array as values again, so that later updates don't change it."""
    if small(array.shape):
        return scalars([at(site.b, array, site.b.index(i)) for i in range(array.size)], array.shape, array.dtype)
    return array


RULES: dict[str, Rule] = {
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update_slice,
    "gather": _gather,
    "scatter": _scatter(None),
    "scatter-update": _scatter(None),
    "scatter-add": _scatter("add"),
    "scatter_add": _scatter("add"),
    "scatter-mul": _scatter("mul"),
    "scatter_mul": _scatter("mul"),
    "scatter-min": _scatter("min"),
    "scatter_min": _scatter("min"),
    "scatter-max": _scatter("max"),
    "scatter_max": _scatter("max"),
}
