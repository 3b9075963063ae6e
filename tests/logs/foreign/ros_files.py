"""MCAP files and ROS bags, written by the formats' own packages."""

import json

import numpy as np
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)


def imu_message(ns, rate, force):
    """A sensor_msgs/Imu that turns at rate (rad/s) and feels force (m/s^2), each (x, y, z)."""
    types = STORE.types
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    stamp = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
    unknown = np.zeros(9)
    return types["sensor_msgs/msg/Imu"](
        header=types["std_msgs/msg/Header"](stamp=stamp, frame_id="imu"),
        orientation=quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=unknown,
        angular_velocity=vector(*rate),
        angular_velocity_covariance=unknown,
        linear_acceleration=vector(*force),
        linear_acceleration_covariance=unknown,
    )


def write_rosbag2(folder, topic, messages):
    """messages: time in ns -> message of sensor_msgs/Imu."""
    with Rosbag2Writer(folder, version=9) as writer:
        connection = writer.add_connection(topic, "sensor_msgs/msg/Imu", typestore=STORE)
        for ns, message in messages.items():
            writer.write(connection, ns, STORE.serialize_cdr(message, "sensor_msgs/msg/Imu"))
    return folder


def write_rosbag1(file, topic, messages):
    """messages: time in ns -> text of std_msgs/Float64."""
    store = get_typestore(Stores.ROS1_NOETIC)
    with BagWriter(file) as writer:
        connection = writer.add_connection(topic, "std_msgs/msg/Float64", typestore=store)
        for ns, value in messages.items():
            message = store.types["std_msgs/msg/Float64"](data=value)
            writer.write(connection, ns, store.serialize_ros1(message, "std_msgs/msg/Float64"))
    return file


def write_cdr_mcap(file, topic, messages):
    """The same messages as `write_rosbag2` writes, in one MCAP file with their definition."""
    text, _ = STORE.generate_msgdef("sensor_msgs/msg/Imu", ros_version=2)
    with open(file, "wb") as stream:
        writer = McapWriter(stream)
        writer.start("ros2")
        schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", text.encode())
        channel = writer.register_channel(topic, "cdr", schema)
        for ns, message in messages.items():
            writer.add_message(channel, ns, bytes(STORE.serialize_cdr(message, "sensor_msgs/msg/Imu")), ns)
        writer.finish()
    return file


def write_json_mcap(file, topic, messages, encoding="json"):
    """messages: pairs of time in ns and what becomes JSON."""
    with open(file, "wb") as stream:
        writer = McapWriter(stream)
        writer.start("json")
        channel = writer.register_channel(topic, encoding, 0)
        for ns, message in messages:
            writer.add_message(channel, ns, json.dumps(message).encode(), ns)
        writer.finish()
    return file
