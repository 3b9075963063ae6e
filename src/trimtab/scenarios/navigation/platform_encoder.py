"""Estimate velocity and position at the end of an arm that rotates at -166 deg/s, with IMU, encoder, magnetometer."""

import math

from trimtab.core.rotation import DEG
from trimtab.estimators.inertial.aided import Intake
from trimtab.laws.turntable import Turntable
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.navigation._platform import ARM, FIX_INTERVAL, LEAK, Covariance, Form, rig_scenario
from trimtab.sensors.encoder import Encoder
from trimtab.sensors.heading import Compass
from trimtab.sensors.imu import Imu
from trimtab.sensors.position import EncoderPosition


def scenario(covariance: Covariance = "consistent", form: Form = "feedforward") -> Scenario:
    """Return the scenario of the velocity and position filter of section 6.2.1 in the thesis (Kulis 2006).

    `covariance=literal` selects the filter as published.
    """
    encoder = Encoder(zero=math.pi / 2, period=FIX_INTERVAL)
    sensors = {
        "imu": Imu.microstrain_3dm_gx1(),
        "heading": Compass(),
        "position": EncoderPosition(encoder=encoder, arm=ARM),
    }
    return rig_scenario(
        "navigation/platform-encoder",
        sensors,
        Turntable(rate=-166 * DEG),
        intake=Intake(),
        covariance=covariance,
        form=form,
        noise={"forward": LEAK, "starboard": LEAK},
    )
