"""The arm's end located by ultrasound: fixes come late and bear no time, so errors grow with the speed."""

import math
from typing import Literal

from trimtab.core.time import ms, seconds
from trimtab.estimators.aided_inertial import Intake
from trimtab.laws.turntable import Turntable
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.navigation._platform import DEG, Covariance, Form, rig
from trimtab.sensors.heading import HeadingSensor
from trimtab.sensors.imu import Imu
from trimtab.sensors.late_fix import LateFix
from trimtab.sensors.position import PositionSensor

Rate = Literal["-115", "-57", "-230"]
Stamped = Literal["arrival", "measurement"]
HEADING_LATENCY, POSITION_LATENCY = 0.087, 0.120
"""Fitted (s): one number for three headings, one for two figures of position and velocity."""
FIX = 0.0044
"""Standard deviation of each coordinate (m): half of the fixes within 0.52 cm, [1] fig. 5.8."""
BASE = 0.2032
"""From unit A at the arm's end inwards to unit B (m): reconstructed, 4 in from the axis."""


def scenario(
    rate: Rate = "-115", stamped: Stamped = "arrival", covariance: Covariance = "consistent", form: Form = "feedforward"
) -> Scenario:
    """[1] section 6.2.1; `covariance=literal` is as published, `stamped=measurement` what the source did not have."""
    fix = LateFix(latency=POSITION_LATENCY, interval=seconds(1), stamped=stamped)
    turned = LateFix(latency=HEADING_LATENCY, interval=seconds(1), stamped=stamped)
    sensors = {
        "imu": Imu.microstrain_3dm_gx1(),
        "heading": HeadingSensor(noise=math.sqrt(2) * FIX / BASE, timing=turned),
        "position": PositionSensor(noise=FIX, timing=fix),
    }
    law = Turntable(rate=float(rate) * DEG)
    return rig("navigation/platform-cricket", sensors, law, intake=Intake(), covariance=covariance, form=form)
