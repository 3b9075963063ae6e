"""What an aeroplane's control laws read, from an inertial unit, satellites and probes in the air."""

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
    """Flight as a law reads it, and the navigation that it comes from. Source: docs page, Air and inertial."""

    speed: Scalar = quantity("m/s", "Through the air, from the pitot tube.")
    alpha: Scalar = quantity("rad", "Angle of attack, from the vane.", kind="angle")
    beta: Scalar = quantity("rad", "Sideslip, from the vane.", kind="angle")
    altitude: Scalar = quantity("m", "Of the centre of mass, above the origin of W.", frame="W")
    roll: Scalar = quantity("rad", "Bank.", frame="WB", kind="angle")
    pitch: Scalar = quantity("rad", "Nose up.", frame="WB", kind="angle")
    roll_rate: Scalar = quantity("rad/s", "P, without the gyro's bias.", frame="B")
    pitch_rate: Scalar = quantity("rad/s", "Q, without the gyro's bias.", frame="B")
    yaw_rate: Scalar = quantity("rad/s", "R, without the gyro's bias.", frame="B")
    normal_load: Scalar = quantity("1", "Load factor upwards at the unit: 1 in level flight.", frame="B")
    side_load: Scalar = quantity("1", "Load factor to starboard at the unit.", frame="B")
    inertial: SpatialNavigationState = part("The navigation, at the inertial unit.")


@record
class AirInertial:
    """Air data beside inertial navigation: wind-free angles from vanes, all else from the error-state filter.

        altitude = -(p - R_WB l)_down        n = (f - b_force)/g

    p, R_WB, b: of the filter, at the unit's place l; f: what the accelerometers read. Rates are the gyros' less their
    believed bias. The estimate is valid when the navigation is and the probes have said something.

    Frames:  as of `GnssInertial`; l in B from the centre of mass.
    Not modelled: the wind is not estimated, and air data do not aid the navigation; nor does a barometer.
    Source:  docs page, Air and inertial.
    """

    inertial: GnssInertial = part("The navigation.", default=GnssInertial())
    lever_arm: Any = quantity("m", "The inertial unit's place.", frame="B", default=ZERO, shape=(3,))
    gravity: Scalar = quantity("m/s^2", "That load factors are counted in.", default=STANDARD, above=0)
    air: str = option("Name of the air data.", default="air")

    @property
    def listens(self) -> tuple[str, ...]:
        """The names of what is read."""
        return (*self.inertial.listens, self.air)

    def init(self, key: Key) -> GnssInertialState:
        """Nothing measured yet."""
        return self.inertial.init(key)

    def step(self, t: Any, state: GnssInertialState, frame: Frame) -> tuple[GnssInertialState, Estimate]:
        """The estimate at integer time t; its state is an AirInertialEstimate."""
        state, of = self.inertial.step(t, state, frame)
        x, air = of.state, frame.samples[self.air]
        place = x.position - quaternion.rotate(x.attitude, jnp.asarray(self.lever_arm, float))
        felt = state.window.felt[3:] - x.force_bias
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
            normal_load=-felt[2] / self.gravity,
            side_load=felt[1] / self.gravity,
            inertial=x,
        )
        return state, Estimate(t=t, age=of.age, fresh=of.fresh, valid=valid, state=estimate)
