"""Air-breathing hypersonic vehicle in the vertical plane with two bending modes. Units are slug, foot and second, as
published."""

from typing import Any, ClassVar

import jax.numpy as jnp

from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.signals import NO_GUST, Bending, Gust, Motion, SurroundingAir
from trimtab.vehicles.hypersonic_aerodynamics import FlexibleModes, Forces, RigidForces
from trimtab.vehicles.imperial import FOOT

STANDARD_GRAVITY = 1.39e16 / (20903500.0 + 85000.0) ** 2
"""Acceleration of gravity at 85000 ft, 31.5538 ft/s^2."""


@record
class HypersonicState:
    """State of the hypersonic vehicle: flight in the vertical plane, and two bending modes.

    Frames:  path angle gamma = theta - alpha, from the horizon.

    The unit of the modal displacements follows from mass-normalised modes: the kinetic energy per width is eta'^2/2.

    Source: [1] eq. 1, x = (h, V, alpha, theta, Q, eta1, eta1', eta2, eta2').
    """

    h: Scalar = quantity("ft", "Altitude.", frame="W")
    V: Scalar = quantity("ft/s", "Speed along the path.")
    alpha: Scalar = quantity("rad", "Angle of attack.", kind="angle")
    theta: Scalar = quantity("rad", "Pitch angle.", frame="W", kind="angle")
    q: Scalar = quantity("rad/s", "Pitch rate, nose up; Q in [1].", frame="B")
    eta1: Scalar = quantity("(slug ft)^1/2", "Modal displacement of bending mode 1.")
    eta1_rate: Scalar = quantity("(slug ft)^1/2/s", "Rate of the modal displacement of bending mode 1.")
    eta2: Scalar = quantity("(slug ft)^1/2", "Modal displacement of bending mode 2.")
    eta2_rate: Scalar = quantity("(slug ft)^1/2/s", "Rate of the modal displacement of bending mode 2.")


@record
class HypersonicInput:
    """Inputs of the hypersonic vehicle: engine and elevator. Source: [1] eq. 2, u = (Phi, delta_e)."""

    Phi: Scalar = quantity("1", "Fuel equivalence ratio.")
    delta_e: Scalar = quantity("rad", "Elevator angle, trailing edge down.", kind="angle")


@record
class Disturbance:
    """Disturbance by external forces and a moment, constant from `start` for `duration`: a gust, a step or an impulse.

    The moment is added to M, so it excites the bending modes too. The forces are added to m V' and m V gamma'.

    Source: named as further work in [1]. The user chooses the sizes.
    """

    moment: Scalar = quantity("lbf ft/ft", "Disturbance moment added to the pitching moment.", default=0.0)
    along: Scalar = quantity("lbf/ft", "Disturbance force along the flight path, positive forward.", default=0.0)
    normal: Scalar = quantity("lbf/ft", "Disturbance force normal to the flight path, positive up.", default=0.0)
    start: Scalar = quantity("s", "Start of the disturbance.", default=0.0)
    duration: Scalar = quantity(
        "s", "Duration of the disturbance. The default is a permanent step.", default=1e9, low=0
    )

    def activation(self, t: Any) -> Any:
        """Return 1.0 while the disturbance acts at time t (s), else 0.0.

        The end of the disturbance is excluded, so a sampled impulse keeps its size.
        """
        since = t - self.start + 1e-9
        return jnp.where((since >= 0) & (since < self.duration), 1.0, 0.0)


