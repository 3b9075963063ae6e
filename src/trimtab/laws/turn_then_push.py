"""Law for a craft that can only push forward: it turns the nose to the needed change of velocity, then pushes.

A propeller that does not reverse cannot brake with the nose forward. The only way to reduce a velocity is to turn the
nose against it. Rudders have no effect without a stream, so each turn pushes the craft, too.

Source: own derivation from the model of `vehicles/rudder_hovercraft.py`.
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError, argument
from trimtab.core.record import Scalar, option, part, quantity, record
from trimtab.core.rotation import planar, wrap
from trimtab.core.signals import Estimate, PlanarForce
from trimtab.laws.pose import READS
from trimtab.vehicles.rudder_hovercraft import RudderHovercraft

REST, TURN, PUSH = range(3)
"""Indices of the steps of the law TurnThenPush, in their order."""
STEPS = ("rest", "turn", "push")


@record
class TurnThenPushState:
    """State of the law `TurnThenPush`. Source: own derivation."""

    mode: Scalar = quantity("1", "Active step of the law.", kind="mode", modes=STEPS)
    nose: Scalar = quantity("rad", "Reference heading of the nose.", kind="angle")
    turns: Scalar = quantity("1", "Number of turns of the nose since the start.", kind="count")


@record
class TurnThenPushOutput:
    """Demand and signals of the law `TurnThenPush`. Source: own derivation."""

    demand: PlanarForce = part("Demanded force at the rudders.")
    mode: Scalar = quantity("1", "Active step of the law.", kind="mode", modes=STEPS)
    turns: Scalar = quantity("1", "Number of turns of the nose since the start.", kind="count")
    heading_reference: Scalar = quantity("rad", "Reference heading of the nose.", kind="angle")
    velocity_error: Scalar = quantity("m/s", "Magnitude of the difference between reference velocity and velocity.")
    distance: Scalar = quantity("m", "Distance to the target position; 0 if the goal is a velocity.")


@record
class TurnThenPush:
    """Law that gives a craft with one-way thrust a velocity, or brings it to a place and keeps it there.

        dv = v_ref - v      F = m (k dv_along + k_side dv_across) + D(v_ref)
        rest  no thrust                                                      until |dv| > start
        turn  no push; the nose turns to F                                   until it points there
        push  FX = n.F, limited to thrust >= 0; the nose follows F           until n.dv < stop (then rest)
              if the nose points away from F by more than `lost`: back to turn

        goal velocity:  v_ref = (speed cos course, speed sin course)
        goal place:     v_ref = e min(c, speed/|e|) for |e| > near, else 0

    v is the velocity in W, e the vector to the place, D the friction at the reference velocity, n the direction of the
    nose. dv_along and dv_across are the components of dv along and across v_ref; without v_ref, all of dv is along. If
    v_ref is not zero and the velocity error is small, the step is push, so that the thrust balances the
    friction. FY = -(J/arm) kr (r_ref - r), r_ref = kh wrap(nose - heading), at most `turn_rate`.

    Ends:    at rest the craft stays anywhere within `near` of the place and with any heading. It cannot hold a heading
             at rest, because each turn pushes it away.
    Valid:   for a slow turn: each turn changes the velocity by about J turn_rate/(m arm tan psi_max), where psi_max is
             the largest angle of the stream (0.27 m/s here). If this is much more than `start`, the law turns forever.
    Source:  own derivation; all gains are our own choice.
    """

    reads: ClassVar[tuple[str, ...]] = READS

    goal: str = option(
        "Goal of the law: a velocity over the floor, or a place on the floor.",
        default="velocity",
        choices=("velocity", "place"),
    )
    speed: Scalar = quantity(
        "m/s", "Reference speed (goal velocity), or maximum speed on the way (goal place).", default=0.0, low=0
    )
    course: Scalar = quantity("rad", "Direction of the reference velocity (goal velocity).", kind="angle", default=0.0)
    north: Scalar = quantity("m", "North coordinate of the place (goal place).", frame="W", default=0.0)
    east: Scalar = quantity("m", "East coordinate of the place (goal place).", frame="W", default=0.0)
    k: Scalar = quantity("1/s", "Gain k: acceleration per velocity error.", default=1.5, above=0)
    k_side: Scalar = quantity(
        "1/s", "Gain k_side: acceleration per velocity error across the reference velocity.", default=0.5, above=0
    )
    c: Scalar = quantity("1/s", "Gain c: reference speed per distance to the place.", default=0.35, above=0)
    near: Scalar = quantity("m", "Distance to the place below which the craft may rest.", default=0.3, above=0)
    start: Scalar = quantity("m/s", "Velocity error above which a turn starts.", default=0.12, above=0)
    stop: Scalar = quantity("m/s", "Velocity error along the nose below which a push ends.", default=0.03, low=0)
    aligned: Scalar = quantity("rad", "Heading error below which a push starts.", default=0.25, above=0)
    lost: Scalar = quantity("rad", "Heading error above which a push ends and a turn starts.", default=0.8, above=0)
    kh: Scalar = quantity("1/s", "Heading gain: yaw rate per heading error.", default=1.2, above=0)
    kr: Scalar = quantity("1/s", "Yaw rate gain: yaw acceleration per yaw rate error.", default=5.0, above=0)
    turn_rate: Scalar = quantity("rad/s", "Maximum yaw rate.", default=1.5, above=0)
    model: RudderHovercraft = part("Vehicle model used by the law.", default=RudderHovercraft())

    def check(self) -> None:
        """Raise InputError if a step would end as soon as it begins."""
        for inner, outer, meaning in (
            ("stop", "start", "the velocity error that ends a push must be less than the one that starts a turn"),
            ("aligned", "lost", "the heading error that starts a push must be less than the one that ends it"),
        ):
            low, high = np.asarray(getattr(self, inner)), np.asarray(getattr(self, outer))
            if not np.all(low < high):
                raise InputError(
                    f"TurnThenPush.{inner}",
                    f"{meaning}, {outer}, got {low} and {high}",
                    fix=argument("settings", f"{float(high.min()) / 3:.2g}", f"autopilot.law.{inner}"),
                )

    def init(self, key: Any) -> TurnThenPushState:
        """Return the initial state, in step "rest"."""
        zero = np.asarray(0, np.int32)
        return TurnThenPushState(mode=zero, nose=np.asarray(0.0), turns=zero)

    def step(
        self, t: Any, state: TurnThenPushState, estimate: Estimate
    ) -> tuple[TurnThenPushState, TurnThenPushOutput]:
        """Update the active step of the law, and return the demand at time t (unit: 100 ns)."""
        s = estimate.state
        body = planar(s.heading)
        n = body[:, 0]
        way = self._way(s)
        reference = self._reference(way)
        error = reference - body @ jnp.stack([s.surge_velocity, s.sway_velocity])
        force = self._force(reference, error)
        now = self._decide(state, estimate, n, reference, error, force)
        rate = jnp.clip(self.kh * wrap(now.nose - s.heading), -self.turn_rate, self.turn_rate)
        side = -self.model.inertia / self.model.arm * self.kr * (rate - s.yaw_rate)
        push = jnp.where(now.mode == PUSH, jnp.maximum(n @ force, 0.0), 0.0)
        return now, TurnThenPushOutput(
            demand=PlanarForce(FX=push, FY=jnp.where(now.mode == REST, 0.0, side)),
            mode=now.mode,
            turns=now.turns,
            heading_reference=now.nose,
            velocity_error=_size(error),
            distance=_size(way),
        )

    def _way(self, s: Any) -> Any:
        """Return the vector (m, in W) to the place, or zero if the goal is a velocity."""
        if self.goal == "velocity":
            return jnp.zeros(2)
        return jnp.stack([self.north - s.north, self.east - s.east])

    def _reference(self, way: Any) -> Any:
        """Return the reference velocity (m/s, in W)."""
        if self.goal == "velocity":
            return self.speed * planar(self.course)[:, 0]
        distance = _size(way)
        far = distance > self.near
        return jnp.where(far, way * jnp.minimum(self.c, self.speed / jnp.where(far, distance, 1.0)), 0.0)

    def _force(self, reference: Any, error: Any) -> Any:
        """Return the force (N, in W) for a reference velocity and a velocity error (m/s, in W)."""
        speed = _size(reference)
        moves = speed > 0
        line = jnp.where(moves, reference / jnp.where(moves, speed, 1.0), jnp.zeros(2))
        along = jnp.where(moves, (line @ error) * line, error)
        acceleration = self.k * along + self.k_side * (error - along)
        return self.model.mass * acceleration + self._drag(reference)

    def _drag(self, velocity: Any) -> Any:
        """Return the force (N, in W) that balances the friction at a constant velocity (m/s, in W)."""
        DX, DY, _ = self.model.friction.wrench(velocity[0], velocity[1], 0.0)
        return -jnp.stack([DX, DY])

    def _decide(
        self, state: TurnThenPushState, estimate: Estimate, n: Any, reference: Any, error: Any, force: Any
    ) -> TurnThenPushState:
        """Return the next step and reference heading. Neither changes while the estimate is not valid."""
        mode, heading = state.mode, estimate.state.heading
        moves = reference @ reference > 0
        off = (_size(error) > self.start) | (moves & (mode == REST))
        some = force @ force > 0
        wanted = jnp.arctan2(jnp.where(some, force[1], 0.0), jnp.where(some, force[0], 1.0))
        nose = jnp.where((mode == REST) & ~off | ~some, state.nose, wanted)
        away = jnp.abs(wrap(nose - heading))
        begins = (mode == REST) & off
        mode = jnp.where(begins, TURN, mode)
        again = (mode == PUSH) & (away > self.lost) & (_size(error) > self.start)
        mode = jnp.where(again, TURN, mode)
        mode = jnp.where((mode == TURN) & (away < self.aligned), PUSH, mode)
        ends = (mode == PUSH) & (n @ error < self.stop) & ~moves
        mode = jnp.where(ends | ((mode == TURN) & ~off & ~moves), REST, mode)
        turns = state.turns + (begins | again).astype(np.int32)
        valid = estimate.valid
        return TurnThenPushState(
            mode=jnp.where(valid, mode, state.mode).astype(np.int32),
            nose=jnp.where(valid, nose, state.nose),
            turns=jnp.where(valid, turns, state.turns),
        )


def _size(vector: Any) -> Any:
    square = vector @ vector
    some = square > 0
    return jnp.where(some, jnp.sqrt(jnp.where(some, square, 1.0)), 0.0)
