"""Internal states of a command that is known a few seconds ahead: computed in flight, moving before it does."""

from typing import Any

import jax.numpy as jnp

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, part, quantity, record
from trimtab.laws.internal_quasi_static import solve_quasi_static
from trimtab.laws.path_inversion import internal_rates
from trimtab.vehicles.hypersonic import Hypersonic

Complex = tuple[Any, Any]
"""Real and imaginary part."""


@record
class FadingModes:
    """Modes q' = l q + L w that fade, one of each complex pair, and how they make up the coordinates: zeta = Re(R q).

    Those that grow are kept as they are in reversed time, where they fade.

    Source: any text on linear systems, e.g. T. Kailath, "Linear systems", Prentice Hall 1980, section 2.6.
    """

    decay: Any = quantity("1/s", "Real parts of the poles l (p,), below zero.", high=0)
    turning: Any = quantity("rad/s", "Imaginary parts (p,).")
    left: Any = quantity("1", "Real and imaginary part of L (2, p, k), each entry in its own unit.")
    right: Any = quantity("1", "Real and imaginary part of R (2, k, p), each entry in its own unit.")

    def modal_input(self, w: Any) -> Complex:
        """L w for w (k, n): (p, n)."""
        return _matrix_product(self.left[0], w), _matrix_product(self.left[1], w)

    def reconstruct(self, q: Complex) -> Any:
        """Re(R q) for q (p, 1): (k, 1)."""
        return _matrix_product(self.right[0], q[0]) - _matrix_product(self.right[1], q[1])

    def powers(self, t: Any) -> Complex:
        """exp(l t) for times t (s) of shape (1, n): (p, n)."""
        size, angle = jnp.exp(self.decay[:, None] * t), self.turning[:, None] * t
        return size * jnp.cos(angle), size * jnp.sin(angle)

    def weights(self, dt: Any) -> tuple[Complex, Complex]:
        """What w at begin and end of a step dt (s) adds to q, exactly where w is linear between; each (p, 1)."""
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
    """What is kept between steps. Source: this module."""

    t: Scalar = quantity("s", "Time of the last step.")
    q: Any = quantity("1", "Modes that come from the past, real and imaginary part (2, p, 1).")
    w: Any = quantity("1", "What drove them at the last step (k, 1), each entry in its own unit per second.")
    alpha: Any = quantity("rad", "Quasi-static angle of attack at the nodes of the last step (n + 1,).", kind="angle")
    started: Scalar = quantity("1", "Whether there was a step.", kind="flag")
    found: Scalar = quantity("1", "Whether every node had its angle of attack.", kind="flag")


