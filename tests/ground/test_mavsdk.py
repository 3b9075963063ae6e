"""MAVSDK discovers, reads, arms and commands a running vehicle. It cannot sign, so the vehicle is unsigned."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from ground.serving import PATIENCE, served

mavsdk = pytest.importorskip("mavsdk", reason='pip install "mavsdk>=4.1"')
pytestmark = [
    pytest.mark.real_time,
    pytest.mark.skipif(not hasattr(mavsdk, "Configuration"), reason='pip install "mavsdk>=4.1"'),
]
STATION = Path(__file__).with_name("mavsdk_station.py")


def station(port):
    """Return MAVSDK's findings. It runs in its own process, because its threads outlive a test."""
    done = subprocess.run(
        [sys.executable, str(STATION), str(port)], capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_mavsdk_reads_state_arms_and_changes_mode_and_parameters(tmp_path):
    more = ("--origin", "38.9897,-76.9378,20", "--out", str(tmp_path / "out"))
    with served(tmp_path, "--unsigned", *more) as vehicle:
        found = station(vehicle.port)
        report = vehicle.stop()
    assert (found["system"], found["components"]) == (1, [1])
    assert found["attitude"] == pytest.approx([0.0, 0.0, 0.0])
    assert found["position"] == pytest.approx([0.0, 0.0, 0.0])
    assert found["place"] == pytest.approx([38.9897, -76.9378], abs=1e-5)
    assert found["home"] == pytest.approx([38.9897, -76.9378], abs=1e-5)
    assert sorted(found["files"]) == ["outputs.txt", "vehicle.mcap"]
    assert len(found["logs"]) == 2
    assert found["local_position_ok"]
    assert found["mass"] == pytest.approx([2.6, 2.8])
    assert 3 < found["parameters"] < 1000
    assert found["armed"] == [False, True, False]
    assert found["modes"] == [15, 0]
    assert any("arm request" in text for text in found["texts"])
    assert report["released_s"] is not None


def test_mavsdk_finds_no_signing_vehicle(tmp_path):
    with served(tmp_path) as vehicle:
        found = station(vehicle.port)
        report = vehicle.stop()
    assert found == {"system": None}
    assert report["line"]["bytes_out"] == 0
    assert report["released_s"] is None
    assert report["wire"]["unsigned"] > 0
