"""Heading autopilot of a craft with a rudder: a reference model, and PID control of the deviation from it."""

from typing import Any

import jax.numpy as jnp

from trimtab.core.record import Scalar, quantity, record, tree_where
from trimtab.core.rotation import wrap


@record
class SteeringState:
    """State of the heading autopilot. Source: Fossen, "Handbook", 2021, section 15.3."""

    began: Scalar = quantity("1", "True after the first step.", kind="flag", default=False)
    heading: Scalar = quantity("rad", "Heading of the reference model.", kind="angle", default=0.0)
    yaw_rate: Scalar = quantity("rad/s", "Yaw rate of the reference model.", default=0.0)
    integral: Scalar = quantity("rad s", "Integral of the heading error.", default=0.0)


@record
class Steering:
    """Heading autopilot that turns a craft with the rudder, along a smooth reference.

        psi_d' = r_d,   r_d' = w^2 (psi_c - psi_d) - 2 z w r_d,   |r_d| <= fastest        psi_c: commanded
        delta = (U0/U)^2 (kp e + kd (r - r_d) + ki integral of e)          e = psi - psi_d, wrapped to ±pi

    psi is the heading, r the yaw rate, delta the rudder angle and U the speed. The rudder force grows with the square
    of the speed, so the gains are divided by that square. Below the speed `slowest` the gains stay constant, because
    the propeller still drives water past the rudder. The integral is held while the rudder is at its limit.

    Frames:  positive rudder pushes the stern to starboard and turns to port, as in SNAME notation.
    Valid:   also for a craft that is unstable in yaw, if kd is large enough.
    Source:  T. I. Fossen, "Handbook of marine craft hydrodynamics and motion control", 2nd ed., 2021, section 15.3.
    """

    kp: Scalar = quantity("1", "Proportional gain: rudder angle per heading error.", default=1.0, low=0)
    kd: Scalar = quantity("s", "Rate gain: rudder angle per yaw rate error.", default=0.9, low=0)
    ki: Scalar = quantity("1/s", "Integral gain: rudder angle per integral of the heading error.", default=0.05, low=0)
    speed: Scalar = quantity("m/s", "Speed U0 through the water for which the gains are tuned.", default=0.58, above=0)
    slowest: Scalar = quantity(
        "m/s", "Speed through the water below which the gains are not increased further.", default=0.58, above=0
    )
    limit: Scalar = quantity("rad", "Maximum rudder angle.", kind="angle", default=0.6, above=0)
    frequency: Scalar = quantity("rad/s", "Natural frequency w of the reference model.", default=2.0, above=0)
    damping: Scalar = quantity("1", "Damping ratio z of the reference model.", default=1.0, above=0)
    fastest: Scalar = quantity("rad/s", "Maximum yaw rate of the reference model.", default=0.35, above=0)

    def init(self) -> SteeringState:
        """Return the initial state, before any command."""
        return SteeringState(jnp.asarray(False), jnp.asarray(0.0), jnp.asarray(0.0), jnp.asarray(0.0))

    def steer(
        self, state: SteeringState, asked: Any, heading: Any, yaw_rate: Any, speed: Any, dt: Any
    ) -> tuple[SteeringState, Any]:
        """Return the next state, and the rudder angle (rad) for a commanded heading.

        Args:
            state: state from the previous step.
            asked: commanded heading (rad).
            heading: estimated heading (rad).
            yaw_rate: estimated yaw rate (rad/s).
            speed: estimated forward speed through the water (m/s).
            dt: time since the previous step (s).
        """
        first = SteeringState(jnp.asarray(True), heading, yaw_rate, jnp.zeros_like(heading))
        s = tree_where(state.began, state, first)
        w = self.frequency
        turn = s.yaw_rate + dt * (w**2 * wrap(asked - s.heading) - 2 * self.damping * w * s.yaw_rate)
        turn = jnp.clip(turn, -self.fastest, self.fastest)
        wanted = s.heading + dt * turn
        e = wrap(heading - wanted)
        scale = (self.speed / jnp.maximum(speed, self.slowest)) ** 2
        total = scale * (self.kp * e + self.kd * (yaw_rate - turn) + self.ki * s.integral)
        rudder = jnp.clip(total, -self.limit, self.limit)
        integral = s.integral + jnp.where(jnp.abs(total) < self.limit, dt * e, 0.0)
        return SteeringState(jnp.asarray(True), wanted, turn, integral), rudder