@record
class PreviewInternal:
    """Wanted internal states from the command now and over the next seconds.

        zeta' = A22 zeta + w        w = Psi(zeta_s) - A22 zeta_s        zeta_s: quasi-static

    One pass of the iteration for the bounded solution, w linear between nodes. Modes that fade are carried along from
    step to step; those that grow are summed backward from the end of the horizon H, where they are as zeta_s says. What
    is wrong there comes back times exp(-l H). The cost of a step is fixed.

    Source: [1] S. Devasia, D. Chen, B. Paden, IEEE Transactions on Automatic Control 41(7), 1996, section III; the
            horizon: Q. Zou, S. Devasia, "Preview-based stable-inversion for output tracking of linear systems", ASME
            Journal of Dynamic Systems, Measurement, and Control 121(4), 1999.
    """

    A22: Any = quantity("1", "dPsi/dzeta at a trim (k, k), each entry in its own unit.")
    past: FadingModes = part("Modes that fade.")
    future: FadingModes = part("Modes that grow, in reversed time.")
    craft: Any = part("The vehicle believed in.", default=Hypersonic())
    horizon: Scalar = quantity("s", "How far ahead the command is read: H.", default=4.0, above=0)
    alpha: Scalar = quantity("rad", "Where the first search starts.", default=0.03, kind="angle")
    intervals: int = option("Nodes ahead.", default=40)
    steps: int = option("Newton steps each time.", default=3)

    def check(self) -> None:
        """Refuse a horizon of no time or without nodes."""
        if not self.horizon > 0:
            problem = f"{float(self.horizon):g} s ahead"
            raise InputError("PreviewInternal.horizon", problem, fix="give some seconds: the error is exp(-l horizon)")
        if self.intervals < 1:
            problem = f"{self.intervals} intervals ahead"
            raise InputError("PreviewInternal.intervals", problem, fix="give at least one, better one each 0.1 s")

    def init(self, key: Any) -> PreviewState:
        """Nothing yet: the first step takes the quasi-static solution."""
        p, k = jnp.shape(self.past.decay)[0], jnp.shape(self.A22)[0]
        off = jnp.asarray(False)
        alpha = jnp.full(self.intervals + 1, 1.0 * self.alpha)
        return PreviewState(jnp.zeros(()), jnp.zeros((2, p, 1)), jnp.zeros((k, 1)), alpha, off, off)

    def step(self, t: Any, state: PreviewState, command: Any) -> tuple[PreviewState, Any]:
        """zeta_d (6,) at time t (s); command: has `at(t)` -> PathPoint for t an array."""
        d = self.horizon / self.intervals
        p = command.at(t + d * jnp.arange(self.intervals + 1.0))
        still, found = solve_quasi_static(self.craft, p, state.alpha, self.steps)
        rates = internal_rates(self.craft, p.h, p.h_rate, p.V, p.h_acceleration, p.V_rate, still)
        zeta = jnp.stack(still)
        w = jnp.stack(rates) - _matrix_product(self.A22, zeta)
        q = self._propagate_past(t, state, w[:, :1], zeta[:, :1])
        made = self.past.reconstruct(q) + self.future.reconstruct(self._sum_future(w, zeta[:, -1:], d))
        kept = PreviewState(1.0 * t, jnp.stack(q), w[:, :1], still[0], jnp.asarray(True), found.all())
        return kept, made[:, 0]

    def _propagate_past(self, t: Any, state: PreviewState, w: Any, zeta: Any) -> Complex:
        """The modes that fade, from the last step to t; at the first step as zeta says."""
        dt = jnp.maximum(t - state.t, 0.0)
        begin, end = self.past.weights(dt)
        E = self.past.powers(dt * jnp.ones((1, 1)))
        drive = _add(_multiply(begin, self.past.modal_input(state.w)), _multiply(end, self.past.modal_input(w)))
        q = _add(_multiply(E, (state.q[0], state.q[1])), drive)
        first = self.past.modal_input(zeta)
        return jnp.where(state.started, q[0], first[0]), jnp.where(state.started, q[1], first[1])

    def _sum_future(self, w: Any, zeta: Any, d: Any) -> Complex:
        """The modes that grow, summed from the end of the horizon; in reversed time w has the other sign."""
        far, near = self.future.weights(d)
        seen = self.future.modal_input(-w)
        each = _add(
            _multiply(near, (seen[0][:, :-1], seen[1][:, :-1])), _multiply(far, (seen[0][:, 1:], seen[1][:, 1:]))
        )
        fading = _multiply(self.future.powers(d * jnp.arange(1.0 * self.intervals)[None]), each)
        last = _multiply(self.future.powers(d * self.intervals * jnp.ones((1, 1))), self.future.modal_input(zeta))
        return fading[0].sum(axis=1, keepdims=True) + last[0], fading[1].sum(axis=1, keepdims=True) + last[1]


def _matrix_product(M: Any, x: Any) -> Any:
    """M x for M (a, b), x (b, n), summed in a fixed order."""
    return (jnp.asarray(M)[:, :, None] * x[None]).sum(axis=1)


def _add(a: Complex, b: Complex) -> Complex:
    return a[0] + b[0], a[1] + b[1]


def _multiply(a: Complex, b: Complex) -> Complex:
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def _divide(a: Complex, b: Complex) -> Complex:
    size = b[0] * b[0] + b[1] * b[1]
    return (a[0] * b[0] + a[1] * b[1]) / size, (a[1] * b[0] - a[0] * b[1]) / size
