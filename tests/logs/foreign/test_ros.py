"""MCAP with JSON and CDR, rosbag2, and a bag of ROS 1."""

import numpy as np
import pytest
from logs.foreign.ros_files import imu_message, write_cdr_mcap, write_json_mcap, write_rosbag1, write_rosbag2
from logs.foreign.written import RATES, gyro, mapping

from trimtab.core.errors import InputError
from trimtab.core.time import ms
from trimtab.logs.foreign import list_topics, read_foreign

RATE, FORCE = (0.1, -0.2, 0.3), (0.5, 0.25, -9.75)


MESSAGES = {ns: imu_message(ns - 5_000_000, RATE, FORCE) for ns in range(10**18, 10**18 + 10**9, 10**8)}
ROS = gyro(["angular_velocity.x", "angular_velocity.y", "angular_velocity.z"], sign=[1, -1, -1])


@pytest.mark.parametrize("kind", ["rosbag2", "mcap"])
def test_reads_ros2_messages_from_rosbag2_and_mcap(tmp_path, kind):
    write = write_rosbag2 if kind == "rosbag2" else write_cdr_mcap
    path = write(tmp_path / f"flight.{kind}", "/imu", MESSAGES)
    force = gyro([f"linear_acceleration.{axis}" for axis in "xyz"], "m/s^2")
    for time, start in ({}, 10**9), ({"field": "header.stamp", "unit": "ns"}, 10**9 - 0.005):
        log = read_foreign(path, mapping({"topic": "/imu", "time": time}, angular_rate=ROS, specific_force=force))
        assert len(log) == 10
        np.testing.assert_array_equal(np.diff(log.ticks), ms(100))
        assert log.metadata["start_s"] == pytest.approx(start, abs=1e-6)
        np.testing.assert_allclose(log[f"downlink.imu.{RATES}"][3], [0.1, 0.2, -0.3])
        np.testing.assert_allclose(log["downlink.imu.value.specific_force"][3], FORCE)
    (topic,) = list_topics(path)
    assert topic.rows == 10
    assert topic.rate == pytest.approx(10)
    assert {"header.stamp", "angular_velocity.z", "log_time"} <= set(topic.fields)


def test_reads_a_ros1_bag(tmp_path):
    file = write_rosbag1(tmp_path / "old.bag", "/depth", {10**9 + k * 10**8: k / 2 for k in range(4)})
    log = read_foreign(file, mapping("/depth", depth={"from": "data", "unit": "cm"}))
    np.testing.assert_allclose(log["downlink.imu.value.depth"], [0, 0.005, 0.01, 0.015])


def test_reads_json_mcap_with_missing_fields(tmp_path):
    messages = [
        (k * 10**7, {"w": {"z": k}, "ok": k % 2 == 0, "note": "x"} if k != 3 else {"ok": True}) for k in range(6)
    ]
    file = write_json_mcap(tmp_path / "a.mcap", "/gyro", messages)
    log = read_foreign(file, mapping("/gyro", yaw_rate=gyro("w.z", "rpm"), ok={"from": "ok", "unit": "flag"}))
    np.testing.assert_allclose(log["downlink.imu.value.yaw_rate"], np.array([0, 1, 2, 4, 5]) * np.pi / 30)
    assert log["downlink.imu.value.ok"].tolist() == [True, False, True, True, False]
    assert log.metadata["converted"]["imu"]["not_finite"] == 1


def test_rejects_unsupported_message_encoding(tmp_path):
    file = write_json_mcap(tmp_path / "a.mcap", "/gyro", [(0, 1)], encoding="protobuf")
    assert list_topics(file)[0].fields == ()
    with pytest.raises(InputError, match=r"topic '/gyro': the messages are neither JSON nor ROS 2 CDR"):
        read_foreign(file, mapping("/gyro", x=gyro("x")))
