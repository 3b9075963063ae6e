"""Law of a piloted hovercraft: the stick commands the thrust, the velocity in the body, or the velocity over the floor.
The fan is at the tail, so sway has no actuator of its own. Without drag a steady turn at speed V and rate w needs the
force m V w across the path, and the only steady force without a torque is along the nose: in a steady turn the nose
points to the centre of the circle. In mode "damped" the pilot has to turn the nose to the centre. In mode "assisted"
the law turns the nose.

Source: own derivation, except for the damping, which is from [1] Z. Kulis, "Feedback control of a hovercraft over a
wireless link", University of Maryland, 2006, section 2.2.
"""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, option, part, quantity, record, replace, tree_where
from trimtab.core.rotation import wrap
from trimtab.core.signals import STICK_MODES, Estimate, PlanarForce
from trimtab.core.time import ms, to_seconds
from trimtab.laws.velocity import READS as VELOCITIES
from trimtab.vehicles.hovercraft import Hovercraft

MANUAL, DAMPED, ASSISTED = range(len(STICK_MODES))
LONGEST_STEP = ms(100)
"""Longest time between two steps. After a longer pause the references restart at the vehicle's present motion."""
TURN_DEAD_ZONE = 0.2
"""Reference yaw rate (rad/s) above which mode "damped" ignores sway."""
REVERSE_SWAY = -0.5
"""Weight s of sway while moving backward. Sway is damped for weights between 0 and -m d^2/J = -2.8."""
REVERSE_SPEED = 0.1
"""Backward speed (m/s) above which the weight of sway is REVERSE_SWAY."""

NOSE_FREE = 1.6
"""Demanded force, as a multiple of nose_force, above which the nose points along this force alone. Below this value the
nose points partly along the course."""
BACKING = 0.3, 0.8
"""Fractions of the demanded force that point against the course: the fan starts to pull backward above the second
fraction, and stops below the first fraction."""


@record
class PilotedState:
    """State of the law `Piloted`. Source: own derivation."""

    t: Scalar = quantity("100 ns", "Time of the last step.", kind="time")
    mode: Scalar = quantity("1", "Mode that the stick selected at the last step.", kind="mode", modes=STICK_MODES)
    began: Scalar = quantity("1", "True after the first step.", kind="flag")
    speed: Scalar = quantity(
        "m/s", 'Reference of surge velocity (mode "damped") or of speed along the course (mode "assisted").'
    )
    rate: Scalar = quantity(
        "rad/s", 'Yaw rate reference (mode "damped") or turn rate reference of the course (mode "assisted").'
    )
    course: Scalar = quantity(
        "rad", "Reference course (direction of the velocity), clockwise from north, not wrapped.", kind="angle"
    )
    backing: Scalar = quantity(
        "1", "True if the fan pulls backward and the nose does not turn to the force.", kind="flag"
    )


@record
class PilotedOutput:
    """Demand and signals of the law `Piloted`. Source: own derivation."""

    demand: PlanarForce = part("Demanded force at the rudder pivot.")
    mode: Scalar = quantity("1", "Active mode of the law, as selected by the stick.", kind="mode", modes=STICK_MODES)
    stick_lost: Scalar = quantity(
        "1", "True if stick samples are missing or too old. The stick then counts as released.", kind="flag"
    )
    speed_reference: Scalar = quantity(
        "m/s",
        'Reference of surge velocity (mode "damped") or of speed along the course (mode "assisted"); else 0.',
    )
    rate_reference: Scalar = quantity(
        "rad/s",
        'Yaw rate reference (mode "damped") or turn rate reference of the course (mode "assisted"); else 0.',
    )
    course_reference: Scalar = quantity(
        "rad", 'Reference course in mode "assisted"; the heading of the nose in other modes.', kind="angle"
    )
    heading_reference: Scalar = quantity(
        "rad", 'Reference heading of the nose in mode "assisted"; the actual heading in other modes.', kind="angle"
    )
    velocity_error: Scalar = quantity(
        "m/s", 'Velocity error in mode "assisted"; surge velocity error in mode "damped"; 0 in mode "manual".'
    )


