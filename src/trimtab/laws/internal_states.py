"""Reference internal states zeta_d for a command, in the order (alpha, Q, eta1, eta1', eta2, eta2').

zeta_d is the motion of these states that the commanded altitude and speed require. There are four classes. They differ
in what they must know of the command.

    InternalTable        the whole command beforehand; computed offline and stored as a table over time
    PreviewInternal      the command over the next seconds; computed in flight; zeta_d moves before the command does
    SylvesterInternal    the filters of the command; linear and causal
    QuasiStaticInternal  the present value of the command, assumed constant
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.errors import InputError, argument
from trimtab.core.record import Scalar, option, part, quantity, record
from trimtab.laws.path_command import FilteredClimb
from trimtab.laws.path_inversion import internal_rates, invert_path, path_turn_rate
from trimtab.vehicles.hypersonic import Hypersonic

INTERNALS = 6
"""Number of internal states: alpha, Q, eta1, eta1', eta2, eta2'."""
STATES = 7
"""Number of states of the two command filters: h - h_f, h', h'', h''', V - V_f, V', V''."""
NEWTON_STEP_MAX = 0.05
"""Largest Newton step in the angle of attack (rad)."""
WIDEST = 0.1
"""Largest angle of attack (rad) in a search. Beyond this the model's curves are not valid, and searches diverge."""
SETTLED = 1e-7
"""Newton step (rad) below which the root counts as found. The next step would be about the square of this step."""
FIRST_ALPHA = 0.03
"""Initial angle of attack of a search (rad)."""
Complex = tuple[Any, Any]
"""Complex number as a pair of real and imaginary part."""


@record
class InternalTable:
    """Table of the reference internal states zeta_d over time.

    Interpolation is cubic Hermite between nodes. Before the first and after the last node zeta_d is constant. s is the
    elapsed fraction of an interval of duration D. z0, z1 are the nodes at its ends, with the rates r0, r1:

        zeta_d = z0 + s^2 (3 - 2 s) (z1 - z0) + D s (1 - s) ((1 - s) r0 - s r1)

    A table is valid for one command only. The order is (alpha, Q, eta1, eta1', eta2, eta2'), in rad, rad/s and modal
    units.

    Source: the interpolation formula is the textbook one (Hairer, Norsett, Wanner, "Solving ordinary differential
            equations I", section II.6); the nodes are from the bounded solution, see docs page.
    """

    nodes: Any = quantity("1", "Internal states zeta_d at the nodes (n, 6), n at least 2. The unit differs by state.")
    rates: Any = quantity("1/s", "Rates of zeta_d at the nodes (n, 6).")
    first: Scalar = quantity("s", "Time of the first node.", default=0.0)
    spacing: Scalar = quantity("s", "Time between two nodes.", default=0.1, above=0)
    exact: bool = option(
        "True if the nodes solve the nonlinear internal dynamics; False if they solve the linearised dynamics.",
        default=True,
    )

    def check(self) -> None:
        """Raise InputError if the table does not have six columns or is not finite."""
        for name, value in (("nodes", self.nodes), ("rates", self.rates)):
            shape = np.shape(value)
            if len(shape) != 2 or shape[0] < 2 or shape[1] != INTERNALS:
                problem = f"the array has shape {shape}, but must have shape (n, {INTERNALS}) with n at least 2"
                raise InputError(f"InternalTable.{name}", problem, fix="give one row of six numbers for each node")
            if not np.isfinite(np.asarray(value)).all():
                row = int(np.argmin(np.isfinite(np.asarray(value)).all(axis=1)))
                raise InputError(
                    f"InternalTable.{name}",
                    f"row {row} contains a number that is not finite",
                    fix="compute the table again",
                )
        if np.shape(self.nodes) != np.shape(self.rates):
            problem = f"each node must have rates, got {len(self.nodes)} nodes and {len(self.rates)} rows of rates"
            raise InputError("InternalTable.rates", problem, fix="give one row of rates for each node")

    def check_duration(self, seconds: float) -> None:
        """Raise InputError if the run is longer than the table, because the table is constant after its last node."""
        end = float(self.first + self.spacing * (np.shape(self.nodes)[0] - 1))
        if seconds > end + float(self.spacing):
            problem = f"the table ends at {end:g} s, before the end of the run at {seconds:g} s"
            shorter, preview = argument("duration", f"{end:g}"), argument("settings", "preview", "internal")
            fix = f"{shorter}, or {preview}, which needs no table"
            raise InputError("InternalTable", problem, fix=fix)

    def init(self, key: Any) -> tuple[()]:
        """Return an empty record, because this method has no state."""
        return ()

    def step(self, t: Any, state: tuple[()], command: Any) -> tuple[tuple[()], Any]:
        """Return the reference internal states zeta_d (6,) at time t (s). The command is not read, because a table is
        made for one command."""
        return state, self.at(t)

    def at(self, t: Any) -> Any:
        """Return the reference internal states zeta_d (6,) at time t (s)."""
        intervals = np.shape(self.nodes)[0] - 1
        position = jnp.clip((t - self.first) / self.spacing, 0.0, 1.0 * intervals)
        begin = jnp.minimum(jnp.floor(position), intervals - 1.0)
        s, index = position - begin, begin.astype(np.uint32)
        z = lax.dynamic_slice(jnp.asarray(self.nodes), (index, np.uint32(0)), (2, INTERNALS))
        r = lax.dynamic_slice(jnp.asarray(self.rates), (index, np.uint32(0)), (2, INTERNALS))
        bend = self.spacing * s * (1 - s) * ((1 - s) * r[0] - s * r[1])
        return z[0] + s * s * (3 - 2 * s) * (z[1] - z[0]) + bend


