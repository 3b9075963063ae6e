"""Messages between PX4 and its simulator, against pymavlink and the message definitions."""

import math

import pytest
from pymavlink.dialects.v20 import common

from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.stacks.ardupilot_json import PhysicsState
from trimtab.flight.stacks.px4_simulator import (
    INERTIAL,
    MAGNETIC,
    PRESSURES,
    ControlFrame,
    Surroundings,
    fix_fields,
    read_controls,
    sensor_fields,
    simulator_dialect,
)

STATE = PhysicsState((0.1, -0.2, -9.8), (0.01, 0.02, 0.03), (1, 2, -3), (0, 0, 0.4), (3.0, -4.0, -1.5), 5.0)
AROUND = Surroundings(math.radians(38.9897), math.radians(-76.9378), 23.0, 101049.0, 15.3, 288.0, (2e-5, -4e-6, 4.8e-5))


@pytest.fixture
def end():
    return Endpoint(simulator_dialect(), 1, 200, unsigned=True)


@pytest.mark.parametrize("name", ["HIL_ACTUATOR_CONTROLS", "HIL_SENSOR", "HIL_GPS"])
def test_simulator_messages_match_the_common_dialect(end, name):
    ours, theirs = end.dialect.definitions[name], common.mavlink_map[end.dialect.definitions[name].id]
    assert (theirs.msgname, theirs.crc_extra) == (name, ours.crc_extra)
    assert theirs.unpacker.size == ours.size


def test_sensor_message_has_correct_units_and_update_flags(end):
    frame = end.pack("HIL_SENSOR", sensor_fields(12_340_000, STATE, AROUND, INERTIAL | MAGNETIC | PRESSURES))
    (read,) = common.MAVLink(None).parse_buffer(frame)
    assert read.time_usec == 1_234_000
    assert [read.xacc, read.yacc, read.zacc] == pytest.approx(STATE.specific_force, rel=1e-6)
    assert [read.xgyro, read.ygyro, read.zgyro] == pytest.approx(STATE.angular_rate, rel=1e-6)
    assert [read.xmag, read.ymag, read.zmag] == pytest.approx([0.2, -0.04, 0.48], rel=1e-6)  # gauss
    assert read.abs_pressure == pytest.approx(1010.49, rel=1e-6)  # hPa
    assert (read.diff_pressure, read.temperature) == pytest.approx((0.153, 14.85), rel=1e-5)
    assert read.fields_updated == 0x1FFF == common.HIL_SENSOR_UPDATED_TEMPERATURE * 2 - 1
    assert common.HIL_SENSOR_UPDATED_XGYRO & INERTIAL
    assert common.HIL_SENSOR_UPDATED_XMAG & MAGNETIC
    assert common.HIL_SENSOR_UPDATED_ABS_PRESSURE & PRESSURES


def test_gps_message_uses_scaled_integer_units(end):
    (read,) = common.MAVLink(None).parse_buffer(end.pack("HIL_GPS", fix_fields(10_000_000, STATE, AROUND)))
    assert (read.lat, read.lon, read.alt) == (389897000, -769378000, 23000)
    assert (read.vn, read.ve, read.vd, read.vel) == (300, -400, -150, 500)
    assert read.cog == round(100 * (360 - math.degrees(math.atan2(4, 3))))
    assert (read.fix_type, read.time_usec) == (common.GPS_FIX_TYPE_3D_FIX, 1_000_000)


def test_actuator_controls_are_read_and_nan_is_rejected(end):
    mav = common.MAVLink(None, 1, 1)
    outputs = [0.5, -0.25, *[0.0] * 14]
    for mode, flags in ((129, 1), (1, 0)):
        (message,) = end.feed(mav.hil_actuator_controls_encode(77, outputs, mode, flags).pack(mav))
        assert read_controls(message) == ControlFrame(77, tuple(outputs), mode == 129, flags == 1)
    spoilt = mav.hil_actuator_controls_encode(77, [0.0, math.nan, *outputs[2:]], 129, 1)
    (message,) = end.feed(spoilt.pack(mav))
    assert read_controls(message) == "PX4's output 2 is not a finite number"
