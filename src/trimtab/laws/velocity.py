"""Laws that control the hovercraft's velocity to a constant: zero, forward or backward.

Sway has no actuator of its own, so the heading is free. Each law controls the velocity in body axes, and no law holds a
heading.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006,
section 2.2.
"""

from typing import Any, ClassVar

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, part, quantity, record
from trimtab.core.signals import Estimate, PlanarForce
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

READS = ("surge_velocity", "sway_velocity", "yaw_rate")


@record
class VelocityOutput:
    """Demand of a velocity law. Source: [1] section 2.2."""

    demand: PlanarForce = part("Demanded force at the rudder pivot.")
    lyapunov: Scalar = quantity(
        "J", "Lyapunov function of the law; for ReverseMomentum the energy of the velocity error, which may grow."
    )


def _error_energy(model: Hovercraft, s: Any, surge_velocity: Any, stretch: Any = 1.0) -> Any:
    """Return the kinetic energy (J) of the velocity error, with the yaw term multiplied by `stretch`."""
    error = s.surge_velocity - surge_velocity
    return model.mass * (error**2 + s.sway_velocity**2) / 2 + stretch * model.inertia * s.yaw_rate**2 / 2


@record
class ZeroVelocity:
    """Law that brings the hovercraft to rest.

        FX = -k1 u        FY = -k2 (v - d r)                                              [1, eq. 2.16]

    u, v and r are surge velocity, sway velocity and yaw rate.

    Stable:  globally asymptotically for all k1, k2 > 0, with V the kinetic energy,
             V' = -k1 u^2 - k2 (v - d r)^2 [1, eq. 2.17]. V' = 0 on a line, not only at rest, but rest is the largest
             invariant set on this line (proof of [1] corrected, see docs Errata).
    Slow:    one eigenvalue at rest is zero. Once the rudder pivot no longer slips, r' = -c r^3 with
             c = slow_manifold_rate(law): the yaw rate decays like 1/sqrt(2 c t), so the heading drifts without bound.
    Source:  [1] eq. 2.16; default gains [1] table 6.1.
    """

    reads: ClassVar[tuple[str, ...]] = READS

    k1: Scalar = quantity("kg/s", "Gain k1 of the surge velocity error.", default=1.0, above=0, source="[1] table 6.1")
    k2: Scalar = quantity(
        "kg/s", "Gain k2 of the rudder pivot's sideways velocity v - d r.", default=2.5, above=0, source="[1] table 6.1"
    )
    model: Hovercraft = part("Vehicle model used by the law.", default=Hovercraft())

    def init(self, key: Any) -> tuple[()]:
        """Return an empty record, because this law has no state."""
        return ()

    def step(self, t: Any, state: tuple[()], estimate: Estimate) -> tuple[tuple[()], VelocityOutput]:
        """Return the demand at time t (unit: 100 ns)."""
        s = estimate.state
        demand = PlanarForce(-self.k1 * s.surge_velocity, -self.k2 * (s.sway_velocity - self.model.arm * s.yaw_rate))
        return state, VelocityOutput(demand, self.lyapunov(s))

    def lyapunov(self, s: Any) -> Any:
        """Return V (J), the kinetic energy of a state s with the fields in `reads` [1, eq. 2.17]."""
        return _error_energy(self.model, s, 0.0)

    def equilibrium(self) -> HovercraftState:
        """Return the equilibrium velocities of the closed loop."""
        return HovercraftState()


def slow_manifold_rate(law: ZeroVelocity) -> Any:
    """Return the coefficient c (s) of the slow final motion under ZeroVelocity: r' = -c r^3, v = d r, u = d m r^2/k1.

    c = m^2 d^2 / (k1 (J + d^2 m)), to leading order. Source: own derivation, not in [1] (docs page).
    """
    m, d = law.model.mass, law.model.arm
    return m**2 * d**2 / (law.k1 * (law.model.inertia + d**2 * m))