@record
class SylvesterInternal:
    """Reference internal states for a `FilteredClimb`, from the linearised dynamics, without knowledge of the future.

    Together the two filters obey omega' = S omega with omega = (h - h_f, h', h'', h''', V - V_f, V', V''). A21 and A22
    are blocks of the linearised internal dynamics. With X S = A22 X + G,

        zeta_d = zeta_0 + X omega - A22^-1 A21 (dh, 0, dV)

    from the time of the step on, and zeta_d = zeta_0 before. zeta_d jumps at the step, because the unstable mode would
    have to move before the step. The method is valid for small climbs, like every linearisation.

    Source: A. Isidori, "Nonlinear Control Systems", Springer 1995, section 8.4, for the equation; the filters are
            those of the command.
    """

    X: Any = quantity(
        "1",
        "Matrix X (6, 7) from the filter states omega to zeta_d, for the bandwidths wh and wV of the "
        "command's filters. The unit differs by element.",
        shape=(6, STATES),
    )
    rest: Any = quantity(
        "1", "Matrix A22^-1 A21 (6, 3), which multiplies (h, h', V). The unit differs by element.", shape=(6, 3)
    )
    zeta_0: Any = quantity(
        "1", "Trim values of the internal states before the step (6,). The unit differs by element.", shape=(6,)
    )

    def init(self, key: Any) -> tuple[()]:
        """Return an empty record, because this method has no state."""
        return ()

    def step(self, t: Any, state: tuple[()], command: FilteredClimb) -> tuple[tuple[()], Any]:
        """Return the reference internal states zeta_d (6,) at time t (s)."""
        p = command.at(t)
        to_h, to_V = p.h - command.h0 - command.dh, p.V - command.V0 - command.dV
        omega = (to_h, p.h_rate, p.h_acceleration, p.h_jerk, to_V, p.V_rate, p.V_acceleration)
        X, rest = jnp.asarray(self.X), jnp.asarray(self.rest)
        moving = sum((X[:, i] * w for i, w in enumerate(omega)), jnp.zeros(6))
        ended = rest[:, 0] * command.dh + rest[:, 2] * command.dV
        return state, jnp.where(t < command.start, self.zeta_0, self.zeta_0 + moving - ended)


