"""Mapping files in TOML, which assign the columns of a foreign log to sensors, with units.

    [sensor.imu]
    topic = "sensor_combined"
    time = {field = "timestamp", unit = "us"}

    [sensor.imu.fields]
    angular_rate = {from = ["gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]"], unit = "rad/s"}

    [truth]                                 # optional; has the same keys as a sensor
    topic = "vehicle_attitude"
    [truth.fields]
    heading = {quaternion = ["q[0]", "q[1]", "q[2]", "q[3]"]}

The docs page Foreign logs explains each key.
"""

import os
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.suggestions import closest
from trimtab.core.time import parse_time
from trimtab.core.units import UNITS, find_unit
from trimtab.core.user_file import read_user_text

TRUTH_SECTION = "truth"
KEYS = ("sensor", TRUTH_SECTION)
TOPIC_KEYS = ("topic", "time", "where", "fields", "geodetic")
TIME_KEYS = ("field", "unit", "offset")
FIELD_KEYS = ("from", "unit", "sign", "offset", "quaternion", "constant", "unwrap", "doc")
GEODETIC_KEYS = ("latitude", "longitude", "altitude", "unit", "altitude_unit", "origin")
SOURCES = ("from", "quaternion", "constant")
EXAMPLE = 'angular_rate = {from = ["gx", "gy", "gz"], unit = "deg/s"}'


class TimeMap(NamedTuple):
    """Mapping of the times of a topic.

    field: name of the time column. Empty: the usual time column of the log's format.  unit: unit of the column.
    offset: time that is added to all times (100 ns).
    """

    field: str = ""
    unit: str = ""
    offset: int = 0


class FieldMap(NamedTuple):
    """Mapping of one field of a sensor. The field's value is sign * column + offset, converted to SI units.

    columns: one column for each component of the field. Empty for a constant.  unit: unit of the columns, or None if
    the mapping states no unit.  sign, offset: one number for each component (k,), or one number for all.  single: True
    if the field is a single number.  quaternion: True if the columns are w, x, y, z of a quaternion. In this case the
    field is the yaw angle of the rotation.  constant: value in every row.  unwrap: True to remove jumps of full turns.
    doc: meaning of the field.
    """

    columns: tuple[str, ...]
    unit: str | None
    sign: Any
    offset: Any
    single: bool
    quaternion: bool
    constant: Any
    unwrap: bool
    doc: str


class GeodeticMap(NamedTuple):
    """Conversion of latitude, longitude and altitude to north, east and down (m) relative to an origin.

    origin: latitude and longitude (deg), and optionally altitude (m), of the origin. Empty: position in the first row.
    """

    latitude: str
    longitude: str
    altitude: str
    unit: str
    altitude_unit: str
    origin: tuple[float, ...]


class TopicMap(NamedTuple):
    """Mapping of a topic to a sensor or to the truth.

    where: name of the section in the mapping file.  rows: name of a column -> value. Only rows with these values are
    used.
    """

    where: str
    topic: str
    time: TimeMap
    rows: Mapping[str, Any]
    fields: Mapping[str, FieldMap]
    geodetic: GeodeticMap | None


class LogMapping(NamedTuple):
    """Mapping of a foreign log.

    sensors: name of a sensor, as in the estimator -> mapping.  truth: mapping of the true state, or None.  content:
    unchanged content of the mapping file.
    """

    sensors: Mapping[str, TopicMap]
    truth: TopicMap | None
    content: Mapping[str, Any]


def read_mapping(path: str | os.PathLike[str]) -> LogMapping:
    """Read a mapping file.

    Raises:
        InputError: the file can't be read, or its content is not a valid mapping.
    """
    where = f"mapping '{path}'"
    try:
        content = tomllib.loads(read_user_text(path))
    except OSError as error:
        raise InputError(where, f"cannot be read: {error.strerror or error}", fix="check the path") from None
    except UnicodeDecodeError as error:
        raise InputError(where, f"cannot be read as text: {error}", fix="save the file as UTF-8 text") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(
            where, f"is not TOML: {error}", fix="correct the line that TOML names; an example is in docs/logs"
        ) from None
    return parse_mapping(content, where)


