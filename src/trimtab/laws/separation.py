"""Barrier that keeps the reference points of a swarm apart, even with late or lost messages.

Each craft has a reference point q. The craft computes q, so it knows q exactly, and its body follows q. The proof
concerns the points: `Separation` limits the velocity of each point so that no two points come nearer than `distance`.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from trimtab.core.record import Scalar, quantity, record
from trimtab.core.signals import Peers
from trimtab.core.time import NEVER, to_seconds

SLIDES = 3
"""Number of times that the velocity command is moved to the limit of the most restrictive neighbour."""
FREE = 1e9
"""Value larger than any distance or speed, which means no limit."""


class _Neighbours(NamedTuple):
    """Velocity limit that each of n neighbours imposes. room: lower bound of (a/2)(|q - q_j| - D), m/s.  north, east:
    unit vector from j to q.

    doubt: bound of the error of this unit vector.  others: False for the craft itself.
    """

    room: Any
    north: Any
    east: Any
    doubt: Any
    others: Any


@record
class Separation:
    """Barrier that limits the velocity of a reference point, so that it stays clear of other points, known with delay.

        h_ij = |q_i - q_j| - D  must stay >= 0.     Every point keeps |u| <= V.
        A message of j, `age` old, has q^.   |q_j - q^| <= V age.         rho = |q_i - q^|,  e^ = (q_i - q^)/rho
        h^ = rho - V age - D <= h_ij                 |e^ - e| <= s = 2 sin(theta/2),  sin theta = V age/rho
        allowed:  e^.u_i >= s |u_i| - (a/2) max(h^, 0)     for each j                                           (*)

    u = 0 is always allowed. A neighbour without a message, or with V age >= rho, may be anywhere, so only u = 0 is
    allowed. The demanded velocity is first moved, three times, to the limit of the most restrictive neighbour, and by
    `swerve` times as much to starboard, so that two craft that meet both turn right. Then it is shortened until (*)
    holds for all.

    Proven:  if h_ij >= 0 at first, it stays so for all time: for any pattern of losses, delays of any length, any
             number of craft, and whatever velocity is demanded. Let d = |q_i - q_j|, e the unit vector between the true
             points, and dt a step with a dt <= 1. A norm is convex, so d(t + dt) >= d + dt e.(u_i - u_j). By (*)
             e.u_i >= e^.u_i - s |u_i| >= -(a/2) max(h^, 0) >= -(a/2) h_ij, for h^ <= h_ij and 0 <= h_ij; likewise
             -e.u_j. So h_ij(t + dt) >= (1 - a dt) h_ij(t) >= 0. (docs page, tests)
    Assumes: messages are true at their time stamps; clocks agree to within a slot's margin; all vehicles nearby are in
             the swarm.
    Not proven: that the body stays near its point (simulations measure its distance); that every craft reaches its
             target.
    Source:  own derivation. Each of two craft may use half of the rate a: L. Wang, A. Ames, M. Egerstedt, IEEE Trans.
             Robotics 33 (2017) 661; barriers in discrete time: A. Agrawal, K. Sreenath, RSS 2017.
    """

    distance: Scalar = quantity("m", "Minimum distance D between two reference points.", default=1.8, above=0)
    rate: Scalar = quantity(
        "1/s",
        "Rate a: fraction of the distance above the minimum that two points may use up per second.",
        default=1.0,
        above=0,
        high=10,
    )
    speed: Scalar = quantity("m/s", "Maximum speed V of a reference point, equal for all craft.", default=0.2, above=0)
    swerve: Scalar = quantity(
        "1",
        "Ratio of the velocity that is added to starboard to the velocity that a neighbour's limit removes.",
        default=2.0,
        low=0,
    )

    def limit(self, t: Any, number: Any, q: Any, wanted: Any, peers: Peers) -> tuple[Any, Any, Any]:
        """Return the allowed velocity (2,), the worst-case spare distance (m), and the largest age (s) of the messages.

        Args:     number: number of this craft.    q: the craft's reference point (2,), m.    wanted: demanded velocity
                  (2,), m/s.
        """
        near, clearance, age = self._judge(t, number, q, peers)
        u = self._shorten(wanted, self.speed)
        for _ in range(SLIDES):
            u = self._slide(u, near)
        speed = norm(u)
        moves = speed > 0
        d = jnp.where(moves, u, 0.0) / jnp.where(moves, speed, 1.0)
        closing = near.doubt - near.north * d[0] - near.east * d[1]
        most = jnp.where(near.others & (closing > 0), near.room / jnp.where(closing > 0, closing, 1.0), FREE)
        return d * jnp.minimum(jnp.minimum(speed, self.speed), jnp.min(most)), clearance, age

    def _judge(self, t: Any, number: Any, q: Any, peers: Peers) -> tuple[_Neighbours, Any, Any]:
        said = peers.message()
        others = jnp.arange(said.north.shape[0]) != number
        heard = said.t != NEVER
        age = to_seconds(jnp.where(heard, t - said.t, t))
        north, east = q[0] - said.north, q[1] - said.east
        square = north * north + east * east
        rho = jnp.sqrt(jnp.where(square > 0, square, 1.0))
        reach = self.speed * age
        known = heard & (reach < rho) & (square > 0)
        sine = jnp.where(known, reach / rho, 0.0)
        # 2 sin(theta/2) = sin theta/cos(theta/2): this form is accurate, and differentiable, at 0
        doubt = jnp.where(known, sine / jnp.sqrt((1 + jnp.sqrt(1 - sine * sine)) / 2), 2.0)
        h = rho - reach - self.distance
        room = self.rate / 2 * jnp.maximum(jnp.where(known, h, 0.0), 0.0)
        near = _Neighbours(room, north / rho, east / rho, doubt, others)
        h = jnp.where(known, jnp.maximum(h, -self.distance), -self.distance)
        return near, jnp.min(jnp.where(others, h, FREE)), jnp.max(jnp.where(others, age, 0.0))

    def _slide(self, u: Any, near: _Neighbours) -> Any:
        """Return the velocity, moved to the limit of the most restrictive neighbour."""
        speed = norm(u)
        spare = near.north * u[0] + near.east * u[1] - near.doubt * speed + near.room
        spare = jnp.where(near.others, spare, FREE)
        least = jnp.min(spare)
        worst = (spare == least).astype(float)
        share = worst / jnp.sum(worst)
        north, east = jnp.sum(share * near.north), jnp.sum(share * near.east)
        short = jnp.maximum(-least, 0.0)
        away = jnp.stack([north + self.swerve * east, east - self.swerve * north])
        return self._shorten(u + short * away, self.speed)

    def _shorten(self, u: Any, most: Any) -> Any:
        size = norm(u)
        return u * jnp.minimum(1.0, most / jnp.where(size > 0, size, 1.0))


def norm(v: Any) -> Any:
    """Return the length of a vector. Its derivative at the zero vector is 0."""
    square = v @ v
    some = square > 0
    return jnp.where(some, jnp.sqrt(jnp.where(some, square, 1.0)), 0.0)
