"""Encoders: the state computed from the motion, and quantised."""

import numpy as np
import pytest

from trimtab.core.record import replace
from trimtab.sensors.rail_encoders import RailEncoders
from trimtab.vehicles.cart_pole import CartForce, CartPole, CartPoleState

X = CartPoleState(0.40321, -1.3, 2.50071, 0.8)
MOTION = CartPole().motion(0, X, CartForce(2.0))


def test_unquantised_reading_equals_the_state():
    sensor = replace(RailEncoders(), position_step=0.0, angle_step=0.0)
    value = sensor.step(0, (), MOTION)[1].value
    got = [value.position, value.speed, value.angle, value.angle_rate]
    assert got == pytest.approx([X.position, X.speed, X.angle, X.angle_rate], abs=1e-12)


def test_reading_is_rounded_to_the_nearest_step():
    value = RailEncoders(position_step=0.01, angle_step=np.pi / 100).step(0, (), MOTION)[1].value
    assert float(value.position) == pytest.approx(0.40)
    assert float(value.angle) == pytest.approx(80 * np.pi / 100)
    assert float(value.speed) == pytest.approx(-1.3)
