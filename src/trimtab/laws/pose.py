"""Rest at a position and heading: the hovercraft brakes, aims, moves there in a straight line, turns, and stays.

No smooth feedback of the state can do this (design/stabilisability.py). The law uses a point of the body whose
acceleration does not depend on the rudder: P, a = J/(m d) ahead of the centre of mass, is the centre of percussion of
the rudder pivot, where FY causes no acceleration. With FX = m (w + a r^2), P is accelerated by w along the nose, n, and
not at all across it:

    v_P' = n w        r' = -(d/J) FY

So the nose can turn freely while P rests, and P moves along a straight line while the nose holds its direction. A small
swing of the nose removes the remaining error across the nose: thrust forward on one side of the swing and backward on
the other moves P sideways.

Source: own derivation from the model of [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link",
University of Maryland, 2006, eq. 2.11. The algorithm of [1] is in `laws/pose_steps.py`.
"""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError, argument
from trimtab.core.record import Scalar, part, quantity, record
from trimtab.core.rotation import planar, wrap
from trimtab.core.signals import Estimate, PlanarForce
from trimtab.core.time import to_seconds
from trimtab.laws.velocity import READS as VELOCITIES
from trimtab.vehicles.hovercraft import Hovercraft

READS = (*VELOCITIES, "heading", "north", "east")
BRAKE, AIM, GO, HOLD = range(4)
"""Indices of the steps of the law Pose, in their order."""
STEPS = ("brake", "aim", "go", "hold")


@record
class PoseState:
    """State of the law `Pose`. Source: own derivation."""

    mode: Scalar = quantity("1", "Active step of the law.", kind="mode", modes=STEPS)
    nose: Scalar = quantity("rad", "Reference heading of the nose.", kind="angle")
    rounds: Scalar = quantity(
        "1", "Number of rounds of the four steps since the start. Each round begins with step brake.", kind="count"
    )


@record
class PoseOutput:
    """Demand and signals of the law `Pose`. Source: own derivation."""

    demand: PlanarForce = part("Demanded force at the rudder pivot.")
    mode: Scalar = quantity("1", "Active step of the law.", kind="mode", modes=STEPS)
    rounds: Scalar = quantity(
        "1", "Number of rounds of the four steps since the start. Each round begins with step brake.", kind="count"
    )
    heading_reference: Scalar = quantity("rad", "Reference heading of the nose.", kind="angle")
    distance: Scalar = quantity("m", "Distance of the centre of percussion P from its target position.")
    speed: Scalar = quantity("m/s", "Speed of the centre of percussion P.")


class _Swing(NamedTuple):
    """Swing of the nose about the target heading: angle (rad), rate (rad/s), acceleration (rad/s^2)."""

    angle: Any
    rate: Any
    acceleration: Any