@record
class ForwardMomentum:
    """Law that drives forward at a constant momentum PXr > 0.

        FX = -k1 (u - PXr/m)        FY = -k2 (v - d r)                                    [1, eq. 2.24]

    u, v and r are surge velocity, sway velocity and yaw rate.

    Stable:  globally asymptotically for ALL k1, k2, PXr > 0. With kappa = PXr/(k2 d) the function
             W = m ((u - PXr/m)^2 + v^2)/2 + lambda J r^2/2, lambda = 1 + kappa, decreases along every motion: W' is a
             negative definite form whose (v, r) block, k2 [[1, -d], [-d, (1 + kappa) d^2]], has determinant
             k2^2 kappa d^2 > 0. [1] takes lambda = 1 - kappa, which needs k2 > PXr/d. The gains of [1] (table 6.2:
             kappa = 2.19) violate this condition. The proof above covers these gains (see docs Errata).
    Source:  [1] eq. 2.24; lambda: own derivation; default gains [1] table 6.2.
    """

    reads: ClassVar[tuple[str, ...]] = READS

    k1: Scalar = quantity("kg/s", "Gain k1 of the surge velocity error.", default=1.0, above=0, source="[1] table 6.2")
    k2: Scalar = quantity(
        "kg/s", "Gain k2 of the rudder pivot's sideways velocity v - d r.", default=4.0, above=0, source="[1] table 6.2"
    )
    reference: Scalar = quantity(
        "kg m/s", "Reference forward momentum PXr, must be above 0.", default=2.8, frame="B", source="[1] table 6.2"
    )
    model: Hovercraft = part("Vehicle model used by the law.", default=Hovercraft())

    def check(self) -> None:
        """Raise InputError if the reference momentum is not positive (forward)."""
        _check_forward("ForwardMomentum", self.reference)

    def init(self, key: Any) -> tuple[()]:
        """Return an empty record, because this law has no state."""
        return ()

    def step(self, t: Any, state: tuple[()], estimate: Estimate) -> tuple[tuple[()], VelocityOutput]:
        """Return the demand at time t (unit: 100 ns)."""
        s, model = estimate.state, self.model
        FX = -self.k1 * (s.surge_velocity - self.reference / model.mass)
        FY = -self.k2 * (s.sway_velocity - model.arm * s.yaw_rate)
        return state, VelocityOutput(PlanarForce(FX, FY), self.lyapunov(s))

    def lyapunov(self, s: Any) -> Any:
        """Return the Lyapunov function W (J), with lambda = 1 + kappa, for a state s with the fields in `reads`."""
        kappa = self.reference / (self.k2 * self.model.arm)
        return _error_energy(self.model, s, self.reference / self.model.mass, 1 + kappa)

    def equilibrium(self) -> HovercraftState:
        """Return the equilibrium velocities of the closed loop."""
        return HovercraftState(surge_velocity=self.reference / self.model.mass)


@record
class ForwardMomentumMatched:
    """Law ForwardMomentum with k2 tied to the reference, so that the cross terms in W' vanish.

        FX = -k1 (u - PXr/m)        FY = -k2 (v - d r),    k2 = PXr/(2 d)                 [1, eq. 2.29]

    u, v and r are surge velocity, sway velocity and yaw rate.

    Stable:  globally asymptotically for all k1, PXr > 0, with W = m ((u - PXr/m)^2 + v^2)/2 + J r^2/2 (kappa = 2,
             lambda = 1): W' = -k1 (u - PXr/m)^2 - k2 (v^2 + d^2 r^2).
    Source:  [1] eq. 2.29; defaults [1] table 6.2.
    """

    reads: ClassVar[tuple[str, ...]] = READS

    k1: Scalar = quantity("kg/s", "Gain k1 of the surge velocity error.", default=1.0, above=0, source="[1] table 6.2")
    reference: Scalar = quantity(
        "kg m/s", "Reference forward momentum PXr, must be above 0.", default=2.8, frame="B", source="[1] table 6.2"
    )
    model: Hovercraft = part("Vehicle model used by the law.", default=Hovercraft())

    def check(self) -> None:
        """Raise InputError if the reference momentum is not positive (forward)."""
        _check_forward("ForwardMomentumMatched", self.reference)

    def init(self, key: Any) -> tuple[()]:
        """Return an empty record, because this law has no state."""
        return ()

    def step(self, t: Any, state: tuple[()], estimate: Estimate) -> tuple[tuple[()], VelocityOutput]:
        """Return the demand at time t (unit: 100 ns)."""
        s, model = estimate.state, self.model
        k2 = self.reference / (2 * model.arm)
        FX = -self.k1 * (s.surge_velocity - self.reference / model.mass)
        FY = -k2 * (s.sway_velocity - model.arm * s.yaw_rate)
        return state, VelocityOutput(PlanarForce(FX, FY), self.lyapunov(s))

    def lyapunov(self, s: Any) -> Any:
        """Return the Lyapunov function W (J), with lambda = 1, for a state s with the fields in `reads`."""
        return _error_energy(self.model, s, self.reference / self.model.mass)

    def equilibrium(self) -> HovercraftState:
        """Return the equilibrium velocities of the closed loop."""
        return HovercraftState(surge_velocity=self.reference / self.model.mass)


