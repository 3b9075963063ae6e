"""The controller of the Crazyflie's firmware (Mellinger, Kumar 2011) as a law, by Crazyflow's unchanged functions."""

import sys
from pathlib import Path
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from crazyflow.control.core import load_fn_params
from crazyflow.control.mellinger import attitude2force_torque, force_torque2rotor_vel, state2attitude

sys.path.insert(0, str(Path(__file__).parent))
from crazyflie import DRONE, FLIP, RPM, crazyflow_state

from trimtab.core.record import Scalar, option, part, quantity, record
from trimtab.core.spatial_reference import FixedPlace
from trimtab.vehicles.quadrotor import RotorSpeeds

FUNCTIONS = (state2attitude, attitude2force_torque, force_torque2rotor_vel)
POSITION, ATTITUDE, MIXER = (load_fn_params(f, DRONE) for f in FUNCTIONS)


@record
class MellingerState:
    """State of the law, in Crazyflow's axes. Source: Crazyflow."""

    steps: Scalar = quantity("1", "Number of steps.", kind="count", default=0)
    time: Scalar = quantity("s", "Time since the start.", default=0.0)
    command: Any = quantity("1", "Commanded attitude (rad, 3) and thrust (N).", shape=(4,), default=np.zeros(4))
    position_integral: Any = quantity("m s", "Integral of the position error.", shape=(3,), default=np.zeros(3))
    attitude_integral: Any = quantity("s", "Integral of the attitude error.", shape=(3,), default=np.zeros(3))
    rate: Any = quantity("rad/s", "Angular velocity at the last step.", shape=(3,), default=np.zeros(3))


@record
class MellingerOutput:
    """Demand of the law and distance from the reference. Source: Crazyflow."""

    demand: RotorSpeeds = part("Demanded speeds of the rotors.")
    distance: Scalar = quantity("m", "Distance from the reference position.")


@record
class Mellinger:
    """Track a position and a heading. The position loop runs once in `every` steps. Source: Crazyflow."""

    reference: Any = part("Reference position.", default=FixedPlace())
    kp: Any = quantity("N/m", "Gains of the position error.", shape=(3,), default=POSITION["kp"], low=0)
    kd: Any = quantity("N s/m", "Gains of the velocity error.", shape=(3,), default=POSITION["kd"], low=0)
    every: int = option("Steps of the attitude loop for each step of the position loop.", default=5)

    reads: ClassVar[tuple[str, ...]] = ("position", "velocity", "attitude", "rate")

    def init(self, key: Any) -> MellingerState:
        """Return the initial state."""
        return MellingerState()

    def step(self, t: Any, state: MellingerState, estimate: Any) -> tuple[MellingerState, MellingerOutput]:
        """Return the demanded rotor speeds."""
        x, goal, dt = crazyflow_state(estimate.state), self.reference.at(state.time), estimate.dt
        half, rate = -goal.heading / 2, 1 / dt
        yaw = jnp.stack([0.0 * half, 0.0 * half, jnp.sin(half), jnp.cos(half)])
        wanted = [FLIP * v for v in (goal.place, goal.velocity, goal.acceleration)]
        setpoint = jnp.concatenate([*wanted, yaw, jnp.zeros(3)])
        gains = POSITION | {"kp": jnp.asarray(self.kp), "kd": jnp.asarray(self.kd)}
        now = state.steps % self.every == 0
        command, integral = state2attitude(
            x["pos"], x["quat"], x["vel"], setpoint, state.position_integral, rate / self.every, **gains
        )
        command = jnp.where(now, command, state.command)
        integral = jnp.where(now, integral, state.position_integral)
        force, torque, turn = attitude2force_torque(
            x["quat"], x["ang_vel"], command, state.rate, state.attitude_integral, rate, **ATTITUDE
        )
        rpm = force_torque2rotor_vel(force, torque, **MIXER)
        error = estimate.state.position - goal.place
        after = MellingerState(state.steps + 1, state.time + dt, command, integral, turn, x["ang_vel"])
        return after, MellingerOutput(RotorSpeeds(rpm / RPM), jnp.sqrt(error @ error + 1e-24))
