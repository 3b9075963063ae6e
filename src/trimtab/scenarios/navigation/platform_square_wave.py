"""Turn a platform back and forth faster than a gyro can follow, with or without compensation of the gyro's dynamics."""

from typing import Literal

from trimtab.core.record import replace
from trimtab.core.rotation import DEG
from trimtab.estimators.inertial.aided import Intake
from trimtab.estimators.inertial.gyro_compensated import CompensatedInertial
from trimtab.laws.turntable import Turntable
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.navigation._platform import Covariance, Form, rig_scenario
from trimtab.sensors.encoder import Tachometer
from trimtab.sensors.gyro_dynamics import DelayedGyro
from trimtab.sensors.heading import Compass
from trimtab.sensors.imu import Imu

Compensation = Literal["yes", "no"]


def scenario(
    compensated: Compensation = "yes", covariance: Covariance = "consistent", form: Form = "feedforward"
) -> Scenario:
    """Return the scenario of table 6.6 in the thesis (Kulis 2006).

    The thesis does not state the amplitude and the period of the square wave. They were reconstructed (docs page,
    Errata).
    """
    imu = Imu.microstrain_3dm_gx1()
    imu = replace(imu, gyro=replace(imu.gyro, bandwidth=0.0, response=DelayedGyro()))
    sensors = {"imu": imu, "heading": Compass(), "tachometer": Tachometer()}
    return rig_scenario(
        "navigation/platform-square-wave",
        sensors,
        Turntable(rate=166 * DEG, cycle=2.0, waveform="square"),
        arm=0.0,
        time_constant=0.07,
        intake=Intake(position=""),
        covariance=covariance,
        form=form,
        estimator=CompensatedInertial if compensated == "yes" else None,
    )
