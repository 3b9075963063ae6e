"""Lowering rules for array access at computed indices: slices, gathers (lookup tables), updates, scatters."""

import numpy as np
from jax import lax

from trimtab.compiler import jaxprs
from trimtab.compiler.arrays import (
    Array,
    ElementUpdate,
    Index,
    apply_updates,
    build_array,
    constant,
    copy_array,
    element_array,
    element_list,
    flat_index,
    is_small,
    loop_over_indices,
    read_element,
    read_flat,
    scalar,
    scalars,
    write_updates,
)
from trimtab.compiler.ir import Builder, is_float
from trimtab.compiler.lower import Rule, Site
from trimtab.compiler.values import Value

MODE = lax.GatherScatterMode


def clamp_start(site: Site, start: Value, extent: int, window: int) -> Value:
    """Return the start index of a window as an int32, clipped so that the window fits into the array."""
    b = site.b
    most = extent - window
    if most == 0:
        return b.index(0)
    start = widen_index(b, start)
    if start.dtype[0] == "u":
        high = b.op("min", start, b.const(most, start.dtype), dtype=start.dtype)
        return b.op("convert", high, dtype="i32")
    low = b.op("max", start, b.const(0, start.dtype), dtype=start.dtype)
    return b.op("convert", b.op("min", low, b.const(most, start.dtype), dtype=start.dtype), dtype="i32")


def widen_index(b: Builder, start: Value) -> Value:
    """Return an index, widened if its type is too small for the length of any array."""
    return b.op("convert", start, dtype="i32") if start.dtype[1:] in ("8", "16") else start


def _window_start(site: Site, array: Array, window: tuple[int, ...], given: list[Array]) -> Index:
    found = [element_list(site.b, s)[0] for s in given]
    return [clamp_start(site, s, n, w) for s, n, w in zip(found, array.shape, window, strict=True)]


def _add_indices(site: Site, starts: Index, index: Index) -> Index:
    return [site.b.op("add", s, i, dtype="i32") for s, i in zip(starts, index, strict=True)]


def _dynamic_slice(site: Site) -> list[Array]:
    array = site.operands[0]
    starts = _window_start(site, array, site.shape, site.operands[1:])
    return [read_window(site, array, starts)]


def read_window(site: Site, array: Array, starts: Index) -> Array:
    """Return the window, with the shape of the result, at a start index in range. Small arrays are read by selects or a
    table."""
    return build_array(
        site.b, site.shape, array.dtype, lambda index: read_element(site.b, array, _add_indices(site, starts, index))
    )


def writable_operand(site: Site, which: int) -> Array:
    """Return operand `which` in a writable buffer: its own buffer if it is not read later, else a copy."""
    array = site.operands[which]
    if array.updates:
        return apply_updates(site.b, array, site.dying[which])
    if array.items is None and site.dying[which] and array.offset is None:
        return array
    return copy_array(site.b, array)


def _dynamic_update_slice(site: Site) -> list[Array]:
    b, (array, update) = site.b, site.operands[:2]
    starts = _window_start(site, array, update.shape, site.operands[2:])
    if is_small(array.shape) and array.items is not None and all(s.op == "const" for s in starts):
        new = array.items.copy()
        window = tuple(slice(int(s.const), int(s.const) + n) for s, n in zip(starts, update.shape, strict=True))
        new[window] = element_array(b, update)
        return [Array(array.shape, array.dtype, new)]
    if is_small(array.shape) and array.items is not None and update.size == 1:
        return [_replace_element(site, array, starts, element_list(b, update)[0])]
    if is_small(update.shape):
        every_index = [[b.index(i) for i in index] for index in np.ndindex(*update.shape)]
        places = [flat_index(b, array.shape, _add_indices(site, starts, index)) for index in every_index]
        numbers, inside = [read_element(b, update, index) for index in every_index], b.const(1, "bool")
        return [_update_elements(site, [ElementUpdate(i, v, inside) for i, v in zip(places, numbers, strict=True)])]
    update = _unshare_update(site, update, array)
    target = writable_operand(site, 0)
    buffer = target.buffer
    assert buffer is not None

    def write(index: Index) -> None:
        b.store(buffer, flat_index(b, array.shape, _add_indices(site, starts, index)), read_element(b, update, index))

    loop_over_indices(b, update.shape, write)
    return [target]