def parse_mapping(content: Mapping[str, Any], where: str = "mapping") -> LogMapping:
    """Parse the content of a mapping file, as read by `tomllib`.

    Raises:
        InputError: the content names no sensor, or is not a valid mapping.
    """
    _check_keys(where, content, KEYS)
    sensors = _take(where, content, "sensor", dict, {})
    if not sensors:
        fix = f"write  [sensor.imu]  with topic, time and  [sensor.imu.fields]  {EXAMPLE}"
        raise InputError(where, "names no sensor", fix=fix)
    made = {name: _parse_topic(f"{where}, [sensor.{name}]", _take(where, sensors, name, dict)) for name in sensors}
    for name in made:
        if not name.isidentifier():
            raise InputError(
                f"{where}, [sensor.{name}]", "is not a valid name", fix="letters, digits and _, e.g. [sensor.imu]"
            )
    truth = content.get(TRUTH_SECTION)
    known = None if truth is None else _parse_topic(f"{where}, [truth]", _take(where, content, TRUTH_SECTION, dict))
    return LogMapping(made, known, content)


def _parse_topic(where: str, table: Mapping[str, Any]) -> TopicMap:
    _check_keys(where, table, TOPIC_KEYS)
    fields = _take(where, table, "fields", dict, {})
    geodetic = _take(where, table, "geodetic", dict, None)
    rows = _take(where, table, "where", dict, {})
    for name, value in rows.items():
        if not isinstance(value, int | float):
            raise InputError(f"{where}, where", f"{name} = {value!r} is not a number", fix=f"where = {{{name} = 0}}")
    if not fields and geodetic is None:
        raise InputError(where, "has no fields", fix=f"write under this heading  {EXAMPLE}")
    return TopicMap(
        where,
        _take(where, table, "topic", str, ""),
        _parse_time_map(f"{where}, time", _take(where, table, "time", dict, {})),
        rows,
        {name: _parse_field(f"{where}, {name}", _take(where, fields, name, dict)) for name in fields},
        None if geodetic is None else _parse_geodetic(f"{where}, geodetic", geodetic),
    )


def _parse_time_map(where: str, table: Mapping[str, Any]) -> TimeMap:
    _check_keys(where, table, TIME_KEYS)
    try:
        offset = parse_time(str(table.get("offset", 0)))
    except InputError as error:
        raise InputError(f"{where}, offset", error.problem, choices=error.choices, fix='offset = "-20 ms"') from None
    return TimeMap(_take(where, table, "field", str, ""), _take(where, table, "unit", str, ""), offset)


def _parse_field(where: str, table: Mapping[str, Any]) -> FieldMap:
    _check_keys(where, table, FIELD_KEYS)
    sources = [key for key in SOURCES if key in table]
    if len(sources) != 1:
        problem = (
            f"has {' and '.join(sources)}, but must have only one of these keys"
            if sources
            else "must name the log columns, or the constant, that contain the values"
        )
        raise InputError(where, problem, choices=SOURCES, fix=f"use one of these keys, e.g. {EXAMPLE}")
    source = table.get("from", table.get("quaternion", []))
    columns = _texts(where, sources[0], [source] if isinstance(source, str) else source)
    is_quaternion = "quaternion" in table
    if not columns and "constant" not in table:
        raise InputError(where, "has no columns", fix=f"e.g. {EXAMPLE}")
    if is_quaternion and len(columns) != 4:
        problem = f"the quaternion has {len(columns)} columns, but must have 4"
        raise InputError(where, problem, fix='give w, x, y, z in this order: quaternion = ["q[0]", "q[1]", …]')
    single = is_quaternion or isinstance(source, str)
    unit = _take(where, table, "unit", str, None)
    if unit is not None:
        _check_unit(f"{where}, unit", unit, "rad" if is_quaternion else None)
    size = 1 if single else len(columns)
    return FieldMap(
        columns=columns,
        unit=unit,
        sign=_parse_sign(where, table.get("sign", 1), size),
        offset=_components(where, "offset", table.get("offset", 0), size),
        single=single,
        quaternion=is_quaternion,
        constant=table.get("constant"),
        unwrap=_take(where, table, "unwrap", bool, False),
        doc=_take(where, table, "doc", str, ""),
    )


