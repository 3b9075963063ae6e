"""A pole on a cart, balanced by a gain from its linear model: trimtab run examples/my_cart.py:scenario"""

import jax.numpy as jnp

from trimtab import Autopilot, Scenario, Target, World, ms, quantity, record, seconds
from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.core.record import Scalar
from trimtab.core.signals import no_motion
from trimtab.estimators.passthrough import Passthrough
from trimtab.links.wire import DelayChain, Wire
from trimtab.loop.linear_laws import design_feedback
from trimtab.sensors.flight_state import TrueState


@record
class CartState:
    """Position and velocity of cart and pole. Source: this file."""

    position: Scalar = quantity("m", "Position of the cart.", default=0.0)
    velocity: Scalar = quantity("m/s", "Velocity of the cart.", default=0.0)
    lean: Scalar = quantity("rad", "Lean of the pole, in the direction of the cart.", kind="angle", default=0.0)
    lean_rate: Scalar = quantity("rad/s", "Angular velocity of the pole.", default=0.0)


@record
class Push:
    """Input of the cart. Source: this file."""

    force: Scalar = quantity("N", "Force along the track of the cart.", default=0.0)


@record
class Cart:
    """A cart of 1 kg, a pole of 0.5 m. Source: Åström, Murray, "Feedback systems", 2008, example 2.1."""

    bob: Scalar = quantity("kg", "Mass at the end of the pole.", default=0.1, above=0)

    def dynamics(self, t, x, u):
        """Return the derivative of x."""
        s, c = jnp.sin(x.lean), jnp.cos(x.lean)
        a = (u.force - 0.1 * x.velocity + self.bob * s * (0.5 * x.lean_rate**2 - 9.80665 * c)) / (1 + self.bob * s**2)
        return CartState(x.velocity, a, x.lean_rate, (9.80665 * s - a * c) / 0.5)

    def motion(self, t, x, u):
        """Return no motion: no sensor on the cart needs it."""
        return no_motion()


LIMITS, T = {"position": 0.3, "velocity": 1.0, "lean": 0.1, "lean_rate": 1.0, "force": 5.0}, ms(5)


def scenario(assumed=None) -> Scenario:
    """Return a flight from a lean of 0.1 rad to upright, with a delay of 10 ms to the motor."""
    law = design_feedback(assumed or Cart(), CartState(), Push(), LIMITS, {"position": 0.5})
    push, link = DirectActuation(Push(), period=T), DelayChain(period=T, steps=2)
    world = World(Cart(), {"state": TrueState(period=T)}, push, downlink=Wire(period=T), uplink=link, max_step=T)
    autopilot = Autopilot(Passthrough("state"), law, DirectAllocation(), period=T)
    return Scenario(world, autopilot, CartState(lean=0.1), seconds(10), (Target("truth.position", 0.0, 0.05),))