@record
class ReverseMomentum:
    """Law that drives backward at a constant momentum PXr < 0.

        FX = -k1 (u - PXr/m)        FY = +k2 (v + theta d r)                              [1, eq. 2.30]

    u, v and r are surge velocity, sway velocity and yaw rate.

    Stable:  locally, for k1, k2 > 0 and theta > J/(d^2 m): the eigenvalues of [1, eq. 2.33] are then in the left half
             plane. The equilibrium is unique. `trimtab design hovercraft/reverse` proves convergence from a region
             around it. Global convergence is not proved; simulations from random starts all converged.
    Source:  [1] eq. 2.30; default gains [1] table 6.3 (theta = 4 J/(d^2 m)).
    """

    reads: ClassVar[tuple[str, ...]] = READS

    k1: Scalar = quantity("kg/s", "Gain k1 of the surge velocity error.", default=1.5, above=0, source="[1] table 6.3")
    k2: Scalar = quantity(
        "kg/s", "Gain k2 of sway velocity and yaw rate.", default=1.0, above=0, source="[1] table 6.3"
    )
    theta: Scalar = quantity(
        "1", "Weight theta of the yaw rate, must be above J/(d^2 m).", default=1.44, source="[1] table 6.3"
    )
    reference: Scalar = quantity(
        "kg m/s", "Reference momentum PXr, must be below 0 (backward).", default=-1.98, frame="B", source="[1] tab. 6.3"
    )
    model: Hovercraft = part("Vehicle model used by the law.", default=Hovercraft())

    def check(self) -> None:
        """Raise InputError if the reference momentum is not negative (backward), or theta makes the equilibrium
        unstable."""
        if not np.all(np.asarray(self.reference) < 0):
            problem = f"the reference momentum must be negative, got {self.reference} kg m/s"
            fix = "write e.g. -1.98, or use the law ForwardMomentum to drive forward"
            raise InputError("ReverseMomentum.reference", problem, fix=fix)
        least = self.model.inertia / (self.model.arm**2 * self.model.mass)
        if not np.all(np.asarray(self.theta) > least):
            problem = f"theta must be above J/(d^2 m) = {least:.4g}, got {self.theta}"
            raise InputError(
                "ReverseMomentum.theta",
                problem,
                fix=f"set theta to four times this bound, as in the thesis: {4 * least:.4g}",
            )

    def init(self, key: Any) -> tuple[()]:
        """Return an empty record, because this law has no state."""
        return ()

    def step(self, t: Any, state: tuple[()], estimate: Estimate) -> tuple[tuple[()], VelocityOutput]:
        """Return the demand at time t (unit: 100 ns)."""
        s, model = estimate.state, self.model
        FX = -self.k1 * (s.surge_velocity - self.reference / model.mass)
        FY = self.k2 * (s.sway_velocity + self.theta * model.arm * s.yaw_rate)
        return state, VelocityOutput(PlanarForce(FX, FY), self.lyapunov(s))

    def lyapunov(self, s: Any) -> Any:
        """Return (PX - PXr)^2/2m + PY^2/2m + Pi^2/2J (J), which is NOT a Lyapunov function, because it can grow.

        s: a state with the fields in `reads`. `trimtab design hovercraft/reverse` finds a Lyapunov function that holds
        in a region.
        """
        return _error_energy(self.model, s, self.reference / self.model.mass)

    def equilibrium(self) -> HovercraftState:
        """Return the equilibrium velocities of the closed loop."""
        return HovercraftState(surge_velocity=self.reference / self.model.mass)


def _check_forward(name: str, reference: Any) -> None:
    if not np.all(np.asarray(reference) > 0):
        problem = f"the reference momentum must be positive, got {reference} kg m/s"
        fix = "give a positive momentum, or use the law ReverseMomentum to move backward, ZeroVelocity to stop"
        raise InputError(f"{name}.reference", problem, fix=fix)