def _parse_geodetic(where: str, table: Mapping[str, Any]) -> GeodeticMap:
    _check_keys(where, table, GEODETIC_KEYS)
    origin = _numbers(where, "origin", table.get("origin", []))
    if len(origin) not in (0, 2, 3):
        problem = f"the origin has {len(origin)} numbers, but must have 2 or 3"
        raise InputError(where, problem, fix="origin = [latitude, longitude] in degrees, or with altitude in m")
    units = {key: _take(where, table, key, str, default) for key, default in (("unit", "deg"), ("altitude_unit", "m"))}
    for key, unit in units.items():
        _check_unit(f"{where}, {key}", unit, "m" if key == "altitude_unit" else "rad")
    for key in ("latitude", "longitude"):
        if key not in table:
            raise InputError(where, f"has no {key}", fix='geodetic = {latitude = "Lat", longitude = "Lng"}')
    names = {key: _take(where, table, key, str, "") for key in ("latitude", "longitude", "altitude")}
    return GeodeticMap(**names, **units, origin=origin)


def _check_unit(where: str, unit: str, stored: str | None) -> None:
    """Raise InputError for an unknown unit, or for a unit that cannot be converted to the unit `stored`."""
    found = find_unit(where, unit).name
    if stored is not None and found != stored:
        raise InputError(where, f"{unit!r} is not a unit of this quantity", choices=UNITS[stored], fix="use a choice")


def _parse_sign(where: str, value: Any, size: int) -> Any:
    sign = _components(where, "sign", value, size)
    if not np.all(sign):
        raise InputError(where, f"sign must not be 0, got {value!r}", fix="sign = -1 for an axis of opposite direction")
    return sign


def _components(where: str, key: str, value: Any, size: int) -> Any:
    """Return the value of a key: one number for all components, or an array with one number for each component."""
    numbers = _numbers(where, key, value if isinstance(value, list) else [value])  # pyright: ignore[reportUnknownArgumentType]
    if len(numbers) not in (1, size):
        raise InputError(
            where,
            f"{key} has {len(numbers)} numbers, but there are {size} columns",
            fix="write one number for each column",
        )
    return numbers[0] if len(numbers) == 1 else np.array(numbers)


def _numbers(where: str, key: str, value: Any) -> tuple[float, ...]:
    several: list[Any] = list(value) if isinstance(value, Sequence) and not isinstance(value, str) else [None]  # pyright: ignore[reportUnknownArgumentType]
    if any(isinstance(v, bool) or not isinstance(v, int | float) for v in several):
        raise InputError(where, f"{key} = {value!r} is not a list of numbers", fix=f"{key} = [1, -1, -1]")
    if not np.isfinite(several).all():
        raise InputError(where, f"{key} must be finite, got {value!r}", fix=f"write finite numbers in {key}")
    return tuple(several)


def _texts(where: str, key: str, value: Any) -> tuple[str, ...]:
    several: list[Any] = list(value) if isinstance(value, list) else [None]  # pyright: ignore[reportUnknownArgumentType]
    if not all(isinstance(v, str) for v in several):
        raise InputError(where, f"{key} = {value!r} must be names of columns", fix=f'{key} = ["x", "y", "z"]')
    return tuple(several)


def _take(where: str, table: Mapping[str, Any], key: str, kind: type, *default: Any) -> Any:
    """Return the value of a key, or the default. Raise InputError if the value has the wrong type."""
    if key not in table and default:
        return default[0]
    if not isinstance(table.get(key), kind):
        words = {dict: "a table: {…}", str: 'a text: "…"', bool: "true or false"}
        raise InputError(f"{where}, {key}", f"is {table.get(key)!r}", fix=f"the value must be {words[kind]}")
    return table[key]


def _check_keys(where: str, table: Mapping[str, Any], known: Sequence[str]) -> None:
    for key in table:
        if key not in known:
            near = closest(key, known, 1)
            fix = f"write {near[0]}" if near else "remove this key"
            raise InputError(where, f"unknown key {key!r}", choices=known, fix=fix)
