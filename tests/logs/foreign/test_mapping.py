"""Mapping files: invalid entries are rejected."""

import math

import pytest
from logs.foreign.written import gyro

from trimtab.core.errors import InputError
from trimtab.logs.foreign import read_foreign
from trimtab.logs.foreign.mapping import parse_mapping

WRONG_MAPPINGS = {
    "nothing": ({}, r"names no sensor(.|\n)*\[sensor.imu\]"),
    "key": ({"sensors": {}}, r"unknown key 'sensors'(.|\n)*write sensor"),
    "section": ({"sensor": {"imu": 3}}, r"the value must be a table"),
    "field": ({"sensor": {"imu": {"fields": {"w": {"column": "x"}}}}}, r"unknown key 'column'(.|\n)*from, unit"),
    "source": ({"sensor": {"imu": {"fields": {"w": {"unit": "m"}}}}}, r"must name the log columns"),
    "unit": (
        {"sensor": {"imu": {"fields": {"w": gyro("x", "degs/s")}}}},
        r"\[sensor.imu\], w, unit: unknown unit 'degs/s'",
    ),
    "near unit": ({"sensor": {"imu": {"fields": {"w": gyro("x", "degs/s")}}}}, r"Fix: unit = \"deg/s\""),
    "sign": ({"sensor": {"imu": {"fields": {"w": gyro(["x", "y"], sign=[1, 1, 1])}}}}, r"sign has 3 numbers"),
    "sign of text": ({"sensor": {"imu": {"fields": {"w": gyro("x", sign="-")}}}}, r"is not a list of numbers"),
    "sign of zero": ({"sensor": {"imu": {"fields": {"w": gyro("x", sign=0)}}}}, r"w: sign must not be 0, got 0"),
    "sign of zero in one axis": (
        {"sensor": {"imu": {"fields": {"w": gyro(["x", "y"], sign=[1, 0])}}}},
        r"sign must not be 0, got \[1, 0\]",
    ),
    "unit of a latitude": (
        {"sensor": {"gps": {"geodetic": {"latitude": "a", "longitude": "o", "unit": "m"}}}},
        r"geodetic, unit: 'm' is not a unit of this quantity(.|\n)*Choices: rad",
    ),
    "offset": (
        {"sensor": {"imu": {"fields": {"w": gyro("x", offset=math.inf)}}}},
        r"offset must be finite, got \[inf\]",
    ),
    "factor": ({"sensor": {"imu": {"fields": {"w": gyro("x", "0 m")}}}}, r"must be finite and not 0, got '0 m'"),
    "time offset": (
        {"sensor": {"imu": {"time": {"offset": "a"}, "fields": {"w": gyro("x")}}}},
        r"imu\], time, offset: 'a' is not a time",
    ),
    "unit of a quaternion": (
        {"sensor": {"imu": {"fields": {"w": {"quaternion": ["a", "b", "c", "d"], "unit": "m"}}}}},
        r"w, unit: 'm' is not a unit of this quantity(.|\n)*Choices: rad, mrad, deg",
    ),
    "unit of a place": (
        {"sensor": {"gps": {"geodetic": {"latitude": "a", "longitude": "o", "altitude_unit": "deg"}}}},
        r"geodetic, altitude_unit: 'deg' is not a unit(.|\n)*Choices: m, km",
    ),
    "quaternion": ({"sensor": {"imu": {"fields": {"w": {"quaternion": ["x"]}}}}}, r"w, x, y, z in this order"),
    "no columns": ({"sensor": {"imu": {"fields": {"w": gyro([])}}}}, r"has no columns"),
    "no fields": ({"sensor": {"imu": {"topic": "x"}}}, r"has no fields"),
    "where": ({"sensor": {"imu": {"where": {"I": "0"}}}}, r"where: I = '0' is not a number"),
    "place": ({"sensor": {"gps": {"geodetic": {"latitude": "Lat"}}}}, r"has no longitude"),
    "truth": ({"sensor": {"imu": {"fields": {"w": gyro("x")}}}, "truth": 1}, r"the value must be a table"),
}


@pytest.mark.parametrize("name", WRONG_MAPPINGS)
def test_rejects_invalid_mapping_entries(name):
    content, said = WRONG_MAPPINGS[name]
    with pytest.raises(InputError, match=said):
        parse_mapping(content)


def test_rejects_malformed_or_missing_toml_mapping(tmp_path, ulog):
    file = tmp_path / "map.toml"
    file.write_text("[sensor.imu\n")
    with pytest.raises(InputError, match=r"map.toml': is not TOML: .*line 1"):
        read_foreign(ulog, file)
    with pytest.raises(InputError, match="cannot be read"):
        read_foreign(ulog, tmp_path / "none.toml")
    file.write_bytes("# Höhe\n".encode("latin-1"))
    with pytest.raises(InputError, match=r"line 1 is not in UTF-8; read as Latin-1, it is '# Höhe'(.|\n)*as UTF-8"):
        read_foreign(ulog, file)