def solve_quasi_static(craft: Hypersonic, p: Any, alpha: Any, steps: int) -> tuple[list[Any], Any]:
    """Return the quasi-static internal states zeta on the reference path, and True if the search found them.

        M(alpha) = 0 with the input of `invert_path`        Q = a_n/V        eta_i = N_i/w_i^2        eta_i' = 0

    The equations are solved by a fixed number of Newton steps. If a step is not finite, the previous angle is kept.

    Args:     p: PathPoint, each field a number or an array of instants.
              alpha: angle of attack at which the search starts (rad), of the same shape as a field of p.
    """

    def moment(alpha: Any) -> tuple[Any, Any]:
        inversion = invert_path(craft, p.h, p.h_rate, p.V, alpha, p.h_acceleration, p.V_rate)
        return craft.forces.at(p.h, p.V, alpha, inversion.u.Phi, inversion.u.delta_e).M, inversion

    def nearer(_: Any, before: tuple[Any, Any]) -> tuple[Any, Any]:
        M, slope, _ = jax.jvp(moment, (before[0],), (jnp.ones_like(before[0]),), has_aux=True)
        step = jnp.where(
            jnp.isfinite(M / slope), jnp.clip(-M / slope, -NEWTON_STEP_MAX, NEWTON_STEP_MAX), NEWTON_STEP_MAX
        )
        alpha = jnp.where(jnp.isfinite(M / slope), jnp.clip(before[0] + step, -WIDEST, WIDEST), before[0])
        return alpha, step

    alpha, last = lax.fori_loop(0, steps, nearer, (alpha, NEWTON_STEP_MAX + jnp.zeros_like(alpha)))
    _, inversion = moment(alpha)
    eta1, eta2 = craft.modes.static_displacements(alpha, inversion.u.delta_e)
    turn = path_turn_rate(p.h_rate, p.V, p.h_acceleration, p.V_rate)
    still = jnp.zeros_like(alpha)
    return [alpha, turn, eta1, still, eta2, still], (jnp.abs(last) < SETTLED) & inversion.solvable


@record
class QuasiStaticState:
    """State of the quasi-static method between steps. Source: this module."""

    alpha: Scalar = quantity("rad", "Angle of attack found by the last search.", kind="angle")
    found: Scalar = quantity("1", "True if the last search found a root.", kind="flag")


@record
class QuasiStaticInternal:
    """Reference internal states for the present command, assuming that the command stays constant.

        M(alpha) = 0 while h'' and V' are as commanded        zeta_d = (alpha, a_n/V, N1/w1^2, 0, N2/w2^2, 0)

    M is the pitching moment, a_n the acceleration normal to the path, and N_i/w_i^2 the static displacement of mode i.
    The method needs neither the future nor the past of the command, and no linearisation. It neglects the duration of
    the internal motion. If no angle of attack is found, the last angle is kept and the state's `found` is False.

    Source: the internal dynamics of [1] "Angular-accelerometer-based flexible-state estimation and tracking controller
            design for hypersonic flight vehicle", Aerospace 2022, 9(4), 206, eq. 7. All rates except
            those of the path are omitted, which is our own simplification.
    """

    craft: Any = part("Vehicle model used by the law.", default=Hypersonic())
    alpha: Scalar = quantity(
        "rad", "Angle of attack at which the first search starts.", default=FIRST_ALPHA, kind="angle"
    )
    steps: int = option("Number of Newton steps in one search.", default=4)

    def init(self, key: Any) -> QuasiStaticState:
        """Return the initial state, before any search."""
        return QuasiStaticState(alpha=jnp.asarray(self.alpha, float), found=jnp.asarray(False))

    def step(self, t: Any, state: QuasiStaticState, command: Any) -> tuple[QuasiStaticState, Any]:
        """Return the reference internal states zeta_d (6,) at time t (s). command: object with a method `at(t)` that
        returns a PathPoint."""
        zeta, found = solve_quasi_static(self.craft, command.at(t), state.alpha, self.steps)
        return QuasiStaticState(alpha=zeta[0], found=found), jnp.stack(zeta)


