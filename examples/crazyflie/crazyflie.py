"""The Crazyflie of Crazyflow as a vehicle. Its identified model is called unchanged; only axes and units are converted.

Install Crazyflow: pip install crazyflow==0.4.0, and set SCIPY_ARRAY_API=1. Source: Crazyflow 0.4 (MIT).
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from crazyflow.drones import Drone
from crazyflow.dynamics.core import load_fn_params
from crazyflow.dynamics.first_principles import dynamics

from trimtab.core import quaternion
from trimtab.core.record import Scalar, quantity, record, replace
from trimtab.core.rotation import to_euler
from trimtab.core.signals import Motion
from trimtab.vehicles.quadrotor import MultirotorState, RotorSpeeds

DRONE = Drone.cf2x_L250
FIXED = load_fn_params(dynamics, DRONE)
"""Crazyflow's parameters of the drone. Those that this vehicle declares as quantities can be changed."""
FLIP = np.array([1.0, -1.0, -1.0])
"""Converts forward-left-up to forward-right-down, north-west-up to north-east-down, and back."""
RPM, FLOOR = 60 / (2 * np.pi), 0.001


def crazyflow_state(x: MultirotorState) -> dict[str, Any]:
    """Return a state in Crazyflow's axes (left, up), order of a quaternion (scalar last) and unit of speed (1/min)."""
    q = jnp.asarray(x.attitude)
    quat = jnp.stack([q[1], -q[2], -q[3], q[0]])
    return {"pos": FLIP * x.position, "quat": quat, "vel": FLIP * x.velocity, "ang_vel": FLIP * x.rate}


@record
class Crazyflie:
    """Crazyflie 2.x, identified by Crazyflow. Frames: W north-east-down, B forward-right-down. Source: Crazyflow."""

    mass: Scalar = quantity("kg", "Mass.", default=float(FIXED["mass"]), above=0)
    inertia: Any = quantity(
        "kg m^2", "Moments of inertia about x, y, z.", shape=(3,), default=np.diag(FIXED["J"]), above=0
    )
    drag: Any = quantity(
        "N s/m", "Drag per speed along x, y, z.", shape=(3,), default=-np.diag(FIXED["drag_matrix"]), low=0
    )

    MAV_TYPE: ClassVar[str] = "QUADROTOR"
    QUATERNIONS: ClassVar[tuple[str, ...]] = ("attitude",)

    def dynamics(self, t: Any, x: MultirotorState, u: RotorSpeeds) -> MultirotorState:
        """Return the time derivative of the state: Crazyflow's, in our axes and units."""
        J, drag = jnp.asarray(self.inertia), -jnp.asarray(self.drag)
        own = {"mass": self.mass, "J": jnp.diag(J), "J_inv": jnp.diag(1 / J), "drag_matrix": jnp.diag(drag)}
        state = crazyflow_state(x)
        _, _, acceleration, turn, spin = dynamics(
            **state, cmd=u.speed * RPM, rotor_vel=x.rotor_speed * RPM, **FIXED | own
        )
        return MultirotorState(
            position=x.velocity,
            velocity=FLIP * acceleration,
            attitude=quaternion.rate(x.attitude, x.rate),
            rate=FLIP * turn,
            rotor_speed=spin / RPM,
        )

    def after_step(self, t: Any, x: MultirotorState) -> MultirotorState:
        """Return the state with its quaternion normalised. The ground stops the craft, as in Crazyflow."""
        is_below, depth = x.position[2] > FLOOR, jnp.minimum(x.position[2], FLOOR)
        return replace(
            x,
            position=jnp.stack([x.position[0], x.position[1], depth]),
            velocity=jnp.where(is_below, 0.0, x.velocity),
            attitude=quaternion.normalise(x.attitude),
        )

    def motion(self, t: Any, x: MultirotorState, u: RotorSpeeds) -> Motion:
        """Return the motion that sensors measure."""
        R, d = quaternion.to_matrix(x.attitude), self.dynamics(t, x, u)
        return Motion(t, x.position, to_euler(R), R.T @ x.velocity, x.rate, R.T @ d.velocity, d.rate)
