"""Estimate the heading on the axis of a platform that rotates at -166 deg/s, with gyro and magnetometer."""

from trimtab.core.rotation import DEG
from trimtab.estimators.inertial.aided import Intake
from trimtab.laws.turntable import Turntable
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.navigation._platform import Covariance, Form, rig_scenario
from trimtab.sensors.encoder import Tachometer
from trimtab.sensors.heading import Compass
from trimtab.sensors.imu import Imu


def scenario(covariance: Covariance = "consistent", form: Form = "feedforward") -> Scenario:
    """Return the scenario of the heading filter of section 6.2.1 in the thesis (Kulis 2006).

    `covariance=literal` selects the filter as published.
    """
    sensors = {"imu": Imu.microstrain_3dm_gx1(), "heading": Compass(), "tachometer": Tachometer()}
    law = Turntable(rate=-166 * DEG)
    intake = Intake(position="")
    return rig_scenario(
        "navigation/platform-magnetometer", sensors, law, arm=0.0, intake=intake, covariance=covariance, form=form
    )
