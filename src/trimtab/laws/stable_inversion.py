"""Tracking of altitude and speed by exact inversion, around the bounded internal motion that the command requires.

Before a run the law rejects a command that does not begin and end in level flight, and a table that was made for
another command.

[1] is "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206.
"""

from functools import partial
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError, argument
from trimtab.core.interfaces import optional_member
from trimtab.core.record import FAST_COMPILE_OPTIONS, Scalar, part, quantity, record, tree_where
from trimtab.core.rng import Key
from trimtab.core.signals import Estimate
from trimtab.core.time import to_seconds
from trimtab.laws.adaptive_robust import AdaptationState, AdaptiveRobust
from trimtab.laws.internal_states import FIRST_ALPHA, InternalTable, QuasiStaticInternal, solve_quasi_static
from trimtab.laws.path_command import FilteredClimb, PathPoint
from trimtab.laws.path_inversion import InputLimits, internal_rates, invert_path
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput

INTERNAL_SIZES = (1e-2, 1e-2, 1.0, 10.0, 1.0, 10.0)
"""Typical sizes of the internal states (alpha, Q, eta1, eta1', eta2, eta2'), each in its own unit."""
SOLVED = 1e-4
"""Largest error of a table's rates for which the table counts as exact, in INTERNAL_SIZES per second."""
LAST = 1e5
"""Time (s) by which every command is assumed to have reached its final values."""
STEPS = 8
K_FLOWN = (
    (0.0893010, 0.688045, -0.355907, 1742.964, 536.101, -0.581358, -0.140480, -1.351494, -0.363934),
    (-0.0184104, -0.132192, -0.465382, -168.6866, -51.9745, 0.0504659, 0.0135084, 0.129350, 0.0334523),
)
"""Default gain K: linear quadratic regulator at 85 000 ft, 7 702 ft/s, from `trimtab design hypersonic`."""
R_FLOWN = (0.01, 0.04)
NO_INTEGRAL = ((0.0, 0.0), (0.0, 0.0))


@record
class StableInversionState:
    """State of the law `StableInversion`. Source: [1] eqs. 13, 18; the integrals are not in [1]."""

    internal: Any = part("State of the method that computes the reference internal motion.")
    adaptation: AdaptationState = part("State of the adaptive robust terms: adapted bounds.")
    integral: Any = quantity("ft s", "Integrals of the altitude error (ft s) and the speed error (ft).", shape=(2,))
    t: Scalar = quantity("100 ns", "Time of the last step.", kind="time")
    started: Scalar = quantity("1", "True after the first step.", kind="flag")


@record
class StableInversionOutput:
    """Demand and signals of the law `StableInversion`. Frames: those of the vehicle. Source: [1] eqs. 13, 16-18."""

    demand: HypersonicInput = part("Demanded fuel ratio and elevator angle, within the limits.")
    h_reference: Scalar = quantity("ft", "Altitude reference.", frame="W")
    V_reference: Scalar = quantity("ft/s", "Speed reference.")
    h_error: Scalar = quantity("ft", "Altitude error: altitude minus reference.")
    V_error: Scalar = quantity("ft/s", "Speed error: speed minus reference.")
    alpha_reference: Scalar = quantity("rad", "Angle of attack required by the command.", kind="angle")
    q_reference: Scalar = quantity("rad/s", "Pitch rate required by the command.")
    eta1_reference: Scalar = quantity("(slug ft)^1/2", "Modal displacement of bending mode 1 required by the command.")
    eta1_rate_reference: Scalar = quantity("(slug ft)^1/2/s", "Rate of bending mode 1 required by the command.")
    eta2_reference: Scalar = quantity("(slug ft)^1/2", "Modal displacement of bending mode 2 required by the command.")
    eta2_rate_reference: Scalar = quantity("(slug ft)^1/2/s", "Rate of bending mode 2 required by the command.")
    v: Any = quantity("ft/s^2", "Demanded accelerations of altitude and speed, the input of the inversion.", shape=(2,))
    s: Any = quantity("1", "Product B'P e of the adaptive robust terms.", shape=(2,))
    u_h: Any = quantity("ft/s^2", "Damping term u_h of the adaptive robust terms.", shape=(2,))
    u_s: Any = quantity("ft/s^2", "Switching term u_s of the adaptive robust terms.", shape=(2,))
    rho0: Scalar = quantity("ft/s^2", "Adapted bound rho0 of the uncertainty: part that does not depend on the error.")
    rho1: Scalar = quantity("ft/s^2", "Adapted bound rho1 of the uncertainty: increase per scaled error.")
    integral: Any = quantity("ft s", "Integrals of the altitude error (ft s) and the speed error (ft).", shape=(2,))
    saturated: Scalar = quantity("1", "True if fuel ratio or elevator is at a limit.", kind="flag")
    unsolvable: Scalar = quantity("1", "True if no elevator angle gives the demanded accelerations.", kind="flag")
    outside: Scalar = quantity(
        "1", "True if the flight is outside the range for which the model was fitted.", kind="flag"
    )