@record
class FadingModes:
    """Decaying modes q' = l q + L w, one of each conjugate pair, and their map to the coordinates, zeta = Re(R q).

    Growing modes are stored in reversed time, in which they decay.

    Source: any text on linear systems, e.g. T. Kailath, "Linear systems", Prentice Hall 1980, section 2.6.
    """

    decay: Any = quantity("1/s", "Real parts of the poles l of the modes (p,), below zero.", high=0)
    turning: Any = quantity("rad/s", "Imaginary parts of the poles l of the modes (p,).")
    left: Any = quantity(
        "1", "Real and imaginary part of the modes' input matrix L (2, p, k). The unit differs by element."
    )
    right: Any = quantity(
        "1", "Real and imaginary part of the matrix R (2, k, p) from modes to coordinates. The unit differs by element."
    )

    def modal_input(self, w: Any) -> Complex:
        """Return the input L w of the modes, of shape (p, n), for w (k, n)."""
        return _matrix_product(self.left[0], w), _matrix_product(self.left[1], w)

    def reconstruct(self, q: Complex) -> Any:
        """Return the coordinates Re(R q), of shape (k, 1), for the modes q (p, 1)."""
        return _matrix_product(self.right[0], q[0]) - _matrix_product(self.right[1], q[1])

    def powers(self, t: Any) -> Complex:
        """Return exp(l t), of shape (p, n), for times t (s) of shape (1, n)."""
        size, angle = jnp.exp(self.decay[:, None] * t), self.turning[:, None] * t
        return size * jnp.cos(angle), size * jnp.sin(angle)

    def weights(self, dt: Any) -> tuple[Complex, Complex]:
        """Return the factors (p, 1) by which w at the start and w at the end of a step dt (s) enter the new q.

        The factors are exact for w linear in time.
        """
        still = dt <= 0
        step = jnp.where(still, 1.0, dt)
        pole = (self.decay[:, None], self.turning[:, None])
        E = self.powers(step * jnp.ones((1, 1)))
        p0 = _divide((E[0] - 1, E[1]), pole)
        p1 = _divide((p0[0] - step, p0[1]), (pole[0] * step, pole[1] * step))
        keep = jnp.where(still, 0.0, 1.0)
        return (keep * (p0[0] - p1[0]), keep * (p0[1] - p1[1])), (keep * p1[0], keep * p1[1])


@record
class PreviewState:
    """State of the preview method between steps. Source: this module."""

    t: Scalar = quantity("s", "Time of the last step.")
    q: Any = quantity("1", "State of the decaying modes, real and imaginary part (2, p, 1).")
    w: Any = quantity(
        "1", "Input w of the modes at the last step (k, 1): rates of the internal states. The unit differs by element."
    )
    alpha: Any = quantity("rad", "Quasi-static angle of attack at the nodes of the last step (n + 1,).", kind="angle")
    started: Scalar = quantity("1", "True after the first step.", kind="flag")
    found: Scalar = quantity("1", "True if the search found an angle of attack at every node.", kind="flag")


