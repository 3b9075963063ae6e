"""Logs of ArduPilot: two units in one type of message, hundredths, units that the file says."""

import numpy as np
import pytest
from logs.foreign.written import DEG, RATES, gyro, mapping

from trimtab.core.errors import InputError
from trimtab.core.time import ms
from trimtab.logs.foreign import read_foreign


def test_reads_imu_and_yaw_from_an_ardupilot_log(bins):
    section = {"topic": "IMU", "where": {"I": 1}}
    log = read_foreign(bins, mapping(section, angular_rate=gyro(["GyrY", "GyrX", "GyrZ"], "deg/s", sign=[1, 1, -1])))
    assert len(log) == 20
    np.testing.assert_allclose(log[f"downlink.imu.{RATES}"][5], [DEG, 0.5 * DEG, -3 * DEG], rtol=1e-7)
    np.testing.assert_array_equal(np.diff(log.ticks), ms(10))
    yaw = read_foreign(bins, mapping("YAW", heading={"from": "Yaw", "unit": "deg", "unwrap": True}))
    np.testing.assert_allclose(yaw["downlink.imu.value.heading"], np.array([-0.5, 0.5, 1.5]) * DEG, atol=1e-9)


def test_mixed_imu_instances_require_a_filter(bins):
    with pytest.raises(InputError, match=r"20 rows have the time of another(.|\n)*where = \{I = 0\}"):
        read_foreign(bins, mapping("IMU", angular_rate=gyro(["GyrX", "GyrY", "GyrZ"])))
