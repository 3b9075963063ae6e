"""Local coordinates of a body over the rotating earth: position, velocity over the ground, and attitude relative to
north-east-down.

`vehicles.rigid_body` integrates in an inertial frame, in which level flight is not an equilibrium. For trim and linear
models, this module expresses the same dynamics exactly in local coordinates, with the earth's rotation and curvature.
This code runs offline.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core import quaternion
from trimtab.core.quantity import children, is_record, records
from trimtab.core.record import FAST_COMPILE_OPTIONS, Scalar, quantity, record, replace
from trimtab.environment.earth import Earth
from trimtab.environment.geodetic import ned_axes
from trimtab.vehicles.rigid_body import RigidBody, RigidBodyState


@record
class LocalFlightState:
    """State of a vehicle relative to the ground below it. Frames: N is north-east-down at the vehicle, B the body axes.

    Source: Stevens, Lewis, Johnson, "Aircraft control and simulation", 3rd ed., section 1.7.
    """

    latitude: Scalar = quantity("rad", "Geodetic latitude.", kind="angle")
    longitude: Scalar = quantity("rad", "Longitude.", kind="angle")
    height: Scalar = quantity("m", "Height above the ellipsoid.")
    velocity: Any = quantity("m/s", "Velocity over the ground.", frame="B", shape=(3,))
    attitude: Any = quantity("1", "Quaternion q_NB, scalar first.", frame="NB", shape=(4,))
    rate: Any = quantity("rad/s", "Angular velocity of B relative to the earth.", frame="B", shape=(3,))


class LocalFlight(NamedTuple):
    """Vehicle whose RigidBodyState is expressed as a LocalFlightState.

    vehicle: the original vehicle.  earth: model of the earth.  path: path of the RigidBodyState in the vehicle's state,
    or "" if the vehicle's state is itself a RigidBodyState.
    """

    vehicle: Any
    earth: Earth
    path: str

    def to_local(self, t: Any, x: Any) -> Any:
        """Return the vehicle's state at the time t (s) in local coordinates."""
        return _with_record(x, self.path, self._localise(t, _record_at(x, self.path)))

    def to_inertial(self, t: Any, x: Any) -> Any:
        """Return the vehicle's original state, given its state in local coordinates at the time t (s)."""
        return _with_record(x, self.path, self._globalise(t, _record_at(x, self.path)))

    def dynamics(self, t: Any, x: Any, u: Any) -> Any:
        """Return the time derivative of the local state at the time t (s)."""
        own = jax.tree.map(lambda v: jnp.asarray(v, jnp.float64), self.to_inertial(t, x))
        rate = jax.tree.map(
            lambda v, d: jnp.broadcast_to(jnp.asarray(d, jnp.float64), jnp.shape(v)),
            own,
            self.vehicle.dynamics(t, own, u),
        )
        now = jnp.asarray(t, jnp.float64)
        return jax.jvp(self.to_local, (now, own), (jnp.ones_like(now), rate))[1]

    def _localise(self, t: Any, x: RigidBodyState) -> LocalFlightState:
        R_EI = self.earth.to_inertial(t).T
        latitude, longitude, height = self.earth.geodetic(R_EI @ x.position)
        R_NI = ned_axes(latitude, longitude).T @ R_EI
        R_IB = quaternion.to_matrix(x.attitude)
        v = x.velocity - self.earth.rate * jnp.stack([-x.position[1], x.position[0], jnp.zeros_like(x.position[0])])
        q_NB = quaternion.from_matrix(R_NI @ R_IB)
        return LocalFlightState(latitude, longitude, height, R_IB.T @ v, q_NB, x.rate - R_IB.T @ self._turn())

    def _globalise(self, t: Any, x: LocalFlightState) -> RigidBodyState:
        R_IE = self.earth.to_inertial(t)
        p = R_IE @ self.earth.place(x.latitude, x.longitude, x.height)
        R_IN = R_IE @ ned_axes(jnp.asarray(x.latitude, float), jnp.asarray(x.longitude, float))
        R_IB = R_IN @ quaternion.to_matrix(x.attitude)
        v = R_IB @ x.velocity + self.earth.rate * jnp.stack([-p[1], p[0], jnp.zeros_like(p[0])])
        return RigidBodyState(p, v, quaternion.from_matrix(R_IB), x.rate + R_IB.T @ self._turn())

    def _turn(self) -> Any:
        return jnp.stack([0 * self.earth.rate, 0 * self.earth.rate, jnp.asarray(self.earth.rate, jnp.float64)])


def fly_locally(vehicle: Any, x: Any, *, t: float = 0.0) -> tuple[Any, Any]:
    """Convert a vehicle over the rotating earth, and its state, to local coordinates. Other vehicles are not
    changed."""
    inside = [path for path, own in records(x) if isinstance(own, RigidBodyState)]
    bodies = [own for _, own in records(vehicle) if isinstance(own, RigidBody)]
    if len(inside) != 1 or not bodies:
        return vehicle, x
    local = LocalFlight(vehicle, bodies[0].earth, inside[0])
    return local, jax.tree.map(np.asarray, jax.jit(local.to_local, compiler_options=FAST_COMPILE_OPTIONS)(t, x))


def _record_at(x: Any, path: str) -> Any:
    for name in path.split(".") if path else ():
        x = next(child for own, child, _ in children(x) if own == name)
    return x


def _with_record(x: Any, path: str, new: Any) -> Any:
    if not path:
        return new
    head, _, rest = path.partition(".")
    child = _with_record(_record_at(x, head), rest, new)
    if is_record(x):
        return replace(x, **{head: child})
    return {**x, head: child}
