"""Logs of PX4: instances, arrays, and unordered rows of another logger."""

import numpy as np
import pytest
from logs.foreign.written import GYRO, RATES, gyro, mapping, ulog_bytes

from trimtab.logs.foreign import list_topics, read_foreign


def test_reads_sensor_topics_from_a_ulog_file(ulog):
    log = read_foreign(ulog, mapping("sensor_gyro", angular_rate=GYRO))
    assert len(log) == 50
    np.testing.assert_array_equal(log.ticks, 40_000 * np.arange(50))
    np.testing.assert_allclose(log[f"downlink.imu.{RATES}"][30], [0.1, -0.2, 3.0], rtol=1e-6)
    assert log.unit(f"downlink.imu.{RATES}") == "rad/s"
    assert log.metadata["format"] == "ULog"
    assert log.metadata["start_s"] == pytest.approx(1.0)
    second = read_foreign(ulog, mapping("sensor_gyro[1]", angular_rate=GYRO))
    assert (second[f"downlink.imu.{RATES}"] == 9).all()


def test_lists_ulog_topics_with_rows_and_rates(ulog):
    topics = {topic.name: topic for topic in list_topics(ulog)}
    assert set(topics) == {"sensor_gyro", "sensor_gyro[1]", "vehicle_attitude"}
    assert topics["sensor_gyro"].rows == 50
    assert topics["sensor_gyro"].rate == pytest.approx(250)
    assert "gyro[2]" in topics["sensor_gyro"].fields


def test_quaternion_gives_heading_and_truth_is_interpolated(ulog):
    truth = {"topic": "vehicle_attitude", "fields": {"heading": {"quaternion": [f"q[{i}]" for i in range(4)]}}}
    log = read_foreign(ulog, mapping("sensor_gyro", truth, angular_rate=GYRO))
    np.testing.assert_allclose(log["truth.heading"], np.pi / 2, rtol=1e-6)
    truth["fields"]["heading"] |= {"sign": -1, "offset": 90, "unit": "deg"}
    log = read_foreign(ulog, mapping("sensor_gyro", truth, angular_rate=GYRO))
    np.testing.assert_allclose(log["truth.heading"], 0, atol=1e-6)


def test_unordered_rows_are_sorted_and_duplicates_dropped(tmp_path):
    order = [0, 1, 3, 2, 2, 4, 4, 5]
    file = tmp_path / "a.ulg"
    rows = [(10_000 * k, float(k)) for k in order]
    file.write_bytes(ulog_bytes({"gyro": ("uint64_t timestamp;float z;", rows)}))
    log = read_foreign(file, mapping("gyro", z=gyro("z")))
    assert log["downlink.imu.value.z"].tolist() == [0, 1, 2, 3, 4, 5]
    counts = {"rows": 8, "not_finite": 0, "out_of_order": 2, "duplicates": 2}
    assert log.metadata["converted"] == {"imu": counts}
