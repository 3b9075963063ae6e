"""Allocation of a planar force to a vectored fan; and direct actuation, where the demand acts as it is.

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
    """Demand to polar form, to rudder angle and speed.

        f = sign(FX) |F|    psi = -atan(FY/FX)
        theta = offset - ratio psi, kept between the stops    n = table(theta, f)

    The size of the force is kept where its direction is not possible: a demand across the vehicle comes out along it,
    at the rudder's stop, and its sign jumps with the sign of FX. With FX = 0 the fan turns forward. Up to the dead zone
    the speed is 0 while the rudder still follows. Demands the fan cannot reach end at its top speed.

    Without "lookup-table", and without "saturation" (where no table reaches), n comes from the thruster's formula; the
    drive does the same.

    Frames:  demand in B at the rudder pivot.
    Source:  [1] section 6.1, eqs. 4.3 and 4.4. Sign, dead zone on |F| and clipping before the table are reconstructed:
             docs page, Errata.
    """

    rudder: RudderServo = part("Servo of the rudder.", default=RudderServo())
    geometry: RudderGeometry = part("Rudder angle to force angle.", default=RudderGeometry())
    thruster: Thruster = part("The fan's formula.", default=Thruster())
    table: BilinearTable | None = part(
        "Speed by rudder angle and force, or None for the formula.",
        default=full_speed_table(Thruster()),
        off={"lookup-table": None},
    )
    dead_zone: Scalar = imperfection(
        "N", "Demands up to this size give no thrust.", "dead-zone", default=0.05, source="[1] 6.1"
    )
    saturation: bool = switch("Whether rudder and fan have limits.", "saturation")

    def check(self) -> None:
        """Refuse a table that is not the thruster's."""
        if self.table is not None:
            check_speed_table(self.table, self.thruster)

    def init(self, key: Key) -> tuple[()]:
        """No state."""
        return ()

    def step(self, t: Any, state: tuple[()], demand: PlanarForce) -> tuple[tuple[()], DriveCommand]:
        """Pulse and speed for a demand (N, in B)."""
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
    """Signed size (N), negative where FX is, and force angle psi (rad) in [-pi/2, pi/2]; (0, 0) for no force."""
    sign = jnp.where(force.FX < 0, -1.0, 1.0)
    square = force.FX**2 + force.FY**2
    some = square > 0
    size = jnp.where(some, jnp.sqrt(jnp.where(some, square, 1.0)), 0.0)
    return sign * size, jnp.arctan2(-sign * force.FY, jnp.where(some, abs(force.FX), 1.0))


@record
class DirectAllocation:
    """Sends the demand itself as the command. Frames: the demand's. Source: docs page, Direct."""

    def init(self, key: Key) -> tuple[()]:
        """No state."""
        return ()

    def step(self, t: Any, state: tuple[()], demand: Any) -> tuple[tuple[()], Any]:
        """The demand."""
        return state, demand


@record
class DirectOutput:
    """What acts on the vehicle. Frames: the input's. Source: docs page, Direct."""

    u: Any = part("The vehicle's input.")


@record
class DirectActuation:
    """Gives the commanded value to the vehicle at once; until there is one, the neutral input.

    Frames:  the input's.    Source:  docs page, Direct.
    """

    neutral_input: Any = part("Input without a command, a record like the command's.", default=PlanarForce(0.0, 0.0))
    period: int = period("How often the input changes.", default=ms(1))

    def neutral(self) -> DirectOutput:
        """The neutral input."""
        return DirectOutput(u=self.neutral_input)

    def init(self, key: Key) -> tuple[()]:
        """No state."""
        return ()

    def step(self, t: Any, state: tuple[()], command: Sample) -> tuple[tuple[()], DirectOutput]:
        """The command's value where it is valid."""
        return state, DirectOutput(u=tree_where(command.valid, command.value, self.neutral_input))
