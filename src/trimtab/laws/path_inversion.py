"""Exact inversion: fuel ratio and elevator angle for given h'' and V', and the rates of the internal states."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from trimtab.core.record import Scalar, quantity, record
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput

STEEPEST = 0.99
"""Largest sine of the flight path angle used in the inversion. On a steeper path the lift hardly changes h''."""


class PathInversion(NamedTuple):
    """Input u = (Phi, delta_e): fuel ratio and elevator angle (rad) that cause the accelerations (h'', V') = v.

    solvable: False if no elevator angle gives v (u then has the nearest angle), or if the path is steeper than
    STEEPEST.  slope: d(normal force)/d(delta_e) (lbf/ft), zero at the edge of solvability.
    """

    u: HypersonicInput
    solvable: Any
    slope: Any


@record
class InputLimits:
    """Limits of engine and elevator. Source: our own choice (docs page), because [1] prints no limits."""

    Phi_low: Scalar = quantity("1", "Minimum fuel ratio.", default=0.02, low=0)
    Phi_high: Scalar = quantity("1", "Maximum fuel ratio.", default=1.5, above=0)
    delta_low: Scalar = quantity("rad", "Minimum elevator angle: -20 deg.", default=-0.3490658503988659, kind="angle")
    delta_high: Scalar = quantity("rad", "Maximum elevator angle: 25.8 deg.", default=0.450294947014537, kind="angle")

    def bounds(self) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
        """Return the limits of fuel ratio and elevator: (minima, maxima)."""
        return (self.Phi_low, self.delta_low), (self.Phi_high, self.delta_high)

    def clip(self, u: HypersonicInput) -> tuple[HypersonicInput, Any]:
        """Return the input within the limits, and True if it was clipped."""
        Phi = jnp.clip(u.Phi, self.Phi_low, self.Phi_high)
        delta_e = jnp.clip(u.delta_e, self.delta_low, self.delta_high)
        return HypersonicInput(Phi, delta_e), (Phi != u.Phi) | (delta_e != u.delta_e)


def solve_elevator(
    craft: Hypersonic, h: Any, h_rate: Any, V: Any, alpha: Any, v1: Any, v2: Any
) -> tuple[Any, Any, Any]:
    """Return the elevator angle delta_e (rad), True if a solution exists, and the equation's slope in delta_e.

    Elimination of the thrust from the two accelerations leaves an equation that is quadratic in the elevator:

        (m (v2 + g sin gamma) + D(delta)) tan alpha + L(delta) - m (a_n + g cos gamma) = 0

    with a_n = (v1 - v2 sin gamma)/cos gamma. The result is the root that stays finite as alpha goes to zero, in a form
    without cancellation. Without a real root, it is the elevator angle with the smallest residual. [1] instead treats
    the elevator angle in the drag as constant, which halves the slope.
    """
    air, sine = craft.forces.aerodynamics, jnp.clip(h_rate / V, -STEEPEST, STEEPEST)
    cosine, tangent = jnp.sqrt(1 - sine * sine), jnp.tan(alpha)
    pressed = craft.forces.dynamic_pressure(h, V) * air.S
    normal = (v1 - v2 * sine) / cosine + craft.g * cosine
    qbar = pressed / air.S
    still = (craft.m * (v2 + craft.g * sine) + air.drag(qbar, alpha, 0.0)) * tangent + air.lift(qbar, alpha, 0.0)
    c = still - craft.m * normal
    b = pressed * (air.CD_d * tangent + air.CL_d)
    a = pressed * air.CD_d2 * tangent
    inside = b * b - 4 * a * c
    root = jnp.sqrt(jnp.maximum(inside, 0.0))
    real = inside >= 0
    delta_e = jnp.where(real, -2 * c / (b + root), -b / jnp.where(real, 1.0, 2 * a))
    return delta_e, real & (jnp.abs(h_rate) <= STEEPEST * V), root


def solve_fuel_ratio(craft: Hypersonic, h: Any, h_rate: Any, V: Any, alpha: Any, v2: Any, delta_e: Any) -> Any:
    """Return the fuel ratio Phi that gives V' = v2 at this elevator angle: T = (m (v2 + g sin gamma) + D)/cos alpha."""
    air, engine = craft.forces.aerodynamics, craft.forces.propulsion
    drag = air.drag(craft.forces.dynamic_pressure(h, V), alpha, delta_e)
    sine = jnp.clip(h_rate / V, -STEEPEST, STEEPEST)
    T = (craft.m * (v2 + craft.g * sine) + drag) / jnp.cos(alpha)
    return (T - engine.thrust_without_fuel(alpha)) / engine.thrust_per_fuel_ratio(alpha)


def invert_path(craft: Hypersonic, h: Any, h_rate: Any, V: Any, alpha: Any, v1: Any, v2: Any) -> PathInversion:
    """Return the input that gives h'' = v1 and V' = v2 (ft/s^2), without limits on the input.

    Args:     craft: the vehicle model.    h, h_rate: altitude (ft) and its rate (ft/s).    V: speed (ft/s).
              alpha: angle of attack (rad).
    """
    delta_e, solvable, slope = solve_elevator(craft, h, h_rate, V, alpha, v1, v2)
    Phi = solve_fuel_ratio(craft, h, h_rate, V, alpha, v2, delta_e)
    return PathInversion(HypersonicInput(Phi, delta_e), solvable, slope)


def path_turn_rate(h_rate: Any, V: Any, v1: Any, v2: Any) -> Any:
    """Return gamma' (rad/s) of a path with this h' and V (ft/s) while h'' = v1 and V' = v2 (ft/s^2)."""
    sine = jnp.clip(h_rate / V, -STEEPEST, STEEPEST)
    return (v1 - v2 * sine) / (V * jnp.sqrt(1 - sine * sine))


def internal_rates(craft: Hypersonic, h: Any, h_rate: Any, V: Any, v1: Any, v2: Any, zeta: Any) -> list[Any]:
    """Return Psi: the rates of zeta = (alpha, Q, eta1, eta1', eta2, eta2') while h'' = v1 and V' = v2 exactly.

    Every argument except the craft may be an array over instants. zeta and the returned rates consist of six such
    arrays. alpha' = Q - gamma' with V gamma' = (v1 - v2 sin gamma)/cos gamma, which contains no force.

    Source: [1] eq. 7, with the input of `invert_path`.
    """
    alpha, q, eta1, eta1_rate, eta2, eta2_rate = zeta
    u = invert_path(craft, h, h_rate, V, alpha, v1, v2).u
    turn = path_turn_rate(h_rate, V, v1, v2)
    moment = craft.forces.at(h, V, alpha, u.Phi, u.delta_e).M
    N1, N2 = craft.modes.forcing(alpha, u.delta_e)
    back1, back2 = craft.modes.restoring_forces(eta1, eta1_rate, eta2, eta2_rate)
    q_rate, first, second = craft.modes.solve_accelerations(craft.Iyy, moment, N1 + back1, N2 + back2)
    return [q - turn, q_rate, eta1_rate, first, eta2_rate, second]
