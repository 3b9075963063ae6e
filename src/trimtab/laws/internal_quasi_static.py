"""Internal states of a command as though it stood still: the fallback for commands nobody knew beforehand.

Internal states of a filtered step, linear and causal: what the filter is doing now says it all.

Internal states that go with a command that is known beforehand: computed offline, kept as a table by time.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, part, quantity, record
from trimtab.laws.path_command import FilteredClimb
from trimtab.laws.path_inversion import STEEPEST, invert_path
from trimtab.vehicles.hypersonic import Hypersonic

INTERNALS = 6
"""alpha, Q, eta1, eta1', eta2, eta2'."""


@record
class InternalTable:
    """Wanted internal states zeta_d by time: cubic Hermite between nodes, held at both ends.

    With s the passed part of an interval D between the nodes z0, z1 whose rates are r0, r1:

        zeta_d = z0 + s^2 (3 - 2 s) (z1 - z0) + D s (1 - s) ((1 - s) r0 - s r1)

    It is for one command: whoever fills it says which. Order: (alpha, Q, eta1, eta1', eta2, eta2'), in rad, rad/s and
    modal units.

    Source: the interpolation formula is the textbook one (Hairer, Norsett, Wanner, "Solving ordinary differential
            equations I", section II.6); the nodes are from the bounded solution, see docs page.
    """

    nodes: Any = quantity("1", "zeta_d at the nodes (n, 6), n at least 2, each in its own unit.")
    rates: Any = quantity("1/s", "Its rate there (n, 6).")
    first: Scalar = quantity("s", "Time of the first node.", default=0.0)
    spacing: Scalar = quantity("s", "Time between nodes.", default=0.1, above=0)
    exact: bool = option("Whether the nodes solve the internal dynamics; else a linear model.", default=True)

    def check(self) -> None:
        """Refuse what is not a table of six columns, or not finite."""
        for name, value in (("nodes", self.nodes), ("rates", self.rates)):
            shape = np.shape(value)
            if len(shape) != 2 or shape[0] < 2 or shape[1] != INTERNALS:
                problem = f"has shape {shape}, wanted is (n, {INTERNALS}) with n at least 2"
                raise InputError(f"InternalTable.{name}", problem, fix="give a row for each node")
            if not np.isfinite(np.asarray(value)).all():
                row = int(np.argmin(np.isfinite(np.asarray(value)).all(axis=1)))
                raise InputError(f"InternalTable.{name}", f"row {row} is not finite", fix="build the table again")
        if np.shape(self.nodes) != np.shape(self.rates):
            problem = f"{len(self.nodes)} nodes and {len(self.rates)} rates"
            raise InputError("InternalTable.rates", problem, fix="give a rate for each node")

    def check_duration(self, seconds: float) -> None:
        """Refuse a run that outlasts the table: after its end the last node would be wanted for ever."""
        end = float(self.first + self.spacing * (np.shape(self.nodes)[0] - 1))
        if seconds > end + float(self.spacing):
            problem = f"the table ends at {end:g} s, the run at {seconds:g} s"
            fix = f"--duration {end:g}, or --set internal=preview, which needs no table"
            raise InputError("InternalTable", problem, fix=fix)

    def init(self, key: Any) -> tuple[()]:
        """No state."""
        return ()

    def step(self, t: Any, state: tuple[()], command: Any) -> tuple[tuple[()], Any]:
        """zeta_d (6,) at time t (s); the command is the one that the table was made for, and isn't looked at."""
        return state, self.at(t)

    def at(self, t: Any) -> Any:
        """zeta_d (6,) at time t (s)."""
        intervals = np.shape(self.nodes)[0] - 1
        position = jnp.clip((t - self.first) / self.spacing, 0.0, 1.0 * intervals)
        begin = jnp.minimum(jnp.floor(position), intervals - 1.0)
        s, index = position - begin, begin.astype(np.uint32)
        z = lax.dynamic_slice(jnp.asarray(self.nodes), (index, np.uint32(0)), (2, INTERNALS))
        r = lax.dynamic_slice(jnp.asarray(self.rates), (index, np.uint32(0)), (2, INTERNALS))
        bend = self.spacing * s * (1 - s) * ((1 - s) * r[0] - s * r[1])
        return z[0] + s * s * (3 - 2 * s) * (z[1] - z[0]) + bend


STATES = 7
"""Of both filters: h - h_f, h', h'', h''', V - V_f, V', V''."""


@record
class SylvesterInternal:
    """Wanted internal states for a `FilteredClimb`, by the linearised inside, without the future.

    Both filters obey omega' = S omega with omega = (h - h_f, h', h'', h''', V - V_f, V', V''). With X S = A22 X + G,

        zeta_d = zeta_0 + X omega - A22^-1 A21 (dh, 0, dV)

    from the step on, zeta_0 before. It jumps at the step, by what the unstable mode should have begun with before it.
    Valid for small climbs, as every linearisation.

    Source: A. Isidori, "Nonlinear Control Systems", Springer 1995, section 8.4, for the equation; the filters are
            those of the command.
    """

    X: Any = quantity("1", "Follows omega (6, 7) of these wh and wV, each entry in its own unit.", shape=(6, STATES))
    rest: Any = quantity("1", "A22^-1 A21 (6, 3): by (h, h', V), each entry in its own unit.", shape=(6, 3))
    zeta_0: Any = quantity("1", "Trim at the start (6,), each in its own unit.", shape=(6,))

    def init(self, key: Any) -> tuple[()]:
        """No state."""
        return ()

    def step(self, t: Any, state: tuple[()], command: FilteredClimb) -> tuple[tuple[()], Any]:
        """zeta_d (6,) at time t (s)."""
        p = command.at(t)
        to_h, to_V = p.h - command.h0 - command.dh, p.V - command.V0 - command.dV
        omega = (to_h, p.h_rate, p.h_acceleration, p.h_jerk, to_V, p.V_rate, p.V_acceleration)
        X, rest = jnp.asarray(self.X), jnp.asarray(self.rest)
        moving = sum((X[:, i] * w for i, w in enumerate(omega)), jnp.zeros(6))
        ended = rest[:, 0] * command.dh + rest[:, 2] * command.dV
        return state, jnp.where(t < command.start, self.zeta_0, self.zeta_0 + moving - ended)


FARTHEST = 0.05
"""Largest Newton step in the angle of attack (rad)."""
WIDEST = 0.1
"""Largest angle of attack looked at (rad): beyond it the curves of the model no longer hold, and searches get lost."""
SETTLED = 1e-7
"""A last Newton step below this (rad) has found the root: the next one is its square."""


def solve_quasi_static(craft: Hypersonic, wanted: Any, alpha: Any, steps: int) -> tuple[list[Any], Any]:
    """zeta at which nothing inside turns or bends while the path is as wanted, and whether it was found.

        M(alpha) = 0 with the input of `invert_path`        Q = a_n/V        eta_i = N_i/w_i^2        eta_i' = 0

    by a fixed number of Newton steps; where they fail, the last angle that was finite stays.

    Args:
        craft: the vehicle believed in.
        wanted: PathPoint, each field a number or an array of instants.
        alpha: where the search starts (rad), of the same shape.
        steps: how many.
    """
    p = wanted

    def moment(alpha: Any) -> tuple[Any, Any]:
        found = invert_path(craft, p.h, p.h_rate, p.V, alpha, p.h_acceleration, p.V_rate)
        return craft.forces.at(p.h, p.V, alpha, found.u.Phi, found.u.delta_e).M, found

    def nearer(_: Any, before: tuple[Any, Any]) -> tuple[Any, Any]:
        M, slope, _ = jax.jvp(moment, (before[0],), (jnp.ones_like(before[0]),), has_aux=True)
        step = jnp.where(jnp.isfinite(M / slope), jnp.clip(-M / slope, -FARTHEST, FARTHEST), FARTHEST)
        moved = jnp.where(jnp.isfinite(M / slope), jnp.clip(before[0] + step, -WIDEST, WIDEST), before[0])
        return moved, step

    alpha, last = lax.fori_loop(0, steps, nearer, (alpha, FARTHEST + jnp.zeros_like(alpha)))
    found = moment(alpha)[1]
    eta1, eta2 = craft.modes.static_displacements(alpha, found.u.delta_e)
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
        zeta, found = solve_quasi_static(self.craft, command.at(t), state.alpha, self.steps)
        return QuasiStaticState(alpha=zeta[0], found=found), jnp.stack(zeta)
