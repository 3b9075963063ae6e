"""Files of other systems that several tests read."""

import numpy as np
import pytest
from logs.foreign.written import bin_bytes, ulog_bytes


@pytest.fixture
def ulog(tmp_path):
    """Two gyros of 250 Hz, an attitude, and what only PX4 does: instances, arrays."""
    form = "uint64_t timestamp;float[3] gyro;float temperature;"
    rows = [(1_000_000 + 4000 * k, 0.1, -0.2, k / 10, 20.0) for k in range(50)]
    other = [(t, 9.0, 9.0, 9.0, s) for t, *_, s in rows]
    half = np.sqrt(0.5)
    turns = [(1_000_000 + 20_000 * k, half, 0.0, 0.0, half) for k in range(10)]
    topics = {"sensor_gyro": (form, rows), ("sensor_gyro", 1): (form, other)}
    topics["vehicle_attitude"] = ("uint64_t timestamp;float[4] q;", turns)
    file = tmp_path / "flight.ulg"
    file.write_bytes(ulog_bytes(topics))
    return file


@pytest.fixture
def bins(tmp_path):
    """Two units in one type of message, hundredths, and angles that pass north."""
    rows = [(500_000 + 10_000 * k, unit, 0.5, 1.0, 2.0 + unit) for k in range(20) for unit in (0, 1)]
    yaws = [(500_000 + 100_000 * k, round(100 * (359.5 + k) % 36_000) - 36_000 * (k < 1)) for k in range(3)]
    file = tmp_path / "1.BIN"
    types = {"IMU": ("QBfff", ("TimeUS", "I", "GyrX", "GyrY", "GyrZ"), rows), "YAW": ("Qc", ("TimeUS", "Yaw"), yaws)}
    file.write_bytes(bin_bytes(types))
    return file


@pytest.fixture
def write(tmp_path):
    def text(content):
        file = tmp_path / "a.csv"
        file.write_text(content)
        return file

    return text
