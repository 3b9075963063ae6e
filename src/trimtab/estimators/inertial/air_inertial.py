"""Flight state for an aeroplane's control laws, estimated from an inertial unit, satellites and air data probes."""

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
    """Flight state for a control law, and the navigation state. Source: docs page, Air data and inertial navigation."""

    speed: Scalar = quantity("m/s", "Airspeed measured by the pitot tube.")
    alpha: Scalar = quantity("rad", "Angle of attack measured by the vane.", kind="angle")
    beta: Scalar = quantity("rad", "Sideslip angle measured by the vane.", kind="angle")
    altitude: Scalar = quantity("m", "Altitude of the centre of mass above the origin of W.", frame="W")
    roll: Scalar = quantity("rad", "Bank angle.", frame="WB", kind="angle")
    pitch: Scalar = quantity("rad", "Pitch angle, nose up.", frame="WB", kind="angle")
    roll_rate: Scalar = quantity("rad/s", "Roll rate P, corrected for the gyro's bias.", frame="B")
    pitch_rate: Scalar = quantity("rad/s", "Pitch rate Q, corrected for the gyro's bias.", frame="B")
    yaw_rate: Scalar = quantity("rad/s", "Yaw rate R, corrected for the gyro's bias.", frame="B")
    normal_load: Scalar = quantity("1", "Upward load factor at the inertial unit: 1 in level flight.", frame="B")
    side_load: Scalar = quantity("1", "Load factor to starboard at the inertial unit.", frame="B")
    inertial: SpatialNavigationState = part("Navigation state at the inertial unit.")


@record
class AirInertial:
    """Flight state from two sources: airspeed and flow angles from probes, all else from an error-state filter.

        altitude = -(p - R_WB l)_down        n = (f - b_force)/g

    p, R_WB, b: position, attitude and biases of the inertial unit, estimated by the filter. l: position of the inertial
    unit in B, measured from the centre of mass. f: accelerometer reading. Rates are the gyro readings minus their
    estimated bias. The estimate is valid if the navigation is valid and the probes' sample is valid.

    Frames:  those of `GnssInertial`.
    Not modelled: wind, which is not estimated. Neither air data nor a barometer aids the navigation.
    Source:  docs page, Air data and inertial navigation.
    """

    inertial: GnssInertial = part("Inertial navigation aided by satellites.", default=GnssInertial())
    lever_arm: Any = quantity(
        "m", "Position of the inertial unit, measured from the centre of mass.", frame="B", default=ZERO, shape=(3,)
    )
    gravity: Scalar = quantity("m/s^2", "Acceleration at a load factor of 1.", default=STANDARD, above=0)
    air: str = option("Name of the air data sensor.", default="air")

    @property
    def listens(self) -> tuple[str, ...]:
        """Return the names of the sensors that the estimator reads."""
        return (*self.inertial.listens, self.air)

    def init(self, key: Key) -> GnssInertialState:
        """Return the estimator's initial state, before any measurement."""
        return self.inertial.init(key)

    def step(self, t: Any, state: GnssInertialState, frame: Frame) -> tuple[GnssInertialState, Estimate]:
        """Return the new state and the estimate, an AirInertialEstimate, at integer time t."""
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
