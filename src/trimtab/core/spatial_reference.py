"""References in three dimensions: a helix, a fixed position, and a path in the plane at a constant height.

`at(t)` returns a SpatialPoint: the position and four derivatives, the heading and two derivatives. References are pure
functions and compile to C, so that a law can use one in flight.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, part, quantity, record
from trimtab.core.reference import Circle


@record
class SpatialPoint:
    """Point of a 3-D reference at one instant. Frames: W, (north, east, down). Source: docs page, References."""

    place: Any = quantity("m", "Reference position: north, east, down.", frame="W", shape=(3,))
    velocity: Any = quantity("m/s", "Reference velocity: first time derivative of the position.", frame="W", shape=(3,))
    acceleration: Any = quantity(
        "m/s^2", "Reference acceleration: second time derivative of the position.", frame="W", shape=(3,)
    )
    jerk: Any = quantity("m/s^3", "Reference jerk: third time derivative of the position.", frame="W", shape=(3,))
    snap: Any = quantity("m/s^4", "Reference snap: fourth time derivative of the position.", frame="W", shape=(3,))
    heading: Scalar = quantity("rad", "Reference heading of the nose.", kind="angle", frame="W")
    heading_rate: Scalar = quantity("rad/s", "Reference yaw rate: first time derivative of the heading.", frame="W")
    heading_acceleration: Scalar = quantity("rad/s^2", "Second time derivative of the reference heading.", frame="W")


@record
class FixedPlace:
    """A constant position and heading. Frames: W. Source: elementary."""

    place: Any = quantity("m", "Reference position: north, east, down.", frame="W", shape=(3,), default=(0.0, 0.0, 0.0))
    heading: Scalar = quantity("rad", "Reference heading of the nose.", kind="angle", frame="W", default=0.0)

    def at(self, t: Any) -> SpatialPoint:
        """Return the point of the reference at t (s)."""
        o, three = jnp.asarray(0.0), jnp.zeros(3)
        heading = jnp.asarray(self.heading, float)
        return SpatialPoint(jnp.asarray(self.place, float), three, three, three, three, heading, o, o)


@record
class Helix:
    """An elliptic helix along north, with a constant yaw rate. It starts at full speed.

        (speed t, across sin wt, -lift cos wt) + origin      heading = turn t

    Frames:  W; `lift` is half the height of the ellipse. For lift > 0, the helix begins at the top.
    Source:  T. Lee, M. Leok, N. H. McClamroch, "Geometric tracking control of a quadrotor UAV on SE(3)", CDC 2010,
             section V: its helix has lift = -0.6.
    """

    speed: Scalar = quantity("m/s", "Speed along the axis of the helix.", default=0.4)
    across: Scalar = quantity("m", "Half the width of the helix.", default=0.4)
    lift: Scalar = quantity("m", "Half the height of the helix.", default=-0.6)
    w: Scalar = quantity("rad/s", "Angular frequency w of the rotation about the helix axis.", default=np.pi)
    turn: Scalar = quantity("rad/s", "Constant yaw rate of the reference heading.", default=np.pi)
    origin: Any = quantity(
        "m", "Point at which the axis of the helix starts.", frame="W", shape=(3,), default=(0.0, 0.0, 0.0)
    )

    def at(self, t: Any) -> SpatialPoint:
        """Return the point of the reference at t (s)."""
        w, s, c = self.w, jnp.sin(self.w * t), jnp.cos(self.w * t)
        o = jnp.zeros_like(s)
        y, z = self.across, -self.lift
        axis = jnp.stack([o + self.speed * t, o, o])
        return SpatialPoint(
            place=jnp.asarray(self.origin) + axis + jnp.stack([o, y * s, z * c]),
            velocity=jnp.stack([o + self.speed, y * w * c, -z * w * s]),
            acceleration=jnp.stack([o, -y * w**2 * s, -z * w**2 * c]),
            jerk=jnp.stack([o, -y * w**3 * c, z * w**3 * s]),
            snap=jnp.stack([o, y * w**4 * s, z * w**4 * c]),
            heading=self.turn * t,
            heading_rate=o + self.turn,
            heading_acceleration=o,
        )


@record
class LevelPath:
    """A path in the plane, at a constant height with a constant heading.

    Frames:  W.    Source:  elementary.
    """

    path: Any = part("Reference in the horizontal plane, as core.interfaces.Reference.", default=Circle())
    height: Scalar = quantity("m", "Height above the origin of W.", frame="W", default=1.5)
    heading: Scalar = quantity("rad", "Constant reference heading of the nose.", kind="angle", frame="W", default=0.0)

    def at(self, t: Any) -> SpatialPoint:
        """Return the point of the reference at t (s)."""
        p = self.path.at(t)
        o = jnp.zeros(1)
        down = jnp.stack([-jnp.asarray(self.height, float)])
        heading = jnp.asarray(self.heading, float)
        return SpatialPoint(
            place=jnp.concatenate([p.place, down]),
            velocity=jnp.concatenate([p.velocity, o]),
            acceleration=jnp.concatenate([p.acceleration, o]),
            jerk=jnp.concatenate([p.jerk, o]),
            snap=jnp.concatenate([p.snap, o]),
            heading=heading,
            heading_rate=o[0],
            heading_acceleration=o[0],
        )
