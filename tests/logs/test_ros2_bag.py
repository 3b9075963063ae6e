"""Axes of ROS 2. Another library reads the bag back in tests/commands/test_convert.py."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trimtab.logs.ros2_bag import convert_pose, convert_vector


def test_axes_are_converted_to_enu_and_flu():
    """Compare with scipy's rotations, and check a vehicle that points north-east with its nose up."""
    frd_in_ned = Rotation.from_euler("ZYX", [[45.0, 20.0, 10.0]], degrees=True)
    enu, flu = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]]), Rotation.from_matrix(np.diag([1, -1, -1]))
    pose = convert_pose(np.array([[1.0, 2.0, -3.0]]), frd_in_ned.as_quat(scalar_first=True))
    assert pose.position.tolist() == [[2.0, 1.0, 3.0]]
    turned = Rotation.from_quat(pose.orientation)
    assert (turned * (enu * frd_in_ned * flu).inv()).magnitude() == pytest.approx(0.0, abs=1e-12)
    nose = turned.apply([1.0, 0.0, 0.0])[0]
    assert math.degrees(math.atan2(nose[1], nose[0])) == pytest.approx(45.0)  # between east and north
    assert nose[2] == pytest.approx(math.sin(math.radians(20.0)))
    assert convert_vector(np.array([[0.0, 0.0, -9.81]])).tolist() == [[0.0, 0.0, 9.81]]