@record
class FitRange:
    """Flight conditions for which the vehicle model was fitted. Source: docs page, Hypersonic vehicle: valid range."""

    h: Any = quantity("ft", "Minimum and maximum altitude of the fitted range.", default=(80000.0, 95000.0), shape=(2,))
    V: Any = quantity("ft/s", "Minimum and maximum speed of the fitted range.", default=(7000.0, 9000.0), shape=(2,))
    alpha: Any = quantity(
        "rad", "Minimum and maximum angle of attack of the fitted range.", default=(0.0, 0.0698131700797732), shape=(2,)
    )

    def is_outside(self, h: Any, V: Any, alpha: Any) -> Any:
        """Return True if altitude, speed or angle of attack is outside the fitted range."""
        pairs = ((h, self.h), (V, self.V), (alpha, self.alpha))
        return jnp.stack([(value < low) | (value > high) for value, (low, high) in pairs]).any()


@record
class StableInversion:
    """Law that inverts the dynamics of altitude and speed, with state feedback around the ideal internal dynamics.

        v = yd^(r) + K e + Ki integral(e_h, e_V) + u_h + u_s            u = inversion(v)
        e = (h, h', V, alpha, Q, eta1, eta1', eta2, eta2') - reference

    yd^(r) are the commanded accelerations, e is the tracking error, and u_h and u_s are the adaptive robust terms.
    Altitude and speed are a non-minimum-phase output: under inversion alone the internal motion diverges with a time
    constant of 0.3 s. `internal` computes the bounded motion that the command requires. This motion begins before the
    command.

    Frames:  those of the vehicle, in the vehicle's units.
    Stable:  locally, proved by `design.certificate`, as long as the input does not saturate.
    Source:  [1] eqs. 13, 16-18, corrected. The K printed in [1] is unstable: docs page.
    """

    internal: Any = part(
        "Method that computes the reference internal motion: a record of laws.internal_states.",
        default=QuasiStaticInternal(),
    )
    craft: Hypersonic = part("Vehicle model used by the law.", default=Hypersonic())
    command: Any = part("Command of altitude and speed.", default=FilteredClimb())
    K: Any = quantity("1", "Feedback gain K, with v = +K e.", default=K_FLOWN, shape=(2, 9))
    Ki: Any = quantity(
        "1", "Gain Ki of the integrals of altitude error and speed error.", default=NO_INTEGRAL, shape=(2, 2)
    )
    robust: AdaptiveRobust = part(
        "Adaptive robust terms.",
        default=AdaptiveRobust(BP=tuple(tuple(-r * k for k in row) for r, row in zip(R_FLOWN, K_FLOWN, strict=True))),
    )
    limits: InputLimits = part("Limits of fuel ratio and elevator.", default=InputLimits())
    fit: FitRange = part(
        "Range of altitude, speed and angle of attack in which the model is valid.", default=FitRange()
    )

    reads: ClassVar[tuple[str, ...]] = ("h", "h_rate", "V", "alpha", "q", "eta1", "eta1_rate", "eta2", "eta2_rate")

    def check(self) -> None:
        """Raise InputError if a lower limit is above its upper limit, or if the command or the table does not suit the
        vehicle."""
        low, high = self.limits.Phi_low, self.limits.Phi_high
        if not (low < high and self.limits.delta_low < self.limits.delta_high):
            raise InputError(
                "StableInversion.limits",
                f"each lower limit must be below its upper limit, got {self.limits}",
                fix="set Phi_low below Phi_high, and delta_low below delta_high",
            )
        check_command_ends(self.craft, self.command, self.limits)
        if isinstance(self.internal, InternalTable) and self.internal.exact:
            check_internal_table(self.craft, self.command, self.internal, self.limits)

    def init(self, key: Key) -> StableInversionState:
        """Return the initial state."""
        return StableInversionState(
            internal=self.internal.init(key),
            adaptation=self.robust.init(),
            integral=jnp.zeros(2),
            t=np.int64(0),
            started=jnp.asarray(False),
        )

    def step(
        self, t: Any, state: StableInversionState, estimate: Estimate
    ) -> tuple[StableInversionState, StableInversionOutput]:
        """Return the demanded fuel ratio and elevator angle at time t (unit: 100 ns)."""
        x, now = estimate.state, to_seconds(t)
        dt = jnp.where(state.started, to_seconds(t - state.t), 0.0)
        want: PathPoint = self.command.at(now)
        internal, zeta = self.internal.step(now, state.internal, self.command)
        zeta = self._rescale_internal_states(x, zeta)
        e = self._error(x, want, zeta)
        terms = self.robust.terms(state.adaptation, e)
        feedback = jnp.asarray(self.K) @ e + jnp.asarray(self.Ki) @ state.integral
        v = jnp.stack([want.h_acceleration, want.V_rate]) + feedback + terms.u_h + terms.u_s
        inversion = invert_path(self.craft, x.h, x.h_rate, x.V, x.alpha, v[0], v[1])
        u, clipped = self.limits.clip(inversion.u)
        usable = jnp.isfinite(u.Phi) & jnp.isfinite(u.delta_e)
        u = tree_where(usable, u, HypersonicInput(self.limits.Phi_low, jnp.asarray(0.0)))
        saturated, integrates = clipped | ~usable, jnp.any(jnp.asarray(self.Ki) != 0)
        new = StableInversionState(
            internal=internal,
            adaptation=tree_where(saturated, state.adaptation, self.robust.adapt(dt, state.adaptation, e, terms.s)),
            integral=jnp.where(saturated | ~integrates, state.integral, state.integral + dt * jnp.stack([e[0], e[2]])),
            t=t,
            started=jnp.asarray(True),
        )
        output = StableInversionOutput(
            *(u, want.h, want.V, e[0], e[2]),
            *(zeta[i] for i in range(6)),
            v=v,
            s=terms.s,
            u_h=terms.u_h,
            u_s=terms.u_s,
            rho0=state.adaptation.rho0,
            rho1=state.adaptation.rho1,
            integral=state.integral,
            saturated=saturated,
            unsolvable=~inversion.solvable,
            outside=self.fit.is_outside(x.h, x.V, x.alpha),
        )
        return new, output

    def _rescale_internal_states(self, x: Any, zeta: Any) -> Any:
        """Return the reference internal states for the estimated frequencies of the modes.

        The static displacement of a mode is N/w^2, so a wrong w changes the reference with the square of w. An
        estimator with the same wrong w has the same error in its states, so the feedback sees no difference. An
        estimator that estimates w corrects the reference.
        """
        frequencies = optional_member(x, "frequencies")
        if isinstance(frequencies, tuple):
            return zeta
        one, two = (self.craft.modes.w1 / frequencies.w1) ** 2, (self.craft.modes.w2 / frequencies.w2) ** 2
        scale = (1.0, 1.0, one, one, two, two)
        return jnp.stack([zeta[i] * by for i, by in enumerate(scale)])

    def _error(self, x: Any, want: PathPoint, zeta: Any) -> Any:
        """Return the tracking error e (9,), in the order of [1]."""
        have = (x.h, x.h_rate, x.V, x.alpha, x.q, x.eta1, x.eta1_rate, x.eta2, x.eta2_rate)
        wanted = (want.h, want.h_rate, want.V, *(zeta[i] for i in range(6)))
        return jnp.stack([jnp.asarray(a - b) for a, b in zip(have, wanted, strict=True)])


