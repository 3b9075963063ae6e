"""Cart and pole: a pole hinged on a cart, which a force pushes along a rail. A vehicle for tutorials.

[1] is A. G. Barto, R. S. Sutton, C. W. Anderson, "Neuronlike adaptive elements that can solve difficult learning
control problems", IEEE Trans. Systems, Man, and Cybernetics 13 (1983), appendix.
"""

from typing import Any, ClassVar

import jax.numpy as jnp

from trimtab.core.record import Scalar, quantity, record
from trimtab.core.signals import Motion


@record
class CartPoleState:
    """State of cart and pole. Frames: the rail points north in W. Source: [1]."""

    position: Scalar = quantity("m", "Position of the cart along the rail.", frame="W", default=0.0)
    speed: Scalar = quantity("m/s", "Speed of the cart.", frame="W", default=0.0)
    angle: Scalar = quantity(
        "rad", "Angle of the pole from upright, positive to the front, not wrapped to one turn.", default=0.0
    )
    angle_rate: Scalar = quantity("rad/s", "Angular velocity of the pole.", default=0.0)


@record
class CartForce:
    """Input of the cart-pole: a force on the cart. Frames: along the rail. Source: [1]."""

    force: Scalar = quantity("N", "Force on the cart, positive to the front.")


@record
class CartPole:
    """Uniform pole hinged on a cart that moves without friction.

        J q'' = m l (g sin q - a cos q)        J = 4/3 m l^2
        F = (M + m) a + m l (q'' cos q - q'^2 sin q)

    q is the angle of the pole from upright, a the acceleration of the cart, F the force on the cart and g gravity.

    Frames:  the rail points north in W; B is fixed to the pole, with z from the top to the hinge. B has the axes of W
             when the pole is upright.
    Valid:   any angle. Not modelled: ends of the rail; friction of the cart and of the hinge, which is small in [1].
    Source:  [1]: masses, half-length, gravity.
    """

    cart_mass: Scalar = quantity("kg", "Mass M of the cart.", default=1.0, above=0, source="[1]")
    pole_mass: Scalar = quantity("kg", "Mass m of the pole.", default=0.1, above=0, source="[1]")
    half_length: Scalar = quantity(
        "m", "Distance l from the hinge to the centre of mass of the pole.", default=0.5, above=0, source="[1]"
    )
    gravity: Scalar = quantity("m/s^2", "Gravitational acceleration g.", default=9.8, above=0, source="[1]")

    MAV_TYPE: ClassVar[str] = "GENERIC"
    """Vehicle type reported to ground stations: a name in `vehicle_type.VehicleType`."""

    def angle_acceleration(self, x: CartPoleState, a: Any) -> Any:
        """Return the pole's angular acceleration (rad/s^2) for an acceleration a of its hinge (m/s^2)."""
        return 3 / (4 * self.half_length) * (self.gravity * jnp.sin(x.angle) - a * jnp.cos(x.angle))

    def force(self, x: CartPoleState, a: Any) -> Any:
        """Return the force (N) that accelerates the cart by a (m/s^2): the inverse of the dynamics."""
        pole = self.angle_acceleration(x, a) * jnp.cos(x.angle) - x.angle_rate**2 * jnp.sin(x.angle)
        return (self.cart_mass + self.pole_mass) * a + self.pole_mass * self.half_length * pole

    def energy(self, x: CartPoleState) -> Any:
        """Return the pole's energy (J) relative to its hinge: 0 upright at rest, -2 m g l hanging at rest."""
        ml = self.pole_mass * self.half_length
        return 2 / 3 * ml * self.half_length * x.angle_rate**2 + ml * self.gravity * (jnp.cos(x.angle) - 1)

    def dynamics(self, t: Any, x: CartPoleState, u: CartForce) -> CartPoleState:
        """Return the time derivative of the state x under the force u."""
        still = self.force(x, 0.0)
        a = (u.force - still) / (self.force(x, 1.0) - still)  # the force is linear in the acceleration
        return CartPoleState(x.speed, a, x.angle_rate, self.angle_acceleration(x, a))

    def motion(self, t: Any, x: CartPoleState, u: CartForce) -> Motion:
        """Return the motion of the pole at its hinge at time t (unit: 100 ns), for sensors."""
        rate, zero = self.dynamics(t, x, u), 0.0 * x.angle
        cosine, sine = jnp.cos(x.angle), jnp.sin(x.angle)

        def along_rail(v: Any) -> Any:
            return jnp.stack([v * cosine, zero, -v * sine])

        def turning(w: Any) -> Any:
            return jnp.stack([zero, -w, zero])

        return Motion(
            t,
            p_WB=jnp.stack([x.position, zero, zero]),
            attitude=turning(x.angle),
            v_WB_B=along_rail(x.speed),
            w_WB_B=turning(x.angle_rate),
            a_WB_B=along_rail(rate.speed),
            alpha_WB_B=turning(rate.angle_rate),
        )
