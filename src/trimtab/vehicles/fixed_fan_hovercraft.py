"""Planar hovercraft with any number of fixed fans, each with a fixed direction of force."""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, quantity, record
from trimtab.core.signals import Motion
from trimtab.vehicles.hovercraft import HovercraftState, planar_motion, planar_rates


@record
class FanThrottles:
    """Commands of the fans. Source: this module."""

    throttle: Any = quantity(
        "1", "Throttle of each fan (n,), limited to the range from 0 (at rest) to 1.", default=np.zeros(2)
    )


@record
class FixedFanHovercraft:
    """Planar hovercraft with fans fixed in the hull, each with a measured thrust curve.

        T_i = a_i c_i + b_i c_i²,   c_i = throttle_i limited to [0, 1]
        FX = sum(T_i cos g_i)    FY = sum(T_i sin g_i)    N = sum(x_i T_i sin g_i - y_i T_i cos g_i)
        u' =  v r + (FX - (d1 + d2 |u|) u)/m       v' = -u r + (FY - (e1 + e2 |v|) v)/m
        r' = (N - (f1 + f2 |r|) r)/J               pose as in `hovercraft.Hovercraft`

    T_i is the thrust of fan i, g_i the direction of this thrust, and (x_i, y_i) the position of the fan. u, v and r are
    surge velocity, sway velocity and yaw rate. The default has two fans side by side that push forward. A difference of
    the two thrusts turns the craft, and no fan pushes the craft sideways.

    Frames:  W north-east-down, B at the centre of mass, x forward, y starboard; g clockwise from the x axis.
    Valid:   level floor.    Not modelled: lag and inflow of the fans, dry friction, coupled damping.
    Source:  Fossen, "Handbook of marine craft hydrodynamics and motion control", 2011, sections 7.3 (three degrees of
             freedom, diagonal damping) and 12.3 (fixed thrusters).
    """

    mass: Scalar = quantity("kg", "Total mass.", default=1.5, above=0)
    inertia: Scalar = quantity("kg m^2", "Moment of inertia about z.", default=0.04, above=0)
    fan_place: Any = quantity(
        "m", "Position x and y of each fan in B (n, 2).", frame="B", default=np.array([[-0.2, -0.1], [-0.2, 0.1]])
    )
    fan_direction: Any = quantity(
        "rad",
        "Direction in which each fan pushes the hull (n,), clockwise from the x axis.",
        frame="B",
        default=np.zeros(2),
    )
    thrust_linear: Any = quantity(
        "N", "Coefficient a of each fan (n,): thrust per throttle.", default=np.array([0.2, 0.2])
    )
    thrust_quadratic: Any = quantity(
        "N", "Coefficient b of each fan (n,): thrust per throttle squared.", default=np.array([0.6, 0.6])
    )
    surge_damping: Scalar = quantity("N s/m", "Coefficient d1: drag per forward speed.", default=0.2, low=0)
    sway_damping: Scalar = quantity("N s/m", "Coefficient e1: drag per lateral speed.", default=0.3, low=0)
    yaw_damping: Scalar = quantity("N m s", "Coefficient f1: torque per yaw rate.", default=0.02, low=0)
    surge_damping_quadratic: Scalar = quantity(
        "N s^2/m^2", "Coefficient d2: drag per forward speed squared.", default=0.1, low=0
    )
    sway_damping_quadratic: Scalar = quantity(
        "N s^2/m^2", "Coefficient e2: drag per lateral speed squared.", default=0.2, low=0
    )
    yaw_damping_quadratic: Scalar = quantity(
        "N m s^2", "Coefficient f2: torque per yaw rate squared.", default=0.005, low=0
    )

    MAV_TYPE: ClassVar[str] = "SURFACE_BOAT"
    """Vehicle type reported to ground stations: a name in `vehicle_type.VehicleType`."""

    def check(self) -> None:
        """Raise InputError unless every fan has a position, a direction and both coefficients of its thrust curve."""
        n = np.shape(self.fan_direction)[0] if np.ndim(self.fan_direction) == 1 else -1
        shapes = {"fan_place": (n, 2), "thrust_linear": (n,), "thrust_quadratic": (n,)}
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                problem = (
                    f"the array has shape {np.shape(getattr(self, name))}, but {n} fan directions need shape {shape}"
                )
                raise InputError(
                    name, problem, fix="give each fan a position, a direction and both coefficients of its thrust curve"
                )

    def wrench(self, u: FanThrottles) -> tuple[Any, Any, Any]:
        """Return force along x and y (N) and torque about z (N m) of all fans."""
        c = jnp.clip(jnp.asarray(u.throttle), 0.0, 1.0)
        thrust = (self.thrust_linear + self.thrust_quadratic * c) * c
        X, Y = thrust * jnp.cos(self.fan_direction), thrust * jnp.sin(self.fan_direction)
        place = jnp.asarray(self.fan_place)
        return jnp.sum(X), jnp.sum(Y), jnp.sum(place[:, 0] * Y - place[:, 1] * X)

    def accelerations(self, x: HovercraftState, u: FanThrottles) -> tuple[Any, Any, Any]:
        """Return the acceleration of the centre of mass in W, resolved in B (x, y, m/s^2), and the yaw acceleration
        (rad/s^2)."""
        X, Y, N = self.wrench(u)
        s, w, r = x.surge_velocity, x.sway_velocity, x.yaw_rate
        X = X - (self.surge_damping + self.surge_damping_quadratic * jnp.abs(s)) * s
        Y = Y - (self.sway_damping + self.sway_damping_quadratic * jnp.abs(w)) * w
        N = N - (self.yaw_damping + self.yaw_damping_quadratic * jnp.abs(r)) * r
        return X / self.mass, Y / self.mass, N / self.inertia

    def dynamics(self, t: Any, x: HovercraftState, u: FanThrottles) -> HovercraftState:
        """Return the time derivative of the state x (SI) under the throttles u."""
        return planar_rates(x, *self.accelerations(x, u))

    def motion(self, t: Any, x: HovercraftState, u: FanThrottles) -> Motion:
        """Return the motion of the vehicle at time t (unit: 100 ns), for sensors."""
        return planar_motion(t, x, *self.accelerations(x, u))
