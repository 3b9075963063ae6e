"""Hover of a multirotor after the loss of a rotor, without yaw control: the craft spins about an axis that points down.

This code runs offline and uses scipy.

[1] is M. W. Mueller, R. D'Andrea, "Stability and control of a quadrocopter despite the complete loss of one, two, or
three propellers", ICRA 2014.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.optimize import root

from trimtab.core.errors import InputError
from trimtab.core.record import FAST_COMPILE_OPTIONS, to_arrays
from trimtab.vehicles.quadrotor import Multirotor, MultirotorState, RotorSpeeds

RESIDUAL = 1e-9
"""Largest accepted residual: of a force, relative to the weight; of a moment, relative to weight times longest arm."""


class RelaxedHover(NamedTuple):
    """Steady spin of a multirotor that has lost one rotor.

    axis: unit vector in B (3,) that points down during the spin. rate: angular velocity in B (3,) (rad/s), along axis.
    thrusts: thrust of each rotor (n,) (N), 0 for the lost rotor.
    """

    axis: Any
    rate: Any
    thrusts: Any


def find_relaxed_hover(craft: Multirotor, lost: int, ratio: float = 0.5) -> RelaxedHover:
    """Find the spin in which the mean thrust without the rotor `lost` balances the weight [1, eqs. 16 to 23].

    Args:
        craft: a quadrotor.
        lost: index of the lost rotor.
        ratio: thrust of the rotor opposite the lost rotor, relative to the thrust of each of the other two rotors.

    Raises: InputError if the craft has no drag about z or does not have four rotors, or if no such spin is found.
    """
    spins = np.asarray(craft.rotors.spins)
    if len(spins) != 4 or not float(np.asarray(craft.turning_drag)[2]) > 0:
        problem = f"got {len(spins)} rotors, and a drag of {np.asarray(craft.turning_drag)[2]:g} N m s about z"
        fix = "give a quadrotor whose turning_drag[2] is above 0; without drag the spin has no limit"
        raise InputError("relaxed hover", problem, fix=fix)
    opposite = (lost + 2) % 4
    shares = np.where(np.arange(4) == opposite, ratio, 1.0)
    shares[lost] = 0.0
    weight = float(craft.mass) * float(craft.gravity)
    craft, arm = to_arrays(craft), float(np.abs(np.asarray(craft.rotors.places)).max())

    def equations(unknown: Any) -> Any:
        rate, thrust = unknown[:3], unknown[3]
        down = np.sign(rate[2]) * rate / np.linalg.norm(rate)
        speed = np.asarray(craft.rotors.speeds(shares * thrust))
        turn = np.asarray(_angular_acceleration(craft, rate, speed))
        lift = shares.sum() * thrust * down[2] / weight - 1
        return np.append(turn * np.asarray(craft.inertia) / (weight * arm), lift)

    each = weight / shares.sum()
    spin = -float(craft.rotors.torque_ratio) * each * float(spins @ shares) / float(craft.turning_drag[2])
    found: Any = root(equations, [0.01, 0.01, spin, each], tol=1e-14)
    if np.abs(found.fun).max() > RESIDUAL or found.x[3] <= 0:
        problem = f"no steady spin was found; a residual of {np.abs(found.fun).max():.2g} of the weight remains"
        raise InputError("relaxed hover", problem, fix=f"give another ratio than {ratio:g}, e.g. ratio=0.3")
    rate = found.x[:3]
    return RelaxedHover(np.sign(rate[2]) * rate / np.linalg.norm(rate), rate, shares * found.x[3])


@partial(jax.jit, compiler_options=FAST_COMPILE_OPTIONS)
def _angular_acceleration(craft: Multirotor, rate: Any, speed: Any) -> Any:
    """Return the angular acceleration in B (3,) of a craft that is level, does not translate, turns at `rate`, and has
    rotors that turn at `speed`."""
    x = MultirotorState(np.zeros(3), np.zeros(3), np.array([1.0, 0, 0, 0]), rate, speed)
    return craft.accelerations(x, RotorSpeeds(speed))[1]


def relaxed_axes(craft: Multirotor, ratio: float = 0.5) -> Any:
    """Return the axis that points down during the spin, for the loss of each rotor (4, 3)."""
    return np.stack([find_relaxed_hover(craft, lost, ratio).axis for lost in range(4)])
