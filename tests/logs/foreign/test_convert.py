"""Conversion of tables to samples: constants, clock offsets, geodetic positions, missing fields."""

import numpy as np
import pytest
from logs.foreign.written import DEG, GYRO, gyro, mapping

from trimtab.core.errors import InputError
from trimtab.logs.foreign import read_foreign
from trimtab.logs.foreign.mapping import parse_mapping


def test_converts_constants_and_applies_a_clock_offset(write):
    section = {"time": {"field": "t", "unit": "us", "offset": "-2 ms"}}
    arm = {"constant": [1, 2], "unit": "cm"}
    log = read_foreign(write("t,a\n5000,1\n6000,5\n"), mapping(section, on={"constant": False}, arm=arm))
    assert log["downlink.imu.value.on"].dtype == bool
    np.testing.assert_allclose(log["downlink.imu.value.arm"], [[0.01, 0.02]] * 2)
    assert log.metadata["start_s"] == pytest.approx(0.003)


def test_latitude_and_longitude_become_local_coordinates(write):
    """A hundredth of a degree at 52 degrees north: 1112.6 m of meridian, 686.5 m of parallel (WGS 84)."""
    file = write("t,lat,lon,alt\n0,52.00,4.00,10\n1,52.01,4.01,15\n")
    place = {"latitude": "lat", "longitude": "lon", "altitude": "alt"}
    for origin in ({}, {"origin": [52.0, 4.0, 10.0]}):
        log = read_foreign(file, parse_mapping({"sensor": {"position": {"geodetic": place | origin}}}))
        assert log["downlink.position.value.north"][1] == pytest.approx(1112.6, abs=0.2)
        assert log["downlink.position.value.east"][1] == pytest.approx(686.6, abs=0.2)
        assert log["downlink.position.value.down"].tolist() == [0, -5]


REFUSED = {
    "topic": ("sensor_gyr", {}, r"flight.ulg'.*no topic 'sensor_gyr'(.|\n)*vehicle_attitude(.|\n)*\"sensor_gyro\""),
    "no topic": ("", {}, r"\[sensor.imu\]: has no topic(.|\n)*sensor_gyro"),
    "column": ("sensor_gyro", {"w": gyro("giro[0]")}, r"no column 'giro\[0\]'(.|\n)*Fix: .*\"gyro\[0\]\""),
    "no unit": ("sensor_gyro", {"w": {"from": "gyro[0]"}}, r"has no unit(.|\n)*unit = \"deg/s\""),
    "time": ({"topic": "sensor_gyro", "time": {"field": "temperature"}}, {}, r"has no unit(.|\n)*ms, us"),
    "rows": ({"topic": "sensor_gyro", "where": {"temperature": 3}}, {}, r"temperature is never 3(.|\n)*Choices: 20"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_rejects_mapping_to_missing_topics_or_fields(ulog, name):
    topic, fields, said = REFUSED[name]
    with pytest.raises(InputError, match=said):
        read_foreign(ulog, mapping(topic, **(fields or {"angular_rate": GYRO})))


@pytest.mark.parametrize(
    ("unit", "si", "size"), [("dps", "rad/s", DEG), ("µs", "s", 1e-6), ("1e-7 deg", "rad", 1e-7 * DEG)]
)
def test_sign_and_offset_apply_in_the_mapped_unit(write, unit, si, size):
    log = read_foreign(write("t,x\n0,3\n1,4\n"), mapping(x={"from": "x", "unit": unit, "sign": -1, "offset": 1}))
    np.testing.assert_allclose(log["downlink.imu.value.x"], [-2 * size, -3 * size])
    assert log.unit("downlink.imu.value.x") == si
