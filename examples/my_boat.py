"""A vehicle of your own, with its scenario: trimtab run examples/my_boat.py:scenario --plot boat.png"""

from typing import ClassVar

import jax.numpy as jnp

from trimtab import Autopilot, Scenario, Target, World, ms, part, quantity, record, seconds
from trimtab.actuators.allocation import DirectAllocation
from trimtab.actuators.bank import ActuatorBank
from trimtab.actuators.lag import FirstOrderLag
from trimtab.core.record import Scalar
from trimtab.core.rotation import wrap
from trimtab.core.signals import Motion
from trimtab.estimators.passthrough import Passthrough
from trimtab.links.wire import DelayChain
from trimtab.sensors.planar_pose import NoisyPlanarPose


@record
class BoatState:
    """Velocity in the body frame, and heading. Source: conventions page."""

    surge_velocity: Scalar = quantity("m/s", "Velocity along the keel.", frame="B", default=0.0)
    sway_velocity: Scalar = quantity("m/s", "Velocity to starboard.", frame="B", default=0.0)
    yaw_rate: Scalar = quantity("rad/s", "Yaw rate, clockwise.", frame="B", default=0.0)
    heading: Scalar = quantity("rad", "Heading from north, clockwise.", kind="angle", default=0.0)


@record
class BoatInput:
    """Output of motor and servo. Source: this file."""

    thrust: Scalar = quantity("N", "Thrust of the propeller, positive ahead.", default=0.0)
    rudder: Scalar = quantity("rad", "Rudder angle; positive turns to starboard.", kind="angle", default=0.0)


@record
class Boat:
    """A model boat with a rudder in its wake. Source: Fossen, "Handbook of marine craft", 2011, ch. 6, linear drag."""

    mass: Scalar = quantity("kg", "Mass.", default=3.0, above=0)
    inertia: Scalar = quantity("kg m^2", "Moment of inertia about the vertical axis.", default=0.15, above=0)
    arm: Scalar = quantity("m", "Distance from the centre of mass to the rudder.", default=0.3, above=0)
    drag: Scalar = quantity("N s/m", "Drag along the keel; ten times as large across.", default=2.0, low=0)
    lift: Scalar = quantity("N s^2/m^2/rad", "Side force of the rudder per speed squared.", default=4.0, above=0)

    MAV_TYPE: ClassVar[str] = "SURFACE_BOAT"

    def dynamics(self, t, x, u):
        """Return the derivative of x."""
        side = -self.lift * abs(x.surge_velocity) * x.surge_velocity * u.rudder
        du = (u.thrust - self.drag * x.surge_velocity) / self.mass + x.sway_velocity * x.yaw_rate
        dv = (side - 10 * self.drag * x.sway_velocity) / self.mass - x.surge_velocity * x.yaw_rate
        dr = (-self.arm * side - 0.2 * self.drag * x.yaw_rate) / self.inertia
        return BoatState(du, dv, dr, x.yaw_rate)

    def motion(self, t, x, u):
        """Return the motion that sensors measure."""
        d, o = self.dynamics(t, x, u), 0.0 * x.heading
        v, turn = jnp.stack([x.surge_velocity, x.sway_velocity, o]), jnp.stack([o, o, x.yaw_rate])
        a, alpha = jnp.stack([d.surge_velocity, d.sway_velocity, o]), jnp.stack([o, o, d.yaw_rate])
        return Motion(t, jnp.zeros(3), jnp.stack([o, o, x.heading]), v, turn, a + jnp.cross(turn, v), alpha)


@record
class CourseOutput:
    """Demand of the law, and its course error. Source: this file."""

    demand: BoatInput = part("Demanded thrust and rudder angle.")
    off_course: Scalar = quantity("rad", "Course error: heading minus desired heading.", kind="angle")


@record
class HoldCourse:
    """Hold speed and heading by proportional gains, with drag feedforward. Source: this file."""

    speed: Scalar = quantity("m/s", "Desired speed.", default=1.0)
    heading: Scalar = quantity("rad", "Desired heading.", kind="angle", default=1.0)
    drag: Scalar = quantity("N s/m", "Drag of the boat in the law's model.", default=2.0, low=0)
    k_speed: Scalar = quantity("N s/m", "Gain from speed error to thrust.", default=4.0, low=0)
    k_heading: Scalar = quantity("1", "Gain from heading error to rudder.", default=1.0, low=0)
    k_rate: Scalar = quantity("s", "Gain from yaw rate to rudder.", default=0.5, low=0)

    reads: ClassVar[tuple[str, ...]] = ("surge_velocity", "yaw_rate", "heading")

    def init(self, key):
        """Return the empty state."""
        return ()

    def step(self, t, state, estimate):
        """Return the demanded thrust and rudder angle."""
        x = estimate.state
        off = wrap(x.heading - self.heading)
        thrust = self.drag * self.speed + self.k_speed * (self.speed - x.surge_velocity)
        return state, CourseOutput(BoatInput(thrust, -self.k_heading * off - self.k_rate * x.yaw_rate), off)


def scenario() -> Scenario:
    """Return a flight from rest to 1 m/s on a course of 1 rad, over a radio with 40 ms each way."""
    link, tick = DelayChain(period=ms(20), steps=2), ms(10)
    motor = FirstOrderLag(time_constant=0.1, low=-3.0, high=6.0)
    servo = FirstOrderLag(time_constant=0.05, rate_limit=5.0, low=-0.6, high=0.6)
    helm = ActuatorBank(BoatInput(), {"thrust": motor, "rudder": servo}, period=tick)
    sensor = NoisyPlanarPose(velocity_noise=0.03, heading_noise=0.02, rate_noise=0.03, period=tick)
    world = World(Boat(), {"navigation": sensor}, helm, downlink=link, uplink=link, max_step=tick)
    autopilot = Autopilot(Passthrough("navigation"), HoldCourse(), DirectAllocation(), period=tick)
    goals = (Target("truth.surge_velocity", 1.0, 0.1), Target("law.off_course", 0.0, 0.1))
    return Scenario(world, autopilot, BoatState(), seconds(12), goals)
