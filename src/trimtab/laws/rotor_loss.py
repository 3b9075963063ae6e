"""Tracking after the loss of a rotor: the quadrotor gives up its yaw, spins, and steers the axis of its spin.

[1] is M. W. Mueller, R. D'Andrea, "Stability and control of a quadrocopter despite the complete loss of one, two, or
three propellers", ICRA 2014; [2] S. Sun, L. Sijbers, X. Wang, C. de Visser, "High-speed flight of quadrotor despite
loss of single rotor", IEEE Robotics and Automation Letters 3 (2018).
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from trimtab.core import quaternion
from trimtab.core.record import Scalar, part, quantity, record, replace, tree_where
from trimtab.core.rng import Key
from trimtab.core.signals import Estimate
from trimtab.core.spatial_reference import FixedPlace, SpatialPoint
from trimtab.laws.geometric_tracking import GeometricTracking, flyable_state
from trimtab.vehicles.quadrotor import RotorDemand, RotorSpeeds

LEAST_COSINE = 0.2
"""Smallest cosine of the angle between the demanded direction and the body's z axis."""
UPRIGHT = np.tile([0.0, 0.0, 1.0], (4, 1))


@record
class RotorLossState:
    """Running time of the law, and each rotor's time below idle speed. Source: this module."""

    time: Scalar = quantity("s", "Time since the law started; it stops at the loss of a rotor.")
    slow: Any = quantity("s", "Each rotor's time below its idle speed (n,); kept for a lost rotor.")


@record
class RotorLossOutput:
    """Demand and errors of the law. Source: this module."""

    demand: RotorDemand = part("Demand to the rotors.")
    position_error: Any = quantity("m", "Position error: position minus reference.", frame="W", shape=(3,))
    velocity_error: Any = quantity("m/s", "Velocity error: velocity minus reference.", frame="W", shape=(3,))
    attitude_error: Scalar = quantity(
        "1", "Attitude error Psi with four rotors; with three, 1 - cos of the axis' error."
    )
    distance: Scalar = quantity("m", "Length of the position error.")
    lost: Scalar = quantity("1", "True if a rotor is lost.", kind="flag")
    rotor: Scalar = quantity("1", "Index of the lost rotor, from 0; -1: none.", kind="count")


