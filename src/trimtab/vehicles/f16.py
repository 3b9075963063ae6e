"""F-16 below Mach 0.6 in six degrees of freedom over the rotating earth, with tables from wind tunnel tests."""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.rotation import DEG
from trimtab.core.signals import Gust, Motion
from trimtab.vehicles import f16_tables as tables
from trimtab.vehicles.imperial import FOOT, POUND_FORCE, SLUG
from trimtab.vehicles.rigid_body import Airflow, FlightCondition, RigidBody, RigidBodyState, Wrench

AREA, SPAN, CHORD = 300 * FOOT**2, 30 * FOOT, 11.32 * FOOT
REFERENCE = 0.35
"""Distance of the reference point of the moments behind the leading edge of the chord (chord lengths)."""
INERTIA = SLUG * FOOT**2
EVERY_BETA = np.concatenate([-tables.SIZE_OF_BETA[:0:-1], tables.SIZE_OF_BETA])
_OVER_ELEVATOR = np.stack([tables.CX, tables.CM], axis=-1)
_OVER_EVERY_BETA = np.stack([np.concatenate([-t[:0:-1], t]) for t in (tables.CL, tables.CN)], axis=-1)
"""Roll and yaw coefficients over signed sideslip. With the sign, the coefficients have a slope at zero sideslip."""
_OVER_BETA = np.stack([tables.CL_AILERON, tables.CL_RUDDER, tables.CN_AILERON, tables.CN_RUDDER], axis=-1)
_OVER_ALPHA = np.stack([tables.CZ, *tables.DAMPING.values()], axis=-1)
_THRUST = np.stack([tables.IDLE, tables.MILITARY, tables.MAXIMUM], axis=-1) * POUND_FORCE
MILITARY = 0.5
"""Throttle above which the afterburner is on."""


@record
class F16Controls:
    """Control surface angles and throttle of the F-16. Source: F16_aero.dml and F16_prop.dml of NASA/TM-2015-218675."""

    elevator: Scalar = quantity("rad", "Elevator angle, trailing edge down.", kind="angle")
    aileron: Scalar = quantity("rad", "Aileron angle; positive rolls to the left.", kind="angle")
    rudder: Scalar = quantity("rad", "Rudder angle, trailing edge left.", kind="angle")
    throttle: Scalar = quantity("1", "Throttle: 0 idle, 0.5 military power, 1 full afterburner.")


@record
class F16:
    """F-16 with the tables of Stevens and Lewis. The engine follows the throttle without lag.

        F = q S (CX, CY, CZ) + (T, 0, 0)        M = q S (b Cl, c Cm, b Cn) + (r_ref - r_cm) × F

    Coefficients are interpolated over angle of attack and sideslip or elevator angle, thrust over Mach number and
    altitude. Interpolation is bilinear, and constant beyond the ends of the tables. Only the thrust is
    extrapolated, down to 10 000 ft below sea level; the book's program extrapolates there too.

    Frames:  as in `RigidBody`; x forward from the centre of mass.
    Valid:   angle of attack -10 to 45 degrees, sideslip within 30 degrees, up to Mach 0.6. Not modelled: lag of engine
             and actuators, angular momentum of the engine, the leading-edge flap, compressibility.
    Source:  Stevens, Lewis, Johnson, "Aircraft control and simulation", 3rd ed., appendix A; F16_aero.dml, F16_prop.dml
             and F16_inertia.dml of NASA/TM-2015-218675.
    """

    body: RigidBody = part(
        "Rigid body of the aeroplane: mass, inertia, earth and wind.",
        default=RigidBody(
            mass=637.1595 * SLUG,
            inertia=np.array([9496.0, 55814.0, 63100.0]) * INERTIA,
            products=np.array([0.0, 0.0, 982.0]) * INERTIA,
        ),
    )
    centre: Scalar = quantity(
        "1", "Distance of the centre of mass behind the leading edge (chord lengths).", default=0.25, low=0.1, high=0.4
    )

    MAV_TYPE: ClassVar[str] = "FIXED_WING"
    """Vehicle type reported to ground stations: a name in `vehicle_type.VehicleType`."""

    def in_gust(self, gust: Gust) -> "F16":
        """Return the aeroplane with this gust added to the wind."""
        return replace(self, body=self.body.in_gust(gust))

    def flight(self, t: Any, x: RigidBodyState) -> FlightCondition:
        """Return the flight state at time t (s): latitude, longitude, height, velocity, angles and airflow."""
        return self.body.flight(t, x)

    def dynamics(self, t: Any, x: RigidBodyState, u: F16Controls) -> RigidBodyState:
        """Return the time derivative of the state x at time t (s)."""
        return self.body.dynamics(t, x, self.wrench(self.flight(t, x), u))

    def motion(self, t: Any, x: RigidBodyState, u: F16Controls) -> Motion:
        """Return the motion of the centre of mass at time t (unit: 100 ns), for sensors."""
        return self.body.motion(t, x, self.wrench(self.flight(t * 1e-7, x), u))

    def wrench(self, flight: FlightCondition, u: F16Controls) -> Wrench:
        """Return force and moment of air and engine together, about the centre of mass."""
        air = self.air_wrench(flight.flow, u)
        thrust = engine_thrust(u.throttle, flight.flow.mach, flight.height)
        return Wrench(air.force + jnp.stack([thrust, 0 * thrust, 0 * thrust]), air.moment)

    def air_wrench(self, flow: Airflow, u: F16Controls) -> Wrench:
        """Return force and moment of the air alone, about the centre of mass."""
        C = coefficients(flow, u)
        qS = flow.pressure * AREA
        force = qS * C[:3]
        arm = (self.centre - REFERENCE) * CHORD  # from the centre of mass to the reference point, forward
        moment = qS * C[3:] * jnp.array([SPAN, CHORD, SPAN]) + jnp.stack([0 * arm, -arm * force[2], arm * force[1]])
        return Wrench(force, moment)