@record
class PreviewInternal:
    """Reference internal states from the present command and the command over the next seconds.

        zeta' = A22 zeta + w        w = Psi(zeta_s) - A22 zeta_s        zeta_s: quasi-static

    Psi are the internal dynamics, and A22 is their linearisation. This is one pass of the iteration for the bounded
    solution, with w linear between nodes. Decaying modes are integrated from step to step. Growing modes are summed
    backward from the end of the horizon H, where they are set to those of zeta_s. An error e at the end of the horizon
    becomes e exp(-l H) at its start. The cost of a step is fixed.

    Source: [1] S. Devasia, D. Chen, B. Paden, IEEE Transactions on Automatic Control 41(7), 1996, section III; the
            horizon: Q. Zou, S. Devasia, "Preview-based stable-inversion for output tracking of linear systems", ASME
            Journal of Dynamic Systems, Measurement, and Control 121(4), 1999.
    """

    A22: Any = quantity(
        "1", "Jacobian dPsi/dzeta of the internal dynamics at a trim (k, k). The unit differs by element."
    )
    past: FadingModes = part("Decaying modes. They are integrated from step to step.")
    future: FadingModes = part(
        "Growing modes, stored in reversed time. They are summed backward from the end of the horizon."
    )
    craft: Any = part("Vehicle model used by the law.", default=Hypersonic())
    horizon: Scalar = quantity("s", "Horizon H over which the command is read ahead.", default=4.0, above=0)
    alpha: Scalar = quantity(
        "rad", "Angle of attack at which the first search starts.", default=FIRST_ALPHA, kind="angle"
    )
    intervals: int = option("Number of intervals between nodes over the horizon.", default=40)
    steps: int = option("Number of Newton steps in one search.", default=3)

    def check(self) -> None:
        """Raise InputError if the horizon is zero or has no nodes."""
        if not self.horizon > 0:
            problem = f"the horizon must be above 0, got {float(self.horizon):g} s"
            raise InputError(
                "PreviewInternal.horizon",
                problem,
                fix="set horizon to some seconds: the error falls as exp(-l horizon)",
            )
        if self.intervals < 1:
            problem = f"intervals must be at least 1, got {self.intervals}"
            raise InputError("PreviewInternal.intervals", problem, fix="set intervals to 10 per second of the horizon")

    def init(self, key: Any) -> PreviewState:
        """Return the initial state. The first step replaces this state by the quasi-static solution."""
        p, k = jnp.shape(self.past.decay)[0], jnp.shape(self.A22)[0]
        off = jnp.asarray(False)
        alpha = jnp.full(self.intervals + 1, 1.0 * self.alpha)
        return PreviewState(jnp.zeros(()), jnp.zeros((2, p, 1)), jnp.zeros((k, 1)), alpha, off, off)

    def step(self, t: Any, state: PreviewState, command: Any) -> tuple[PreviewState, Any]:
        """Return the reference internal states zeta_d (6,) at time t (s). command: object whose method `at(t)` returns
        a PathPoint for an array t."""
        d = self.horizon / self.intervals
        p = command.at(t + d * jnp.arange(self.intervals + 1.0))
        still, found = solve_quasi_static(self.craft, p, state.alpha, self.steps)
        rates = internal_rates(self.craft, p.h, p.h_rate, p.V, p.h_acceleration, p.V_rate, still)
        zeta = jnp.stack(still)
        w = jnp.stack(rates) - _matrix_product(self.A22, zeta)
        q = self._propagate_past(t, state, w[:, :1], zeta[:, :1])
        wanted = self.past.reconstruct(q) + self.future.reconstruct(self._sum_future(w, zeta[:, -1:], d))
        new = PreviewState(1.0 * t, jnp.stack(q), w[:, :1], still[0], jnp.asarray(True), found.all())
        return new, wanted[:, 0]

    def _propagate_past(self, t: Any, state: PreviewState, w: Any, zeta: Any) -> Complex:
        """Return the decaying modes at time t, integrated from the last step. At the first step, return the modes of
        zeta."""
        dt = jnp.maximum(t - state.t, 0.0)
        begin, end = self.past.weights(dt)
        E = self.past.powers(dt * jnp.ones((1, 1)))
        drive = _add(_multiply(begin, self.past.modal_input(state.w)), _multiply(end, self.past.modal_input(w)))
        q = _add(_multiply(E, (state.q[0], state.q[1])), drive)
        first = self.past.modal_input(zeta)
        return jnp.where(state.started, q[0], first[0]), jnp.where(state.started, q[1], first[1])

    def _sum_future(self, w: Any, zeta: Any, d: Any) -> Complex:
        """Return the growing modes, summed backward from the end of the horizon. In reversed time w changes sign."""
        far, near = self.future.weights(d)
        real, imaginary = self.future.modal_input(-w)
        near_part = _multiply(near, (real[:, :-1], imaginary[:, :-1]))
        each = _add(near_part, _multiply(far, (real[:, 1:], imaginary[:, 1:])))
        fading = _multiply(self.future.powers(d * jnp.arange(1.0 * self.intervals)[None]), each)
        last = _multiply(self.future.powers(d * self.intervals * jnp.ones((1, 1))), self.future.modal_input(zeta))
        return fading[0].sum(axis=1, keepdims=True) + last[0], fading[1].sum(axis=1, keepdims=True) + last[1]


def _matrix_product(M: Any, x: Any) -> Any:
    """Return M x for M (a, b), x (b, n), summed in a fixed order."""
    return (jnp.asarray(M)[:, :, None] * x[None]).sum(axis=1)


def _add(a: Complex, b: Complex) -> Complex:
    return a[0] + b[0], a[1] + b[1]


def _multiply(a: Complex, b: Complex) -> Complex:
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def _divide(a: Complex, b: Complex) -> Complex:
    size = b[0] * b[0] + b[1] * b[1]
    return (a[0] * b[0] + a[1] * b[1]) / size, (a[1] * b[0] - a[0] * b[1]) / size
