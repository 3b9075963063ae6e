"""Depth and heading autopilots of an underwater vehicle: nested loops for depth and pitch, PID for the heading."""

from typing import Any, ClassVar

import jax.numpy as jnp

from trimtab.core.record import Scalar, part, quantity, record, tree_where
from trimtab.core.signals import Estimate
from trimtab.laws.steering import Steering, SteeringState
from trimtab.vehicles.torpedo import CRUISE, TorpedoControls


@record
class DivingState:
    """State of the depth and heading autopilots. Source: Fossen, "Handbook", 2021, section 15.3."""

    began: Scalar = quantity("1", "True after the first step.", kind="flag")
    depth: Scalar = quantity("m", "Depth reference, which moves to the commanded depth at a limited rate.", frame="W")
    depth_integral: Scalar = quantity("m s", "Integral of the depth error.")
    pitch_integral: Scalar = quantity("rad s", "Integral of the pitch error.")
    steering: SteeringState = part("State of the heading autopilot.")


@record
class DivingOutput:
    """Demand and signals of the depth and heading autopilots. Source: Fossen, "Handbook", 2021, section 15.3."""

    demand: TorpedoControls = part("Demanded fin angles and shaft speed.")
    depth_reference: Scalar = quantity(
        "m", "Depth reference, which moves to the commanded depth at a limited rate.", frame="W"
    )
    depth_error: Scalar = quantity("m", "Depth error: depth minus reference, positive when too deep.")
    pitch_command: Scalar = quantity("rad", "Pitch angle commanded by the depth loop.", kind="angle")
    heading_reference: Scalar = quantity(
        "rad", "Heading of the heading autopilot's reference model.", kind="angle", frame="W"
    )


@record
class Diving:
    """Depth and heading autopilots at a given shaft speed.

        z_r moves to the commanded depth at a rate of at most `climb`
        theta_c = -asin(z_r'/U) + kz (z - z_r) + kzi integral,     |theta_c| <= steepest
        delta_s = (U0/U)^2 (kp (theta - theta_c) + kd q + ki integral)
        rudder: as in `Steering`

    z is the depth, z_r the depth reference, theta the pitch angle, q the pitch rate, U the speed through the water and
    delta_s the stern plane angle. The integrals compensate buoyancy, propeller torque and a roll angle. Each integral
    is held while its output is limited.

    Frames:  depth down, pitch nose up; positive stern planes push the tail up and the nose down, as in SNAME notation.
    Valid:   small roll; above the speed at which the planes can hold the buoyancy.
    Source:  T. I. Fossen, "Handbook of marine craft hydrodynamics and motion control", 2nd ed., 2021, section 15.3
             (successive loop closure). The gains are our own choice.
    """

    reads: ClassVar[tuple[str, ...]] = ("depth", "pitch", "heading", "surge_velocity", "pitch_rate", "yaw_rate")

    depth: Scalar = quantity("m", "Commanded depth.", frame="W", default=5.0)
    heading: Scalar = quantity("rad", "Commanded heading.", kind="angle", default=0.0)
    shaft_speed: Scalar = quantity(
        "rad/s", "Speed of the propeller shaft, held constant.", default=CRUISE * 1750 / 1500, low=0
    )
    climb: Scalar = quantity("m/s", "Maximum rate of the depth reference.", default=0.25, above=0)
    kz: Scalar = quantity("rad/m", "Gain of the depth loop: commanded pitch angle per depth error.", default=0.2, low=0)
    kzi: Scalar = quantity(
        "rad/(m s)",
        "Integral gain of the depth loop: commanded pitch angle per integral of the depth error.",
        default=0.02,
        low=0,
    )
    steepest: Scalar = quantity("rad", "Maximum commanded pitch angle.", kind="angle", default=0.3, above=0)
    kp: Scalar = quantity(
        "1", "Proportional gain of the pitch loop: stern plane angle per pitch error.", default=1.0, low=0
    )
    kd: Scalar = quantity("s", "Rate gain of the pitch loop: stern plane angle per pitch rate.", default=1.4, low=0)
    ki: Scalar = quantity(
        "1/s", "Integral gain of the pitch loop: stern plane angle per integral of the pitch error.", default=0.2, low=0
    )
    speed: Scalar = quantity("m/s", "Speed U0 through the water for which the gains are tuned.", default=1.76, above=0)
    slowest: Scalar = quantity(
        "m/s", "Speed through the water below which the gains are not increased further.", default=1.2, above=0
    )
    limit: Scalar = quantity("rad", "Maximum stern plane angle.", kind="angle", default=0.237, above=0)
    steering: Steering = part(
        "Heading autopilot.",
        default=Steering(kp=1.0, kd=1.3, ki=0.1, speed=1.76, slowest=1.2, limit=0.237, frequency=1.0, fastest=0.2),
    )

    def init(self, key: Any) -> DivingState:
        """Return the initial state, before any command."""
        zero = jnp.asarray(0.0)
        return DivingState(jnp.asarray(False), zero, zero, zero, self.steering.init())

    def step(self, t: Any, state: DivingState, estimate: Estimate) -> tuple[DivingState, DivingOutput]:
        """Return the demand at time t (unit: 100 ns). Demand and state are held while the estimate is not valid."""
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
            pitch_command=pitch,
            heading_reference=steering.heading,
        )
        return tree_where(estimate.valid, new, state), output
