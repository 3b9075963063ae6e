"""A hovercraft and a wall: trimtab run examples/my_wall.py:scenario --set world.integration.method=rosenbrock"""

import jax.numpy as jnp

from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.time import seconds
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.build import build
from trimtab.vehicles.hovercraft import Hovercraft, planar_motion, planar_rates


@record
class StiffWall:
    """A hovercraft, and a wall across north that pushes back: F = max(0, k p + c p'), p = north - wall > 0."""

    craft: Hovercraft = part("The hovercraft.", default=Hovercraft())
    wall: Scalar = quantity("m", "Where it stands.", default=2.0)
    k: Scalar = quantity("N/m", "Its stiffness.", default=1e8, low=0)
    c: Scalar = quantity("N s/m", "Its damping.", default=3e3, low=0)

    def accelerations(self, x, u):
        """Of the centre of mass in W, resolved in B, and the yaw acceleration."""
        ax, ay, turn = self.craft.accelerations(x, u)
        p, rate = x.north - self.wall, planar_rates(x, 0.0, 0.0, 0.0).north
        a = jnp.where(p > 0, jnp.maximum(self.k * p + self.c * rate, 0.0), 0.0) / self.craft.mass
        return ax - a * jnp.cos(x.heading), ay + a * jnp.sin(x.heading), turn

    def dynamics(self, t, x, u):
        """The derivative of x."""
        return planar_rates(x, *self.accelerations(x, u))

    def motion(self, t, x, u):
        """All that a sensor can feel."""
        return planar_motion(t, x, *self.accelerations(x, u))


@record
class HardWall(StiffWall):
    """The same without a spring: where it touches, it comes off with half of its speed."""

    def events(self, t, x):
        """What changes its sign at the wall."""
        return (x.north - self.wall,)

    def jump(self, t, x, crossed):
        """At the wall the speed towards it is halved and turned around."""
        change = -1.5 * planar_rates(x, 0.0, 0.0, 0.0).north
        u, v = (change * jnp.cos(x.heading), -change * jnp.sin(x.heading))
        return replace(x, surge_velocity=x.surge_velocity + u, sway_velocity=x.sway_velocity + v, north=self.wall)


def scenario(wall: str = "stiff") -> Scenario:
    """`hovercraft/forward` for eight seconds, with a wall two metres ahead; wall: "stiff" or "hard"."""
    flown = build("hovercraft/forward")
    vehicle = HardWall(k=0.0, c=0.0) if wall == "hard" else StiffWall()
    return replace(flown, world=replace(flown.world, vehicle=vehicle), duration=seconds(8))