def _update_elements(site: Site, updates: list[ElementUpdate]) -> Array:
    """Return operand 0 with a few elements written. If the old elements are read later, the writes stay pending."""
    array = site.operands[0]
    if is_small(array.shape) or array.offset is not None or site.dying[0]:
        target = writable_operand(site, 0)
        write_updates(site.b, target, updates)
        return target
    return Array(array.shape, array.dtype, buffer=array.buffer, updates=(*array.updates, *updates))


def _unshare_update(site: Site, update: Array, array: Array) -> Array:
    """Return the update array, or a copy of it if it shares memory with the target array."""
    if update.items is None and update.buffer is array.buffer:
        return copy_array(site.b, update)
    return update


def _replace_element(site: Site, array: Array, starts: Index, value: Value) -> Array:
    """Return a small array with one element replaced, by a select for each element, without memory."""
    b, where = site.b, flat_index(site.b, array.shape, starts)
    new = [
        b.op("select", b.op("eq", where, b.index(i), dtype="bool"), value, old, dtype=array.dtype)
        for i, old in enumerate(element_list(b, array))
    ]
    return scalars(new, array.shape, array.dtype)


class Windows:
    """Positions of the windows of a gather or scatter, from its dimension numbers and its array of indices."""

    def __init__(self, site: Site, array: Array, indices: Array, sizes: tuple[int, ...], to: tuple[int, ...]) -> None:
        self.site, self.array, self.indices, self.sizes, self.to = site, array, indices, sizes, to

    def starts(self, batch: Index, paired: dict[int, int]) -> tuple[Index, Value]:
        """Return the clipped start of the window of a batch index, and True if the start was in range."""
        b, array = self.site.b, self.array
        found: Index = [b.index(0)] * len(array.shape)
        inside = b.const(1, "bool")
        for k, axis in enumerate(self.to):
            start = widen_index(b, read_element(b, self.indices, [*batch, b.index(k)]))
            most = array.shape[axis] - self.sizes[axis]
            for test, limit in (("ge", 0), ("le", most)):
                if test == "ge" and start.dtype[0] == "u":
                    continue
                within = b.op(test, start, b.const(limit, start.dtype), dtype="bool")
                inside = b.op("and", inside, within, dtype="bool")
            found[axis] = clamp_start(self.site, start, array.shape[axis], self.sizes[axis])
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
    fill = _fill_value(site, array)

    def element(index: Index) -> Value:
        batch = [i for a, i in enumerate(index) if a not in numbers.offset_dims]
        inner = [index[a] for a in numbers.offset_dims]
        starts, inside = windows.starts(batch, paired)
        place = list(starts)
        for a, i in zip(kept, inner, strict=True):
            place[a] = b.op("add", starts[a], i, dtype="i32")
        value = read_element(b, array, place)
        if mode in (MODE.CLIP, MODE.PROMISE_IN_BOUNDS):
            return value
        return b.op("select", inside, value, fill, dtype=array.dtype)

    return [build_array(b, site.shape, array.dtype, element)]


def _fill_value(site: Site, array: Array) -> Value:
    given = site.params["fill_value"]
    if given is None:
        if is_float(array.dtype):
            given = np.nan
        elif array.dtype == "bool":
            given = True
        else:
            limits = np.iinfo(np.dtype(array.dtype.replace("i", "int").replace("u", "uint").replace("uuint", "uint")))
            given = limits.min if array.dtype[0] == "i" else limits.max
    return element_list(site.b, constant(site.b, np.asarray(given), array.dtype))[0]


