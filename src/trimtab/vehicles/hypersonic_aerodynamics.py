"""Air, forces, thrust and the two bending modes of the hypersonic vehicle, in slug, foot, second.

The forces are fitted curves. An algebraic loop couples the bending modes with the pitch acceleration.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eqs. 1-3. [2] Parker, Serrani, Yurkovich, Bolender, Doman, "Control-oriented
modeling of an air-breathing hypersonic vehicle", Journal of Guidance, Control, and Dynamics 30(3), 2007.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from trimtab.core.record import Scalar, option, part, quantity, record, replace

KMODES = ("parker", "paper", "author")
FITTED = "reconstructed from a printed entry of [1]'s A, see docs page"
UNCERTAIN = "literature, uncorroborated; docs page"
LIFT, DRAG, MOMENT, THRUST = "[1], [2], lift", "[1], [2], drag", "[1], [2], pitching moment", "[1], [2], thrust"


class Forces(NamedTuple):
    """Forces per foot of width: thrust, lift, drag (lbf/ft), moment (lbf ft/ft); dynamic pressure (lbf/ft^2)."""

    T: Any
    L: Any
    D: Any
    M: Any
    qbar: Any


@record
class ExponentialAtmosphere:
    """Air density that falls by a factor e per scale height.

        rho = rho0 exp(-(h - h0)/hs)

    Valid:   near h0.    Not modelled: temperature, wind.
    Source:  [1] eq. 2; [2].
    """

    rho0: Scalar = quantity(
        "slug/ft^3", "Air density rho0 at the altitude h0.", default=6.7429e-5, above=0, source="[1], [2]"
    )
    h0: Scalar = quantity("ft", "Altitude h0 at which the air density is rho0.", default=85000.0, source="[1], [2]")
    hs: Scalar = quantity("ft", "Scale height of the air density.", default=21358.0, above=0, source="[1], [2]")

    def density(self, h: Any) -> Any:
        """Return the air density (slug/ft^3) at altitude h (ft)."""
        return self.rho0 * jnp.exp(-(h - self.h0) / self.hs)


@record
class Aerodynamics:
    """Lift, drag and pitching moment by polynomials in angle of attack and elevator, per foot of width.

        L = qbar S (CL_a al + CL_d de + CL_0)
        D = qbar S (CD_a2 al^2 + CD_a al + CD_d2 de^2 + CD_d de + CD_0)
        M = qbar S c (CM_a2 al^2 + CM_a al + CM_0 + ce de)                without the moment of the thrust

    Lift, drag and moment do not depend on the bending modes.

    Source:  [1] eqs. 2-3; [2].
    """

    S: Scalar = quantity("ft^2/ft", "Reference area S per foot of width.", default=17.0, above=0, source="[1], [2]")
    c: Scalar = quantity("ft", "Mean chord.", default=17.0, above=0, source="[1], [2]")
    CL_a: Scalar = quantity("1/rad", "Lift coefficient per angle of attack.", default=4.6773, source=LIFT)
    CL_d: Scalar = quantity("1/rad", "Lift coefficient per elevator angle.", default=0.76224, source=LIFT)
    CL_0: Scalar = quantity(
        "1", "Lift coefficient at zero angle of attack and elevator angle.", default=-0.018714, source=LIFT
    )
    CD_a2: Scalar = quantity("1/rad^2", "Drag coefficient per angle of attack squared.", default=5.8224, source=DRAG)
    CD_a: Scalar = quantity("1/rad", "Drag coefficient per angle of attack.", default=-0.045315, source=DRAG)
    CD_d2: Scalar = quantity("1/rad^2", "Drag coefficient per elevator angle squared.", default=0.81993, source=DRAG)
    CD_d: Scalar = quantity("1/rad", "Drag coefficient per elevator angle.", default=2.7699e-4, source=DRAG)
    CD_0: Scalar = quantity(
        "1", "Drag coefficient at zero angle of attack and elevator angle.", default=0.010131, source=DRAG
    )
    CM_a2: Scalar = quantity(
        "1/rad^2", "Pitching moment coefficient per angle of attack squared.", default=6.2926, source=MOMENT
    )
    CM_a: Scalar = quantity("1/rad", "Pitching moment coefficient per angle of attack.", default=2.1335, source=MOMENT)
    CM_0: Scalar = quantity(
        "1", "Pitching moment coefficient at zero angle of attack and elevator angle.", default=0.18979, source=MOMENT
    )
    ce: Scalar = quantity("1/rad", "Pitching moment coefficient per elevator angle.", default=-1.2897, source=MOMENT)

    def lift(self, qbar: Any, alpha: Any, delta_e: Any) -> Any:
        """Return lift (lbf/ft) at dynamic pressure qbar (lbf/ft^2)."""
        return qbar * self.S * (self.CL_a * alpha + self.CL_d * delta_e + self.CL_0)

    def drag(self, qbar: Any, alpha: Any, delta_e: Any) -> Any:
        """Return drag (lbf/ft) at dynamic pressure qbar (lbf/ft^2).

        The drag is quadratic in the elevator angle, so the model is not affine in its inputs.
        """
        by_alpha = (self.CD_a2 * alpha + self.CD_a) * alpha
        by_elevator = (self.CD_d2 * delta_e + self.CD_d) * delta_e
        return qbar * self.S * (by_alpha + by_elevator + self.CD_0)

    def moment(self, qbar: Any, alpha: Any, delta_e: Any) -> Any:
        """Return pitching moment of the air (lbf ft/ft), nose up."""
        return qbar * self.S * self.c * ((self.CM_a2 * alpha + self.CM_a) * alpha + self.CM_0 + self.ce * delta_e)


@record
class Propulsion:
    """Thrust of the air-breathing engine: cubic in the angle of attack al, affine in the fuel equivalence ratio Phi.

        T = T0 + TP Phi      TP = b1 al^3 + b3 al^2 + b5 al + b7      T0 = b2 al^3 + b4 al^2 + b6 al + b8

    The thrust acts at a distance zT below the centre of mass, so it pitches the nose up.

    Not modelled: thermal choking, the dependence on altitude and speed.
    Source:  [1] eqs. 2-3; [2].
    """

    zT: Scalar = quantity("ft", "Arm of the thrust about the centre of mass.", default=8.36, source="[1], [2]")
    b1: Scalar = quantity(
        "lbf/ft",
        "Coefficient b1 in the thrust term b1 al^3 Phi (angle of attack al, fuel ratio Phi).",
        default=-3.7693e5,
        source=THRUST,
    )
    b2: Scalar = quantity(
        "lbf/ft", "Coefficient b2 in the thrust term b2 al^3 (angle of attack al).", default=-3.7225e4, source=THRUST
    )
    b3: Scalar = quantity(
        "lbf/ft",
        "Coefficient b3 in the thrust term b3 al^2 Phi (angle of attack al, fuel ratio Phi).",
        default=2.6814e4,
        source=THRUST,
    )
    b4: Scalar = quantity(
        "lbf/ft", "Coefficient b4 in the thrust term b4 al^2 (angle of attack al).", default=-1.7277e4, source=THRUST
    )
    b5: Scalar = quantity(
        "lbf/ft",
        "Coefficient b5 in the thrust term b5 al Phi (angle of attack al, fuel ratio Phi).",
        default=3.5542e4,
        source=THRUST,
    )
    b6: Scalar = quantity(
        "lbf/ft", "Coefficient b6 in the thrust term b6 al (angle of attack al).", default=-2.4216e3, source=THRUST
    )
    b7: Scalar = quantity(
        "lbf/ft", "Coefficient b7 in the thrust term b7 Phi (fuel ratio Phi).", default=6.3785e3, source=THRUST
    )
    b8: Scalar = quantity(
        "lbf/ft",
        "Thrust b8 at zero angle of attack and zero fuel ratio.",
        default=-1.0090e2,
        source=THRUST,
    )

    def thrust_without_fuel(self, alpha: Any) -> Any:
        """Return T0 (lbf/ft), the thrust at zero fuel ratio."""
        return ((self.b2 * alpha + self.b4) * alpha + self.b6) * alpha + self.b8

    def thrust_per_fuel_ratio(self, alpha: Any) -> Any:
        """Return TP (lbf/ft), the thrust per fuel equivalence ratio."""
        return ((self.b1 * alpha + self.b3) * alpha + self.b5) * alpha + self.b7

    def thrust(self, alpha: Any, Phi: Any) -> Any:
        """Return the thrust T (lbf/ft) at an angle of attack (rad) and a fuel equivalence ratio."""
        return self.thrust_without_fuel(alpha) + self.thrust_per_fuel_ratio(alpha) * Phi


@record
class RigidForces:
    """All forces and the moment on the rigid vehicle: air, aerodynamics and propulsion. Source: [1] eqs. 2-3."""

    atmosphere: Any = part("Air density as a function of altitude.", default=ExponentialAtmosphere())
    aerodynamics: Any = part("Aerodynamics: lift, drag and pitching moment.", default=Aerodynamics())
    propulsion: Any = part("Propulsion: thrust and its lever arm.", default=Propulsion())

    def dynamic_pressure(self, h: Any, V: Any) -> Any:
        """Return the dynamic pressure rho V^2/2 (lbf/ft^2)."""
        return self.atmosphere.density(h) * V * V / 2

    def at(self, h: Any, V: Any, alpha: Any, Phi: Any, delta_e: Any) -> Forces:
        """Return forces at altitude h (ft), speed V (ft/s), angle of attack and elevator (rad), fuel ratio Phi.

        M = zT T + moment of the air.
        """
        qbar = self.dynamic_pressure(h, V)
        T = self.propulsion.thrust(alpha, Phi)
        M = self.propulsion.zT * T + self.aerodynamics.moment(qbar, alpha, delta_e)
        L, D = self.aerodynamics.lift(qbar, alpha, delta_e), self.aerodynamics.drag(qbar, alpha, delta_e)
        return Forces(T=T, L=L, D=D, M=M, qbar=qbar)


@record
class FlexibleModes:
    """Two bending modes, mass-normalised, excited by angle of attack, elevator and pitch acceleration.

        k_i eta_i'' = r_i - psi_i M/Iyy - (psi_1 psi_2/Iyy) eta_j''      r_i = N_i - 2 zeta_i w_i eta_i' - w_i^2 eta_i
        Iyy Q' = M + psi_1 eta_1'' + psi_2 eta_2''                                                        [1, eq. 1]

    The equations of the two modes contain each other's accelerations and are solved exactly. [1] leaves k_i undefined.
    `kmode` selects its interpretation:

    - parker: k_i = 1 + psi_i^2/Iyy, that is eta_i'' = r_i - psi_i Q' and Q' = (M + psi_1 r_1 + psi_2 r_2)/J with
      J = Iyy + psi_1^2 + psi_2^2 [2];
    - paper: k_i = 1, eq. 1 to the letter;
    - author: psi_i/Iyy replaces psi_i in the equations of the modes, as in the printed matrices of [1]. This variant
      mixes units and serves only to reproduce these matrices.

    Source:  [1] eqs. 1-3; [2]. Reconstructed: frequencies, damping, psi_i and most of N_i, see docs page.
    """

    w1: Scalar = quantity("rad/s", "Natural frequency of bending mode 1.", default=16.5, above=0, source=FITTED)
    w2: Scalar = quantity("rad/s", "Natural frequency of bending mode 2.", default=20.0, above=0, source=FITTED)
    zeta1: Scalar = quantity("1", "Damping ratio of bending mode 1.", default=0.02, low=0, source=FITTED)
    zeta2: Scalar = quantity("1", "Damping ratio of bending mode 2.", default=0.02, low=0, source=FITTED)
    psi1: Scalar = quantity("(slug ft)^1/2", "Coupling of bending mode 1 with pitch.", default=136.82, source=FITTED)
    psi2: Scalar = quantity("(slug ft)^1/2", "Coupling of bending mode 2 with pitch.", default=329.22, source=FITTED)
    N1_a2: Scalar = quantity(
        "(slug ft)^1/2/s^2",
        "Coefficient of the force on bending mode 1 per angle of attack squared (rad^2).",
        default=1.4013e3,
        source=UNCERTAIN,
    )
    N1_a: Scalar = quantity(
        "(slug ft)^1/2/s^2",
        "Coefficient of the force on bending mode 1 per angle of attack (rad).",
        default=4.5737e3,
        source=FITTED,
    )
    N1_0: Scalar = quantity(
        "(slug ft)^1/2/s^2", "Constant force on bending mode 1.", default=1.1752e2, source=UNCERTAIN
    )
    N2_a2: Scalar = quantity(
        "(slug ft)^1/2/s^2",
        "Coefficient of the force on bending mode 2 per angle of attack squared (rad^2).",
        default=-5.0227e3,
        source=UNCERTAIN,
    )
    N2_a: Scalar = quantity(
        "(slug ft)^1/2/s^2",
        "Coefficient of the force on bending mode 2 per angle of attack (rad).",
        default=2.8633e3,
        source=FITTED,
    )
    N2_d: Scalar = quantity(
        "(slug ft)^1/2/s^2",
        "Coefficient of the force on bending mode 2 per elevator angle (rad).",
        default=1.2465e3,
        source=FITTED,
    )
    N2_0: Scalar = quantity(
        "(slug ft)^1/2/s^2", "Constant force on bending mode 2.", default=-4.4201e1, source=UNCERTAIN
    )
    kmode: str = option(
        "Interpretation of the factor k_i, which couples the bending modes and is undefined in [1].",
        default="parker",
        choices=KMODES,
    )

    def forcing(self, alpha: Any, delta_e: Any) -> tuple[Any, Any]:
        """Return N1, N2: generalised forces on the modes due to angle of attack and elevator (rad)."""
        N1 = (self.N1_a2 * alpha + self.N1_a) * alpha + self.N1_0
        N2 = (self.N2_a2 * alpha + self.N2_a) * alpha + self.N2_d * delta_e + self.N2_0
        return N1, N2

    def restoring_forces(self, eta1: Any, eta1_rate: Any, eta2: Any, eta2_rate: Any) -> tuple[Any, Any]:
        """Return the restoring and damping forces -2 zeta_i w_i eta_i' - w_i^2 eta_i of both modes."""
        one = -2 * self.zeta1 * self.w1 * eta1_rate - self.w1**2 * eta1
        two = -2 * self.zeta2 * self.w2 * eta2_rate - self.w2**2 * eta2
        return one, two

    def static_displacements(self, alpha: Any, delta_e: Any) -> tuple[Any, Any]:
        """Return N_i/w_i^2: the displacements at which both modes are at rest while the pitch rate is constant."""
        N1, N2 = self.forcing(alpha, delta_e)
        return N1 / self.w1**2, N2 / self.w2**2

    def detune(self, by: Any) -> "FlexibleModes":
        """Return a copy with both frequencies multiplied by `by`, for a plant that differs from the filter's model."""
        return replace(self, w1=self.w1 * by, w2=self.w2 * by)

    def solve_accelerations(self, Iyy: Any, M: Any, r1: Any, r2: Any) -> tuple[Any, Any, Any]:
        """Return Q' (rad/s^2), eta1'' and eta2'' for moment M and modal forces r1, r2: exact solution of the equations.

        Args:     Iyy: moment of inertia (slug ft^2/ft).    M: pitching moment (lbf ft/ft).
                  r1, r2: N_i and restoring force of each mode.
        """
        if self.kmode == "parker":
            J = Iyy + self.psi1**2 + self.psi2**2
            Q_rate = (M + self.psi1 * r1 + self.psi2 * r2) / J
            return Q_rate, r1 - self.psi1 * Q_rate, r2 - self.psi2 * Q_rate
        t1, t2 = self.psi1 / Iyy, self.psi2 / Iyy
        p1, p2 = (t1, t2) if self.kmode == "author" else (self.psi1, self.psi2)
        k = t1 * t2 if self.kmode == "author" else self.psi1 * t2
        s1, s2 = r1 - p1 * M / Iyy, r2 - p2 * M / Iyy
        eta1_acceleration = (s1 - k * s2) / (1 - k * k)
        eta2_acceleration = (s2 - k * s1) / (1 - k * k)
        return M / Iyy + t1 * eta1_acceleration + t2 * eta2_acceleration, eta1_acceleration, eta2_acceleration