class _Hand(NamedTuple):
    """Stick input of the law: deflections forward and to the side, mode, and True if the stick is lost."""

    forward: Any
    turn: Any
    mode: Any
    lost: Any


@record
class Piloted:
    """Law that follows a pilot's stick in one of three modes. A switch on the stick selects the mode.

        manual    F = thrust forward, turned by deflection turn: FX = |F| cos, FY = -|F| sin, as with a radio control
        damped    FX = k1 (u_r - u)                        FY = k2 (d (r - r_r) - s v)
        assisted  FX = n.F + m a r^2                       FY = (J/d) kr (r - r_d)
                  F = m (v_r' + k (v_r - v_P))             r_d = w_r + kh wrap(heading_d - heading), limited

    n is the direction of the nose, v_r = V_r (cos c_r, sin c_r) the reference velocity in W, c_r' = w_r. The references
    u_r, r_r, V_r, w_r are the stick times a range, with a rate limit. P lies a = J/(m d) ahead of the centre of mass,
    where FY causes no acceleration (the centre of percussion of the rudder pivot): v_P' = n (FX/m - a r^2), so v_P' = n
    (n.F)/m. heading_d is the direction of the sum of F and a vector along the course that vanishes as F grows. While
    the fan pulls backward, -F replaces F. At rest the course is the heading of the nose.

    damped, proven (tests):
      turn released, u_r >= 0 held: ForwardMomentum and ZeroVelocity of [1], s = 1, globally stable for all k1, k2 > 0.
      u_r != 0 held, r_r = 0: locally stable if and only if s u_r > 0 (s > -m d^2/J), so s changes sign with u_r.
      |r_r| > 0.2 rad/s: s = 0 and (r - r_r)' = -(k2 d^2/J)(r - r_r), exactly; u -> 0 and v -> -k1 u_r/(m r_r), the turn
      in which the nose points to the centre. Surge cannot be held in this turn.
    assisted, proven (tests): r' = kr (r_d - r), whatever the velocity. While course and speed are held,
      E = m |v_r - v_P|^2/2 never grows, whatever the heading, for E' = -m k (n.(v_r - v_P))^2. Nor does it
      grow under the limits of FX, while m a r^2 < push. A nose at its reference heading is not perpendicular to the
      velocity error, so no error above nose_dead_zone/(m k) lasts. Only simulated, not proven: the fall of E while the
      nose turns and while backing switches, and turns, in which the nose has to turn before F can be given.
    The proofs neglect the limit of the actuators, which turn a force by at most about 21 degrees from the body's axis.

    Dead man:  a stick sample that is older than stick_timeout, invalid or not a number counts as a released stick in
               its last mode. In manual this means no thrust: the vehicle slides on. Before the first sample the mode is
               damped.
    Windup:    references stay constant while the law is not called. After a pause or a change of mode they restart at
               the vehicle's motion. In assisted they change more slowly as the velocity error approaches `hold_error`.
    Frames:    velocities in B, course and heading clockwise from north in W.
    Source:    own derivation; damping [1] eqs. 2.16, 2.24, 2.30. Gains and ranges are our own choice.
    """

    reads: ClassVar[tuple[str, ...]] = (*VELOCITIES, "heading")

    thrust: Scalar = quantity("N", 'Force at full forward stick in mode "manual".', default=1.2, above=0)
    deflection: Scalar = quantity(
        "rad", 'Angle of the force at full turn in mode "manual".', default=0.36, above=0, high=1.5
    )
    surge_range: Scalar = quantity(
        "m/s", 'Surge velocity at full forward stick in mode "damped".', default=0.8, above=0
    )
    yaw_range: Scalar = quantity("rad/s", 'Yaw rate at full turn in mode "damped".', default=1.5, above=0)
    speed_range: Scalar = quantity("m/s", 'Speed at full forward stick in mode "assisted".', default=0.8, above=0)
    course_range: Scalar = quantity(
        "rad/s", 'Rate of turn of the course at full turn in mode "assisted".', default=0.6, above=0
    )
    acceleration: Scalar = quantity("m/s^2", "Maximum acceleration of the speed reference.", default=0.3, above=0)
    yaw_acceleration: Scalar = quantity(
        "rad/s^2", 'Maximum acceleration of the yaw rate reference in mode "damped".', default=1.0, above=0
    )
    course_acceleration: Scalar = quantity(
        "rad/s^2",
        'Maximum angular acceleration of the course reference in mode "assisted".',
        default=0.3,
        above=0,
    )
    turn_acceleration: Scalar = quantity(
        "m/s^2",
        'Maximum lateral acceleration, speed times rate of turn of the course, in mode "assisted".',
        default=0.35,
        above=0,
    )
    k1: Scalar = quantity("kg/s", 'Gain of the surge velocity error in mode "damped".', default=2.0, above=0)
    k2: Scalar = quantity("kg/s", 'Gain of sway velocity and yaw rate error in mode "damped".', default=2.5, above=0)
    k: Scalar = quantity("1/s", 'Gain of the velocity error in mode "assisted".', default=0.8, above=0)
    kh: Scalar = quantity("1/s", 'Heading gain in mode "assisted": yaw rate per heading error.', default=1.0, above=0)
    kr: Scalar = quantity(
        "1/s", 'Yaw rate gain in mode "assisted": yaw acceleration per yaw rate error.', default=3.0, above=0
    )
    turn_rate: Scalar = quantity("rad/s", 'Maximum yaw rate in mode "assisted".', default=1.0, above=0)
    push: Scalar = quantity("N", 'Maximum forward force in mode "assisted".', default=1.4, above=0)
    pull: Scalar = quantity("N", 'Maximum backward force in mode "assisted".', default=0.7, above=0)
    swing: Scalar = quantity("N", 'Maximum force to the side in mode "assisted".', default=0.4, above=0)
    nose_force: Scalar = quantity(
        "N",
        'Demanded force at which the nose turns from the course to the force, in mode "assisted".',
        default=0.35,
        above=0,
    )
    nose_dead_zone: Scalar = quantity(
        "N", 'Demanded force below which the nose does not turn, in mode "assisted".', default=0.03, low=0
    )
    hold_error: Scalar = quantity(
        "m/s", 'Velocity error at which the references stop changing, in mode "assisted".', default=0.4, above=0
    )
    stick_timeout: Scalar = quantity("s", "Maximum age of a stick sample.", default=0.3, above=0)
    stick: str = option("Name of the sensor that provides the pilot's stick input.", default="stick")
    model: Hovercraft = part("Vehicle model used by the law.", default=Hovercraft())

    def init(self, key: Any) -> PilotedState:
        """Return the initial state, in mode "damped"."""
        zero, no = np.asarray(0.0), np.asarray(False)
        return PilotedState(
            t=np.asarray(0, np.int64),
            mode=np.asarray(DAMPED, np.int32),
            began=no,
            speed=zero,
            rate=zero,
            course=zero,
            backing=no,
        )

    def step(self, t: Any, state: PilotedState, estimate: Estimate) -> tuple[PilotedState, PilotedOutput]:
        """Return the demand at time t (unit: 100 ns)."""
        s = estimate.state
        hand = self._read_stick(state, estimate)
        before, dt = self._begin_again(t, state, hand.mode, s)
        damped = self._ramp_damped(before, hand, dt)
        assisted, F, error = self._lead_course(before, hand, dt, s)
        drive = self._drive_damped(damped, s)
        fly, aim = self._fly_assisted(assisted, F, s)
        now = tree_where(hand.mode == ASSISTED, assisted, tree_where(hand.mode == DAMPED, damped, before))
        size, angle = self.thrust * hand.forward, self.deflection * hand.turn
        manual = PlanarForce(FX=size * jnp.cos(angle), FY=-size * jnp.sin(angle))
        demand = tree_where(hand.mode == ASSISTED, fly, tree_where(hand.mode == DAMPED, drive, manual))
        surge_error = jnp.where(hand.mode == DAMPED, jnp.abs(now.speed - s.surge_velocity), 0.0)
        return now, PilotedOutput(
            demand=demand,
            mode=hand.mode,
            stick_lost=hand.lost,
            speed_reference=now.speed,
            rate_reference=now.rate,
            course_reference=now.course,
            heading_reference=jnp.where(hand.mode == ASSISTED, aim, s.heading),
            velocity_error=jnp.where(hand.mode == ASSISTED, error, surge_error),
        )

    def _read_stick(self, state: PilotedState, estimate: Estimate) -> _Hand:
        """Return the stick input. A missing stick counts as released, in the last mode."""
        if estimate.stick is None:
            return _Hand(jnp.asarray(0.0), jnp.asarray(0.0), state.mode, jnp.asarray(True))
        sample, stick = estimate.stick, estimate.stick.value
        known = (stick.mode >= 0) & (stick.mode < len(STICK_MODES))
        held = sample.valid & (sample.age <= self.stick_timeout) & known
        held = held & jnp.isfinite(stick.forward) & jnp.isfinite(stick.turn)

        def take(x: Any) -> Any:
            return jnp.where(held, jnp.clip(jnp.where(held, x, 0.0), -1.0, 1.0), 0.0)

        mode = jnp.where(held, stick.mode, state.mode).astype(np.int32)
        return _Hand(take(stick.forward), take(stick.turn), mode, ~held)

    def _begin_again(self, t: Any, state: PilotedState, mode: Any, s: Any) -> tuple[PilotedState, Any]:
        """Return the state at the start of a step, and the time (s) since the last step, zero after a restart."""
        gap = t - state.t
        goes_on = state.began & (gap >= 0) & (gap <= LONGEST_STEP) & (mode == state.mode) & (mode != MANUAL)
        backing = s.surge_velocity < 0
        slide = jnp.sqrt(s.surge_velocity**2 + s.sway_velocity**2)
        drift = jnp.arctan2(*_flip(backing, s.sway_velocity, s.surge_velocity))
        moves = slide > REVERSE_SPEED
        along = jnp.where(moves, jnp.where(backing, -slide, slide), 0.0)
        speed = jnp.where(mode == ASSISTED, along, jnp.where(mode == DAMPED, s.surge_velocity, 0.0))
        course = s.heading + jnp.where((mode == ASSISTED) & moves, drift, 0.0)
        anew = PilotedState(
            t=t,
            mode=mode,
            began=jnp.asarray(True),
            speed=speed,
            rate=jnp.where(mode == DAMPED, s.yaw_rate, 0.0),
            course=course,
            backing=jnp.asarray(False),
        )
        same = replace(state, t=t, mode=mode)
        return tree_where(goes_on, same, anew), jnp.where(goes_on, to_seconds(gap), 0.0)

    def _ramp_damped(self, s: PilotedState, hand: _Hand, dt: Any) -> PilotedState:
        """Return the references of surge velocity and yaw rate after dt (s)."""
        speed = _ramp(s.speed, hand.forward * self.surge_range, self.acceleration * dt)
        rate = _ramp(s.rate, hand.turn * self.yaw_range, self.yaw_acceleration * dt)
        return replace(s, speed=speed, rate=rate)

    def _drive_damped(self, reference: PilotedState, s: Any) -> PlanarForce:
        straight = jnp.maximum(1 - jnp.abs(reference.rate) / TURN_DEAD_ZONE, 0.0)
        backward = jnp.clip(-reference.speed / REVERSE_SPEED, 0.0, 1.0)
        weight = straight * (1 + backward * (REVERSE_SWAY - 1))
        slip = self.model.arm * (s.yaw_rate - reference.rate) - weight * s.sway_velocity
        return PlanarForce(FX=self.k1 * (reference.speed - s.surge_velocity), FY=self.k2 * slip)

    def _lead_course(self, before: PilotedState, hand: _Hand, dt: Any, s: Any) -> tuple[PilotedState, Any, Any]:
        """Return the references after dt (s), the demanded force in W (N; north, east), and the velocity error
        (m/s)."""
        c, n = jnp.cos(s.heading), jnp.sin(s.heading)
        side = s.sway_velocity + self.model.percussion_arm * s.yaw_rate
        velocity = jnp.stack([c * s.surge_velocity - n * side, n * s.surge_velocity + c * side])
        lag = _direction(before.course) * before.speed - velocity
        slack = jnp.clip(2 - 2 * jnp.sqrt(lag @ lag) / self.hold_error, 0.0, 1.0)
        wanted = hand.forward * self.speed_range
        speed = _ramp(before.speed, wanted, self.acceleration * dt * slack)
        most = self.turn_acceleration / jnp.maximum(jnp.abs(speed), REVERSE_SPEED)
        rate = jnp.clip(hand.turn * self.course_range, -most, most)
        rate = _ramp(before.rate, rate, self.course_acceleration * dt)
        rests = (speed == 0) & (wanted == 0)
        course = jnp.where(rests, s.heading, before.course + rate * slack * dt)
        now = replace(before, speed=speed, rate=rate, course=course)
        ahead, across = _direction(now.course), _direction(now.course + np.pi / 2)
        growth = jnp.where(dt > 0, (speed - before.speed) / jnp.where(dt > 0, dt, 1.0), 0.0)
        error = ahead * speed - velocity
        F = self.model.mass * (ahead * growth + across * (speed * rate * slack) + self.k * error)
        along, size = F @ ahead, jnp.sqrt(F @ F)
        most = size * jnp.minimum(size / self.nose_force, 1.0) * jnp.where(before.backing, *BACKING)
        backing = along < -most
        return replace(now, backing=backing), F, jnp.sqrt(error @ error)

    def _fly_assisted(self, reference: PilotedState, F: Any, s: Any) -> tuple[PlanarForce, Any]:
        """Return the demand (N), and the reference heading of the nose (rad)."""
        size = jnp.sqrt(F @ F)
        rest = self.nose_force * jnp.maximum(1 - size / (NOSE_FREE * self.nose_force), 0.0)
        share = jnp.maximum(1 - self.nose_dead_zone / jnp.where(size > 0, size, 1.0), 0.0)
        nose = share * jnp.where(reference.backing, -F, F) + rest * _direction(reference.course)
        known = nose @ nose > 0
        away = jnp.arctan2(jnp.where(known, nose[1], 0.0), jnp.where(known, nose[0], 1.0)) - s.heading
        away = jnp.where(known, wrap(away), 0.0)
        rate = jnp.clip(reference.rate + self.kh * away, -self.turn_rate, self.turn_rate)
        model = self.model
        FX = _direction(s.heading) @ F + model.mass * model.percussion_arm * s.yaw_rate**2
        FY = self.kr * (s.yaw_rate - rate) * model.inertia / model.arm
        force = PlanarForce(FX=jnp.clip(FX, -self.pull, self.push), FY=jnp.clip(FY, -self.swing, self.swing))
        return force, s.heading + away


def _flip(whether: Any, y: Any, x: Any) -> tuple[Any, Any]:
    return jnp.where(whether, -y, y), jnp.where(whether, -x, x)


def _direction(angle: Any) -> Any:
    """Return the unit vector (north, east) at an angle (rad) clockwise from north."""
    return jnp.stack([jnp.cos(angle), jnp.sin(angle)])


def _ramp(value: Any, wanted: Any, most: Any) -> Any:
    """Return `value`, moved towards the target value by at most `most`."""
    return value + jnp.clip(wanted - value, -most, most)
