"""Encoders of a cart on a rail and of the pole hinged to the cart.

Source: docs page, Cart-pole.
"""

from typing import Any

import jax.numpy as jnp

from trimtab.core.record import Scalar, imperfection, period, record
from trimtab.core.rng import Key
from trimtab.core.signals import Motion, Sample, new_sample
from trimtab.core.time import ms
from trimtab.vehicles.cart_pole import CartPoleState


@record
class RailEncoders:
    """Encoders of the cart's position and the hinge angle, with quantisation, and ideal tachometers for both rates.

    Frames:  the rail points north in W. The hinge angle is minus the pitch angle of the pole, zero if the pole is
             upright.
    Not modelled: noise of the tachometers, a tilted hinge axis.
    Source:  docs page, Cart-pole.
    """

    position_step: Scalar = imperfection(
        "m", "Quantisation step of the cart's encoder; 0: no quantisation.", "encoder-steps", default=1e-3
    )
    angle_step: Scalar = imperfection(
        "rad", "Quantisation step of the hinge's encoder; 0: no quantisation.", "encoder-steps", default=1.5e-3
    )
    period: int = period("Time between samples.", default=ms(10))

    def init(self, key: Key) -> tuple[()]:
        """Return an empty record, because this sensor has no state."""
        return ()

    def measure(self, motion: Motion) -> CartPoleState:
        """Return the measurement h(x) for the vehicle's motion, without quantisation."""
        pitch = motion.attitude[1]
        speed = jnp.cos(pitch) * motion.v_WB_B[0] + jnp.sin(pitch) * motion.v_WB_B[2]
        return CartPoleState(position=motion.p_WB[0], speed=speed, angle=-pitch, angle_rate=-motion.w_WB_B[1])

    def step(self, t: Any, state: tuple[()], motion: Motion) -> tuple[tuple[()], Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        true = self.measure(motion)
        reading = CartPoleState(
            position=_round_to(true.position, self.position_step),
            speed=true.speed,
            angle=_round_to(true.angle, self.angle_step),
            angle_rate=true.angle_rate,
        )
        return state, new_sample(t, reading)


def _round_to(value: Any, step: Any) -> Any:
    """Return the value rounded to a multiple of the step, or unchanged where the step is 0."""
    some = jnp.where(step > 0, step, 1.0)
    return jnp.where(step > 0, jnp.round(value / some) * some, value)
