"""State for an aeroplane's control laws, from an inertial unit, satellites and air data probes."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core import quaternion
from trimtab.core.record import Scalar, option, part, quantity, record
from trimtab.core.rng import Key
from trimtab.core.signals import Estimate, Frame
from trimtab.environment.geodetic import STANDARD
from trimtab.estimators.inertial.gnss_inertial import GnssInertial, GnssInertialState, SpatialNavigationState

ZERO = (0.0, 0.0, 0.0)


@record
class AirInertialEstimate:
    """Flight state for a control law, with the navigation state behind it. Source: docs page, Air and inertial."""

    speed: Scalar = quantity("m/s", "Airspeed, from the pitot tube.")
    alpha: Scalar = quantity("rad", "Angle of attack, from the vane.", kind="angle")
    beta: Scalar = quantity("rad", "Sideslip, from the vane.", kind="angle")
    altitude: Scalar = quantity("m", "Altitude of the centre of mass above the origin of W.", frame="W")
    roll: Scalar = quantity("rad", "Bank angle.", frame="WB", kind="angle")
    pitch: Scalar = quantity("rad", "Pitch angle, nose up.", frame="WB", kind="angle")
    roll_rate: Scalar = quantity("rad/s", "Roll rate P, without the gyro's bias.", frame="B")
    pitch_rate: Scalar = quantity("rad/s", "Pitch rate Q, without the gyro's bias.", frame="B")
    yaw_rate: Scalar = quantity("rad/s", "Yaw rate R, without the gyro's bias.", frame="B")
    normal_load: Scalar = quantity("1", "Upward load factor at the inertial unit: 1 in level flight.", frame="B")
    side_load: Scalar = quantity("1", "Load factor to starboard at the inertial unit.", frame="B")
    inertial: SpatialNavigationState = part("Navigation state at the inertial unit.")


@record
class AirInertial:
    """Air data beside inertial navigation: airspeed and flow angles from probes, the rest from the error-state filter.

        altitude = -(p - R_WB l)_down        n = (f - b_force)/g

    p, R_WB, b: from the filter, at the unit's place l; f: accelerometer reading. Rates are the gyro readings minus
    their estimated bias. The estimate is valid when the navigation is valid and the probes have given a sample.

    Frames:  as of `GnssInertial`; l in B from the centre of mass.
    Not modelled: the wind is not estimated, and air data do not aid the navigation; nor does a barometer.
    Source:  docs page, Air and inertial.
    """

    inertial: GnssInertial = part("Inertial navigation.", default=GnssInertial())
    lever_arm: Any = quantity("m", "Position of the inertial unit.", frame="B", default=ZERO, shape=(3,))
    gravity: Scalar = quantity("m/s^2", "Acceleration that counts as a load factor of 1.", default=STANDARD, above=0)
    air: str = option("Name of the air data sensor.", default="air")

    @property
    def listens(self) -> tuple[str, ...]:
        """Return the names of the sensors that are read."""
        return (*self.inertial.listens, self.air)

    def init(self, key: Key) -> GnssInertialState:
        """Return the initial state, before any measurement."""
        return self.inertial.init(key)

    def step(self, t: Any, state: GnssInertialState, frame: Frame) -> tuple[GnssInertialState, Estimate]:
        """Return the estimate at integer time t; its state is an AirInertialEstimate."""
        state, of = self.inertial.step(t, state, frame)
        x, air = of.state, frame.samples[self.air]
        place = x.position - quaternion.rotate(x.attitude, jnp.asarray(self.lever_arm, float))
        imu_reading = state.window.imu_reading[3:] - x.force_bias
        valid = of.valid & jnp.asarray(air.valid, np.bool_)
        estimate = AirInertialEstimate(
            speed=air.value.airspeed,
            alpha=air.value.alpha,
            beta=air.value.beta,
            altitude=-place[2],
            roll=x.angles[0],
            pitch=x.angles[1],
            roll_rate=x.angular_rate[0],
            pitch_rate=x.angular_rate[1],
            yaw_rate=x.angular_rate[2],
            normal_load=-imu_reading[2] / self.gravity,
            side_load=imu_reading[1] / self.gravity,
            inertial=x,
        )
        return state, Estimate(t=t, age=of.age, fresh=of.fresh, valid=valid, state=estimate)
