"""Position tracking after the loss of a rotor: the quadrotor spins without yaw control, and tilts its spin axis.

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
"""Smallest magnitude used for the cosine of the angle between the demanded direction and the body's z axis."""
UPRIGHT = np.tile([0.0, 0.0, 1.0], (4, 1))


@record
class RotorLossState:
    """State of the law `RotorLossTracking`: time, and each rotor's time below idle speed. Source: this module."""

    time: Scalar = quantity("s", "Time since the law started. Stops at the loss of a rotor.")
    slow: Any = quantity(
        "s", "Time that each rotor has been below idle speed (n,). Stays constant after the loss of a rotor."
    )


@record
class RotorLossOutput:
    """Demand and errors of the law `RotorLossTracking`. Source: this module."""

    demand: RotorDemand = part("Demanded thrust and moments, and a flag for each rotor that works.")
    position_error: Any = quantity("m", "Position error: position minus reference.", frame="W", shape=(3,))
    velocity_error: Any = quantity("m/s", "Velocity error: velocity minus reference.", frame="W", shape=(3,))
    attitude_error: Scalar = quantity(
        "1",
        "Attitude error: Psi of the nominal law while all rotors work; 1 - cos(angle of the spin axis error) "
        "after a loss.",
    )
    distance: Scalar = quantity("m", "Length of the position error.")
    lost: Scalar = quantity("1", "True after the loss of a rotor.", kind="flag")
    rotor: Scalar = quantity("1", "Index of the lost rotor, counted from 0; -1 if all rotors work.", kind="count")


@record
class RotorLossTracking:
    """Law that tracks with `nominal` while all rotors work, and steers the spin axis after the loss of a rotor.

        d = R.T (-A/|A|)      d' = d × w      s = d - axis
        demanded d'' = -ks s c - kd d'    c = d_z/max(d_z, 0.2)
        T = |A|/axis_z      M = J w' + w × (J w + h e3) + D_w w

    A is the demanded force as in `nominal`, with the gains kx and kv. d is the direction of -A in body axes, R the
    attitude, w the angular rate, and axis the spin axis. The roll and pitch accelerations in w' follow from the
    demanded d'', exactly at every yaw rate [2, section IV]. Yaw is not controlled. The axis is that of the relaxed
    hover [1]: the rotor opposite the lost one gives a fraction of the thrust of the others, so its thrust can rise and
    fall. c is 1 except for a body on its side or upside down. Without c the mirror image of the axis would be stable
    too: a tipped craft would spin about it, and fall. Rates and direction are predicted over `prediction_time`, because
    the body turns during the delay of links and rotors.

    A rotor that turns slower than `idle` for `patience` counts as lost for the rest of the run. The allocation never
    commands a working rotor below `idle`. The law handles the loss of one rotor, not of a second. After the loss the
    reference stays at its last position, because three rotors that carry the craft have little thrust left to follow a
    path.

    Frames:  W north-east-down, B body; `axes` points down in B.
    Valid:   a quadrotor whose rotors' speeds are measured. Not modelled: two lost rotors; drag of the body's motion.
    Source:  [1] section III for the axis; [2] section IV for the inversion. The gains are our own choice.
    """

    nominal: GeometricTracking = part("Law used while all rotors work.", default=GeometricTracking())
    axes: Any = quantity(
        "1", "Spin axis after the loss of each rotor, pointing down in B (n, 3).", frame="B", default=UPRIGHT
    )
    ks: Scalar = quantity("1/s^2", "Gain ks of the spin axis error.", default=100.0, above=0)
    kd: Scalar = quantity("1/s", "Gain kd of the rate of the spin axis error.", default=18.0, above=0)
    kx: Scalar = quantity("1/s^2", "Gain kx of the position error after a loss.", default=3.0, above=0)
    kv: Scalar = quantity("1/s", "Gain kv of the velocity error after a loss.", default=2.8, above=0)
    prediction_time: Scalar = quantity(
        "s", "Prediction time of rates and direction, for the delay of links and rotors.", default=0.02, low=0
    )
    idle: Scalar = quantity("rad/s", "Idle speed: minimum speed of a working rotor.", default=43.0, above=0)
    patience: Scalar = quantity("s", "Time below idle speed after which a rotor counts as lost.", default=0.012, low=0)

    reads: ClassVar[tuple[str, ...]] = ("position", "velocity", "attitude", "rate", "rotor_speed")

    @property
    def reference(self) -> Any:
        """Return the reference of `nominal`, the law that is used while all rotors work."""
        return self.nominal.reference

    def init(self, key: Key) -> RotorLossState:
        """Return the initial state: all rotors work."""
        return RotorLossState(np.float64(0.0), np.zeros(np.size(self.nominal.craft.rotors.spins)))

    def step(self, t: Any, state: RotorLossState, estimate: Estimate) -> tuple[RotorLossState, RotorLossOutput]:
        """Return the demand at time t (unit: 100 ns)."""
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
        """Return the demand after the loss of a rotor, and 1 - cos of the angle between spin axis and d."""
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
        rest = -self.kd * d_rate - jnp.cross(d_rate, w)  # x, y of d'' = d' × w + d × w' give roll and pitch
        dz = jnp.where(jnp.abs(d[2]) < LEAST_COSINE, jnp.where(d[2] < 0, -LEAST_COSINE, LEAST_COSINE), d[2])
        pull = self.ks / jnp.maximum(d[2], LEAST_COSINE)  # to the axis even if upside down, not to its mirror image
        roll = -pull * s[1] + (rest[1] + d[0] * yaw) / dz
        turn = jnp.stack([roll, pull * s[0] + (d[1] * yaw - rest[0]) / dz, yaw])
        J, spin = jnp.asarray(craft.inertia), craft.rotors.angular_momentum(x.rotor_speed)
        damping = jnp.asarray(craft.turning_drag) * w
        moment = J * turn + jnp.cross(w, J * w + spin * jnp.array([0.0, 0.0, 1.0])) + damping
        return RotorDemand(size / axis[2], moment, ~gone), 1 - d @ axis

    def _look_ahead(self, x: Any) -> tuple[Any, Any]:
        """Return the state predicted by `prediction_time` at the present rotor speeds.

        The second result is the yaw acceleration (rad/s^2).
        """
        turn = self.nominal.craft.accelerations(x, RotorSpeeds(x.rotor_speed))[1]
        rate = x.rate + self.prediction_time * turn
        attitude = quaternion.retract(x.attitude, self.prediction_time / 2 * (x.rate + rate))
        return replace(x, rate=rate, attitude=attitude), turn[2]