def check_command_ends(craft: Any, command: Any, limits: InputLimits) -> None:
    """Raise InputError if a command begins or ends where the model has no level flight within the input limits."""
    found, u, h, V = (np.asarray(a) for a in _level_flight_at_ends(craft, command))
    for i, where in enumerate(("begins", "ends")):
        if not found[i]:
            problem = (
                f"the command {where} at {h[i]:g} ft, {V[i]:g} ft/s: no angle of attack makes the pitching moment zero"
            )
            raise InputError(
                "command", problem, fix="choose h0, V0, dh and dV so that the command stays near 85000 ft and 7700 ft/s"
            )
    where = [f"level flight at {a:g} ft, {b:g} ft/s" for a, b in zip(h, V, strict=True)]
    _check_input_limits(limits, u, where)


def check_internal_table(craft: Any, command: Any, table: InternalTable, limits: InputLimits) -> None:
    """Raise InputError if a table is for another command or vehicle, or the command exceeds the input limits."""
    t = table.first + table.spacing * np.arange(len(table.nodes))
    wrong, u = (np.asarray(a) for a in _table_residual(craft, command, t, table.nodes, table.rates))
    if not wrong.max() < SOLVED:
        when = (
            f"at {t[wrong.argmax()]:g} s the error of the table's rates is {wrong.max():.2g} of the rates' "
            "typical sizes"
        )
        problem = f"the table was made for another command or vehicle: {when}"
        preview = argument("settings", "preview", "internal")
        fix = f"{preview}, which needs no table, or run a scenario made for this command"
        raise InputError("internal", problem, fix=fix)
    _check_input_limits(limits, u, [f"the command at {x:g} s" for x in t])


