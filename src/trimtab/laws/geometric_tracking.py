"""Position tracking by thrust along one body axis: geometric control on SE(3), which has no singular attitude.

[1] is T. Lee, M. Leok, N. H. McClamroch, "Geometric tracking control of a quadrotor UAV on SE(3)", CDC 2010.
"""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np

from trimtab.core import quaternion
from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.rng import Key
from trimtab.core.rotation import cross_matrix
from trimtab.core.signals import Estimate
from trimtab.core.spatial_reference import FixedPlace, SpatialPoint
from trimtab.vehicles.quadrotor import Multirotor, RotorDemand

DOWN = np.array([0.0, 0.0, 1.0])
LEAST_LENGTH = 1e-6
"""Lower bound of the length by which a vector is divided to normalise it."""


UNLIMITED = 1e9
"""Value of the force limit (N) that means no limit."""


class Motion3(NamedTuple):
    """Vector and its first two time derivatives, each (3,)."""

    value: Any
    rate: Any
    acceleration: Any


class AttitudeCommand(NamedTuple):
    """Reference attitude R_WC (3, 3), its angular rate (3,) (rad/s) and angular acceleration (3,) (rad/s^2), in C."""

    R: Any
    rate: Any
    turn: Any


@record
class GeometricTrackingOutput:
    """Demand and errors of the law `GeometricTracking`. Source: [1] section III."""

    demand: RotorDemand = part("Demanded thrust and moments of the rotors.")
    position_error: Any = quantity("m", "Position error: position minus reference.", frame="W", shape=(3,))
    velocity_error: Any = quantity("m/s", "Velocity error: velocity minus reference.", frame="W", shape=(3,))
    attitude_error: Scalar = quantity("1", "Attitude error Psi: 0 at the reference attitude, 2 at half a turn from it.")
    distance: Scalar = quantity("m", "Length of the position error.")


@record
class GeometricTrackingState:
    """State of the law `GeometricTracking`: time since its start. Source: this module."""

    time: Scalar = quantity("s", "Time since the law started.", default=0.0)


@record
class GeometricTracking:
    """Law that tracks a position and a heading by thrust and moments, from almost every initial state.

        f = -(A · R e3)      A = -kx ex - kv ev - m g e3 + m x_d''
        M = -kR eR - kW eW + W × J W - J (W^ R.T Rc Wc - R.T Rc Wc')
        Psi = tr(I - Rc.T R)/2      eR = (Rc.T R - R.T Rc)v/2      eW = W - R.T Rc Wc

    x_d is the reference position, ex and ev are the errors of position and velocity, R is the attitude, W the angular
    rate and J the inertia. Rc is the reference attitude. The third axis of Rc is -A/|A|, and the first axis of Rc is as
    near as possible to the reference heading. The reference rates Wc and Wc' follow from the vehicle model, without
    drag and actuator lag. From Psi < 1 the errors decay exponentially, from Psi < 2 they converge, if the initial eW is
    bounded as in [1, propositions 2 to 4].

    Frames:  W north-east-down, B body.
    Valid:   if A ≠ 0 (the reference is not in free fall) and the reference heading is not along the thrust.
    Source:  [1] eqs. 12 to 21, with its gains.
    """

    craft: Multirotor = part("Vehicle model used by the law: mass, inertia and gravity.", default=Multirotor())
    reference: Any = part("Reference position in space, as a function of time.", default=FixedPlace())
    kx: Scalar = quantity("N/m", "Gain of the position error.", default=16 * 4.34, above=0, source="[1] 16 m")
    kv: Scalar = quantity("N s/m", "Gain of the velocity error.", default=5.6 * 4.34, above=0, source="[1] 5.6 m")
    kR: Scalar = quantity("N m", "Gain of the attitude error.", default=8.81, above=0, source="[1]")
    kW: Scalar = quantity("N m s", "Gain of the angular rate error.", default=2.54, above=0, source="[1]")
    most: Scalar = quantity(
        "N", "Maximum magnitude of the feedback force -kx ex - kv ev. [1] has no limit.", default=UNLIMITED, above=0
    )

    reads: ClassVar[tuple[str, ...]] = ("position", "velocity", "attitude", "rate")

    def init(self, key: Key) -> GeometricTrackingState:
        """Return the initial state, at time zero."""
        return GeometricTrackingState()

    def step(
        self, t: Any, state: GeometricTrackingState, estimate: Estimate
    ) -> tuple[GeometricTrackingState, GeometricTrackingOutput]:
        """Return the demand at time t (unit: 100 ns)."""
        output = self.track(self.reference.at(state.time), flyable_state(estimate))
        return GeometricTrackingState(state.time + estimate.dt), output

    def track(self, wanted: SpatialPoint, x: Any) -> GeometricTrackingOutput:
        """Return the demand for a state x with the fields that the law reads, and for a reference point."""
        R = quaternion.to_matrix(x.attitude)
        A = self.command_force(wanted, x, R)
        thrust = -A.value @ R[:, 2]
        command = command_attitude(A, heading_vector(wanted))
        Q = R.T @ command.R
        eR = _vee(Q.T - Q) / 2
        eW = x.rate - Q @ command.rate
        J = jnp.asarray(self.craft.inertia)
        feedforward = jnp.cross(x.rate, J * x.rate) - J * (jnp.cross(x.rate, Q @ command.rate) - Q @ command.turn)
        error = x.position - wanted.place
        return GeometricTrackingOutput(
            demand=RotorDemand(
                thrust=thrust,
                moment=-self.kR * eR - self.kW * eW + feedforward,
                working=jnp.ones(jnp.shape(self.craft.rotors.spins), bool),
            ),
            position_error=error,
            velocity_error=x.velocity - wanted.velocity,
            attitude_error=(3 - Q[0, 0] - Q[1, 1] - Q[2, 2]) / 2,
            distance=jnp.sqrt(error @ error + 1e-24),
        )

    def command_force(self, wanted: SpatialPoint, x: Any, R: Any) -> Motion3:
        """Return the force A (N) in W, and its time derivatives while the model moves under the resulting thrust.

        The k-th derivative of A needs the k-th derivative of the velocity, which follows from the (k - 1)-th derivative
        of A.
        """
        m, g = self.craft.mass, self.craft.gravity * DOWN
        ex, ev = x.position - wanted.place, x.velocity - wanted.velocity
        o = jnp.zeros(3)
        F = Motion3(-self.kx * ex - self.kv * ev, o, o)
        A = self._limit(F).value - m * g + m * wanted.acceleration
        axis, f = R[:, 2], -A @ R[:, 2]
        ea = g - f / m * axis - wanted.acceleration
        F = F._replace(rate=-self.kx * ev - self.kv * ea)
        A1 = self._limit(F).rate + m * wanted.jerk
        axis_rate = R @ jnp.cross(x.rate, DOWN)
        f_rate = -A1 @ axis - A @ axis_rate
        ej = -(f_rate * axis + f * axis_rate) / m - wanted.jerk
        F = F._replace(acceleration=-self.kx * ea - self.kv * ej)
        return Motion3(A, A1, self._limit(F).acceleration + m * wanted.snap)

    def _limit(self, F: Motion3) -> Motion3:
        """Return a feedback force F limited to the length `most`, and its first two time derivatives."""
        too_long = F.value @ F.value > self.most**2
        return Motion3(*(jnp.where(too_long, self.most * u, v) for u, v in zip(_direction(F), F, strict=True)))