@record
class Hypersonic:
    """Air-breathing hypersonic vehicle in the vertical plane with two bending modes.

        h'     = V sin gamma                                              gamma = theta - alpha
        V'     = (T cos alpha - D)/m - g sin gamma
        alpha' = Q - gamma'        gamma' = (T sin alpha + L)/(m V) - (g/V) cos gamma
        theta' = Q                 Q', eta1'', eta2'': part `modes`, solved together          [1, eqs. 1-3]

    h is the altitude, V the speed, gamma the path angle, alpha the angle of attack, theta the pitch angle and Q the
    pitch rate. T, L and D are thrust, lift and drag. In a gust the forces follow from airspeed and angle of attack
    relative to the moving air, and lift and drag act along the axes of this flow.

    Forces, moment, mass and inertia are per foot of width. With altitude and speed as outputs the vehicle is
    non-minimum phase.

    Frames:  W north-east-down, B at the centre of mass, x forward, y starboard; pitch is nose up.
    Valid:   near 85 000 ft and 7 700 ft/s (about 80-95 kft, 7-9 kft/s, alpha 0-4 deg), where the curves were fitted.
    Not modelled: round earth, mean wind, angular rates of a gust, delay of a gust from nose to tail, aerodynamic
             effects of the bending, lags of engine and elevator.
    Source:  [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic
             flight vehicle", Aerospace 2022, 9(4), 206; [2] Parker et al., Journal of Guidance, Control, and Dynamics
             30(3), 2007. Differences from [1]: docs page.
    """

    m: Scalar = quantity("slug/ft", "Mass per foot of width.", default=300.0, above=0, source="[1], [2]")
    Iyy: Scalar = quantity(
        "slug ft^2/ft", "Moment of inertia in pitch per foot of width.", default=5e5, above=0, source="[2]"
    )
    g: Scalar = quantity(
        "ft/s^2", "Acceleration of gravity.", default=STANDARD_GRAVITY, source="reconstructed from [1]'s printed A"
    )
    forces: RigidForces = part("Models of air density, aerodynamics and propulsion.", default=RigidForces())
    modes: FlexibleModes = part("Bending modes and their coupling.", default=FlexibleModes())
    disturbance: Any = part("External disturbance; None: no disturbance.", default=None)
    gust: Any = part("Gust added to still air. A world with turbulence sets this field. None: no gust.", default=None)

    MAV_TYPE: ClassVar[str] = "FIXED_WING"
    """Vehicle type reported to ground stations: a name in `vehicle_type.VehicleType`."""

    def dynamics(self, t: Any, x: HypersonicState, u: HypersonicInput) -> HypersonicState:
        """Return the time derivative of the state x at time t (s) under fuel ratio and elevator."""
        V_rate, lifting = self.path_accelerations(t, x, u)
        q_rate, eta1_acceleration, eta2_acceleration = self.coupled_accelerations(t, x, u)
        return HypersonicState(
            h=x.V * jnp.sin(x.theta - x.alpha),
            V=V_rate,
            alpha=x.q - lifting / x.V,
            theta=x.q,
            q=q_rate,
            eta1=x.eta1_rate,
            eta1_rate=eta1_acceleration,
            eta2=x.eta2_rate,
            eta2_rate=eta2_acceleration,
        )

    def in_gust(self, gust: Gust) -> "Hypersonic":
        """Return the vehicle with this gust in the air around it."""
        return replace(self, gust=gust)

    def airflow(self, x: HypersonicState) -> tuple[Any, Any]:
        """Return airspeed (ft/s) and angle of attack (rad) relative to the moving air."""
        if self.gust is None:
            return x.V, x.alpha
        forward, _, down = self.gust.velocity / FOOT
        u, w = x.V * jnp.cos(x.alpha) - forward, x.V * jnp.sin(x.alpha) - down
        return jnp.sqrt(u * u + w * w), jnp.arctan2(w, u)

    def forces_at(self, x: HypersonicState, u: HypersonicInput) -> Forces:
        """Return thrust, lift, drag, moment and dynamic pressure, per foot of width."""
        V, alpha = self.airflow(x)
        return self.forces.at(x.h, V, alpha, u.Phi, u.delta_e)

    def path_accelerations(self, t: Any, x: HypersonicState, u: HypersonicInput) -> tuple[Any, Any]:
        """Return the accelerations V' along the flight path and V gamma' normal to the path, up (ft/s^2)."""
        f, gamma = self.forces_at(x, u), x.theta - x.alpha
        drag, lift = f.D, f.L
        if self.gust is not None:
            turned = self.airflow(x)[1] - x.alpha  # angle from the flight path to the path through the air, nose up
            c, s = jnp.cos(turned), jnp.sin(turned)
            drag, lift = f.D * c - f.L * s, f.L * c + f.D * s
        along = f.T * jnp.cos(x.alpha) - drag
        normal = f.T * jnp.sin(x.alpha) + lift
        if self.disturbance is not None:
            on = self.disturbance.activation(t)
            along, normal = along + on * self.disturbance.along, normal + on * self.disturbance.normal
        return along / self.m - self.g * jnp.sin(gamma), normal / self.m - self.g * jnp.cos(gamma)

    def coupled_accelerations(self, t: Any, x: HypersonicState, u: HypersonicInput) -> tuple[Any, Any, Any]:
        """Return the accelerations of pitch Q' (rad/s^2) and of the bending modes eta1'', eta2''."""
        M = self.forces_at(x, u).M
        if self.disturbance is not None:
            M = M + self.disturbance.activation(t) * self.disturbance.moment
        N1, N2 = self.modes.forcing(self.airflow(x)[1], u.delta_e)
        back1, back2 = self.modes.restoring_forces(x.eta1, x.eta1_rate, x.eta2, x.eta2_rate)
        return self.modes.solve_accelerations(self.Iyy, M, N1 + back1, N2 + back2)

    def motion(self, t: Any, x: HypersonicState, u: HypersonicInput) -> Motion:
        """Return the motion of the centre of mass at time t (unit: 100 ns), for sensors, in SI units.

        The model has no horizontal position, so north and east stay zero.
        """
        seconds = t * 1e-7
        along, normal = self.path_accelerations(seconds, x, u)
        q_rate, *bends = self.coupled_accelerations(seconds, x, u)
        c, s, o = jnp.cos(x.alpha), jnp.sin(x.alpha), jnp.zeros_like(q_rate)
        gust = NO_GUST if self.gust is None else self.gust
        return Motion(
            t=t,
            p_WB=jnp.stack([o, o, -x.h * FOOT]),
            attitude=jnp.stack([o, x.theta + o, o]),
            v_WB_B=jnp.stack([x.V * c, o, x.V * s]) * FOOT,
            w_WB_B=jnp.stack([o, x.q + o, o]),
            a_WB_B=jnp.stack([along * c + normal * s, o, along * s - normal * c]) * FOOT,
            alpha_WB_B=jnp.stack([o, q_rate, o]),
            air=SurroundingAir(height=x.h * FOOT, velocity=gust.velocity + o, rate=gust.rate + o),
            bending=Bending(rate=jnp.stack([x.eta1_rate + o, x.eta2_rate + o]), acceleration=jnp.stack(bends)),
        )

    def level_state(self, h: Any, V: Any, alpha: Any, delta_e: Any) -> HypersonicState:
        """Return the state in level flight at this angle of attack, with the bending modes at rest.

        The state is trimmed if V', gamma' and M are zero.
        """
        eta1, eta2 = self.modes.static_displacements(alpha, delta_e)
        return HypersonicState(h, V, alpha, alpha, 0.0, eta1, 0.0, eta2, 0.0)
