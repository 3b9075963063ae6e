"""Conversion of a table of a foreign log to samples of a sensor: selected, sorted by time, and in SI units."""

import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity
from trimtab.core.suggestions import closest
from trimtab.core.time import FOREVER, UNITS_PER_SECOND
from trimtab.core.units import UNITS, find_size, find_unit
from trimtab.logs.foreign.mapping import FieldMap, GeodeticMap, TopicMap
from trimtab.logs.foreign.tables import Table
from trimtab.logs.samples import SampleSeries

DISORDER = UNITS_PER_SECOND
"""Jump back in time (100 ns) from which on the logger's clock counts as restarted. Rows with a smaller jump are
sorted."""
EQUATOR, FLATTENING = 6378137.0, 1 / 298.257223563
"""Equatorial radius (m) and flattening of the WGS 84 ellipsoid."""


class Conversion(NamedTuple):
    """Converted samples of a sensor.

    counts: numbers of all rows, and of rows that are not finite, out of order, or duplicate.  left_out: description of
    the rows that are left out, or "".
    """

    series: SampleSeries
    counts: dict[str, int]
    left_out: str = ""


def convert_table(where: str, table: Table, mapping: TopicMap) -> Conversion:
    """Convert a table of a foreign log to the samples of one sensor.

    Rows are sorted by time. Rows that repeat time and values of another row, and rows with non-finite values, are left
    out and counted.

    Args:
        where: name of the file and of the topic, for errors.
        table: table of the topic.
        mapping: mapping of the sensor.

    Raises:
        InputError: a column or unit is unknown, no row is left, the times jump back, or a time has two values.
    """
    chosen = _choose_rows(where, table, mapping)
    ticks = _read_ticks(where, table, mapping)[chosen]
    if not len(ticks):
        rule = f" with {mapping.rows}" if mapping.rows else ""
        raise InputError(where, f"has no rows{rule}", fix="map another topic, or record this topic")
    values, declared = {}, {}
    for name, field in mapping.fields.items():
        values[name], declared[name] = _convert_field(where, table, mapping, name, field, chosen)
    if mapping.geodetic is not None:
        placed = _place(where, table, mapping.geodetic, chosen)
        values |= placed
        declared |= {name: Quantity("m", f"{name}, from latitude, longitude and altitude.") for name in placed}
    sound = _find_finite(where, values)
    gaps = [name for name, array in values.items() if not np.isfinite(array).all()]
    values = {name: array[sound].astype(declared[name].dtype()) for name, array in values.items()}
    at = functools.partial(_name_rows, table, chosen[sound])
    ticks, values, disordered, again = _order_rows(where, ticks[sound], values, mapping, at)
    counts = {"rows": len(chosen), "not_finite": int((~sound).sum()), "out_of_order": disordered}
    counts["duplicates"] = len(again)
    left = [(chosen[~sound], f"{' or '.join(gaps)} is empty or not finite")]
    left += [(np.sort(chosen[sound][again]), "a row is repeated")]
    texts = [f"{why} in {table.name_rows(rows)}" for rows, why in left if len(rows)]
    share = f"{len(chosen) - len(ticks)} of {len(chosen)} rows are left out: {'; '.join(texts)}"
    for name, field in mapping.fields.items():
        if field.unwrap or field.quaternion:
            values[name] = np.unwrap(values[name], axis=0)
    return Conversion(SampleSeries(ticks, values, declared), counts, share if texts else "")


def _column(where: str, table: Table, name: str, key: str) -> Any:
    if name not in table.columns:
        near = closest(name, table.columns, 1)
        fix = f'{key}: "{near[0]}"' if near else f"in the mapping, set {key} to one of the choices"
        raise InputError(where, f"has no column {name!r}, which {key} uses", choices=table.columns, fix=fix)
    column = np.asarray(table.columns[name])
    if column.dtype.kind not in "biuf":
        choices = [n for n, c in table.columns.items() if np.asarray(c).dtype.kind in "biuf"]
        problem = table.problems.get(name, f"the column {name!r} contains no numbers")
        raise InputError(where, problem, choices=choices, fix=f"name another column in {key}")
    return column