def flyable_state(estimate: Estimate) -> Any:
    """Return the estimated state. Before the first estimate (a quaternion of zeros) the attitude is level, nose to the
    north.
    """
    x = estimate.state
    return replace(x, attitude=jnp.where(estimate.valid, x.attitude, jnp.array([1.0, 0.0, 0.0, 0.0])))


def heading_vector(wanted: SpatialPoint) -> Motion3:
    """Return the level unit vector along the reference heading, and its derivatives, in W."""
    c, s, o = jnp.cos(wanted.heading), jnp.sin(wanted.heading), jnp.zeros_like(wanted.heading)
    along, across = jnp.stack([c, s, o]), jnp.stack([-s, c, o])
    w = wanted.heading_rate
    return Motion3(along, w * across, wanted.heading_acceleration * across - w**2 * along)


def command_attitude(A: Motion3, heading: Motion3) -> AttitudeCommand:
    """Return the attitude with the third axis -A/|A| and the first axis nearest to the heading [1, eqs. 12 and 13]."""
    b3 = _direction(Motion3(-A.value, -A.rate, -A.acceleration))
    b2 = _direction(_cross(b3, heading))
    b1 = _cross(b2, b3)
    R, R1, R2 = (jnp.stack(axes, axis=1) for axes in zip(b1, b2, b3, strict=True))
    rate = _vee(R.T @ R1)
    spin = cross_matrix(rate)
    return AttitudeCommand(R, rate, _vee(R.T @ R2 - spin @ spin))


def _direction(v: Motion3) -> Motion3:
    """Return the unit vector v/|v| and its first two time derivatives."""
    n = jnp.sqrt(jnp.maximum(v.value @ v.value, LEAST_LENGTH**2))
    u = v.value / n
    n1 = u @ v.rate
    u1 = (v.rate - n1 * u) / n
    n2 = u1 @ v.rate + u @ v.acceleration
    return Motion3(u, u1, (v.acceleration - n2 * u - 2 * n1 * u1) / n)


def _cross(a: Motion3, b: Motion3) -> Motion3:
    """Return the cross product a × b and its first two time derivatives."""
    cross = jnp.cross
    first = cross(a.rate, b.value) + cross(a.value, b.rate)
    second = cross(a.acceleration, b.value) + 2 * cross(a.rate, b.rate) + cross(a.value, b.acceleration)
    return Motion3(cross(a.value, b.value), first, second)


def _vee(S: Any) -> Any:
    """Return v (3,), whose cross-product matrix is the antisymmetric part of S (3, 3)."""
    return jnp.stack([S[2, 1] - S[1, 2], S[0, 2] - S[2, 0], S[1, 0] - S[0, 1]]) / 2
