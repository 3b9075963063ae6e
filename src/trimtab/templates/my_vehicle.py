"""A vehicle of your own, at first a bicycle: trimtab run my_vehicle.py:scenario"""

import jax.numpy as jnp

from trimtab import Autopilot, Scenario, Target, World, ms, quantity, record, replace
from trimtab.actuators.allocation import DirectAllocation
from trimtab.actuators.bank import ActuatorBank
from trimtab.actuators.lag import FirstOrderLag
from trimtab.core.record import Scalar
from trimtab.core.signals import Motion, no_motion
from trimtab.estimators.passthrough import Passthrough
from trimtab.links.wire import DelayChain
from trimtab.loop.linear_laws import design_feedback
from trimtab.sensors.flight_state import TrueState


@record
class MyVehicleState:  # the integrated state; a field may be a vector: shape=(3,), default=(0, 0, 0)
    """State of the bicycle. Source: this file."""

    lean: Scalar = quantity("rad", "Lean angle, positive to starboard.", frame="WB", kind="angle", default=0.0)
    lean_rate: Scalar = quantity("rad/s", "Rate of change of the lean angle.", frame="B", default=0.0)
    heading: Scalar = quantity("rad", "Heading, clockwise from north.", frame="WB", kind="angle", default=0.0)


@record
class MyVehicleInput:  # computed by the law, applied by the actuators
    """Input of the bicycle: position of the handlebar. Source: this file."""

    steer: Scalar = quantity("rad", "Steering angle, positive to starboard.", frame="B", kind="angle", default=0.0)


@record
class MyVehicle:  # its fields are settings: --set world.vehicle.speed=5
    """Bicycle that one servo balances and steers. Source: Åström, Klein, Lennartsson, IEEE CSM 25(4), 2005."""

    speed: Scalar = quantity("m/s", "Speed of the wheels.", default=4.0, above=0)
    height: Scalar = quantity("m", "Height of the centre of mass above the rear wheel's contact.", default=0.9, above=0)
    base: Scalar = quantity("m", "Wheel base.", default=1.0, above=0)

    def dynamics(self, t: Scalar, x: MyVehicleState, u: MyVehicleInput):
        """Return the derivative of the state x at time t (s). Use jnp.where instead of `if` on a number of x or u."""
        turn = self.speed * jnp.tan(u.steer) / self.base  # rad/s
        fall = (9.80665 * jnp.sin(x.lean) - self.speed * turn * jnp.cos(x.lean)) / self.height  # rad/s^2
        return MyVehicleState(x.lean_rate, fall, turn)

    def motion(self, t: Scalar, x: MyVehicleState, u: MyVehicleInput) -> Motion:
        """Return the motion that sensors measure, here only the attitude (3,). An IMU also needs the other fields."""
        return replace(no_motion(), t=t, attitude=jnp.stack([x.lean, 0.0 * x.lean, x.heading]))


def scenario() -> Scenario:
    """Return the scenario: a bicycle starts half a radian off course. The radio delays each way by 20 ms."""
    dt, rest, start = ms(10), MyVehicleInput(), MyVehicleState(heading=-0.5)
    bike, limits = MyVehicle(), {"lean": 0.2, "lean_rate": 0.7, "heading": 0.5, "steer": 0.2}
    law = design_feedback(bike, replace(start, heading=0.0), rest, limits)  # gain for these largest deviations
    link, bar = DelayChain(period=dt, steps=2), FirstOrderLag(time_constant=0.03, low=-0.6, high=0.6)
    world = World(bike, {"state": TrueState(period=dt)}, ActuatorBank(rest, {"steer": bar}, period=dt), link, link, dt)
    pilot = Autopilot(Passthrough("state"), law, DirectAllocation(), period=dt)
    return Scenario(world, pilot, start, targets=(Target("truth.heading", 0.0, 0.05),), name="my_vehicle")
