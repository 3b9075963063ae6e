"""`trimtab convert`: a flight as a ROS 2 bag, read back by another library, and as a Rerun recording."""

import importlib.util
import json
import math

import numpy as np
import pytest
from click.testing import CliRunner
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from scipy.spatial.transform import Rotation

from trimtab.cli import main
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.time import ms
from trimtab.logs.mcap import read_mcap
from trimtab.run.log_motion import choose_rows

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
HAS_RERUN = importlib.util.find_spec("rerun") is not None
SHORT = "--duration", "500 ms", "--no-ideal"


def call(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    return fly(tmp_path_factory.mktemp("flight"), "hovercraft/zero-velocity")


def fly(folder, *words):
    done = call("run", *words, *SHORT, "--out", folder / "craft")
    assert done.exit_code == 0, done.output
    return folder / "craft" / "run.mcap"


def test_chosen_rows_are_one_period_apart():
    assert choose_rows(np.array([0, 1, 5, 6, 11, 30]) * ms(1), ms(5)).tolist() == [0, 2, 4, 5]


@pytest.mark.thorough
def test_ros2_bag_matches_log_when_read_by_another_library(flight, tmp_path):
    done = call("convert", flight, "--as", "ros2", "--out", tmp_path / "bag", "--json")
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)["messages"]
    assert sorted(p.name for p in (tmp_path / "bag").iterdir()) == ["bag.mcap", "metadata.yaml"]
    with Reader(tmp_path / "bag") as bag:
        assert {c.topic: c.msgtype for c in bag.connections}["/odom"] == "nav_msgs/msg/Odometry"
    log = read_mcap(flight)
    with AnyReader([tmp_path / "bag"]) as bag:
        found = {c.topic: [] for c in bag.connections}
        times = []
        for connection, time, data in bag.messages():
            found[connection.topic].append(bag.deserialize(data, connection.msgtype))
            times.append(time)
    assert times == sorted(times)
    assert {topic: len(messages) for topic, messages in found.items()} == said
    assert len(found["/odom"]) == len(found["/tf"]) == 50
    odom, row = found["/odom"][-1], int(np.searchsorted(log.ticks, ms(490)))
    assert (odom.header.frame_id, odom.child_frame_id) == ("map", "base_link")
    assert odom.header.stamp.nanosec == 490_000_000
    place = odom.pose.pose.position
    assert (place.x, place.y, place.z) == (log["truth.east"][row], log["truth.north"][row], 0.0)
    turn = odom.pose.pose.orientation
    yaw = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_euler("ZYX")[0]
    assert math.remainder(yaw - (math.pi / 2 - log["truth.heading"][row]), math.tau) == pytest.approx(0.0, abs=1e-12)
    twist = odom.twist.twist
    assert (twist.linear.x, twist.linear.y) == (log["truth.surge_velocity"][row], -log["truth.sway_velocity"][row])
    assert twist.angular.z == -log["truth.yaw_rate"][row]
    moved = found["/tf"][-1].transforms[0].transform.translation
    assert (moved.x, moved.y) == (place.x, place.y)
    assert found["/imu"][-1].linear_acceleration.z == pytest.approx(9.80665)


@pytest.mark.thorough
def test_bag_contains_imu_samples_as_measured(tmp_path):
    flight = fly(tmp_path, "hovercraft/forward", "--navigation", "ins")
    assert call("convert", flight, "--as", "ros2", "--out", tmp_path / "bag").exit_code == 0
    log = read_mcap(flight)
    name = next(p for p in log.paths if p.endswith(".value.specific_force")).split(".")[1]
    with AnyReader([tmp_path / "bag"]) as bag:
        chosen = [c for c in bag.connections if c.topic in ("/imu", f"/{name}/imu")]
        found = {"/imu": [], f"/{name}/imu": []}
        for connection, _, data in bag.messages(connections=chosen):
            found[connection.topic].append(bag.deserialize(data, connection.msgtype))
    measured = found[f"/{name}/imu"]
    assert len(measured) == np.unique(log[f"sensors.{name}.t"]).size
    force = measured[-1].linear_acceleration
    there = log[f"sensors.{name}.value.specific_force"][-1]
    assert (force.x, force.y, force.z) == (there[0], -there[1], -there[2])
    assert measured[-1].orientation_covariance[0] == -1.0
    assert found["/imu"][-1].linear_acceleration.z == pytest.approx(9.80665)
    assert found["/imu"][-1].orientation_covariance[0] == 0.0


@pytest.mark.thorough
def test_rejects_existing_bag_and_wrong_file_suffix(flight, tmp_path):
    (tmp_path / "bag").mkdir()
    refused = call("convert", flight, "--as", "ros2", "--out", tmp_path / "bag")
    assert refused.exit_code == 2
    assert "already exists" in refused.stderr
    refused = call("convert", flight, "--as", "rerun", "--out", tmp_path / "flight.txt")
    assert refused.exit_code == 2
    assert "flight.rrd" in refused.stderr
    refused = call("convert", flight, "--as", "ros2", "--out", tmp_path / "new", "--period", "0")
    assert refused.exit_code == 2
    assert "--period: must be above 0, got '0'" in refused.stderr


if HAS_RERUN:

    def test_rerun_recording_contains_body_and_all_signals(flight, tmp_path):
        from rerun.chunk import RrdReader

        file = tmp_path / "flight.rrd"
        done = call("convert", flight, "--as", "rerun", "--out", file, "--json")
        assert done.exit_code == 0, done.output
        columns = {}
        for chunk in RrdReader(file).stream().to_chunks():
            columns.setdefault(chunk.entity_path.lstrip("/"), []).append(chunk.to_record_batch())
        log = read_mcap(flight)
        assert sum(b.num_rows for b in columns["signals/truth/yaw_rate"]) == len(log)
        assert sum(b.num_rows for b in columns["world/vehicle"]) == 50
        values = np.concatenate([scalars(batch) for batch in columns["signals/truth/yaw_rate"]])
        assert np.array_equal(values, log["truth.yaw_rate"])

    def scalars(batch):
        name = next(n for n in batch.schema.names if "calar" in n)
        return np.array([row[0] for row in batch.column(name).to_pylist()])

else:

    def test_missing_rerun_package_is_reported_with_install_command(flight, tmp_path):
        refused = call("convert", flight, "--as", "rerun", "--out", tmp_path / "flight.rrd")
        assert refused.exit_code == 2
        assert 'pip install "trimtab[rerun]"' in refused.stderr
        assert not (tmp_path / "flight.rrd").exists()
