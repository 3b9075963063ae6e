"""Allocation of a planar force to a vectored fan, and direct actuation, where the demand acts on the vehicle unchanged.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import jax.numpy as jnp

from trimtab.actuators.drive import DriveCommand
from trimtab.actuators.lookup import BilinearTable, check_speed_table, full_speed_table
from trimtab.actuators.rudder import RudderGeometry, RudderServo
from trimtab.actuators.thruster import Thruster
from trimtab.core.record import Scalar, imperfection, part, period, record, switch, tree_where
from trimtab.core.rng import Key
from trimtab.core.signals import PlanarForce, Sample
from trimtab.core.time import ms


@record
class ThrustVectorAllocation:
    """Allocation that converts a demanded force to polar form, and then to a rudder angle and a fan speed.

        f = sign(FX) |F|    psi = -atan(FY/FX)
        theta = offset - ratio psi, limited to the stops      n = table(theta, f)

    F = (FX, FY) is the demanded force, psi the force angle, theta the rudder angle and n the fan speed. If the rudder
    cannot reach the direction of the demand, the rudder goes to its stop and the magnitude of the force is kept. The
    thrust always has the sign of FX. With FX = 0 the fan turns forward. Within the dead zone the fan speed is 0, but
    the rudder still follows the demand. Demands above the fan's maximum thrust give the maximum fan speed.

    If the imperfection "lookup-table" or "saturation" is off, n is computed from the thruster's formula, as in the
    drive.

    Frames:  demand in B at the rudder pivot.
    Source:  [1] section 6.1, eqs. 4.3 and 4.4. Sign, dead zone on |F| and clipping before the table are reconstructed:
             docs page, Errata.
    """

    rudder: RudderServo = part("Servo of the rudder.", default=RudderServo())
    geometry: RudderGeometry = part("Relation between rudder angle and force angle.", default=RudderGeometry())
    thruster: Thruster = part("Model of the fan's thrust as a function of its speed.", default=Thruster())
    table: BilinearTable | None = part(
        "Table of the fan speed over rudder angle and force. None: use the thruster's formula.",
        default=full_speed_table(Thruster()),
        off={"lookup-table": None},
    )
    dead_zone: Scalar = imperfection(
        "N", "Largest demanded force for which the fan stays at rest.", "dead-zone", default=0.05, source="[1] 6.1"
    )
    saturation: bool = switch("True: the rudder angle and the fan speed are limited.", "saturation")

    def check(self) -> None:
        """Raise InputError if the table was computed from another thruster."""
        if self.table is not None:
            check_speed_table(self.table, self.thruster)

    def init(self, key: Key) -> tuple[()]:
        """Return an empty record, because this part has no state."""
        return ()

    def step(self, t: Any, state: tuple[()], demand: PlanarForce) -> tuple[tuple[()], DriveCommand]:
        """Return the rudder pulse and the fan speed for a demanded force (N, in B)."""
        force, psi = to_polar(demand)
        theta = self.geometry.rudder_angle(psi)
        if self.saturation:
            theta = self.rudder.limit_angle(theta)
        speed = jnp.where(abs(force) > self.dead_zone, self._speed(force, theta), 0.0)
        return state, DriveCommand(rudder_pulse=self.rudder.pulse(theta), speed_rpm=speed)

    def _speed(self, force: Any, rudder_angle: Any) -> Any:
        if self.table is not None and self.saturation:
            return self.table.at(rudder_angle, force)
        speed = self.thruster.speed_rpm(force, rudder_angle)
        limit = self.thruster.speed_max_rpm
        return jnp.clip(speed, -limit, limit) if self.saturation else speed


def to_polar(force: PlanarForce) -> tuple[Any, Any]:
    """Return the magnitude (N) of a force, with the sign of FX, and the force's angle psi (rad) in [-pi/2, pi/2].

    For a zero force, both are 0.
    """
    sign = jnp.where(force.FX < 0, -1.0, 1.0)
    square = force.FX**2 + force.FY**2
    some = square > 0
    size = jnp.where(some, jnp.sqrt(jnp.where(some, square, 1.0)), 0.0)
    return sign * size, jnp.arctan2(-sign * force.FY, jnp.where(some, abs(force.FX), 1.0))


@record
class DirectAllocation:
    """Allocation that sends the demand unchanged as the command.

    Frames:  those of the demand.
    Source:  docs page, Direct.
    """

    def init(self, key: Key) -> tuple[()]:
        """Return an empty record, because this part has no state."""
        return ()

    def step(self, t: Any, state: tuple[()], demand: Any) -> tuple[tuple[()], Any]:
        """Return the demand as the command."""
        return state, demand


@record
class DirectOutput:
    """Output of `DirectActuation`. Frames: those of the vehicle's input. Source: docs page, Direct."""

    u: Any = part("Input of the vehicle, e.g. its force.")


@record
class DirectActuation:
    """Actuators that apply a valid command without delay. Without a valid command, the actuators apply the neutral
    input.

    Frames:  those of the vehicle's input.    Source:  docs page, Direct.
    """

    neutral_input: Any = part(
        "Neutral input of the vehicle, used without a valid command. It is a record of the same class as the command.",
        default=PlanarForce(0.0, 0.0),
    )
    period: int = period("Period at which the input of the vehicle is updated.", default=ms(1))

    def neutral(self) -> DirectOutput:
        """Return the neutral input."""
        return DirectOutput(u=self.neutral_input)

    def init(self, key: Key) -> tuple[()]:
        """Return an empty record, because this part has no state."""
        return ()

    def step(self, t: Any, state: tuple[()], command: Sample) -> tuple[tuple[()], DirectOutput]:
        """Return the value of the command if the command is valid, else the neutral input."""
        return state, DirectOutput(u=tree_where(command.valid, command.value, self.neutral_input))
