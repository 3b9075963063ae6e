"""ROS 2 bag of a flight: a folder for `ros2 bag play`, RViz and Foxglove, with standard messages.

    /odom          nav_msgs/msg/Odometry     true position and attitude in `map`, true velocities in `base_link`
    /tf            tf2_msgs/msg/TFMessage    true pose of `base_link` in `map`
    /imu           sensor_msgs/msg/Imu       measurements of an ideal IMU
    /NAME/imu      sensor_msgs/msg/Imu       measurements of the three-axis IMU NAME of the vehicle

World axes are east, north, up in ROS, and north, east, down in this package. Body axes are forward, left, up in ROS,
and forward, starboard, down in this package. Source: REP 103, 105, 145; rosbag2, storage MCAP.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.logs.foreign.tables import import_package
from trimtab.logs.messages import NS_PER_SECOND, NS_PER_TICK

MAP, BODY = "map", "base_link"
TYPES = {"odom": "nav_msgs/msg/Odometry", "tf": "tf2_msgs/msg/TFMessage", "imu": "sensor_msgs/msg/Imu"}
HALF = math.sqrt(0.5)
NED_IN_ENU, FLU_IN_FRD = (0.0, HALF, HALF, 0.0), (0.0, 1.0, 0.0, 0.0)
NO_ORIENTATION = -1.0
"""First element of a covariance matrix in sensor_msgs/Imu if the quantity is not measured."""
BAG_VERSION = 9


class RosPose(NamedTuple):
    """Poses of the vehicle in the frames of ROS.

    The fields are the position in frame `map` (n, 3), and the attitude of `base_link` in `map`, as quaternions x, y, z,
    w (n, 4).
    """

    position: Any
    orientation: Any


def convert_pose(position: Any, attitude: Any) -> RosPose:
    """Return poses in the frames of ROS, for positions in W (n, 3) and quaternions q_WB (n, 4), scalar first."""
    turned = multiply_quaternions(multiply_quaternions(np.array(NED_IN_ENU), attitude), np.array(FLU_IN_FRD))
    return RosPose(position[:, [1, 0, 2]] * [1, 1, -1], turned[:, [1, 2, 3, 0]])


def convert_vector(in_body: Any) -> Any:
    """Return vectors (n, 3) in the body axes of ROS (forward, left, up), for vectors in B (forward, starboard,
    down)."""
    return in_body * [1, -1, -1]


def multiply_quaternions(p: Any, q: Any) -> Any:
    """Return the product p q of quaternions (n, 4), scalar first, row by row."""
    a, b, c, d = np.moveaxis(np.asarray(p, float), -1, 0)
    w, x, y, z = np.moveaxis(np.asarray(q, float), -1, 0)
    rows = a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y
    more = a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w
    return np.stack([*rows, *more], axis=-1)


def write_ros2_bag(folder: Path, motion: Any, imus: Mapping[str, Any], epoch: int = 0) -> dict[str, int]:
    """Write a ROS 2 bag. Return the topic -> number of messages. Rows with NaN are left out.

    Args:
        folder: path of a folder that does not exist yet.
        motion: motion of the body, `run.log_motion.MotionRows`.
        imus: name of an IMU -> its measurements, `run.log_motion.ImuRows`.
        epoch: time of day at time zero of the log (ns).

    Raises:
        InputError: the package rosbags is missing, or the folder exists already.
    """
    part = f"folder '{folder}'"
    rosbag2 = import_package(part, "rosbags.rosbag2")
    if folder.exists():
        raise InputError(part, "exists already", fix="use the name of a new folder, because a bag cannot be extended")
    messages = RosMessages(import_package(part, "rosbags.typesys"), epoch)
    topics = {"/odom": ("odom", motion), "/tf": ("tf", motion), "/imu": ("imu", motion)}
    topics |= {f"/{name}/imu": ("imu", rows) for name, rows in imus.items()}
    counts = dict[str, int]()
    with rosbag2.Writer(folder, version=BAG_VERSION, storage_plugin=rosbag2.StoragePlugin.MCAP) as bag:
        queued = list[tuple[int, Any, bytes]]()
        for topic, (kind, rows) in topics.items():
            connection = bag.add_connection(topic, TYPES[kind], typestore=messages.store)
            written = messages.encode(kind, _keep_finite(rows), is_measured=topic != "/imu")
            counts[topic] = len(written)
            queued += [(time, connection, data) for time, data in written]
        for time, connection, data in sorted(queued, key=lambda message: message[0]):
            bag.write(connection, time, data)
    return counts


def _keep_finite(rows: Any) -> Any:
    """Return the arrays with only those rows in which all numbers of all arrays are finite."""
    good = np.logical_and.reduce([np.isfinite(c).reshape(len(c), -1).all(axis=1) for c in rows])
    return type(rows)(*(c[good] for c in rows))


class RosMessages:
    """Encoder of rows of a log as messages of ROS 2 Humble."""

    def __init__(self, typesys: Any, epoch: int) -> None:
        """Create an encoder. typesys: module `typesys` of the package rosbags.  epoch: time of day at time zero
        (ns)."""
        self.store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        self._epoch = epoch

    def encode(self, kind: str, rows: Any, *, is_measured: bool) -> list[tuple[int, bytes]]:
        """Return time (ns) and bytes of the message of each row.

        is_measured: True for samples of a real IMU, which contain no attitude.
        """
        times = (rows.ticks * NS_PER_TICK + self._epoch).tolist()
        if kind == "imu":
            pose = None if is_measured else convert_pose(rows.position, rows.attitude)
            made = [self._imu(*row) for row in self._imu_rows(times, rows, pose)]
        else:
            pose = convert_pose(rows.position, rows.attitude)
            twist = convert_vector(rows.velocity).tolist(), convert_vector(rows.rate).tolist()
            each = zip(times, pose.position.tolist(), pose.orientation.tolist(), *twist, strict=True)
            made = [self._odometry(*row) if kind == "odom" else self._transform(*row[:3]) for row in each]
        return [(t, bytes(self.store.serialize_cdr(m, TYPES[kind]))) for t, m in zip(times, made, strict=True)]

    def _imu_rows(self, times: list[int], rows: Any, pose: RosPose | None) -> Any:
        none = [[0.0, 0.0, 0.0, 1.0]] * len(times)
        turns = none if pose is None else pose.orientation.tolist()
        known = [pose is not None] * len(times)
        vectors = convert_vector(rows.rate).tolist(), convert_vector(rows.specific_force).tolist()
        return zip(times, turns, known, *vectors, strict=True)

    def _of(self, name: str, *values: Any) -> Any:
        return self.store.types[name](*values)

    def _header(self, time: int, frame: str) -> Any:
        stamp = self._of("builtin_interfaces/msg/Time", *divmod(time, NS_PER_SECOND))
        return self._of("std_msgs/msg/Header", stamp, frame)

    def _vector(self, values: Any) -> Any:
        return self._of("geometry_msgs/msg/Vector3", *values)

    def _quaternion(self, values: Any) -> Any:
        return self._of("geometry_msgs/msg/Quaternion", *values)

    def _transform(self, time: int, place: Any, turn: Any) -> Any:
        moved = self._of("geometry_msgs/msg/Transform", self._vector(place), self._quaternion(turn))
        one = self._of("geometry_msgs/msg/TransformStamped", self._header(time, MAP), BODY, moved)
        return self._of("tf2_msgs/msg/TFMessage", [one])

    def _odometry(self, time: int, place: Any, turn: Any, velocity: Any, rate: Any) -> Any:
        point = self._of("geometry_msgs/msg/Point", *place)
        pose = self._of("geometry_msgs/msg/Pose", point, self._quaternion(turn))
        twist = self._of("geometry_msgs/msg/Twist", self._vector(velocity), self._vector(rate))
        no_doubt = np.zeros(36)
        with_doubt = self._of("geometry_msgs/msg/PoseWithCovariance", pose, no_doubt)
        moving = self._of("geometry_msgs/msg/TwistWithCovariance", twist, no_doubt)
        return self._of("nav_msgs/msg/Odometry", self._header(time, MAP), BODY, with_doubt, moving)

    def _imu(self, time: int, turn: Any, is_known: bool, rate: Any, force: Any) -> Any:
        none, unknown = np.zeros(9), np.array([0.0 if is_known else NO_ORIENTATION, *[0.0] * 8])
        turned, header = self._quaternion(turn), self._header(time, BODY)
        return self._of(TYPES["imu"], header, turned, unknown, self._vector(rate), none, self._vector(force), none)
