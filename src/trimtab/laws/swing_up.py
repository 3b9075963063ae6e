"""Swing a pole up by its energy, catch it where it nearly stands, and balance it.

[1] is K. J. Åström, K. Furuta, "Swinging up a pendulum by energy control", Automatica 36 (2000).
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.rotation import wrap
from trimtab.core.signals import Estimate
from trimtab.vehicles.cart_pole import CartForce, CartPole

MODES = ("swing", "balance")
SWING, BALANCE = range(2)


@record
class SwingUpState:
    """Active law. Source: this module."""

    mode: Scalar = quantity("1", "Active law.", kind="mode", modes=MODES, default=np.int32(SWING))


@record
class SwingUpOutput:
    """Demand and signals of the law. Source: this module."""

    demand: CartForce = part("Demanded force on the cart.")
    mode: Scalar = quantity("1", "Active law.", kind="mode", modes=MODES)
    energy: Scalar = quantity("J", "Energy of the pole, 0 where it stands upright at rest.")
    lean: Scalar = quantity("rad", "Angle of the pole from upright, by the shortest way.", kind="angle")


@record
class SwingUp:
    """Energy control, then a linear regulator.

        swing:    a = clip(k E q' cos q, ±n g) - k_x x - k_v x'      so that E' = -m l a q' cos q leads E to 0
        balance:  F = -K (x, x', q, q')

    It catches the pole inside `catch` of upright, where the regulator's law asks for little, and lets go of it outside
    `release`. With the centring terms, which [1] has not, the cart stays near the middle of its rail.

    Frames:  of the cart-pole.    Valid: a force of some 10 N. Not modelled: the rail's ends.
    Source:  [1] eqs. 7 and 8; K: design.lqr with weights (1, 1, 10, 1) and 0.1, see the test.
    """

    craft: CartPole = part("Model of the cart-pole used by the law.", default=CartPole())
    k: Scalar = quantity("s/(kg m)", "Acceleration per energy and rate.", default=8.0, above=0)
    n: Scalar = quantity("1", "Maximum acceleration of the swing, in g.", default=0.6, above=0)
    k_x: Scalar = quantity("1/s^2", "Centring gain on the position while it swings.", default=0.6, low=0)
    k_v: Scalar = quantity("1/s", "Centring gain on the speed while it swings.", default=0.6, low=0)
    K: Any = quantity(
        "1", "Gain of (m, m/s, rad, rad/s), N each.", shape=(4,), default=np.array([-3.1623, -5.9155, -49.507, -12.844])
    )
    catch: Scalar = quantity("rad", "Angle from upright within which balancing begins.", default=0.35, above=0)
    catch_rate: Scalar = quantity("rad/s", "Rate below which balancing begins.", default=2.0, above=0)
    release: Scalar = quantity("rad", "Angle from upright beyond which balancing ends.", default=0.9, above=0)

    reads: ClassVar[tuple[str, ...]] = ("position", "speed", "angle", "angle_rate")

    def init(self, key: Any) -> SwingUpState:
        """Return the initial state: swing."""
        return SwingUpState()

    def step(self, t: Any, state: SwingUpState, estimate: Estimate) -> tuple[SwingUpState, SwingUpOutput]:
        """Return the force at integer time t."""
        x = estimate.state
        lean, energy = wrap(x.angle), self.craft.energy(x)
        nearly = (abs(lean) < self.catch) & (abs(x.angle_rate) < self.catch_rate)
        keeps = (state.mode == BALANCE) & (abs(lean) < self.release)
        mode = jnp.where(estimate.valid, jnp.where(nearly | keeps, BALANCE, SWING), state.mode).astype(np.int32)
        most = self.n * self.craft.gravity
        pump = jnp.clip(self.k * energy * x.angle_rate * jnp.cos(x.angle), -most, most)
        swing = self.craft.force(x, pump - self.k_x * x.position - self.k_v * x.speed)
        balance = -(self.K[0] * x.position + self.K[1] * x.speed + self.K[2] * lean + self.K[3] * x.angle_rate)
        force = jnp.where(mode == BALANCE, balance, swing)
        return replace(state, mode=mode), SwingUpOutput(CartForce(force), mode, energy, lean)
