"""A truck with a tank, whose unmeasured slosh is estimated and damped: trimtab run examples/my_tank.py:scenario"""

import jax.numpy as jnp

from trimtab import Autopilot, Scenario, Target, World, ms, quantity, record, seconds
from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.core.record import Scalar, replace
from trimtab.core.signals import no_motion
from trimtab.links.wire import Wire
from trimtab.loop.linear_filter import design_filter
from trimtab.loop.linear_laws import design_feedback
from trimtab.sensors.flight_state import ActingInput
from trimtab.sensors.planar_pose import NoisyPlanarPose


@record
class TankState:
    """State of truck and water. Source: this file."""

    position: Scalar = quantity("m", "Position of the truck.", default=0.0)
    velocity: Scalar = quantity("m/s", "Velocity of the truck.", default=0.0)
    slosh: Scalar = quantity("m", "Displacement of the water relative to the truck.", default=0.0)
    slosh_rate: Scalar = quantity("m/s", "Velocity of the water relative to the truck.", default=0.0)


@record
class Push:
    """Input of the truck. Source: this file."""

    force: Scalar = quantity("N", "Force on the truck.", default=0.0)


@record
class Tank:
    """Truck of 1 kg with water that sloshes at 5 rad/s, damping ratio 0.01. Source: this file."""

    water: Scalar = quantity("kg", "Mass of the sloshing water.", default=0.3, above=0)

    def dynamics(self, t, x, u):
        """Return the derivative of x."""
        pull = 25.0 * x.slosh + 0.1 * x.slosh_rate
        return TankState(x.velocity, a := u.force + self.water * pull, x.slosh_rate, -pull - a)

    def motion(self, t, x, u):
        """Return the motion that sensors measure."""
        return replace(no_motion(), t=t, p_WB=jnp.stack([x.position, 0.0, 0.0]))


LIMITS = {"position": 0.2, "velocity": 1.0, "slosh": 0.05, "slosh_rate": 0.5, "force": 2.0}
FIRST, T = {"position": 0.1, "velocity": 0.1, "slosh": 0.05, "slosh_rate": 0.25}, ms(10)


def scenario() -> Scenario:
    """Return a move by half a metre, with initial slosh. Only the position is measured, to 2 mm."""
    sensors = {"pose": NoisyPlanarPose(position_noise=0.002, period=T), "actuators": ActingInput(period=T)}
    observer = design_filter(Tank(), TankState(), Push(), sensors, {"pose.north": 0.002}, FIRST, period=T)
    world = World(Tank(), sensors, DirectActuation(Push(), period=T), Wire(period=T), Wire(period=T), max_step=T)
    autopilot = Autopilot(observer, design_feedback(Tank(), TankState(), Push(), LIMITS), DirectAllocation(), period=T)
    return Scenario(world, autopilot, TankState(-0.1, 0, 0.05), seconds(10), (Target("truth.slosh", 0.0, 0.01),))
