"""Tracking of a path in time by the hovercraft: thrust along the nose, and the nose turned to the needed thrust.

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
    """State of the law: its start, and the progress along the path. Source: own derivation."""

    began: Scalar = quantity("1", "True after the first step.", kind="flag")
    t: Scalar = quantity("100 ns", "Time of the last step.", kind="time")
    progress: Scalar = quantity("s", "Path parameter: the path's own time.")
    heading: Scalar = quantity("rad", "Heading of the craft when the path last began to rest.", kind="angle")
    rest: PoseState = part("State of the law used while the path rests.")


@record
class PathTrackingOutput:
    """Demand and signals of the law. P is the centre of percussion. Source: own derivation."""

    demand: PlanarForce = part("Demanded force at the rudder pivot.")
    north_reference: Scalar = quantity("m", "Reference position of P, north.", frame="W")
    east_reference: Scalar = quantity("m", "Reference position of P, east.", frame="W")
    heading_reference: Scalar = quantity(
        "rad", "Reference heading of the nose; the present one without thrust.", kind="angle"
    )
    yaw_rate_reference: Scalar = quantity("rad/s", "Reference yaw rate.")
    position_error: Scalar = quantity("m", "Distance of P from its reference.")
    velocity_error: Scalar = quantity("m/s", "Velocity error of P.")
    lyapunov: Scalar = quantity("m^2/s^2", "Lyapunov function V of the law.")
    progress: Scalar = quantity("s", "Path parameter: the path's own time.")
    backing: Scalar = quantity("1", "True if the tail, not the nose, points along the demanded thrust.", kind="flag")
    resting: Scalar = quantity("1", "True if the path rests and the law for rest is active.", kind="flag")


class _Errors(NamedTuple):
    """Errors of P, (2,) in W: position e (m), velocity v (m/s); and the reference: acceleration, jerk, less drag."""

    e: Any
    v: Any
    acceleration: Any
    jerk: Any
    heading: Any


class _End(NamedTuple):
    """One end of the craft turned along the demanded thrust: its yaw rate, its part of V, and the torque for it."""

    rate: Any
    V: Any
    turn: Any


@record
class PathTracking:
    """Makes the centre of percussion P follow a reference, in position and velocity, by thrust along the nose.

    P is accelerated along the nose n only (`laws.pose`): v_P' = n w for FX = m (w + a r^2). With the errors of place
    and velocity e, v, the acceleration and jerk of the reference A, A',

        s = A - k1 e - k2 v     w = n.s     y = b.s: what is wanted across the nose, b = n turned by 90 degrees
        r_d = |s|^2/(|s|^4 + s0^4) (s_perp.s' + 2 tan(delta/2) s.s' + o |s| (kn y - c/q))
        r' = r_d' - kr (r - r_d) + o (q/p) |s| y,       FY = -(J/d) r'

    s_perp.s' = w b.s' - y n.s'; o = +1: the nose points along s, o = -1: the tail does; delta is what that end has to
    turn, sin(delta) = o y/|s|, cos(delta) = o w/|s|; c = b.(v + k2 e/2). The end is the one with less V,

        V = |v|^2/2 + (k2/2) e.v + (k1/2 + k2^2/4)|e|^2 + q |s| (|s| - o w) + p (r - r_d)^2/2.

    Stable, proven and held by tests: with G = |s|^4/(|s|^4 + s0^4) and M = (s_perp.s' + 2 tan(delta/2) s.s')/|s|
        V' = -(k1 k2/2)|e|^2 - (k2/2)|v|^2 - q kn G y^2 - p kr (r - r_d)^2 + (1 - G) y (o q M - c)
      for every state, and V doesn't jump when the end changes. While delta is within 90 degrees,
        V' <= -2 mu V + q kn s0^2/2 + 0.57 s0 (3 q |s'| + |c|)        mu = `decay(law)`, (1 - G)|y| <= 0.57 s0,
      so that V falls exponentially to a neighbourhood whose size goes to zero with s0. Where |s| is well above s0, as
      on a circle, V vanishes but for (s0/|s|)^4. Where the wanted thrust passes through zero the nose isn't hurried:
      the craft coasts, and thrusts the other way afterwards.
    Not proven: limits of fan, rudder and yaw rate, delays, the dead zone: simulated. An end more than 90 degrees off
      is only chosen while the yaw rate favours it.
    Friction:  what the model has of it is taken off s and off the torque, its rate of change off s', but not its second
               derivative off r_d'.
    Progress:  "time": the path's time is that since the law began. "path": it goes slower while the craft is behind
               and faster, up to twice, while it is ahead; V is as above for a path whose time goes at that rate.
    Rest:      where the path rests no thrust is wanted that could turn the nose, and the neighbourhood is a circling:
               there `Pose` takes over, with the path's heading, or that of the craft.
    Valid:     references that `laws.path_feasibility` doesn't refuse before the run.
    Source:    own derivation; backstepping: M. Krstic, I. Kanellakopoulos, P. Kokotovic, "Nonlinear and adaptive
               control design", 1995; underactuated vehicles: A. Aguiar, J. Hespanha, IEEE Trans. Automatic Control 52
               (2007) 1362; the choice by V: C. Mayhew, R. Sanfelice, A. Teel, same journal 56 (2011) 2517. Gains are
               this project's.
    """

    reads: ClassVar[tuple[str, ...]] = READS

    reference: Any = part("Reference position of P.", default=Circle())
    progress: str = option(
        "Time base of the path: elapsed time, or the craft's progress along the path.",
        default="time",
        choices=("time", "path"),
    )
    k1: Scalar = quantity("1/s^2", "Acceleration per position error.", default=0.2, above=0)
    k2: Scalar = quantity("1/s", "Acceleration per velocity error.", default=0.6, above=0)
    kn: Scalar = quantity("1/s", "Yaw rate per sine of the nose's error.", default=1.0, above=0)
    kr: Scalar = quantity("1/s", "Yaw acceleration per error of yaw rate.", default=2.0, above=0)
    q: Scalar = quantity("s^2", "Weight of the nose in V.", default=10.0, above=0)
    p: Scalar = quantity("m^2", "Weight of the yaw rate in V.", default=0.5, above=0)
    s0: Scalar = quantity(
        "m/s^2", "Demanded acceleration below which the nose is not turned to it.", default=0.05, above=0
    )
    kp: Scalar = quantity(
        "1/m", "Change of the path's rate per distance ahead, with progress by path.", default=1.0, above=0
    )
    rest: Pose = part("Law used while the path rests.", default=Pose())
    side: Scalar = quantity("N", "Force to the side that is allowed without any along the nose.", default=0.2, above=0)
    limits: ThrustLimits = part("Limits of fan and rudder.", default=ThrustLimits())
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
        """Return the demand at integer time t."""
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
        """Return the angle of the nose from its reference (rad); zero where no thrust is demanded."""
        wanted = self._demand(errors)
        line, thrusts = jnp.where(backs, -wanted, wanted), wanted @ wanted > 1e-12
        aim = jnp.arctan2(jnp.where(thrusts, line[1], 0.0), jnp.where(thrusts, line[0], 1.0))
        return jnp.where(thrusts, wrap(aim - errors.heading), 0.0)

    def _limit(self, wanted: PlanarForce) -> PlanarForce:
        """Return the part of a force (N) that fan and rudder can give; a little also to the side alone."""
        FX = jnp.clip(wanted.FX, -self.limits.pull, self.limits.push)
        most = jnp.maximum(jnp.tan(self.limits.angle) * jnp.abs(FX), self.side)
        return PlanarForce(FX=FX, FY=jnp.clip(wanted.FY, -most, most))

    def _hold(
        self, t: Any, state: PathTrackingState, estimate: Estimate, point: ReferencePoint, heading: Any
    ) -> tuple[PoseState, PlanarForce]:
        """Return the demand of the law for rest: P at the point, the nose at the path's heading, or where it was."""
        heading = jnp.where(point.has_heading, point.heading, heading)
        place = point.place - self.model.percussion_arm * planar(heading)[:, 0]
        law = replace(self.rest, north=place[0], east=place[1], heading=heading, model=self.model)
        rest, output = law.step(t, state.rest, estimate)
        return rest, output.demand

    def _progress(self, t: Any, state: PathTrackingState, s: Any, body: Any) -> tuple[Any, ReferencePoint, Any]:
        """Return the path's own time now, the reference there, and whether the path rests there."""
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
        """Return the errors of P, and the torque of friction (N m)."""
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
        """Return the acceleration of P by friction (m/s^2, W), and the torque (N m), at a velocity of P (m/s, W)."""
        body, model = planar(heading), self.model
        surge, side = body.T @ velocity
        X, Y, torque = model.friction.wrench(surge, side - model.percussion_arm * rate, rate)
        along = jnp.stack([X / model.mass, Y / model.mass + model.percussion_arm * torque / model.inertia])
        return body @ along, torque

    def _demand(self, errors: _Errors) -> Any:
        """Return s (m/s^2), in W."""
        return errors.acceleration - self.k1 * errors.e - self.k2 * errors.v

    def _thrust(self, errors: _Errors, heading: Any) -> Any:
        """Return w (m/s^2), along the nose."""
        return planar(heading)[:, 0] @ self._demand(errors)

    def _turn_end(self, end: float, errors: _Errors, point: ReferencePoint, s: Any, w: Any) -> _End:
        """Return yaw rate, V and yaw acceleration with the nose (1.0) or the tail (-1.0) along the demanded thrust."""
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
        """Return r_d (rad/s)."""
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
        """Return the first three terms of V, of errors of position (m) and velocity (m/s), each (2,)."""
        k1, k2 = self.k1, self.k2
        return v @ v / 2 + k2 / 2 * (e @ v) + (k1 / 2 + k2**2 / 4) * (e @ e)


def _size(s: Any) -> Any:
    """Return |s|, smooth at zero (m/s^2)."""
    return jnp.sqrt(s @ s + 1e-12)


def decay(law: PathTracking) -> float:
    """Return mu (1/s), the rate at which V falls."""
    k1, k2 = float(law.k1), float(law.k2)
    M = np.array([[k1 + k2**2 / 2, k2 / 2], [k2 / 2, 1.0]])
    own = float(np.linalg.eigvals(np.linalg.solve(M, np.diag([k1 * k2, k2]))).real.min()) / 2
    return min(own, float(law.kn) / 2, float(law.kr))
