"""Air, forces and thrust of the hypersonic vehicle: the fit by curves that its model is made of, in slug, foot, second.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eqs. 1-3. [2] Parker, Serrani, Yurkovich, Bolender, Doman, "Control-oriented
modeling of an air-breathing hypersonic vehicle", Journal of Guidance, Control, and Dynamics 30(3), 2007.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from trimtab.core.record import Scalar, part, quantity, record

LIFT, DRAG, MOMENT, THRUST = "[1], [2], lift", "[1], [2], drag", "[1], [2], pitching moment", "[1], [2], thrust"


class Forces(NamedTuple):
    """Per foot of width: thrust, lift, drag (lbf/ft), pitching moment (lbf ft/ft), dynamic pressure (lbf/ft^2)."""

    T: Any
    L: Any
    D: Any
    M: Any
    qbar: Any


@record
class ExponentialAtmosphere:
    """Density that falls by a factor e each scale height.

        rho = rho0 exp(-(h - h0)/hs)

    Valid:   near h0.    Not modelled: temperature, wind.
    Source:  [1] eq. 2; [2].
    """

    rho0: Scalar = quantity("slug/ft^3", "Density at h0.", default=6.7429e-5, above=0, source="[1], [2]")
    h0: Scalar = quantity("ft", "Altitude of rho0.", default=85000.0, source="[1], [2]")
    hs: Scalar = quantity("ft", "Scale height.", default=21358.0, above=0, source="[1], [2]")

    def density(self, h: Any) -> Any:
        """Density (slug/ft^3) at altitude h (ft)."""
        return self.rho0 * jnp.exp(-(h - self.h0) / self.hs)


@record
class Aerodynamics:
    """Lift, drag and pitching moment by polynomials in angle of attack and elevator, per foot of width.

        L = qbar S (CL_a al + CL_d de + CL_0)
        D = qbar S (CD_a2 al^2 + CD_a al + CD_d2 de^2 + CD_d de + CD_0)
        M = qbar S c (CM_a2 al^2 + CM_a al + CM_0 + ce de)                without the thrust's

    None of them feels the flexible modes.

    Source:  [1] eqs. 2-3; [2].
    """

    S: Scalar = quantity("ft^2/ft", "Reference area per width.", default=17.0, above=0, source="[1], [2]")
    c: Scalar = quantity("ft", "Mean chord.", default=17.0, above=0, source="[1], [2]")
    CL_a: Scalar = quantity("1/rad", "Lift by angle of attack.", default=4.6773, source=LIFT)
    CL_d: Scalar = quantity("1/rad", "Lift by elevator.", default=0.76224, source=LIFT)
    CL_0: Scalar = quantity("1", "Lift else.", default=-0.018714, source=LIFT)
    CD_a2: Scalar = quantity("1/rad^2", "Drag by angle of attack squared.", default=5.8224, source=DRAG)
    CD_a: Scalar = quantity("1/rad", "Drag by angle of attack.", default=-0.045315, source=DRAG)
    CD_d2: Scalar = quantity("1/rad^2", "Drag by elevator squared.", default=0.81993, source=DRAG)
    CD_d: Scalar = quantity("1/rad", "Drag by elevator.", default=2.7699e-4, source=DRAG)
    CD_0: Scalar = quantity("1", "Drag else.", default=0.010131, source=DRAG)
    CM_a2: Scalar = quantity("1/rad^2", "Moment by angle of attack squared.", default=6.2926, source=MOMENT)
    CM_a: Scalar = quantity("1/rad", "Moment by angle of attack.", default=2.1335, source=MOMENT)
    CM_0: Scalar = quantity("1", "Moment else.", default=0.18979, source=MOMENT)
    ce: Scalar = quantity("1/rad", "Moment by elevator.", default=-1.2897, source=MOMENT)

    def lift(self, qbar: Any, alpha: Any, delta_e: Any) -> Any:
        """Lift (lbf/ft) at dynamic pressure qbar (lbf/ft^2)."""
        return qbar * self.S * (self.CL_a * alpha + self.CL_d * delta_e + self.CL_0)

    def drag(self, qbar: Any, alpha: Any, delta_e: Any) -> Any:
        """Drag (lbf/ft) at dynamic pressure qbar (lbf/ft^2); quadratic in the elevator, so the model is not affine."""
        by_alpha = (self.CD_a2 * alpha + self.CD_a) * alpha
        by_elevator = (self.CD_d2 * delta_e + self.CD_d) * delta_e
        return qbar * self.S * (by_alpha + by_elevator + self.CD_0)

    def moment(self, qbar: Any, alpha: Any, delta_e: Any) -> Any:
        """Pitching moment of the air (lbf ft/ft), nose up."""
        return qbar * self.S * self.c * ((self.CM_a2 * alpha + self.CM_a) * alpha + self.CM_0 + self.ce * delta_e)


@record
class Propulsion:
    """Thrust of the air-breathing engine by cubics in the angle of attack, affine in the fuel equivalence ratio.

        T = T0 + TP Phi      TP = b1 al^3 + b3 al^2 + b5 al + b7      T0 = b2 al^3 + b4 al^2 + b6 al + b8

    It acts zT below the centre of mass, which turns the nose up.

    Not modelled: thermal choking, the dependence on altitude and speed.
    Source:  [1] eqs. 2-3; [2].
    """

    zT: Scalar = quantity("ft", "Arm of the thrust about the centre of mass.", default=8.36, source="[1], [2]")
    b1: Scalar = quantity("lbf/ft", "By angle of attack cubed and fuel ratio.", default=-3.7693e5, source=THRUST)
    b2: Scalar = quantity("lbf/ft", "By angle of attack cubed.", default=-3.7225e4, source=THRUST)
    b3: Scalar = quantity("lbf/ft", "By angle of attack squared and fuel ratio.", default=2.6814e4, source=THRUST)
    b4: Scalar = quantity("lbf/ft", "By angle of attack squared.", default=-1.7277e4, source=THRUST)
    b5: Scalar = quantity("lbf/ft", "By angle of attack and fuel ratio.", default=3.5542e4, source=THRUST)
    b6: Scalar = quantity("lbf/ft", "By angle of attack.", default=-2.4216e3, source=THRUST)
    b7: Scalar = quantity("lbf/ft", "By fuel ratio.", default=6.3785e3, source=THRUST)
    b8: Scalar = quantity("lbf/ft", "Else.", default=-1.0090e2, source=THRUST)

    def thrust_without_fuel(self, alpha: Any) -> Any:
        """T0 (lbf/ft)."""
        return ((self.b2 * alpha + self.b4) * alpha + self.b6) * alpha + self.b8

    def thrust_per_fuel_ratio(self, alpha: Any) -> Any:
        """TP (lbf/ft), thrust per fuel equivalence ratio."""
        return ((self.b1 * alpha + self.b3) * alpha + self.b5) * alpha + self.b7

    def thrust(self, alpha: Any, Phi: Any) -> Any:
        """T (lbf/ft)."""
        return self.thrust_without_fuel(alpha) + self.thrust_per_fuel_ratio(alpha) * Phi


@record
class RigidForces:
    """All forces and the moment on the rigid vehicle: air, aerodynamics and propulsion. Source: [1] eqs. 2-3."""

    atmosphere: Any = part("Density by altitude.", default=ExponentialAtmosphere())
    aerodynamics: Any = part("Lift, drag, moment.", default=Aerodynamics())
    propulsion: Any = part("Thrust and its arm.", default=Propulsion())

    def dynamic_pressure(self, h: Any, V: Any) -> Any:
        """rho V^2/2 (lbf/ft^2)."""
        return self.atmosphere.density(h) * V * V / 2

    def at(self, h: Any, V: Any, alpha: Any, Phi: Any, delta_e: Any) -> Forces:
        """Forces at altitude h (ft), speed V (ft/s), angle of attack and elevator (rad), fuel ratio Phi.

        M = zT T + moment of the air.
        """
        qbar = self.dynamic_pressure(h, V)
        T = self.propulsion.thrust(alpha, Phi)
        M = self.propulsion.zT * T + self.aerodynamics.moment(qbar, alpha, delta_e)
        L, D = self.aerodynamics.lift(qbar, alpha, delta_e), self.aerodynamics.drag(qbar, alpha, delta_e)
        return Forces(T=T, L=L, D=D, M=M, qbar=qbar)
