"""Depth and heading autopilots of an underwater vehicle: successive loops for depth and pitch, PID for the heading."""

from typing import Any, ClassVar

import jax.numpy as jnp

from trimtab.core.record import Scalar, part, quantity, record, tree_where
from trimtab.core.signals import Estimate
from trimtab.laws.steering import Steering, SteeringState
from trimtab.vehicles.torpedo import CRUISE, TorpedoControls


@record
class DivingState:
    """What the autopilots remember. Source: Fossen, "Handbook", 2021, section 15.3."""

    began: Scalar = quantity("1", "Whether it has been asked before.", kind="flag")
    depth: Scalar = quantity("m", "The depth on the way to the one asked.", frame="W")
    depth_integral: Scalar = quantity("m s", "Of the depth's error.")
    pitch_integral: Scalar = quantity("rad s", "Of the pitch angle's error.")
    steering: SteeringState = part("Of the heading autopilot.")


@record
class DivingOutput:
    """What the autopilots ask for, and why. Source: Fossen, "Handbook", 2021, section 15.3."""

    demand: TorpedoControls = part("Fins and shaft.")
    depth_reference: Scalar = quantity("m", "The depth on the way to the one asked.", frame="W")
    depth_error: Scalar = quantity("m", "How much too deep.")
    pitch_asked: Scalar = quantity("rad", "By the depth loop.", kind="angle")
    heading_reference: Scalar = quantity("rad", "Of the heading autopilot.", kind="angle", frame="W")


@record
class Diving:
    """Holds depth and heading at a given shaft speed.

        z_r goes to the depth asked, no faster than `climb`
        theta_c = -asin(z_r'/U) + kz (z - z_r) + kzi integral,     |theta_c| <= steepest
        delta_s = (U0/U)^2 (kp (theta - theta_c) + kd q + ki integral)
        the rudder as in `Steering`

    The integrals find what buoyancy, propeller torque and a roll angle need; each stands still at its limit.

    Frames:  depth down, pitch nose up; positive stern planes push the tail up and the nose down, as SNAME has it.
    Valid:   small roll; above the speed at which the planes can hold the buoyancy.
    Source:  T. I. Fossen, "Handbook of marine craft hydrodynamics and motion control", 2nd ed., 2021, section 15.3
             (successive loop closure); gains are this project's.
    """

    reads: ClassVar[tuple[str, ...]] = ("depth", "pitch", "heading", "surge_velocity", "pitch_rate", "yaw_rate")

    depth: Scalar = quantity("m", "Wanted.", frame="W", default=5.0)
    heading: Scalar = quantity("rad", "Wanted.", kind="angle", default=0.0)
    shaft_speed: Scalar = quantity("rad/s", "Of the propeller, held.", default=CRUISE * 1750 / 1500, low=0)
    climb: Scalar = quantity("m/s", "Fastest change of depth.", default=0.25, above=0)
    kz: Scalar = quantity("rad/m", "Pitch per depth error.", default=0.2, low=0)
    kzi: Scalar = quantity("rad/(m s)", "Pitch per integral of it.", default=0.02, low=0)
    steepest: Scalar = quantity("rad", "Most pitch asked.", kind="angle", default=0.3, above=0)
    kp: Scalar = quantity("1", "Stern planes per pitch error.", default=1.0, low=0)
    kd: Scalar = quantity("s", "Stern planes per pitch rate.", default=1.4, low=0)
    ki: Scalar = quantity("1/s", "Stern planes per integral of the pitch error.", default=0.2, low=0)
    speed: Scalar = quantity("m/s", "U0, for which the gains are.", default=1.76, above=0)
    slowest: Scalar = quantity("m/s", "Speed below which they grow no more.", default=1.2, above=0)
    limit: Scalar = quantity("rad", "Most stern planes.", kind="angle", default=0.237, above=0)
    steering: Steering = part(
        "The heading autopilot.",
        default=Steering(kp=1.0, kd=1.3, ki=0.1, speed=1.76, slowest=1.2, limit=0.237, frequency=1.0, fastest=0.2),
    )

    def init(self, key: Any) -> DivingState:
        """Nothing asked yet."""
        zero = jnp.asarray(0.0)
        return DivingState(jnp.asarray(False), zero, zero, zero, self.steering.init())

    def step(self, t: Any, state: DivingState, estimate: Estimate) -> tuple[DivingState, DivingOutput]:
        """The demand at integer time t; nothing moves while the estimate is not valid."""
        x, dt = estimate.state, estimate.dt
        speed = jnp.maximum(x.surge_velocity, self.slowest)
        on_way = jnp.where(state.began, state.depth, x.depth)
        way = jnp.clip(self.depth - on_way, -self.climb * dt, self.climb * dt)
        reference = on_way + way
        e = x.depth - reference
        rise = jnp.arcsin(jnp.clip(way / (dt * speed), -0.9, 0.9))
        asked = self.kz * e + self.kzi * state.depth_integral - rise
        pitch = jnp.clip(asked, -self.steepest, self.steepest)
        off = x.pitch - pitch
        scale = (self.speed / speed) ** 2
        total = scale * (self.kp * off + self.kd * x.pitch_rate + self.ki * state.pitch_integral)
        stern = jnp.clip(total, -self.limit, self.limit)
        steering, rudder = self.steering.steer(
            state.steering, self.heading, x.heading, x.yaw_rate, x.surge_velocity, dt
        )
        new = DivingState(
            began=jnp.asarray(True),
            depth=reference,
            depth_integral=state.depth_integral + jnp.where(asked == pitch, dt * e, 0.0),
            pitch_integral=state.pitch_integral + jnp.where(total == stern, dt * off, 0.0),
            steering=steering,
        )
        output = DivingOutput(
            demand=TorpedoControls(rudder, stern, self.shaft_speed),
            depth_reference=reference,
            depth_error=e,
            pitch_asked=pitch,
            heading_reference=steering.heading,
        )
        return tree_where(estimate.valid, new, state), output