def _check_input_limits(limits: InputLimits, u: Any, where: list[str]) -> None:
    """Raise InputError if a fuel ratio or elevator angle in u (2, n) exceeds a limit. where: n texts for the error."""
    low, high = (np.array([*pair]) for pair in limits.bounds())
    for value, least, most, what in zip(u, low, high, ("fuel ratio", "elevator (rad)"), strict=True):
        beyond = np.maximum(least - value, value - most)
        if beyond.max() > 0:
            at = int(beyond.argmax())
            problem = f"{where[at]} needs {what} {value[at]:.4g}, but the limits are {least:.4g} and {most:.4g}"
            raise InputError("command", problem, fix="make the climb smaller, or wh and wV lower")


@partial(jax.jit, compiler_options=FAST_COMPILE_OPTIONS)
def _level_flight_at_ends(craft: Any, command: Any) -> Any:
    """Return True if level flight exists (2,), its input (2, 2), h and V (2,), each for the command's start and end."""
    p: PathPoint = command.at(jnp.array([0.0, LAST]))
    still = jnp.zeros(2)
    level = PathPoint(p.h, still, still, still, p.V, still, still)
    zeta, found = solve_quasi_static(craft, level, jnp.full(2, FIRST_ALPHA), STEPS)
    u = invert_path(craft, p.h, still, p.V, zeta[0], still, still).u
    return found, jnp.stack([u.Phi, u.delta_e]), p.h, p.V


@partial(jax.jit, compiler_options=FAST_COMPILE_OPTIONS)
def _table_residual(craft: Any, command: Any, t: Any, nodes: Any, rates: Any) -> tuple[Any, Any]:
    """Return the error of a table's rates (n, 6) against the internal dynamics, as a fraction of INTERNAL_SIZES (n,).

    The second result is the fuel ratio and elevator angle (rad) that the command needs at the times t (2, n).
    """
    p: PathPoint = command.at(t)
    path = (p.h, p.h_rate, p.V)
    exact = internal_rates(craft, *path, p.h_acceleration, p.V_rate, nodes.T)
    off = jnp.abs((jnp.stack(exact, axis=1) - rates) / jnp.asarray(INTERNAL_SIZES)).max(axis=1)
    u = invert_path(craft, *path, nodes[:, 0], p.h_acceleration, p.V_rate).u
    return off, jnp.stack([u.Phi, u.delta_e])
