"""Internal states of a command as though it stood still: the fallback for commands nobody knew beforehand."""

from typing import Any

from jax import lax

from trimtab.core.float64 import jax, jnp
from trimtab.core.record import Scalar, option, part, quantity, record
from trimtab.laws.path_inversion import STEEPEST, invert
from trimtab.vehicles.hypersonic import Hypersonic

FARTHEST = 0.05
"""Largest Newton step in the angle of attack (rad)."""
WIDEST = 0.1
"""Largest angle of attack looked at (rad): beyond it the curves of the model no longer hold, and searches get lost."""
SETTLED = 1e-7
"""A last Newton step below this (rad) has found the root: the next one is its square."""


def quasi_static(craft: Hypersonic, wanted: Any, alpha: Any, steps: int) -> tuple[list[Any], Any]:
    """zeta at which nothing inside turns or bends while the path is as wanted, and whether it was found.

        M(alpha) = 0 with the input of `invert`        Q = a_n/V        eta_i = N_i/w_i^2        eta_i' = 0

    by a fixed number of Newton steps; where they fail, the last angle that was finite stays.

    Args:
        craft: the vehicle believed in.
        wanted: PathPoint, each field a number or an array of instants.
        alpha: where the search starts (rad), of the same shape.
        steps: how many.
    """
    p = wanted

    def moment(alpha: Any) -> tuple[Any, Any]:
        found = invert(craft, p.h, p.h_rate, p.V, alpha, p.h_acceleration, p.V_rate)
        return craft.forces.at(p.h, p.V, alpha, found.u.Phi, found.u.delta_e).M, found

    def nearer(_: Any, before: tuple[Any, Any]) -> tuple[Any, Any]:
        M, slope, _ = jax.jvp(moment, (before[0],), (jnp.ones_like(before[0]),), has_aux=True)
        step = jnp.where(jnp.isfinite(M / slope), jnp.clip(-M / slope, -FARTHEST, FARTHEST), FARTHEST)
        moved = jnp.where(jnp.isfinite(M / slope), jnp.clip(before[0] + step, -WIDEST, WIDEST), before[0])
        return moved, step

    alpha, last = lax.fori_loop(0, steps, nearer, (alpha, FARTHEST + jnp.zeros_like(alpha)))
    found = moment(alpha)[1]
    eta1, eta2 = craft.modes.static(alpha, found.u.delta_e)
    sine = jnp.clip(p.h_rate / p.V, -STEEPEST, STEEPEST)
    turn = (p.h_acceleration - p.V_rate * sine) / (p.V * jnp.sqrt(1 - sine * sine))
    still = jnp.zeros_like(alpha)
    return [alpha, turn, eta1, still, eta2, still], (jnp.abs(last) < SETTLED) & found.solvable


@record
class QuasiStaticState:
    """What is kept between steps. Source: this module."""

    alpha: Scalar = quantity("rad", "Angle of attack found last.", kind="angle")
    found: Scalar = quantity("1", "Whether the search ended at a root.", kind="flag")


@record
class QuasiStaticInternal:
    """Wanted internal states for what the command is now, as though it stayed so.

        M(alpha) = 0 while h'' and V' are as wanted        zeta_d = (alpha, a_n/V, N1/w1^2, 0, N2/w2^2, 0)

    Needs neither the future nor the past of the command, and no linearisation; what it leaves out is the time that the
    inside takes. Where there is no such angle of attack, the state says so, and the last one is kept.

    Source: the internal dynamics of [1] "Angular-accelerometer-based flexible-state estimation and tracking controller
            design for hypersonic flight vehicle", Aerospace 2022, 9(4), 206, eq. 7, with all rates but the path's left
            out; chosen here.
    """

    craft: Any = part("The vehicle believed in.", default=Hypersonic())
    alpha: Scalar = quantity("rad", "Where the first search starts.", default=0.03, kind="angle")
    steps: int = option("Newton steps each time.", default=4)

    def init(self, key: Any) -> QuasiStaticState:
        """Nothing found yet."""
        return QuasiStaticState(alpha=jnp.asarray(self.alpha, float), found=jnp.asarray(False))

    def step(self, t: Any, state: QuasiStaticState, command: Any) -> tuple[QuasiStaticState, Any]:
        """zeta_d (6,) at time t (s); command: has `at(t)` -> PathPoint."""
        zeta, found = quasi_static(self.craft, command.at(t), state.alpha, self.steps)
        return QuasiStaticState(alpha=zeta[0], found=found), jnp.stack(zeta)
