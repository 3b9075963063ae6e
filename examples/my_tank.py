"""A truck with a tank, whose water swings unseen: estimated and calmed: trimtab run examples/my_tank.py:scenario"""

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
    """Where truck and water are. Source: this file."""

    position: Scalar = quantity("m", "Of the truck.", default=0.0)
    velocity: Scalar = quantity("m/s", "Its derivative.", default=0.0)
    slosh: Scalar = quantity("m", "Of the water, against the truck.", default=0.0)
    slosh_rate: Scalar = quantity("m/s", "Its derivative.", default=0.0)


@record
class Push:
    """What moves it. Source: this file."""

    force: Scalar = quantity("N", "On the truck.", default=0.0)


@record
class Tank:
    """1 kg of truck, and water that swings at 5 rad/s, damped by a hundredth. Source: this file."""

    water: Scalar = quantity("kg", "That swings.", default=0.3, above=0)

    def dynamics(self, t, x, u):
        """The derivative of x."""
        pull = 25.0 * x.slosh + 0.1 * x.slosh_rate
        return TankState(x.velocity, a := u.force + self.water * pull, x.slosh_rate, -pull - a)

    def motion(self, t, x, u):
        """What a sensor on it feels."""
        return replace(no_motion(), t=t, p_WB=jnp.stack([x.position, 0.0, 0.0]))


LIMITS = {"position": 0.2, "velocity": 1.0, "slosh": 0.05, "slosh_rate": 0.5, "force": 2.0}
FIRST, T = {"position": 0.1, "velocity": 0.1, "slosh": 0.05, "slosh_rate": 0.25}, ms(10)


def scenario() -> Scenario:
    """Half a metre to go, with water that swings at first; its place alone is measured, to 2 mm."""
    sensors = {"pose": NoisyPlanarPose(position_noise=0.002, period=T), "actuators": ActingInput(period=T)}
    observer = design_filter(Tank(), TankState(), Push(), sensors, {"pose.north": 0.002}, FIRST, period=T)
    world = World(Tank(), sensors, DirectActuation(Push(), period=T), Wire(period=T), Wire(period=T), max_step=T)
    autopilot = Autopilot(observer, design_feedback(Tank(), TankState(), Push(), LIMITS), DirectAllocation(), period=T)
    return Scenario(world, autopilot, TankState(-0.1, 0, 0.05), seconds(10), (Target("truth.slosh", 0.0, 0.01),))
