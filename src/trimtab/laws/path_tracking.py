"""Trajectory tracking by the hovercraft, which thrusts along its nose and turns the nose to the demanded thrust.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, option, part, quantity, record, replace, tree_where
from trimtab.core.reference import Circle, ReferencePoint, retime
from trimtab.core.rotation import planar, wrap
from trimtab.core.signals import Estimate, PlanarForce
from trimtab.core.time import to_seconds
from trimtab.laws.path_feasibility import ThrustLimits, refuse_infeasible
from trimtab.laws.pose import READS, Pose, PoseState
from trimtab.vehicles.hovercraft import Hovercraft


@record
class PathTrackingState:
    """State of the law `PathTracking`: path parameter, and state of the law for rest. Source: own derivation."""

    began: Scalar = quantity("1", "True after the first step.", kind="flag")
    t: Scalar = quantity("100 ns", "Time of the last step.", kind="time")
    progress: Scalar = quantity("s", "Path parameter: time argument at which the reference path is evaluated.")
    heading: Scalar = quantity("rad", "Heading of the craft when the reference path last came to rest.", kind="angle")
    rest: PoseState = part("State of the law used while the path rests.")


@record
class PathTrackingOutput:
    """Demand and signals of the law `PathTracking`. P is the centre of percussion. Source: own derivation."""

    demand: PlanarForce = part("Demanded force at the rudder pivot.")
    north_reference: Scalar = quantity("m", "Reference north coordinate of the centre of percussion P.", frame="W")
    east_reference: Scalar = quantity("m", "Reference east coordinate of the centre of percussion P.", frame="W")
    heading_reference: Scalar = quantity(
        "rad", "Reference heading of the nose, equal to the present heading if no thrust is demanded.", kind="angle"
    )
    yaw_rate_reference: Scalar = quantity("rad/s", "Reference yaw rate r_d of the law.")
    position_error: Scalar = quantity("m", "Distance of the centre of percussion P from its reference position.")
    velocity_error: Scalar = quantity("m/s", "Magnitude of the velocity error of the centre of percussion P.")
    lyapunov: Scalar = quantity("m^2/s^2", "Lyapunov function V of the law.")
    progress: Scalar = quantity("s", "Path parameter: time argument at which the reference path is evaluated.")
    backing: Scalar = quantity("1", "True if the tail, not the nose, points along the demanded thrust.", kind="flag")
    resting: Scalar = quantity(
        "1", "True if the reference path is at rest, so that the law for rest is active.", kind="flag"
    )


class _Errors(NamedTuple):
    """Errors of the centre of percussion P, (2,) in W: position error e (m), velocity error v (m/s).

    acceleration, jerk: acceleration and jerk of the reference, minus those that drag causes. heading: heading of the
    craft (rad).
    """

    e: Any
    v: Any
    acceleration: Any
    jerk: Any
    heading: Any


class _End(NamedTuple):
    """Control with nose or tail along the thrust: reference yaw rate (rad/s), Lyapunov function V, and yaw acceleration
    (rad/s^2)."""

    rate: Any
    V: Any
    turn: Any


@record
class PathTracking:
    """Law that makes the centre of percussion P follow a reference in position and velocity, by thrust along the nose.

    P is accelerated along the nose n only (`laws.pose`): v_P' = n w for FX = m (w + a r^2). With the errors e, v of
    position and velocity, and the acceleration and jerk A, A' of the reference,

        s = A - k1 e - k2 v     w = n.s     y = b.s: demand across the nose, b = n turned by 90 degrees
        r_d = |s|^2/(|s|^4 + s0^4) (s_perp.s' + 2 tan(delta/2) s.s' + o |s| (kn y - c/q))
        r' = r_d' - kr (r - r_d) + o (q/p) |s| y,       FY = -(J/d) r'

    s_perp.s' = w b.s' - y n.s'. o = +1 if the nose is to point along s, o = -1 if the tail is. delta is the angle by
    which the nose or tail has to turn: sin(delta) = o y/|s|, cos(delta) = o w/|s|. c = b.(v + k2 e/2). The law chooses
    nose or tail, whichever has the smaller V,

        V = |v|^2/2 + (k2/2) e.v + (k1/2 + k2^2/4)|e|^2 + q |s| (|s| - o w) + p (r - r_d)^2/2.

    Stable, proven and tested: with G = |s|^4/(|s|^4 + s0^4) and M = (s_perp.s' + 2 tan(delta/2) s.s')/|s|
        V' = -(k1 k2/2)|e|^2 - (k2/2)|v|^2 - q kn G y^2 - p kr (r - r_d)^2 + (1 - G) y (o q M - c)
      for every state, and V does not jump when the law changes between nose and tail. While delta is within 90 degrees,
        V' <= -2 mu V + q kn s0^2/2 + 0.57 s0 (3 q |s'| + |c|)        mu = `decay(law)`, (1 - G)|y| <= 0.57 s0,
      so that V falls exponentially to a neighbourhood whose size goes to zero with s0. Where |s| is well above s0, as
      on a circle, V goes to zero except for a part of order (s0/|s|)^4. Where the demanded thrust passes through zero
      the nose does not turn: the craft coasts, and then thrusts the other way.
    Only simulated, not proven: limits of fan, rudder and yaw rate, delays, and the dead zone. A nose or tail that has
    to turn by more than 90 degrees is chosen only if it already turns in that direction.
    Friction:  the model's friction is subtracted from s and from the torque, and its rate of change from s'. The second
               derivative of the friction is not subtracted from r_d'.
    Progress:  "time": the path parameter is the time since the law started. "path": the path parameter runs slower
               while the craft is behind, and up to twice as fast while the craft is ahead. V then refers to the path
               traversed at this rate.
    Rest:      while the path rests no thrust is demanded, so the heading would be free. Then the law `Pose` acts,
               with the path's heading, or with the craft's heading if the path has none.
    Valid:     references that `laws.path_feasibility` accepts before the run.
    Source:    own derivation; backstepping: M. Krstic, I. Kanellakopoulos, P. Kokotovic, "Nonlinear and adaptive
               control design", 1995; underactuated vehicles: A. Aguiar, J. Hespanha, IEEE Trans. Automatic Control 52
               (2007) 1362; the choice by V: C. Mayhew, R. Sanfelice, A. Teel, same journal 56 (2011) 2517. The gains
               are our own choice.
    """

    reads: ClassVar[tuple[str, ...]] = READS

    reference: Any = part("Reference position of the centre of percussion P, as a function of time.", default=Circle())
    progress: str = option(
        "Rate of the path parameter: follows the elapsed time (time) or the craft's progress (path).",
        default="time",
        choices=("time", "path"),
    )
    k1: Scalar = quantity("1/s^2", "Position gain k1: acceleration per position error.", default=0.2, above=0)
    k2: Scalar = quantity("1/s", "Velocity gain k2: acceleration per velocity error.", default=0.6, above=0)
    kn: Scalar = quantity("1/s", "Heading gain kn: yaw rate per sine of the nose's angle error.", default=1.0, above=0)
    kr: Scalar = quantity("1/s", "Yaw rate gain kr: yaw acceleration per yaw rate error.", default=2.0, above=0)
    q: Scalar = quantity("s^2", "Weight q of the nose's angle error in the Lyapunov function V.", default=10.0, above=0)
    p: Scalar = quantity("m^2", "Weight p of the yaw rate error in the Lyapunov function V.", default=0.5, above=0)
    s0: Scalar = quantity(
        "m/s^2",
        "Demanded acceleration s0 below which the nose does not turn to the direction of this demand.",
        default=0.05,
        above=0,
    )
    kp: Scalar = quantity(
        "1/m",
        "Gain, for progress=path: increase of the path parameter's rate per distance that the craft is ahead.",
        default=1.0,
        above=0,
    )
    rest: Pose = part("Law used while the path is at rest.", default=Pose())
    side: Scalar = quantity(
        "N", "Maximum side force that is allowed while the force along the nose is zero.", default=0.2, above=0
    )
    limits: ThrustLimits = part("Limits of fan and rudder that the law assumes.", default=ThrustLimits())
    model: Hovercraft = part("Vehicle model used by the law.", default=Hovercraft())

    def check_duration(self, seconds: float) -> None:
        """Raise InputError if the craft cannot follow the reference within a run of this length."""
        refuse_infeasible(self.reference, self.model, self.limits, seconds)

    def init(self, key: Any) -> PathTrackingState:
        """Return the initial state, before the first step."""
        zero, rest = np.asarray(0.0), self.rest.init(key)
        return PathTrackingState(np.asarray(False), np.asarray(0, np.int64), progress=zero, heading=zero, rest=rest)

    def step(
        self, t: Any, state: PathTrackingState, estimate: Estimate
    ) -> tuple[PathTrackingState, PathTrackingOutput]:
        """Return the demand at time t (unit: 100 ns)."""
        s = estimate.state
        body = planar(s.heading)
        progress, point, rests = self._progress(t, state, s, body)
        heading = jnp.where(rests & state.began, state.heading, s.heading)
        rest, hold = self._hold(t, state, estimate, point, heading)
        rest = tree_where(rests, rest, self.rest.init(None))
        now = PathTrackingState(jnp.asarray(True), jnp.asarray(t), progress, heading, rest)
        errors, friction = self._errors(s, body, point)
        w = self._thrust(errors, s.heading)
        nose, tail = (self._turn_end(end, errors, point, s, w) for end in (1.0, -1.0))
        backs = tail.V < nose.V
        end = tree_where(backs, tail, nose)
        FX = self.model.mass * (w + self.model.percussion_arm * s.yaw_rate**2)
        FY = -(self.model.inertia * end.turn - friction) / self.model.arm
        demand = tree_where(rests, hold, PlanarForce(FX=FX, FY=FY))
        return now, PathTrackingOutput(
            demand=self._limit(demand),
            north_reference=point.place[0],
            east_reference=point.place[1],
            heading_reference=s.heading + self._away(errors, backs),
            yaw_rate_reference=end.rate,
            position_error=jnp.sqrt(errors.e @ errors.e),
            velocity_error=jnp.sqrt(errors.v @ errors.v),
            lyapunov=end.V,
            progress=progress,
            backing=backs,
            resting=rests,
        )

    def _away(self, errors: _Errors, backs: Any) -> Any:
        """Return reference heading minus heading (rad), or zero where no thrust is demanded."""
        wanted = self._demand(errors)
        line, thrusts = jnp.where(backs, -wanted, wanted), wanted @ wanted > 1e-12
        aim = jnp.arctan2(jnp.where(thrusts, line[1], 0.0), jnp.where(thrusts, line[0], 1.0))
        return jnp.where(thrusts, wrap(aim - errors.heading), 0.0)

    def _limit(self, wanted: PlanarForce) -> PlanarForce:
        """Return a force (N) within the limits of fan and rudder. A small side force is allowed without thrust."""
        FX = jnp.clip(wanted.FX, -self.limits.pull, self.limits.push)
        most = jnp.maximum(jnp.tan(self.limits.angle) * jnp.abs(FX), self.side)
        return PlanarForce(FX=FX, FY=jnp.clip(wanted.FY, -most, most))

    def _hold(
        self, t: Any, state: PathTrackingState, estimate: Estimate, point: ReferencePoint, heading: Any
    ) -> tuple[PoseState, PlanarForce]:
        """Return the demand of the law for rest, with P at the path's point and the nose at the path's heading.

        heading: target heading (rad) if the path has none.
        """
        heading = jnp.where(point.has_heading, point.heading, heading)
        place = point.place - self.model.percussion_arm * planar(heading)[:, 0]
        law = replace(self.rest, north=place[0], east=place[1], heading=heading, model=self.model)
        rest, output = law.step(t, state.rest, estimate)
        return rest, output.demand

    def _progress(self, t: Any, state: PathTrackingState, s: Any, body: Any) -> tuple[Any, ReferencePoint, Any]:
        """Return the path parameter, the reference at this parameter, and True if the path is at rest there."""
        since = jnp.where(state.began, to_seconds(t - state.t), 0.0)
        rate = jnp.asarray(1.0)
        if self.progress == "path":
            before = self.reference.at(state.progress)
            speed = jnp.sqrt(before.velocity @ before.velocity)
            ahead = (self._place(s, body) - before.place) @ before.velocity / jnp.maximum(speed, 0.05)
            rate = jnp.clip(1 + self.kp * ahead, 0.0, 2.0)
        progress = state.progress + rate * since
        point = self.reference.at(progress)
        rests = ~jnp.any(jnp.stack([point.velocity, point.acceleration, point.jerk]) != 0.0)
        return progress, retime(point, (rate, 0.0, 0.0, 0.0)), rests

    def _place(self, s: Any, body: Any) -> Any:
        return jnp.stack([s.north, s.east]) + self.model.percussion_arm * body[:, 0]

    def _errors(self, s: Any, body: Any, point: ReferencePoint) -> tuple[_Errors, Any]:
        """Return the errors of the centre of percussion P, and the friction torque (N m)."""
        arm = self.model.percussion_arm
        velocity = body @ jnp.stack([s.surge_velocity, s.sway_velocity + arm * s.yaw_rate])
        e, v = self._place(s, body) - point.place, velocity - point.velocity
        errors = _Errors(e, v, point.acceleration, point.jerk, s.heading)
        if self.model.friction is None:
            return errors, jnp.asarray(0.0)

        def drag(velocity: Any, heading: Any) -> Any:
            return self._drag(velocity, heading, s.yaw_rate)[0]

        felt, torque = self._drag(velocity, s.heading, s.yaw_rate)
        errors = errors._replace(acceleration=point.acceleration - felt)
        gain = body[:, 0] * self._thrust(errors, s.heading) + felt
        _, change = jax.jvp(drag, (velocity, s.heading), (gain, s.yaw_rate))
        return errors._replace(jerk=point.jerk - change), torque

    def _drag(self, velocity: Any, heading: Any, rate: Any) -> tuple[Any, Any]:
        """Return the acceleration of the centre of percussion P by friction (m/s^2, in W), and the friction torque (N
        m), at a velocity of P (m/s, in W)."""
        body, model = planar(heading), self.model
        surge, side = body.T @ velocity
        X, Y, torque = model.friction.wrench(surge, side - model.percussion_arm * rate, rate)
        along = jnp.stack([X / model.mass, Y / model.mass + model.percussion_arm * torque / model.inertia])
        return body @ along, torque

    def _demand(self, errors: _Errors) -> Any:
        """Return the demanded acceleration s (m/s^2), in W."""
        return errors.acceleration - self.k1 * errors.e - self.k2 * errors.v

    def _thrust(self, errors: _Errors, heading: Any) -> Any:
        """Return the component w (m/s^2) of the demanded acceleration along the nose."""
        return planar(heading)[:, 0] @ self._demand(errors)

    def _turn_end(self, end: float, errors: _Errors, point: ReferencePoint, s: Any, w: Any) -> _End:
        """Return the control with the nose (end = 1.0) or the tail (end = -1.0) along the demanded thrust."""
        across = planar(s.heading)[:, 1]
        wanted = self._demand(errors)
        y = across @ wanted
        change = -self.k1 * errors.e - self.k2 * errors.v - across * y
        slope = _Errors(errors.v, change, point.jerk, point.snap, s.yaw_rate)
        rate, acceleration = jax.jvp(lambda x: self._rate(end, x), (errors,), (slope,))
        z, size = s.yaw_rate - rate, _size(wanted)
        V = self.error_energy(errors.e, errors.v) + self.q * size * (size - end * w) + self.p * z**2 / 2
        return _End(rate, V, acceleration - self.kr * z + end * self.q / self.p * size * y)

    def _rate(self, end: float, errors: _Errors) -> Any:
        """Return the reference yaw rate r_d (rad/s) with the nose (end = 1) or the tail (end = -1) along the thrust."""
        body, s = planar(errors.heading), self._demand(errors)
        n, b = body[:, 0], body[:, 1]
        w, y, size = n @ s, b @ s, _size(s)
        slope = errors.jerk - self.k1 * errors.v + self.k2 * (self.k1 * errors.e + self.k2 * errors.v + b * y)
        half = end * y / jnp.maximum(size + end * w, 1e-3 * size)
        c = b @ (errors.v + self.k2 / 2 * errors.e)
        turn = w * (b @ slope) - y * (n @ slope) + 2 * half * (s @ slope)
        square = size**2
        rate = square / (square**2 + self.s0**4) * (turn + end * size * (self.kn * y - c / self.q))
        return jnp.clip(rate, -self.limits.turn_rate, self.limits.turn_rate)

    def error_energy(self, e: Any, v: Any) -> Any:
        """Return the terms of V in the position error (m) and the velocity error (m/s), each (2,)."""
        k1, k2 = self.k1, self.k2
        return v @ v / 2 + k2 / 2 * (e @ v) + (k1 / 2 + k2**2 / 4) * (e @ e)


def _size(s: Any) -> Any:
    """Return |s| (m/s^2), with a finite derivative at zero."""
    return jnp.sqrt(s @ s + 1e-12)


def decay(law: PathTracking) -> float:
    """Return the decay rate mu (1/s) of the law: V falls as exp(-2 mu t)."""
    k1, k2 = float(law.k1), float(law.k2)
    M = np.array([[k1 + k2**2 / 2, k2 / 2], [k2 / 2, 1.0]])
    own = float(np.linalg.eigvals(np.linalg.solve(M, np.diag([k1 * k2, k2]))).real.min()) / 2
    return min(own, float(law.kn) / 2, float(law.kr))