class ScatterUpdates:
    """Updates of a scatter: the position of each update, a test that it is in range, and the new number."""

    def __init__(self, site: Site, combine: str | None, updates: Array, indices: Array) -> None:
        self.site, self.combine, self.updates = site, combine, updates
        self.array = array = site.operands[0]
        self.numbers = numbers = site.params["dimension_numbers"]
        gone = {*numbers.inserted_window_dims, *numbers.operand_batching_dims}
        self.kept = [a for a in range(len(array.shape)) if a not in gone]
        sizes = [1] * len(array.shape)
        for a, of_update in zip(self.kept, numbers.update_window_dims, strict=True):
            sizes[a] = updates.shape[of_update]
        self.windows = Windows(site, array, indices, tuple(sizes), numbers.scatter_dims_to_operand_dims)
        self.paired = dict(zip(numbers.operand_batching_dims, numbers.scatter_indices_batching_dims, strict=True))
        self.function = site.params["update_jaxpr"] if combine is None else None

    def place(self, index: Index) -> tuple[Value, Value]:
        """Return the row-major position of an update, and the test that its window is in range."""
        b, window = self.site.b, self.numbers.update_window_dims
        batch = [i for a, i in enumerate(index) if a not in window]
        starts, inside = self.windows.starts(batch, self.paired)
        place = list(starts)
        for a, i in zip(self.kept, [index[a] for a in window], strict=True):
            place[a] = b.op("add", starts[a], i, dtype="i32")
        if self.site.params["mode"] in (MODE.CLIP, MODE.PROMISE_IN_BOUNDS):
            inside = b.const(1, "bool")
        return flat_index(b, self.array.shape, place), inside

    def updated_value(self, old: Value, index: Index, inside: Value) -> Value:
        """Return the new number of an element: the result of combining its old number with an update."""
        site, b = self.site, self.site.b
        new = read_element(b, self.updates, index)
        if self.combine is not None:
            new = b.op(self.combine, old, new, dtype=self.array.dtype)
        elif self.function is not None:
            function = jaxprs.close_jaxpr(self.function, site.params["update_consts"])
            new = element_list(b, site.inline(function, [scalar(old), scalar(new)])[0])[0]
        return b.op("select", inside, new, old, dtype=self.array.dtype)


def _scatter(combine: str | None) -> Rule:
    def rule(site: Site) -> list[Array]:
        b, (array, indices, given) = site.b, site.operands
        updates = ScatterUpdates(
            site, combine, _unshare_update(site, given, array), _unshare_update(site, indices, array)
        )
        every_index = (
            [[b.index(i) for i in index] for index in np.ndindex(*given.shape)] if is_small(given.shape) else []
        )
        if array.items is not None and is_small(given.shape):
            places = [updates.place(index) for index in every_index]
            if all(where.op == "const" for where, _ in places):
                return [_rewrite_elements(array, updates, every_index, places)]
        if is_small(given.shape) and combine is None and updates.function is None:
            places = [updates.place(index) for index in every_index]
            numbers = [read_element(b, updates.updates, index) for index in every_index]
            writes = [ElementUpdate(where, v, inside) for (where, inside), v in zip(places, numbers, strict=True)]
            return [_unroll_array(site, _update_elements(site, writes))]
        target = writable_operand(site, 0)
        buffer = target.buffer
        assert buffer is not None

        def write(index: Index) -> None:
            where, inside = updates.place(index)
            b.store(buffer, where, updates.updated_value(b.load(buffer, where), index, inside))

        if is_small(given.shape):
            for index in every_index:
                write(index)
        else:
            loop_over_indices(b, given.shape, write)
        return [_unroll_array(site, target)]

    return rule


def _rewrite_elements(
    array: Array, updates: ScatterUpdates, indices: list[Index], places: list[tuple[Value, Value]]
) -> Array:
    """Return a small array with elements replaced at known positions, without memory."""
    flat = list(array.items.ravel())
    for index, (where, inside) in zip(indices, places, strict=True):
        flat[int(where.const)] = updates.updated_value(flat[int(where.const)], index, inside)
    return scalars(flat, array.shape, array.dtype)


def _unroll_array(site: Site, array: Array) -> Array:
    """Return a small array as scalar values instead of in a buffer, so that later updates do not change it."""
    if is_small(array.shape):
        return scalars([read_flat(site.b, array, site.b.index(i)) for i in range(array.size)], array.shape, array.dtype)
    return array


RULES: dict[str, Rule] = {
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update_slice,
    "gather": _gather,
    "scatter": _scatter(None),
    "scatter-add": _scatter("add"),
    "scatter-sub": _scatter("sub"),
    "scatter-mul": _scatter("mul"),
    "scatter-min": _scatter("min"),
    "scatter-max": _scatter("max"),
}