def flow_angles(flow: Airflow) -> tuple[Any, Any]:
    """Return angle of attack and sideslip (rad)."""
    u, v, w = flow.velocity
    return jnp.arctan2(w, u), jnp.arcsin(jnp.clip(v / jnp.maximum(flow.speed, 1e-9), -1, 1))


def coefficients(flow: Airflow, u: F16Controls) -> Any:
    """Return the coefficients CX, CY, CZ, Cl, Cm, Cn (6,) about the reference point."""
    alpha, beta = flow_angles(flow)
    a, b = alpha / DEG, beta / DEG
    elevator, aileron, rudder = u.elevator / DEG, u.aileron / (20 * DEG), u.rudder / (30 * DEG)
    twice = 2 * jnp.maximum(flow.speed, 1e-9)
    p, q, r = flow.rate * jnp.array([SPAN, CHORD, SPAN]) / twice
    CZ, CXq, CYr, CYp, CZq, Clr, Clp, Cmq, Cnr, Cnp = interpolate_line(a, tables.ALPHA, _OVER_ALPHA)
    CX, Cm = interpolate_plane(elevator, a, tables.ELEVATOR, tables.ALPHA, _OVER_ELEVATOR)
    Cl, Cn = interpolate_plane(b, a, EVERY_BETA, tables.ALPHA, _OVER_EVERY_BETA)
    Cl_a, Cl_r, Cn_a, Cn_r = interpolate_plane(b, a, tables.BETA, tables.ALPHA, _OVER_BETA)
    CX = CX + CXq * q
    CY = -0.02 * b + 0.021 * aileron + 0.086 * rudder + CYp * p + CYr * r
    CZ = CZ * (1 - beta**2) - 0.19 * elevator / 25 + CZq * q
    Cl = Cl + Cl_a * aileron + Cl_r * rudder + Clp * p + Clr * r
    Cm = Cm + Cmq * q
    Cn = Cn + Cn_a * aileron + Cn_r * rudder + Cnp * p + Cnr * r
    return jnp.stack([CX, CY, CZ, Cl, Cm, Cn])


def engine_thrust(throttle: Any, mach: Any, height: Any) -> Any:
    """Return thrust (N) at a throttle, a Mach number and a height (m)."""
    idle, military, maximum = interpolate_plane(mach, height / FOOT, tables.MACH, tables.ALTITUDE, _THRUST, below=1.0)
    dry = idle + (military - idle) * throttle / MILITARY
    wet = military + (maximum - military) * (throttle - MILITARY) / (1 - MILITARY)
    return jnp.where(throttle < MILITARY, dry, wet)


def interpolate_line(x: Any, grid: Any, values: Any) -> Any:
    """Interpolate values (n, k) on a uniform grid at x: linear inside, constant outside. Return an array (k,)."""
    i, part = _cell(x, grid)
    ends = lax.dynamic_slice(jnp.asarray(values), (i, np.uint32(0)), (2, values.shape[1]))
    return ends[0] * (1 - part) + ends[1] * part


def interpolate_plane(y: Any, x: Any, rows: Any, columns: Any, values: Any, below: float = 0.0) -> Any:
    """Interpolate values (rows, columns, k) on a uniform grid at y, x: bilinear inside, constant outside.

    Return an array (k,). below: number of cells by which x is extrapolated below the first column.
    """
    i, up = _cell(y, rows)
    j, along = _cell(x, columns, below)
    corners = lax.dynamic_slice(jnp.asarray(values), (i, j, np.uint32(0)), (2, 2, values.shape[2]))
    ends = corners[:, 0] * (1 - along) + corners[:, 1] * along
    return ends[0] * (1 - up) + ends[1] * up


def _cell(x: Any, grid: Any, below: float = 0.0) -> tuple[Any, Any]:
    """Return the index of the cell of a uniform grid that contains a point, and the position in the cell, 0 to 1.

    A point up to `below` cells below the grid belongs to the first cell, at a negative position.
    """
    place = jnp.clip((x - grid[0]) / (grid[1] - grid[0]), -below, len(grid) - 1.0)
    i = jnp.clip(jnp.floor(place), 0, len(grid) - 2).astype(np.uint32)
    return i, place - i
