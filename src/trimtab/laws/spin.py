"""Laws that spin the craft in place at a constant yaw rate, and the conditions for a safe start.

In this file a reference is a yaw rate (rad/s), Pir = J reference, J is the inertia and D = d^2 m.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, sections
2.2.6 and 2.3. Equations 2.40 to 2.48 and 2.62 to 2.69 are reconstructed from their results, see docs Errata.
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, option, part, quantity, record, tree_where
from trimtab.core.signals import Estimate, PlanarForce
from trimtab.laws.velocity import READS, VelocityOutput, ZeroVelocity
from trimtab.vehicles.hovercraft import Hovercraft

BRAKE, SPIN = 0, 1
"""Indices of the modes of SupervisedSpin."""


@record
class ConstantSpin:
    """Law that spins at a constant yaw rate (called PI law in [1], but without an integrator).

        FX = -k1 u        FY = -k2 (v - d (r - r_ref))                                    [1, eq. 2.39]

    u, v and r are surge velocity, sway velocity and yaw rate.

    Stable:  W = m (u^2 + v^2)/2 + J (r - r_ref)^2/2 never grows, for all k1, k2 > 0, but there are two limit points. At
             the good limit point the craft spins in place at r_ref. At the bad limit point it slides sideways at v = -d
             r_ref. All starts with W < limit_point_value reach the good limit point. An open set of other starts
             reaches the bad limit point.
    Slow:    once the pivot's slip has settled, r' = -c r^2 (r - r_ref), c = slow_manifold_rate of the same k1.
    Source:  [1] eq. 2.39; default gains and reference [1] table 6.4.
    """

    reads: ClassVar[tuple[str, ...]] = READS

    k1: Scalar = quantity("kg/s", "Gain k1 of the surge velocity.", default=0.5, above=0, source="[1] table 6.4")
    k2: Scalar = quantity(
        "kg/s", "Gain k2 of sway velocity and yaw rate error.", default=3.5, above=0, source="[1] table 6.4"
    )
    reference: Scalar = quantity("rad/s", "Reference yaw rate, Pir/J.", default=3.0, frame="B", source="[1] table 6.4")
    model: Hovercraft = part("Vehicle model used by the law.", default=Hovercraft())

    def init(self, key: Any) -> tuple[()]:
        """Return an empty record, because this law has no state."""
        return ()

    def step(self, t: Any, state: tuple[()], estimate: Estimate) -> tuple[tuple[()], VelocityOutput]:
        """Return the demand at time t (unit: 100 ns)."""
        s = estimate.state
        FY = -self.k2 * (s.sway_velocity - self.model.arm * (s.yaw_rate - self.reference))
        return state, VelocityOutput(PlanarForce(-self.k1 * s.surge_velocity, FY), self.lyapunov(s))

    def lyapunov(self, s: Any) -> Any:
        """Return the Lyapunov function W (J) for a state s with the fields in `reads`."""
        return lyapunov(self.model, s, self.reference)


def lyapunov(model: Hovercraft, s: Any, reference: Any) -> Any:
    """Return W (J) = m (u^2 + v^2)/2 + J (r - reference)^2/2 for a reference yaw rate (rad/s): [1] eq. 2.37."""
    energy = model.mass * (s.surge_velocity**2 + s.sway_velocity**2) / 2
    return energy + model.inertia * (s.yaw_rate - reference) ** 2 / 2


def limit_point_value(model: Hovercraft, reference: Any) -> Any:
    """Return W (J) at the bad limit point, (J + D) reference^2/2. Every start with a smaller W reaches the good limit
    point.

    Source: [1] section 2.2.6.
    """
    return (model.inertia + model.arm**2 * model.mass) * reference**2 / 2


def switching_energy(model: Hovercraft, reference: Any) -> Any:
    """Return eps (J): kinetic energy below which ConstantSpin may take over, D^2 reference^2 / (8 (J + D)).

    A kinetic energy below eps implies W < limit_point_value, with a margin of 43 % in energy for the default model.
    Source: [1] eq. 2.48.
    """
    D = model.arm**2 * model.mass
    return D**2 * reference**2 / (8 * (model.inertia + D))


def switching_energy_sharp(model: Hovercraft, reference: Any) -> Any:
    """Return the largest eps (J) with the property of switching_energy: D^2 reference^2 / (2 (sqrt J + sqrt(J + D))^2).

    A pure yaw rate opposite to the reference with this energy has exactly W = limit_point_value.
    Source: own derivation, from the root that [1, eq. 2.47] replaces by a larger one.
    """
    D = model.arm**2 * model.mass
    return D**2 * reference**2 / (2 * (jnp.sqrt(model.inertia) + jnp.sqrt(model.inertia + D)) ** 2)


def safe_reference_bound(model: Hovercraft, W: Any, reference: Any) -> Any:
    """Return the yaw rate (rad/s, >= 0) above which a new reference of the same sign keeps ConstantSpin safe.

    The bound is (sqrt(2 W/J) + |reference|) / (1 + sqrt(1 + D/J)), where W (J) is computed with the present reference.
    The bound is below |reference| exactly while W < limit_point_value. Then it is tight, and any larger reference is
    safe too. After a disturbance the bound may be above |reference|. Then a reference above the bound need not be safe.
    The bound never covers a change of sign: brake first.

    Source: [1] eq. 2.69, reconstructed (docs Errata); the middle sign of [1, eq. 2.66] is +.
    """
    swing = jnp.where(W > 0, jnp.sqrt(jnp.where(W > 0, 2 * W / model.inertia, 1.0)), 0.0)
    return (swing + jnp.abs(reference)) / (1 + jnp.sqrt(1 + model.arm**2 * model.mass / model.inertia))


@record
class SpinSupervisorState:
    """State of the law SupervisedSpin. Source: [1] section 2.2.6."""

    mode: Scalar = quantity("1", "Active mode of the law: brake or spin.", kind="mode", modes=("brake", "spin"))
    switches: Scalar = quantity("1", "Number of switches from brake to spin: 0 or 1.", kind="count")


@record
class SupervisedSpinOutput:
    """Demand and signals of SupervisedSpin. Source: [1] section 2.2.6."""

    demand: PlanarForce = part("Demanded force at the rudder pivot.")
    mode: Scalar = quantity("1", "Active mode of the law: brake or spin.", kind="mode", modes=("brake", "spin"))
    switches: Scalar = quantity("1", "Number of switches from brake to spin: 0 or 1.", kind="count")
    lyapunov: Scalar = quantity("J", 'Lyapunov function: V in mode "brake", W in mode "spin".')


@record
class SupervisedSpin:
    """Law that brakes until a spin is safe, then spins. It reaches the good limit point of ConstantSpin from any start.

    Modes:   brake (ZeroVelocity) -> spin (ConstantSpin) once V < eps(reference). The law never brakes again, and does
             not switch while the estimate is not valid.
    Stable:  globally, on an ideal vehicle: V falls below any eps > 0 in finite time, and V < eps implies
             W < limit_point_value. With a reference of 0 the law brakes for ever.
    Source:  [1] section 2.2.6 and eq. 2.48.
    """

    reads: ClassVar[tuple[str, ...]] = READS

    braking: ZeroVelocity = part('Law used in mode "brake".', default=ZeroVelocity())
    spinning: ConstantSpin = part(
        'Law used in mode "spin". Its parameter `reference` is the commanded yaw rate.', default=ConstantSpin()
    )
    threshold: str = option(
        "Energy at which the law switches: as published, or sharp (1.74 times as large for the default model).",
        default="published",
        choices=("published", "sharp"),
    )

    def init(self, key: Any) -> SpinSupervisorState:
        """Return the initial state, in mode "brake"."""
        return SpinSupervisorState(mode=np.asarray(BRAKE, np.int32), switches=np.asarray(0, np.int32))

    def step(
        self, t: Any, state: SpinSupervisorState, estimate: Estimate
    ) -> tuple[SpinSupervisorState, SupervisedSpinOutput]:
        """Update the mode, and return the demand at time t (unit: 100 ns)."""
        _, brake = self.braking.step(t, (), estimate)
        _, spin = self.spinning.step(t, (), estimate)
        limit = switching_energy if self.threshold == "published" else switching_energy_sharp
        calm = brake.lyapunov < limit(self.spinning.model, self.spinning.reference)
        switch = (state.mode == BRAKE) & calm & estimate.valid
        spins = (state.mode == SPIN) | switch
        now = SpinSupervisorState(
            mode=jnp.where(spins, SPIN, BRAKE).astype(np.int32),
            switches=state.switches + jnp.where(switch, 1, 0).astype(np.int32),
        )
        demand = tree_where(spins, spin.demand, brake.demand)
        value = jnp.where(spins, spin.lyapunov, brake.lyapunov)
        return now, SupervisedSpinOutput(demand=demand, mode=now.mode, switches=now.switches, lyapunov=value)