@record
class Pose:
    """Law that brings the hovercraft to rest at a position and heading, in four steps about its centre of percussion P.

        brake  w = -k n.v_P            the nose turns to the line of v_P          until |v_P| < rest_speed
        aim    w = -k n.v_P            the nose turns to the line to the goal     until it points there
        go     w = k (v_d - n.v_P)     the nose holds that line                   until P is there or passes beside it
        hold   w = k (v_d - n.v_P) + w_y   the nose at the target heading + theta     until P has left

        theta = swing q sin(f t), q = min(1, sqrt(|s|/s0));   w_y = (2/swing^2) max(|s|, s0) sign(s) sin(heading error)
        s = h^2 e_y - 2 h y'; e_y: remaining distance across the target heading, y': speed of P across it

    e is the vector from P to its target; v_d = c n.e, at most `speed`. FX = m (w + a r^2), FY = -(J/d) kr (r_d - r),
    r_d = kh wrap(nose - heading), at most `turn_rate`. Along a line the nose takes the nearer of the two directions, so
    the craft also moves backward. A step whose goal is already met takes no time.

    Stable:  brake and aim: |v_P|^2/2 falls at the rate k (n.v_P)^2. It is constant only while v_P is across the nose,
             and the nose turns away from this direction. go: with the nose on the line the remaining distance obeys e''
             = -k e' - k c e, stable for all k, c > 0, without overshoot for k >= 4 c. r' = kr (r_d - r) whatever P
             does. Each round brings P nearer: after `go` only the error across the line is left, at most rest_speed
             times the duration of `go`. hold: across the heading y'' = w sin(heading error), so w_y pushes in the right
             direction for every heading. Averaged over a swing, y'' = s, with a double pole at -h. Swing and push
             vanish with s, so in the end the craft rests. Only simulated, not proven: the average, and steps that end
             early. (tests)
    Ends:    at a distance below `near` and a speed below rest_speed. A new round begins at a distance above `far`, or a
             speed above leave_speed.
    Valid:   as far as the actuators can give the demand. The fan and rudder of [1] give no side force without thrust.
    Source:  own derivation (docs page); a swing that shrinks with the root of the error: R. M'Closkey, R. Murray, IEEE
             Trans. Automatic Control 42 (1997) 614. The gains are our own choice.
    """

    reads: ClassVar[tuple[str, ...]] = READS

    north: Scalar = quantity("m", "Target north coordinate of the centre of mass.", frame="W", default=0.0)
    east: Scalar = quantity("m", "Target east coordinate of the centre of mass.", frame="W", default=0.0)
    heading: Scalar = quantity("rad", "Target heading of the nose.", kind="angle", default=0.0)
    k: Scalar = quantity("1/s", "Gain k of the velocity error of the centre of percussion.", default=2.0, above=0)
    c: Scalar = quantity("1/s", "Gain c: commanded speed per remaining distance.", default=0.5, above=0)
    speed: Scalar = quantity("m/s", 'Maximum commanded speed in step "go".', default=0.6, above=0)
    kh: Scalar = quantity("1/s", "Heading gain: yaw rate per heading error.", default=1.5, above=0)
    kr: Scalar = quantity("1/s", "Yaw rate gain: yaw acceleration per yaw rate error.", default=6.0, above=0)
    turn_rate: Scalar = quantity("rad/s", "Maximum yaw rate.", default=1.5, above=0)
    aligned: Scalar = quantity("rad", 'Heading error below which step "go" starts.', default=0.001, above=0)
    near: Scalar = quantity("m", 'Remaining distance below which step "hold" starts.', default=0.01, above=0)
    rest_speed: Scalar = quantity("m/s", "Speed below which the craft counts as at rest.", default=1e-3, above=0)
    far: Scalar = quantity(
        "m", 'Remaining distance above which step "hold" ends and a new round begins.', default=0.1, above=0
    )
    leave_speed: Scalar = quantity(
        "m/s", 'Speed above which step "hold" ends and a new round begins.', default=0.1, above=0
    )
    swing: Scalar = quantity("rad", 'Maximum swing angle of the nose in step "hold".', default=0.025, above=0)
    f: Scalar = quantity("rad/s", 'Angular frequency of the swing of the nose in step "hold".', default=3.0, above=0)
    h: Scalar = quantity("1/s", 'Decay rate h of the lateral error in step "hold".', default=0.3, above=0)
    s0: Scalar = quantity(
        "m/s^2",
        'Demanded lateral acceleration s above which the swing has its maximum angle, in step "hold".',
        default=1e-3,
        above=0,
    )
    model: Hovercraft = part("Vehicle model used by the law.", default=Hovercraft())

    def check(self) -> None:
        """Raise InputError if step "hold" would end as soon as it begins."""
        for inner, outer in (("near", "far"), ("rest_speed", "leave_speed")):
            low, high = np.asarray(getattr(self, inner)), np.asarray(getattr(self, outer))
            if not np.all(low < high):
                problem = (
                    f"{inner}, below which step hold begins, must be less than {outer}, above which step "
                    f"hold ends, got {low} and {high}"
                )
                raise InputError(
                    f"Pose.{inner}",
                    problem,
                    fix=argument("settings", f"{float(high.min()) / 3:.2g}", f"autopilot.law.{inner}"),
                )

    def init(self, key: Any) -> PoseState:
        """Return the initial state, in step "brake"."""
        zero = np.asarray(0, np.int32)
        return PoseState(mode=zero, nose=np.asarray(0.0), rounds=np.asarray(1, np.int32))

    def step(self, t: Any, state: PoseState, estimate: Estimate) -> tuple[PoseState, PoseOutput]:
        """Update the active step of the law, and return the demand at time t (unit: 100 ns)."""
        s, arm = estimate.state, self.model.percussion_arm
        body = planar(s.heading)
        n = body[:, 0]
        rest = jnp.stack([self.north, self.east]) + arm * planar(self.heading)[:, 0]
        way = rest - jnp.stack([s.north, s.east]) - arm * n
        v = body @ jnp.stack([s.surge_velocity, s.sway_velocity + arm * s.yaw_rate])
        now = self._decide(state, estimate, way, v)
        goes = (now.mode == GO) | (now.mode == HOLD)
        theta, push = self._swing(t, now, s.heading, way, v)
        wanted = jnp.where(goes, jnp.clip(self.c * (n @ way), -self.speed, self.speed), 0.0)
        away = wrap(now.nose + theta.angle - s.heading)
        rate = jnp.clip(self.kh * away, -self.turn_rate, self.turn_rate) + theta.rate
        FX = self.model.mass * (self.k * (wanted - n @ v) + push + arm * s.yaw_rate**2)
        FY = -self.model.inertia / self.model.arm * (self.kr * (rate - s.yaw_rate) + theta.acceleration)
        return now, PoseOutput(
            demand=PlanarForce(FX=FX, FY=FY),
            mode=now.mode,
            rounds=now.rounds,
            heading_reference=now.nose + theta.angle,
            distance=_size(way),
            speed=_size(v),
        )

    def _swing(self, t: Any, now: PoseState, heading: Any, way: Any, v: Any) -> "tuple[_Swing, Any]":
        """Return the nose's swing, and the thrust acceleration (m/s^2) that moves P sideways. Both are zero outside
        step "hold".
        """
        across = planar(self.heading)[:, 1]
        s = jnp.where(now.mode == HOLD, self.h**2 * (across @ way) - 2 * self.h * (across @ v), 0.0)
        size = self.swing * jnp.sqrt(jnp.minimum(jnp.abs(s) / self.s0, 1.0))
        phase = self.f * to_seconds(t)
        side = jnp.clip(wrap(heading - self.heading), -self.swing, self.swing)
        push = 2 / self.swing**2 * jnp.maximum(jnp.abs(s), self.s0) * jnp.sign(s) * side
        angle = size * jnp.sin(phase)
        return _Swing(angle, self.f * size * jnp.cos(phase), -(self.f**2) * angle), push

    def _decide(self, state: PoseState, estimate: Estimate, way: Any, v: Any) -> PoseState:
        """Return the next step and reference heading. Neither changes while the estimate is not valid."""
        heading = estimate.state.heading
        distance, speed, mode = _size(way), _size(v), state.mode
        left = (mode == HOLD) & ((distance > self.far) | (speed > self.leave_speed))
        mode = jnp.where(left, BRAKE, mode)
        rests, arrived = speed < self.rest_speed, distance < self.near
        line = planar(state.nose)[:, 0]
        is_beside, is_slow = jnp.abs(line @ way) < self.near / 2, jnp.abs(line @ v) < self.rest_speed / 2
        passes = (mode == GO) & is_beside & is_slow & ~(arrived & rests)
        mode = jnp.where(passes, BRAKE, mode)
        aims = (mode == BRAKE) & rests
        mode = jnp.where(aims, AIM, mode)
        is_aligned = (jnp.abs(wrap(state.nose - heading)) < self.aligned) & (
            jnp.abs(estimate.state.yaw_rate) < self.aligned
        )
        mode = jnp.where((mode == AIM) & is_aligned & ~aims, GO, mode)
        mode = jnp.where((mode != HOLD) & rests & arrived, HOLD, mode)
        braking = _nearer_end(_angle(v, heading), heading)
        nose = jnp.where(mode == BRAKE, jnp.where(rests, state.nose, braking), state.nose)
        nose = jnp.where(aims, _nearer_end(_angle(way, heading), heading), jnp.where(mode == HOLD, self.heading, nose))
        begun = (left | passes).astype(np.int32)
        now = PoseState(mode=mode.astype(np.int32), nose=nose, rounds=state.rounds + begun)
        valid = estimate.valid
        return PoseState(
            mode=jnp.where(valid, now.mode, state.mode),
            nose=jnp.where(valid, now.nose, state.nose),
            rounds=jnp.where(valid, now.rounds, state.rounds),
        )


def _size(vector: Any) -> Any:
    return jnp.sqrt(vector @ vector)


def _angle(vector: Any, otherwise: Any) -> Any:
    """Return the direction of a vector, clockwise from north; `otherwise` for a zero vector."""
    known = vector @ vector > 0
    return jnp.where(known, jnp.arctan2(jnp.where(known, vector[1], 0.0), jnp.where(known, vector[0], 1.0)), otherwise)


def _nearer_end(line: Any, heading: Any) -> Any:
    """Return the one of the two directions of a line that is nearer to the heading."""
    back = jnp.abs(wrap(line - heading)) > np.pi / 2
    return jnp.where(back, line + np.pi, line)