def _choose_rows(where: str, table: Table, mapping: TopicMap) -> Any:
    """Return the indices of the rows that the mapping selects."""
    size = len(next(iter(table.columns.values()), ()))
    mask = np.ones(size, bool)
    for name, value in mapping.rows.items():
        column = _column(where, table, name, f"{mapping.where}, where")
        if size and not (column == value).any():
            there = [f"{v:g}" for v in np.unique(column)[:12]]
            raise InputError(where, f"{name} is never {value!r}", choices=there, fix=f"where = {{{name} = …}}")
        mask &= column == value
    return np.flatnonzero(mask)


def _read_ticks(where: str, table: Table, mapping: TopicMap) -> Any:
    """Return the times of all rows in 100 ns, int64 (n,). Integer times are converted exactly, without floats."""
    field = mapping.time.field or table.time
    key = f"{mapping.where}, time"
    if not field:
        fix = f'{key}: time = {{field = "…", unit = "s"}}'
        raise InputError(where, "the mapping does not name the column of times", choices=table.columns, fix=fix)
    column = _column(where, table, field, key)
    unit = mapping.time.unit or (table.time_unit if field == table.time else table.units.get(field, ""))
    size = find_size(unit, "s") if unit else None
    if size is None:
        problem = f"{key} is in {unit!r}, which is not a unit of time" if unit else f"{key} has no unit"
        raise InputError(where, problem, choices=UNITS["s"], fix=f'time = {{field = "{field}", unit = "us"}}')
    ticks = column.astype(np.float64) * (size * UNITS_PER_SECOND)
    if not (np.abs(ticks) < FOREVER).all():
        row = int(np.argmin(np.abs(ticks) < FOREVER))
        problem = f"{table.name_rows([row])}, column {field!r}: the time is {column[row]:.9g} {unit}"
        raise InputError(where, problem, fix="correct the time or its unit, or leave the row out")
    per_tick = round(1 / (size * UNITS_PER_SECOND)), round(size * UNITS_PER_SECOND)
    if column.dtype.kind in "iu":
        whole = column.astype(np.int64)
        return (whole // per_tick[0] if per_tick[0] > 1 else whole * per_tick[1]) + mapping.time.offset
    return np.round(ticks).astype(np.int64) + mapping.time.offset


def _convert_field(
    where: str, table: Table, mapping: TopicMap, name: str, field: FieldMap, chosen: Any
) -> tuple[Any, Quantity]:
    key = f"{mapping.where}, {name}"
    if field.constant is not None:
        value, unit = np.asarray(field.constant), find_unit(key, field.unit or "1")
        if value.dtype.kind not in "biuf":
            raise InputError(key, f"constant = {field.constant!r} is not a number", fix="constant = false, or 0.0")
        same = np.broadcast_to(value * unit.scale, (len(chosen), *value.shape))
        kind = "flag" if value.dtype.kind == "b" else unit.kind
        return same, Quantity(unit.name, field.doc or "Constant in every row.", kind=kind)
    columns = [_column(where, table, column, key) for column in field.columns]
    if field.quaternion:
        w, x, y, z = (c[chosen].astype(np.float64) for c in columns)
        yaw = np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
        unit = find_unit(key, field.unit or "rad")
        return field.sign * yaw + field.offset * unit.scale, Quantity("rad", field.doc or f"Yaw of {field.columns[0]}.")
    text = field.unit if field.unit is not None else _find_written_unit(where, table, key, field.columns)
    unit = find_unit(key, text)
    raw = np.stack([c[chosen] for c in columns], axis=1)
    doc = field.doc or f"From {', '.join(field.columns)}."
    values = (field.sign * raw.astype(np.float64) + field.offset) * unit.scale
    return values[:, 0] if field.single else values, Quantity(unit.name, doc, kind=unit.kind)


def _find_written_unit(where: str, table: Table, key: str, columns: Iterable[str]) -> str:
    """Return the unit that the file states for the columns of a field. Raise InputError if the file states no unit."""
    written = {table.units.get(name, "") for name in columns}
    if len(written) != 1 or not (unit := written.pop()):
        problem = f"{key} has no unit, and the file does not give one for all of {', '.join(columns)}"
        raise InputError(where, problem, fix='write e.g.  unit = "deg/s"; unit = "1" for a number without unit')
    return unit


def _place(where: str, table: Table, mapping: GeodeticMap, chosen: Any) -> dict[str, Any]:
    """Return north and east (m) in the tangent plane at the origin and, if the mapping has an altitude, down (m).

    Within some kilometres, the error is below 1e-4 of the distance.
    """
    names = {"latitude": mapping.latitude, "longitude": mapping.longitude}
    scale = find_unit(where, mapping.unit).scale
    phi, lam = (_column(where, table, n, f"geodetic.{k}")[chosen] * scale for k, n in names.items())
    finite = np.flatnonzero(np.isfinite(phi) & np.isfinite(lam))
    first = finite[0] if len(finite) else 0
    phi0, lam0 = np.deg2rad(mapping.origin[:2]) if mapping.origin else (phi[first], lam[first])
    e2 = FLATTENING * (2 - FLATTENING)
    bend = 1 - e2 * np.sin(phi0) ** 2
    meridian, normal = EQUATOR * (1 - e2) / bend**1.5, EQUATOR / np.sqrt(bend)
    east = (lam - lam0 + np.pi) % (2 * np.pi) - np.pi
    placed = {"north": meridian * (phi - phi0), "east": normal * np.cos(phi0) * east}
    if mapping.altitude:
        height = _column(where, table, mapping.altitude, "geodetic.altitude")[chosen]
        height = height * find_unit(where, mapping.altitude_unit).scale
        placed["down"] = (mapping.origin[2] if len(mapping.origin) == 3 else height[first]) - height
    return placed


def _name_rows(table: Table, chosen: Any, rows: Iterable[int]) -> str:
    """Return as text the line numbers, or row numbers, of some of the chosen rows of a table."""
    return table.name_rows(chosen[list(rows)])


def _find_finite(where: str, values: Mapping[str, Any]) -> Any:
    """Return a mask of the rows whose values are all finite. Raise InputError if the mask is empty."""
    sound = np.array([np.isfinite(array).reshape(len(array), -1).all(axis=1) for array in values.values()]).all(axis=0)
    if not sound.any():
        bad = [name for name, array in values.items() if not np.isfinite(array).any()]
        raise InputError(where, f"no row has only finite values: {', '.join(bad or values)}", fix="map other columns")
    return sound


def _order_rows(
    where: str, ticks: Any, values: dict[str, Any], mapping: TopicMap, name_rows: Callable[[Iterable[int]], str]
) -> tuple[Any, dict[str, Any], int, Any]:
    """Return the rows sorted by time and without duplicates, the number of rows out of order, and the duplicates."""
    late = np.maximum.accumulate(ticks) - ticks
    if late.max() >= DISORDER:
        row = int(np.argmax(late >= DISORDER))
        problem = f"the times jump back by {late[row] / UNITS_PER_SECOND:g} s at {name_rows([row])}"
        raise InputError(where, problem, fix="cut the log there, or map a column of rising times")
    order = np.argsort(ticks, kind="stable")
    ticks, values = ticks[order], {name: array[order] for name, array in values.items()}
    again = np.flatnonzero(np.diff(ticks) == 0) + 1
    for name, array in values.items():
        other = [k for k in again if not np.array_equal(array[k], array[k - 1])]
        if other:
            k = other[0]
            problem = f"{len(other)} rows have the time of another row but a different {name}, the first at"
            problem += f" {ticks[k] / UNITS_PER_SECOND:.7f} s ({name_rows(order[k - 1 : k + 1])}): {array[k - 1]}, then"
            problem += f" {array[k]}"
            fix = (
                f"select the rows of one sensor: in {mapping.where}  where = {{I = 0}}; or map another column of times"
            )
            raise InputError(where, problem, fix=fix)
    keep = np.ones(len(ticks), bool)
    keep[again] = False
    return ticks[keep], {name: array[keep] for name, array in values.items()}, int((late > 0).sum()), order[again]
