"""Law that swings a pole up by energy control, then balances it by state feedback near the upright position.

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
    """State of the law `SwingUp`: its active mode. Source: this module."""

    mode: Scalar = quantity(
        "1", "Active mode of the law: swing or balance.", kind="mode", modes=MODES, default=np.int32(SWING)
    )


@record
class SwingUpOutput:
    """Demand and signals of the law `SwingUp`. Source: this module."""

    demand: CartForce = part("Demanded force on the cart.")
    mode: Scalar = quantity("1", "Active mode of the law: swing or balance.", kind="mode", modes=MODES)
    energy: Scalar = quantity("J", "Energy of the pole relative to the pole upright at rest.")
    lean: Scalar = quantity("rad", "Angle of the pole from upright, wrapped to ±pi.", kind="angle")


@record
class SwingUp:
    """Law that swings a pole up by energy control, then balances it by a linear regulator.

        swing:    a = clip(k E q' cos q, ±n g) - k_x x - k_v x'      so that E' = -m l a q' cos q leads E to 0
        balance:  F = -K (x, x', q, q')

    x is the position of the cart, a the acceleration of the cart, q the angle of the pole from upright, and E the
    energy of the pole. The law switches to balance at an angle below `catch` from upright, where the regulator needs
    little force. It switches back to swing at an angle above `release`. The centring terms, which [1] lacks, keep the
    cart near the middle of its rail.

    Frames:  those of the cart-pole.    Valid: forces of up to about 10 N. Not modelled: the rail's ends.
    Source:  [1] eqs. 7 and 8; K: design.lqr with state weights (1, 1, 10, 1) and input weight 0.1.
    """

    craft: CartPole = part("Model of the cart-pole used by the law.", default=CartPole())
    k: Scalar = quantity(
        "s/(kg m)", "Gain k of the energy control: cart acceleration per energy and pole rate.", default=8.0, above=0
    )
    n: Scalar = quantity("1", "Maximum acceleration n of the energy control, in g.", default=0.6, above=0)
    k_x: Scalar = quantity(
        "1/s^2", 'Gain k_x of the cart position, which centres the cart in mode "swing".', default=0.6, low=0
    )
    k_v: Scalar = quantity(
        "1/s", 'Gain k_v of the cart speed, which damps the cart in mode "swing".', default=0.6, low=0
    )
    K: Any = quantity(
        "1",
        'Gain K in F = -K x of mode "balance". x: position (m), speed (m/s), angle (rad), angle rate (rad/s).',
        shape=(4,),
        default=np.array([-3.1623, -5.9155, -49.507, -12.844]),
    )
    catch: Scalar = quantity("rad", 'Angle from upright below which mode "balance" begins.', default=0.35, above=0)
    catch_rate: Scalar = quantity("rad/s", 'Pole rate below which mode "balance" begins.', default=2.0, above=0)
    release: Scalar = quantity("rad", 'Angle from upright above which mode "balance" ends.', default=0.9, above=0)

    reads: ClassVar[tuple[str, ...]] = ("position", "speed", "angle", "angle_rate")

    def init(self, key: Any) -> SwingUpState:
        """Return the initial state, in mode "swing"."""
        return SwingUpState()

    def step(self, t: Any, state: SwingUpState, estimate: Estimate) -> tuple[SwingUpState, SwingUpOutput]:
        """Return the demanded force at time t (unit: 100 ns)."""
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
