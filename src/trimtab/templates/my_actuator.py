"""An actuator of your own: trimtab run my_actuator.py:scenario"""

from typing import Any

import jax.numpy as jnp

from trimtab import Scenario, build, quantity, record, replace
from trimtab.actuators.bank import ActuatorBank
from trimtab.core.interfaces import StageOutput
from trimtab.vehicles.cart_pole import CartForce


@record
class MyActuator:  # its fields are settings: --set world.actuators.stages.force.0.friction=2
    """Motor with static friction, a lag and two stops. Source: this file.

    The motor is a stage of an ActuatorBank, for one field of the vehicle's input. It has the field's unit and shape.
    """

    # `off=` states the value that --without my-friction sets
    friction: Any = quantity(
        "1",
        "Static friction: a command of at most this size has no effect.",
        default=0.2,
        low=0,
        off={"my-friction": 0.0},
    )
    time_constant: Any = quantity("s", "Time constant of the lag.", default=0.03, above=0)
    low: Any = quantity("1", "Lower stop.", default=-10.0)
    high: Any = quantity("1", "Upper stop.", default=10.0)

    def init(self, rest: Any) -> Any:
        """Return the initial state: the position at the neutral command."""
        return jnp.asarray(rest, float)

    def step(self, state: Any, value: Any, dt: Any) -> tuple[Any, StageOutput]:
        """Return the position dt (s) later at a constant command. The solution is exact and so stable for every dt."""
        wanted = value - jnp.clip(value, -self.friction, self.friction)
        stop = jnp.clip(wanted, self.low, self.high)
        now = stop + (state - stop) * jnp.exp(-dt / self.time_constant)
        return now, StageOutput(value=now, limited=stop != wanted)


def scenario() -> Scenario:
    """Return the scenario: a cart swings up and balances a pole. This motor moves the cart by a force (N)."""
    base = build("cart-pole/swing-up")
    motor = ActuatorBank(CartForce(0.0), {"force": MyActuator()}, period=base.world.actuators.period)
    return replace(base, world=replace(base.world, actuators=motor), name="my_actuator")
