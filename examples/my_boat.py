"""A vehicle of your own, flown: trimtab run examples/my_boat.py:scenario --plot boat.png"""

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
    """Velocity in the body, heading. Source: conventions page."""

    surge_velocity: Scalar = quantity("m/s", "Along the keel.", frame="B", default=0.0)
    sway_velocity: Scalar = quantity("m/s", "To starboard.", frame="B", default=0.0)
    yaw_rate: Scalar = quantity("rad/s", "Clockwise.", frame="B", default=0.0)
    heading: Scalar = quantity("rad", "From north, clockwise.", kind="angle", default=0.0)


@record
class BoatInput:
    """What the motor and the servo do. Source: this file."""

    thrust: Scalar = quantity("N", "Of the propeller, positive ahead.", default=0.0)
    rudder: Scalar = quantity("rad", "Positive turns to starboard.", kind="angle", default=0.0)


@record
class Boat:
    """A model boat with a rudder in its wake. Source: Fossen, "Handbook of marine craft", 2011, ch. 6, linear drag."""

    mass: Scalar = quantity("kg", "Mass.", default=3.0, above=0)
    inertia: Scalar = quantity("kg m^2", "About the vertical axis.", default=0.15, above=0)
    arm: Scalar = quantity("m", "Centre of mass to rudder.", default=0.3, above=0)
    drag: Scalar = quantity("N s/m", "Along the keel; ten times as much across.", default=2.0, low=0)
    lift: Scalar = quantity("N s^2/m^2/rad", "Side force of the rudder, by speed squared.", default=4.0, above=0)

    MAV_TYPE: ClassVar[str] = "SURFACE_BOAT"

    def dynamics(self, t, x, u):
        """The derivative of x."""
        side = -self.lift * abs(x.surge_velocity) * x.surge_velocity * u.rudder
        du = (u.thrust - self.drag * x.surge_velocity) / self.mass + x.sway_velocity * x.yaw_rate
        dv = (side - 10 * self.drag * x.sway_velocity) / self.mass - x.surge_velocity * x.yaw_rate
        dr = (-self.arm * side - 0.2 * self.drag * x.yaw_rate) / self.inertia
        return BoatState(du, dv, dr, x.yaw_rate)

    def motion(self, t, x, u):
        """All that a sensor can feel."""
        d, o = self.dynamics(t, x, u), 0.0 * x.heading
        v, turn = jnp.stack([x.surge_velocity, x.sway_velocity, o]), jnp.stack([o, o, x.yaw_rate])
        a, alpha = jnp.stack([d.surge_velocity, d.sway_velocity, o]), jnp.stack([o, o, d.yaw_rate])
        return Motion(t, jnp.zeros(3), jnp.stack([o, o, x.heading]), v, turn, a + jnp.cross(turn, v), alpha)


@record
class CourseOutput:
    """What the law wants, and how far off it is. Source: this file."""

    demand: BoatInput = part("Thrust and rudder.")
    off_course: Scalar = quantity("rad", "Heading less the one wanted.", kind="angle")


@record
class HoldCourse:
    """Holds speed and heading by proportional gains, the drag fed forward. Source: this file."""

    speed: Scalar = quantity("m/s", "Wanted.", default=1.0)
    heading: Scalar = quantity("rad", "Wanted.", kind="angle", default=1.0)
    drag: Scalar = quantity("N s/m", "What it believes of the boat.", default=2.0, low=0)
    k_speed: Scalar = quantity("N s/m", "Thrust by speed.", default=4.0, low=0)
    k_heading: Scalar = quantity("1", "Rudder by heading.", default=1.0, low=0)
    k_rate: Scalar = quantity("s", "Rudder by rate of turn.", default=0.5, low=0)

    reads: ClassVar[tuple[str, ...]] = ("surge_velocity", "yaw_rate", "heading")

    def init(self, key):
        """No state."""
        return ()

    def step(self, t, state, estimate):
        """Thrust and rudder."""
        x = estimate.state
        off = wrap(x.heading - self.heading)
        thrust = self.drag * self.speed + self.k_speed * (self.speed - x.surge_velocity)
        return state, CourseOutput(BoatInput(thrust, -self.k_heading * off - self.k_rate * x.yaw_rate), off)


def scenario() -> Scenario:
    """From rest to 1 m/s on a course of 1 rad, over a radio with 40 ms each way."""
    link, tick = DelayChain(period=ms(20), steps=2), ms(10)
    motor = FirstOrderLag(time_constant=0.1, low=-3.0, high=6.0)
    servo = FirstOrderLag(time_constant=0.05, rate_limit=5.0, low=-0.6, high=0.6)
    helm = ActuatorBank(BoatInput(), {"thrust": motor, "rudder": servo}, period=tick)
    sensor = NoisyPlanarPose(velocity_noise=0.03, heading_noise=0.02, rate_noise=0.03, period=tick)
    world = World(Boat(), {"navigation": sensor}, helm, downlink=link, uplink=link, max_step=tick)
    autopilot = Autopilot(Passthrough("navigation"), HoldCourse(), DirectAllocation(), period=tick)
    goals = (Target("truth.surge_velocity", 1.0, 0.1), Target("law.off_course", 0.0, 0.1))
    return Scenario(world, autopilot, BoatState(), seconds(12), goals)
