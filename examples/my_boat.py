"""A vehicle of your own, flown: trimtab run examples/my_boat.py:scenario --plot boat.png"""

import jax.numpy as jnp

from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.core.record import Scalar, quantity, record
from trimtab.core.signals import Motion, PlanarForce
from trimtab.core.time import ms, seconds
from trimtab.estimators.passthrough import Passthrough
from trimtab.laws.velocity import ForwardMomentum
from trimtab.links.wire import DelayChain
from trimtab.logs.metrics import Target
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World
from trimtab.sensors.navigation_errors import NavigationErrors


@record
class BoatState:
    """Velocity in the body, heading. Source: conventions page."""

    surge_velocity: Scalar = quantity("m/s", "Along the keel.", frame="B", default=0.0)
    sway_velocity: Scalar = quantity("m/s", "To starboard.", frame="B", default=0.0)
    yaw_rate: Scalar = quantity("rad/s", "Clockwise.", frame="B", default=0.0)
    heading: Scalar = quantity("rad", "From north, clockwise.", kind="angle", default=0.0)


@record
class Boat:
    """A boat pushed at its stern, with linear drag. Source: Fossen, "Handbook of marine craft", 2011, ch. 6."""

    mass: Scalar = quantity("kg", "Mass.", default=3.0, above=0)
    inertia: Scalar = quantity("kg m^2", "About the vertical axis.", default=0.15, above=0)
    arm: Scalar = quantity("m", "Centre of mass to thruster.", default=0.3, above=0)
    drag: Scalar = quantity("N s/m", "Along the keel; ten times as much across.", default=0.2, low=0)

    def dynamics(self, t, x, u):
        """The derivative of x."""
        du = (u.FX - self.drag * x.surge_velocity) / self.mass + x.sway_velocity * x.yaw_rate
        dv = (u.FY - 10 * self.drag * x.sway_velocity) / self.mass - x.surge_velocity * x.yaw_rate
        dr = (-self.arm * u.FY - 0.1 * self.drag * x.yaw_rate) / self.inertia
        return BoatState(du, dv, dr, x.yaw_rate)

    def motion(self, t, x, u):
        """All that a sensor can feel."""
        d, o = self.dynamics(t, x, u), 0.0 * x.heading
        v, turn = jnp.stack([x.surge_velocity, x.sway_velocity, o]), jnp.stack([o, o, x.yaw_rate])
        a, alpha = jnp.stack([d.surge_velocity, d.sway_velocity, o]), jnp.stack([o, o, d.yaw_rate])
        return Motion(t, jnp.zeros(3), jnp.stack([o, o, x.heading]), v, turn, a + jnp.cross(turn, v), alpha)


def scenario() -> Scenario:
    """From rest to 0.55 m/s over a radio with 40 ms each way."""
    link, push = DelayChain(period=ms(20), steps=2), DirectActuation(neutral_input=PlanarForce(0.0, 0.0))
    world = World(Boat(), {"navigation": NavigationErrors()}, push, downlink=link, uplink=link)
    law = ForwardMomentum(k1=4.0, k2=4.0, reference=1.5)
    autopilot = Autopilot(Passthrough("navigation"), law, DirectAllocation())
    return Scenario(world, autopilot, BoatState(), seconds(10), (Target("truth.surge_velocity", 0.55, 0.05),))
