"""Fields of the standard messages against scipy's rotations and the numbers of the common dialect."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from trimtab.core.time import seconds
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.station import telemetry
from trimtab.flight.station.telemetry import Health, VehicleMotion

NAN = math.nan
angle = st.floats(-20, 20)
speed = st.floats(-100, 100)
SEEN = VehicleMotion((1.0, -2.0, 3.0), (0.1, -0.2, 7.0), (3.0, 4.0, 0.0), (0.4, 0.5, 0.6))


@given(st.tuples(angle, angle, angle), st.tuples(speed, speed, speed))
def test_rotation_to_world_matches_scipy(attitude, vector):
    roll, pitch, yaw = attitude
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll]).apply(vector)
    assert telemetry.rotate_to_world(attitude, vector) == pytest.approx(expected, abs=1e-9)


def test_attitude_message_has_wrapped_yaw_and_boot_time():
    found = telemetry.attitude(seconds("1.5"), SEEN)
    assert found["time_boot_ms"] == 1500
    assert found["yaw"] == pytest.approx(7.0 - 2 * math.pi)
    assert (found["roll"], found["pitch"]) == pytest.approx((0.1, -0.2))
    assert [found[n] for n in ("rollspeed", "pitchspeed", "yawspeed")] == [0.4, 0.5, 0.6]


def test_local_position_and_vfr_hud_agree():
    place, shown = telemetry.local_position(0, SEEN), telemetry.vfr_hud(SEEN)
    assert (place["x"], place["y"], place["z"]) == (1.0, -2.0, 3.0)
    assert shown["alt"] == -3.0
    assert shown["airspeed"] == pytest.approx(5.0)
    assert shown["groundspeed"] == pytest.approx(math.hypot(place["vx"], place["vy"]))
    assert shown["climb"] == pytest.approx(-place["vz"])
    assert shown["heading"] == 401 - 360
    assert telemetry.vfr_hud(SEEN._replace(attitude=(0.0, 0.0, math.radians(-0.4))))["heading"] == 0


def test_imu_update_flags_reflect_the_magnetometer():
    bare = telemetry.inertial_sample(seconds(2), (1.0, 2.0, -9.8), (0.1, 0.2, 0.3))
    assert (bare["time_usec"], bare["zacc"], bare["xgyro"], bare["xmag"]) == (2_000_000, -9.8, 0.1, 0.0)
    assert bare["fields_updated"] == 0b000_111_111
    whole = telemetry.inertial_sample(0, (0.0,) * 3, (0.0,) * 3, (2e-5, 0.0, 4e-5))
    assert (whole["xmag"], whole["zmag"]) == pytest.approx((0.2, 0.4))
    assert whole["fields_updated"] == 0b111_111_111


def test_servo_and_receiver_messages_are_in_microseconds():
    found = telemetry.servo_outputs(seconds(5000), [0.0, 0.5, 1.0, NAN])
    assert [found[f"servo{k}_raw"] for k in range(1, 5)] == [1000, 1500, 2000, 0]
    assert found["time_usec"] == 5_000_000_000 % 2**32
    heard = telemetry.receiver_channels(0, (1.5e-3, NAN, 2e-3))
    assert [heard[f"chan{k}_raw"] for k in range(1, 5)] == [1500, 65535, 2000, 65535]
    assert (heard["chancount"], heard["rssi"]) == (3, 255)
    assert telemetry.receiver_channels(0, ())["chancount"] == 0


def test_health_reports_link_loss_and_present_sensors_only():
    found = telemetry.system_health(Health.GYRO | Health.MOTORS, Health.GYRO | Health.MAGNETOMETER, 1, 3, 70_000)
    assert found["onboard_control_sensors_present"] == 0x8001
    assert found["onboard_control_sensors_health"] & 0x8007 == 1
    assert found["drop_rate_comm"] == 2500
    assert found["errors_comm"] == 70_000 % 65536
    assert telemetry.system_health(Health(0), Health(0), 0, 0, 0)["drop_rate_comm"] == 0


def test_every_telemetry_message_is_readable_by_pymavlink(dialect):
    common = pytest.importorskip("pymavlink.dialects.v20.common")
    own, theirs = Endpoint(dialect, 1, 1, unsigned=True), common.MAVLink(None)
    for name, fields in (
        ("ATTITUDE", telemetry.attitude(seconds(1), SEEN)),
        ("LOCAL_POSITION_NED", telemetry.local_position(seconds(1), SEEN)),
        ("VFR_HUD", telemetry.vfr_hud(SEEN)),
        ("HIGHRES_IMU", telemetry.inertial_sample(seconds(1), (1.0,) * 3, (2.0,) * 3)),
        ("SERVO_OUTPUT_RAW", telemetry.servo_outputs(seconds(1), [0.5] * 20)),
        ("RC_CHANNELS", telemetry.receiver_channels(seconds(1), (1.5e-3,) * 18)),
        ("SYS_STATUS", telemetry.system_health(Health.GYRO, Health.GYRO, 0, 1, 0)),
        ("EXTENDED_SYS_STATE", telemetry.landed_state(True)),
        ("SYSTEM_TIME", telemetry.system_time(seconds(1), 1.8e9)),
    ):
        message = theirs.parse_char(own.pack(name, fields))
        assert message.get_type() == name
        for field, value in fields.items():
            assert getattr(message, field) == pytest.approx(float(value), rel=1e-6)
    assert own.counts.clamped == 0
