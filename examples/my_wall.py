"""A hovercraft and a wall: trimtab run examples/my_wall.py:scenario --set world.integration.method=rosenbrock"""

import jax.numpy as jnp

from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.time import seconds
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.build import build
from trimtab.vehicles.hovercraft import Hovercraft, planar_motion, planar_rates


@record
class StiffWall:
    """Hovercraft and a wall across north that pushes back: F = max(0, k p + c p'), p = north - wall > 0."""

    craft: Hovercraft = part("The hovercraft.", default=Hovercraft())
    wall: Scalar = quantity("m", "Position of the wall.", default=2.0)
    k: Scalar = quantity("N/m", "Stiffness of the wall.", default=1e8, low=0)
    c: Scalar = quantity("N s/m", "Damping of the wall.", default=3e3, low=0)

    def accelerations(self, x, u):
        """Return the acceleration of the centre of mass in W, resolved in B, and the yaw acceleration."""
        ax, ay, turn = self.craft.accelerations(x, u)
        p, rate = x.north - self.wall, planar_rates(x, 0.0, 0.0, 0.0).north
        a = jnp.where(p > 0, jnp.maximum(self.k * p + self.c * rate, 0.0), 0.0) / self.craft.mass
        return ax - a * jnp.cos(x.heading), ay + a * jnp.sin(x.heading), turn

    def dynamics(self, t, x, u):
        """Return the derivative of x."""
        return planar_rates(x, *self.accelerations(x, u))

    def motion(self, t, x, u):
        """Return the motion that sensors measure."""
        return planar_motion(t, x, *self.accelerations(x, u))


@record
class HardWall(StiffWall):
    """Hovercraft and a wall without a spring: it bounces off with half of its speed."""

    def events(self, t, x):
        """Return the number whose sign changes at the wall."""
        return (x.north - self.wall,)

    def jump(self, t, x, crossed):
        """Return the state with half of the speed, away from the wall."""
        change = -1.5 * planar_rates(x, 0.0, 0.0, 0.0).north
        u, v = (change * jnp.cos(x.heading), -change * jnp.sin(x.heading))
        return replace(x, surge_velocity=x.surge_velocity + u, sway_velocity=x.sway_velocity + v, north=self.wall)


def scenario(wall: str = "stiff") -> Scenario:
    """Return `hovercraft/forward` for eight seconds, with a wall two metres ahead; wall: "stiff" or "hard"."""
    flown = build("hovercraft/forward")
    vehicle = HardWall(k=0.0, c=0.0) if wall == "hard" else StiffWall()
    return replace(flown, world=replace(flown.world, vehicle=vehicle), duration=seconds(8))