@record
class RotorLossTracking:
    """Uses the law for all rotors while they turn; after a loss, steers the axis about which the vehicle then spins.

        d = R.T (-A/|A|)      d' = d × w      s = d - axis
        d'' wanted = -ks s c - kd d'    c = d_z/max(d_z, 0.2)
        T = |A|/axis_z      M = J w' + w × (J w + h e3) + D_w w

    A is the force wanted as in the law for all rotors, by gains of its own; d is its direction in the body, down. The
    roll and pitch rates follow from s' and s'', exactly at every yaw rate [2, section IV]; yaw is as it comes. The
    axis is that of the relaxed hover [1], at which the thrust opposite the lost rotor is not zero but a part of the
    others': so it can push both ways. Without c, which is 1 but for a body on its side or upside down, the axis' mirror
    image would draw it in as the axis does: a craft that had tipped over would spin there, and fall. Rates and
    direction are those of `lead` later, for a body that spins turns by as much while links and rotors lag.

    A rotor counts as lost, for ever, when it has turned slower than `idle` for `patience`: the allocation lets no
    working rotor be so slow. The first one that is lost is flown without; a second one is not. From then on it stays
    where its reference was: three rotors that carry the craft have little left for a path.

    Frames:  W north-east-down, B body; `axes` points down in B.
    Valid:   a quadrotor whose rotors' speeds are measured. Not modelled: two lost rotors; drag of the body's way.
    Source:  [1] section III for the axis; [2] section IV for the inversion; its gains are chosen.
    """

    nominal: GeometricTracking = part("Law while all rotors turn.", default=GeometricTracking())
    axes: Any = quantity(
        "1", "Spin axes, down in B, for each rotor that may be lost (n, 3).", frame="B", default=UPRIGHT
    )
    ks: Scalar = quantity("1/s^2", "Gain of the axis error.", default=100.0, above=0)
    kd: Scalar = quantity("1/s", "Gain of the axis' rate.", default=18.0, above=0)
    kx: Scalar = quantity("1/s^2", "Gain of the position error.", default=3.0, above=0)
    kv: Scalar = quantity("1/s", "Gain of the velocity error.", default=2.8, above=0)
    lead: Scalar = quantity("s", "Time by which rates and direction are predicted.", default=0.02, low=0)
    idle: Scalar = quantity("rad/s", "Lowest speed of a working rotor.", default=43.0, above=0)
    patience: Scalar = quantity("s", "Time below that speed after which a rotor counts as lost.", default=0.012, low=0)

    reads: ClassVar[tuple[str, ...]] = ("position", "velocity", "attitude", "rate", "rotor_speed")

    @property
    def reference(self) -> Any:
        """Return the reference."""
        return self.nominal.reference

    def init(self, key: Key) -> RotorLossState:
        """Return the initial state: all rotors work."""
        return RotorLossState(np.float64(0.0), np.zeros(np.size(self.nominal.craft.rotors.spins)))

    def step(self, t: Any, state: RotorLossState, estimate: Estimate) -> tuple[RotorLossState, RotorLossOutput]:
        """Return the demand at integer time t."""
        x, dt = flyable_state(estimate), estimate.dt
        known = jnp.any(state.slow >= self.patience)
        slow = jnp.where(known, state.slow, jnp.where(jnp.abs(x.rotor_speed) < self.idle, state.slow + dt, 0.0))
        gone = slow >= self.patience
        lost = jnp.any(gone)
        wanted = self.reference.at(state.time)
        wanted = tree_where(lost, FixedPlace(wanted.place, wanted.heading).at(state.time), wanted)
        whole = self.nominal.track(wanted, x)
        demand, error = self._spin(wanted, x, gone)
        output = RotorLossOutput(
            demand=tree_where(lost, demand, whole.demand),
            position_error=whole.position_error,
            velocity_error=whole.velocity_error,
            attitude_error=jnp.where(lost, error, whole.attitude_error),
            distance=whole.distance,
            lost=lost,
            rotor=jnp.where(lost, jnp.argmax(gone), -1).astype(np.int32),
        )
        return RotorLossState(jnp.where(lost, state.time, state.time + dt), slow), output

    def _spin(self, wanted: SpatialPoint, x: Any, gone: Any) -> tuple[RotorDemand, Any]:
        """Return the demand without the first lost rotor, and 1 - cos of the angle between axis and direction."""
        craft = self.nominal.craft
        axis = jnp.asarray(self.axes)[jnp.argmax(gone)]
        ahead, yaw = self._look_ahead(x)
        slower = replace(self.nominal, kx=self.kx * craft.mass, kv=self.kv * craft.mass)
        R = quaternion.to_matrix(ahead.attitude)
        A = slower.command_force(wanted, x, R).value
        size = jnp.sqrt(jnp.maximum(A @ A, 1e-12))
        d, w = -(R.T @ A) / size, ahead.rate
        d_rate = jnp.cross(d, w)
        s = d - axis
        rest = -self.kd * d_rate - jnp.cross(d_rate, w)  # x and y of d'' = d' × w + d × w' give roll and pitch
        dz = jnp.where(jnp.abs(d[2]) < LEAST_COSINE, jnp.where(d[2] < 0, -LEAST_COSINE, LEAST_COSINE), d[2])
        pull = self.ks / jnp.maximum(d[2], LEAST_COSINE)  # attracted by the axis also upside down, not by its mirror
        roll = -pull * s[1] + (rest[1] + d[0] * yaw) / dz
        turn = jnp.stack([roll, pull * s[0] + (d[1] * yaw - rest[0]) / dz, yaw])
        J, spin = jnp.asarray(craft.inertia), craft.rotors.angular_momentum(x.rotor_speed)
        damping = jnp.asarray(craft.turning_drag) * w
        moment = J * turn + jnp.cross(w, J * w + spin * jnp.array([0.0, 0.0, 1.0])) + damping
        return RotorDemand(size / axis[2], moment, ~gone), 1 - d @ axis

    def _look_ahead(self, x: Any) -> tuple[Any, Any]:
        """Return the state `lead` later, at the present rotor speeds, and the yaw acceleration (rad/s^2)."""
        turn = self.nominal.craft.accelerations(x, RotorSpeeds(x.rotor_speed))[1]
        rate = x.rate + self.lead * turn
        attitude = quaternion.retract(x.attitude, self.lead / 2 * (x.rate + rate))
        return replace(x, rate=rate, attitude=attitude), turn[2]
