"""Allocation of thrust and moments to n rotors, with limits and failed rotors, and the drive of the rotors.

[1] is E. J. J. Smeur, G. C. H. E. de Croon, Q. Chu, "Prioritized control allocation for quadrotors subject to
saturation", IMAV 2017.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.actuators.servo_pulse import ServoPulse, linear_pulse
from trimtab.core.box_least_squares import solve_box_least_squares
from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, imperfection, option, part, period, quantity, record, switch
from trimtab.core.rng import Key
from trimtab.core.signals import Sample
from trimtab.core.time import ms
from trimtab.vehicles.quadrotor import Multirotor, RotorDemand, RotorSpeeds

EFFORT = 1e-6
"""Weight of the rotor thrusts relative to the errors in the demand. As it is small, it only selects between solutions
with the same errors."""


@record
class RotorAllocation:
    """Allocation that computes the rotor thrusts closest to a demand, with priorities if the demand can't be met.

        minimise  |W (B T - v)|^2 + e |T - T0|^2    with  least <= T <= most,    T = 0 for a failed rotor

    T are the rotor thrusts, B T the thrust and moments of all rotors, and v the demanded thrust and moments, each
    divided by the maximum that half of the rotors can produce. W are the weights. T0 distributes the thrust evenly.
    Roll and pitch have priority over thrust, and thrust over yaw. If more than four rotors work, they share a demand in
    such proportions that each rotor stays within its limits.

    Frames:  B.
    Valid:   if 2 n + 2 steps of the active-set solver suffice; tests count the unsolved cases.
    Source:  [1] eqs. 11 to 17, with its weights of 1000, 1000, 1 for roll, pitch, yaw and 100 for thrust.
    """

    craft: Multirotor = part("Vehicle model whose rotors the allocation uses.", default=Multirotor())
    least: Scalar = quantity("N", "Minimum thrust of a working rotor, at idle.", default=0.3, low=0)
    most: Scalar = quantity("N", "Maximum thrust of a rotor.", default=30.0, above=0)
    weights: Any = quantity(
        "1",
        "Weights of the errors in thrust, and in the roll, pitch and yaw moments.",
        shape=(4,),
        default=np.array([100.0, 1000, 1000, 1]),
        above=0,
        source="[1] section IV",
    )

    def check(self) -> None:
        """Raise InputError unless the minimum thrust is below the maximum."""
        if float(self.least) >= float(self.most):
            problem = f"the minimum thrust of {float(self.least):g} N must be below the maximum, {float(self.most):g} N"
            raise InputError("least", problem, fix="give a minimum thrust between 0 and the maximum")

    def init(self, key: Key) -> tuple[()]:
        """Return an empty record, because this part has no state."""
        return ()

    def step(self, t: Any, state: tuple[()], demand: RotorDemand) -> tuple[tuple[()], RotorSpeeds]:
        """Return the commanded rotor speeds for a demand of thrust and moments."""
        return state, RotorSpeeds(self.craft.rotors.speeds(self.thrusts(demand)))

    def thrusts(self, demand: RotorDemand) -> Any:
        """Return the thrust of each rotor (N, shape (n,)) for a demand."""
        B = self.craft.rotors.effectiveness()
        n = B.shape[1]
        works = jnp.asarray(demand.working)
        reach = jnp.sum(jnp.abs(B), axis=1) / 2
        rows = B * jnp.where(works, 1.0, 0.0) / reach[:, None]
        v = jnp.concatenate([jnp.stack([jnp.asarray(demand.thrust, float)]), demand.moment]) / (reach * self.most)
        even = v[0] * reach[0] / jnp.maximum(jnp.sum(works), 1)
        W = (jnp.asarray(self.weights) / jnp.max(jnp.asarray(self.weights))) ** 2
        H = rows.T @ (W[:, None] * rows) + EFFORT**2 * jnp.eye(n)
        g = -rows.T @ (W * v) - EFFORT**2 * even
        low, high = jnp.where(works, self.least / self.most, 0.0), jnp.where(works, 1.0, 0.0)
        start = jnp.full(n, 1.0) * even
        return self.most * solve_box_least_squares(H, g, low, high, start, steps=2 * n + 2).x


@record
class RotorDriveOutput:
    """Output of the rotor drives. Source: this module."""

    u: RotorSpeeds = part("Commanded speeds of the rotors, before the rotors' lag in the vehicle model.")


@record
class RotorDrive:
    """Speed controllers of the rotors. They limit each commanded speed and round it to the resolution of the signal.

    Frames:  those of the vehicle.    Not modelled: battery, heat. The lag of the rotors is part of the vehicle model.
    Source:  docs page, Rotor allocation.
    """

    least: Scalar = quantity("rad/s", "Minimum speed of a rotor whose commanded speed is not 0.", default=40.0, low=0)
    most: Scalar = quantity("rad/s", "Maximum speed of a rotor.", default=615.0, above=0)
    resolution: Scalar = imperfection("rad/s", "Resolution of the commanded speeds.", "speed-steps", default=0.3)
    saturation: bool = switch("True: the commanded speeds are limited.", "saturation")
    count: int = option("Number of rotors.", default=4)
    period: int = period("Time step of the drive.", default=ms(5))

    def pulses(self) -> dict[str, ServoPulse]:
        """Return the pulse table of the rotor speeds, from zero to the maximum speed."""
        return {"speed": linear_pulse(0.0, self.most)}

    def neutral(self) -> RotorDriveOutput:
        """Return the output with all rotors at rest."""
        return RotorDriveOutput(RotorSpeeds(jnp.zeros(self.count)))

    def init(self, key: Key) -> tuple[()]:
        """Return an empty record, because this part has no state."""
        return ()

    def step(self, t: Any, state: tuple[()], command: Sample) -> tuple[tuple[()], RotorDriveOutput]:
        """Return the commanded speeds that act from integer time t on. Without a valid command they are 0."""
        speed = command.value.speed
        if self.saturation:
            told = speed != 0
            speed = jnp.where(told, jnp.clip(speed, self.least, self.most), 0.0)
        fine = self.resolution > 0
        step = jnp.where(fine, self.resolution, 1.0)
        speed = jnp.where(fine, jnp.round(speed / step) * step, speed)
        return state, RotorDriveOutput(RotorSpeeds(jnp.where(command.valid, speed, 0.0)))
