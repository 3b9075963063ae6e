"""Law of one craft in a formation. A reference point keeps a position beside the leader, and the craft follows this
point.

The law has three layers. The first commands the velocity of the point, from the leader's newest message. The second is
a barrier that limits this velocity, from the messages of all craft (`laws.separation`). The third makes the craft's
centre of percussion follow the point.
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, part, quantity, record
from trimtab.core.rotation import planar, wrap
from trimtab.core.signals import Estimate, PeerMessage, Peers, PlanarForce, SwarmInput
from trimtab.core.time import NEVER, ms, to_seconds
from trimtab.laws.separation import Separation, norm
from trimtab.vehicles.hovercraft import Hovercraft

LONGEST_STEP = ms(100)
"""Longest time between two steps. During a longer pause, the reference point does not move."""
TURN_ROUND = 0.3
"""Hysteresis of the choice between nose and tail: threshold of the cosine of the angle from the nose to the demanded
force. Below minus this value, the law turns the tail to the force. Above this value, it turns the nose to the force
again."""


@record
class FormationState:
    """State of the law `Formation`: the reference point that the craft follows. Source: own derivation."""

    t: Scalar = quantity("100 ns", "Time of the last step.", kind="time")
    north: Scalar = quantity("m", "North coordinate of the reference point.", frame="W")
    east: Scalar = quantity("m", "East coordinate of the reference point.", frame="W")
    backing: Scalar = quantity("1", "True if the tail, not the nose, is turned to the demanded force.", kind="flag")
    reverse: Scalar = quantity("1", "True if the fan runs in reverse.", kind="flag")


@record
class FormationOutput:
    """Demand and signals of the law `Formation`. Source: own derivation."""

    demand: SwarmInput = part("Demanded force at the rudder pivot, and the message to the other craft.")
    place_error: Scalar = quantity(
        "m", "Distance of the reference point from its place in the formation; 0 without a message from the leader."
    )
    point_error: Scalar = quantity("m", "Distance of the centre of percussion from the reference point.")
    clearance: Scalar = quantity(
        "m", "Worst-case distance to the nearest neighbour's reference point, minus the minimum distance."
    )
    oldest: Scalar = quantity(
        "s",
        "Largest age, over all neighbours, of the newest message. For a neighbour without a message, the age "
        "is the time since the start of the run.",
    )
    speed: Scalar = quantity("m/s", "Speed of the reference point.")


@record
class Formation:
    """Law that keeps the craft at a position beside the leader (craft 0), and at a distance from all other craft.

        leader    u = c' + k (c - q)          c: the route, a circle of `radius` about a centre, at `leader_speed`
        follower  u = u_0 + k (q_0 + age u_0 + place - q)     q_0, u_0, age: the leader's newest message
        barrier   u limited by the separation, and reduced as the craft lags behind its point:
                  to zero at `waiting_distance`
        point     q' = u
        craft     F = m k_v (u + k_p (q - p) - v)      p, v: position and velocity of P, a = J/(m d)
                  FX = n.F + m a r^2,   FY = (J/d) k_r (r - r_d),   r_d = k_h wrap(direction of ±F - heading)

    q is the craft's reference point, and u the velocity of this point. P is the centre of percussion, which is the
    distance a ahead of the centre of mass. P is accelerated only along the nose n (`laws.pose`), so either the nose or
    the tail is turned to the force. A leader's message older than `horizon` is not extrapolated: the leader is assumed
    to be at rest at its last position.

    Proven:  the points never come nearer to each other than `separation.distance`. While the barrier does not
             limit u and the leader moves at a constant velocity, e = q_0 + place - q obeys e' = -k e for any delay of
             the messages, because the extrapolation is then exact. Only simulated, not proven: that the craft stays
             near its point; the formation while the barrier limits u; a leader on a circle (e is at most
             leader_speed^2/radius times age (1/k + age/2)).
    Decentralised: a command depends only on the craft's own estimate, its own point, and the messages that it received.
    Valid: for a fan that pushes along the nose, and for initial points further apart than the minimum distance.
    Source:  own derivation; leader and followers: J. Desai, J. Ostrowski, V. Kumar, IEEE Trans. Robotics and Automation
             17 (2001) 905. The gains are our own choice.
    """

    reads: ClassVar[tuple[str, ...]] = ("own", "peers")

    number: Scalar = quantity("1", "Number of this craft. Craft 0 is the leader.", kind="count", default=np.int32(0))
    north: Scalar = quantity(
        "m", "North coordinate of the craft relative to the leader, in the formation.", frame="W", default=0.0
    )
    east: Scalar = quantity(
        "m", "East coordinate of the craft relative to the leader, in the formation.", frame="W", default=0.0
    )
    centre_north: Scalar = quantity(
        "m", "North coordinate of the centre of the leader's circular route.", frame="W", default=0.0
    )
    centre_east: Scalar = quantity(
        "m", "East coordinate of the centre of the leader's circular route.", frame="W", default=0.0
    )
    radius: Scalar = quantity(
        "m", "Radius of the leader's circular route. If 0, the leader stays at the centre.", default=0.0, low=0
    )
    leader_speed: Scalar = quantity("m/s", "Speed of the leader along its route.", default=0.1, low=0)
    k: Scalar = quantity(
        "1/s",
        "Gain k: speed of the reference point per distance from its place in the formation.",
        default=0.2,
        above=0,
    )
    horizon: Scalar = quantity(
        "s", "Maximum time over which the leader's last message is extrapolated.", default=3.0, above=0
    )
    waiting_distance: Scalar = quantity(
        "m", "Distance between craft and reference point at which the point stops and waits.", default=0.6, above=0
    )
    kp: Scalar = quantity(
        "1/s", "Position gain: speed of the craft per distance from its reference point.", default=0.35, above=0
    )
    catch_up: Scalar = quantity("m/s", "Maximum speed that the position gain adds.", default=0.2, above=0)
    kv: Scalar = quantity("1/s", "Gain of the velocity error of the centre of percussion.", default=1.4, above=0)
    kh: Scalar = quantity("1/s", "Heading gain: yaw rate per heading error.", default=1.1, above=0)
    kr: Scalar = quantity("1/s", "Yaw rate gain: yaw acceleration per yaw rate error.", default=1.3, above=0)
    turn_rate: Scalar = quantity("rad/s", "Maximum yaw rate.", default=1.1, above=0)
    push: Scalar = quantity("N", "Maximum forward force.", default=1.4, above=0)
    pull: Scalar = quantity("N", "Maximum backward force.", default=0.5, above=0)
    swing: Scalar = quantity("N", "Maximum force to the side.", default=0.35, above=0)
    cone: Scalar = quantity(
        "1", "Minimum ratio of the force along the nose to the force to the side.", default=2.7, low=0
    )
    grip: Scalar = quantity(
        "N",
        "Demanded force along the nose above which the fan switches to the direction of this force.",
        default=0.1,
        above=0,
    )
    dead_zone: Scalar = quantity("N", "Demanded force below which the nose does not turn.", default=0.08, above=0)
    separation: Separation = part("Barrier that keeps the reference points of the craft apart.", default=Separation())
    model: Hovercraft = part("Vehicle model used by the law.", default=Hovercraft())

    def check(self) -> None:
        """Raise InputError unless the leader's speed is below the maximum speed of the reference points."""
        if np.any(np.asarray(self.leader_speed) >= np.asarray(self.separation.speed)):
            problem = (
                f"leader_speed must be below separation.speed, {self.separation.speed} m/s, got {self.leader_speed} m/s"
            )
            raise InputError("Formation.leader_speed", problem, fix="set leader_speed below separation.speed")

    def init(self, key: Any) -> FormationState:
        """Return the initial state. The reference point is set to the craft's position at the first step."""
        return FormationState(np.int64(NEVER), *np.zeros(2), *np.zeros(2, np.bool_))

    def step(self, t: Any, state: FormationState, estimate: Estimate) -> tuple[FormationState, FormationOutput]:
        """Return the demand and the message at time t (unit: 100 ns)."""
        s, peers = estimate.state.own, estimate.state.peers
        body, a = planar(s.heading), self.model.percussion_arm
        p = jnp.stack([s.north, s.east]) + a * body[:, 0]
        v = body @ jnp.stack([s.surge_velocity, s.sway_velocity + a * s.yaw_rate])
        begun = state.t != NEVER
        q = jnp.where(begun, jnp.stack([state.north, state.east]), p)
        lag = q - p
        point_error = norm(lag)
        way, onward = self._find_place(t, q, peers)
        u, clearance, oldest = self.separation.limit(t, self.number, q, onward + self.k * way, peers)
        u = u * jnp.clip(2 - 2 * point_error / self.waiting_distance, 0.0, 1.0)
        pause = t - state.t
        dt = jnp.where(begun & (pause >= 0) & (pause <= LONGEST_STEP), to_seconds(pause), 0.0)
        q = q + dt * u
        catch = self.kp * jnp.minimum(1.0, self.catch_up / (self.kp * jnp.maximum(point_error, 1e-9)))
        F = self.model.mass * self.kv * (u + catch * lag - v)
        force, backing, reverse = self._steer(state, F, body[:, 0], s)
        message = PeerMessage(t=t, north=q[0], east=q[1], north_velocity=u[0], east_velocity=u[1])
        new = FormationState(t=t, north=q[0], east=q[1], backing=backing, reverse=reverse)
        return new, FormationOutput(
            demand=SwarmInput(act=force, message=message),
            place_error=norm(way),
            point_error=point_error,
            clearance=clearance,
            oldest=oldest,
            speed=norm(u),
        )

    def _find_place(self, t: Any, q: Any, peers: Peers) -> tuple[Any, Any]:
        """Return the vector (2,) from the reference point to its place in the formation, and the velocity (2,) of this
        place."""
        said = peers.message()
        place = jnp.stack([self.north, self.east])
        age = to_seconds(t - said.t[0])
        u = jnp.stack([said.north_velocity[0], said.east_velocity[0]]) * (age <= self.horizon)
        behind = jnp.stack([said.north[0], said.east[0]]) + jnp.minimum(age, self.horizon) * u + place - q
        known = said.t[0] != NEVER
        turns = self.radius > 0
        angle = jnp.where(turns, self.leader_speed / jnp.where(turns, self.radius, 1.0), 0.0) * to_seconds(t)
        out = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        centre = jnp.stack([self.centre_north, self.centre_east]) + self.radius * out
        along = jnp.where(turns, self.leader_speed, 0.0) * jnp.stack([-out[1], out[0]])
        leads = self.number == 0
        way = jnp.where(leads, centre - q, jnp.where(known, behind, 0.0))
        return way, jnp.where(leads, along, jnp.where(known, u, 0.0))

    def _steer(self, state: FormationState, F: Any, nose: Any, s: Any) -> tuple[PlanarForce, Any, Any]:
        """Return the demand for a force F (2,) in W, True if the tail is ahead, and True if the fan runs in reverse."""
        size, along = norm(F), nose @ F
        backing = along < size * jnp.where(state.backing, TURN_ROUND, -TURN_ROUND)
        end = jnp.where(backing, -F, F)
        away = jnp.arctan2(nose[0] * end[1] - nose[1] * end[0], jnp.where(size > 0, nose @ end, 1.0))
        share = jnp.maximum(1 - self.dead_zone / jnp.where(size > 0, size, 1.0), 0.0)
        rate = jnp.clip(share * self.kh * wrap(away), -self.turn_rate, self.turn_rate)
        model = self.model
        FX = along + model.mass * model.percussion_arm * s.yaw_rate**2
        FY = self.kr * (s.yaw_rate - rate) * model.inertia / model.arm
        FY = jnp.clip(FY, -self.swing, self.swing)
        reverse = jnp.where(jnp.abs(FX) > self.grip, FX < 0, state.reverse)
        sign = jnp.where(reverse, -1.0, 1.0)
        FX = sign * jnp.maximum(sign * FX, self.cone * jnp.abs(FY))
        return PlanarForce(FX=jnp.clip(FX, -self.pull, self.push), FY=FY), backing, reverse
