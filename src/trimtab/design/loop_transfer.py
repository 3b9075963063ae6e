"""Transfer function L of a feedback loop, opened at the law's demand and closed by negative feedback.

This code runs offline and uses LAPACK and scipy.

Source: [1] S. Skogestad, I. Postlethwaite, "Multivariable feedback control", Wiley 2005, sections 2.4 and 4.10.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import FAST_COMPILE_OPTIONS
from trimtab.core.rng import Key
from trimtab.core.signals import Estimate
from trimtab.design.linearise import linearise
from trimtab.design.model import entry_names, model_of_vehicle, record_vector, unpack_record
from trimtab.design.poles import balance_matrix, format_pole, sorted_poles, uncontrollable_poles

PER_DECADE = 120
"""Number of frequencies per decade at which a loop's frequency response is evaluated."""
NEAR = np.geomspace(1e-3, 10, 40)
"""Distances of extra frequencies from each pole's frequency, as factors of the pole's real part."""
UNSTABLE = 1e-9
"""Smallest decay rate of a stable closed-loop pole, as a fraction of the largest entry of A."""


class FeedbackLoop(NamedTuple):
    """Feedback loop x' = A x + B e, y = C x + D e, closed by e = -y: L(s) = C (s I - A)^-1 B + D.

    A: (n, n).  B: (n, m).  C: (m, n).  D: (m, m).  period: 0 for a continuous loop; otherwise the sampling period (s).
    In a sampled loop, x' means x at the next sample.
    """

    A: Any
    B: Any
    C: Any
    D: Any
    period: float = 0.0

    def frequency_response(self, w: Any) -> Any:
        """Return L at frequencies w (k,) in rad/s, above 0: complex (k, m, m)."""
        w = np.atleast_1d(np.asarray(w, float))
        s = np.exp(1j * w * self.period) if self.period else 1j * w
        shifted = s[:, None, None] * np.eye(len(self.A)) - self.A
        return self.C @ np.linalg.solve(shifted, np.broadcast_to(self.B, (len(w), *self.B.shape))) + self.D

    def complementary_sensitivity(self) -> "FeedbackLoop":
        """Return T = (I + L)^-1 L. It maps a disturbance of the demand to minus the loop's reaction."""
        try:
            F = np.linalg.inv(np.eye(len(self.D)) + self.D)
        except np.linalg.LinAlgError as error:
            fix = "give a loop whose matrix D does not have the eigenvalue -1"
            raise InputError("loop", "I + D has no inverse, so the loop can't be closed", fix=fix) from error
        return FeedbackLoop(self.A - self.B @ F @ self.C, self.B @ F, F @ self.C, F @ self.D, self.period)

    def unstable_poles(self) -> tuple[complex, ...]:
        """Return the closed-loop poles that do not decay, without uncontrollable and unobservable poles."""
        T = self.complementary_sensitivity()
        A = balance_matrix(T.A)
        hidden = np.array([*uncontrollable_poles(T.A, T.B), *uncontrollable_poles(T.A.T, T.C.T), np.inf])
        size = max(np.abs(A).max(initial=0.0), np.finfo(float).tiny)
        unstable = []
        for pole in sorted_poles(A):
            grows = abs(pole) >= 1 - UNSTABLE if self.period else pole.real >= -UNSTABLE * size
            if grows and np.abs(hidden - pole).min() > math.sqrt(UNSTABLE) * size:
                unstable.append(complex(pole))
        return tuple(unstable)

    def require_stable(self, part: str) -> "FeedbackLoop":
        """Return this loop unchanged; raise InputError if the closed loop is not stable without delay."""
        bad = self.unstable_poles()
        if bad:
            problem = f"the closed loop is not stable even without delay; it has the pole {format_pole(bad[0])}"
            raise InputError(
                part, problem, fix="change the gains or their sign; the loop is closed by negative feedback, e = -y"
            )
        return self

    def discretise(self, period: float) -> "FeedbackLoop":
        """Return the sampled loop: a computer samples y every `period` (s) and holds e until the next sample."""
        from scipy.signal import cont2discrete

        if self.period or not (math.isfinite(period) and period > 0):
            fix = "sample a continuous loop, with a period above 0 s"
            problem = (
                f"the loop must be continuous and the period above 0 s, got {period} s for a loop of {self.period} s"
            )
            raise InputError("loop.sampled", problem, fix=fix)
        sampled: Any = cont2discrete((self.A, self.B, self.C, self.D), period, method="zoh")
        A, B, C, D, _ = sampled
        return FeedbackLoop(A, B, C, D, float(period))

    def grid(self) -> Any:
        """Return frequencies (rad/s) at which to evaluate L and T: evenly spaced on a log scale, dense near poles."""
        poles: Any = np.concatenate([np.linalg.eigvals(self.A), np.linalg.eigvals(self.complementary_sensitivity().A)])
        if self.period:
            moved = np.where(np.abs(poles) > 1e-12, poles, 1e-12)
            poles = np.log(moved.astype(complex)) / self.period
        sizes = np.abs(poles)
        sizes = sizes[sizes > 1e-9 * sizes.max(initial=1e-300)]
        low, high = (sizes.min() * 1e-4, sizes.max() * 1e4) if len(sizes) else (1e-4, 1e4)
        last = math.pi / self.period if self.period else high
        top = max(last, 10 * low)
        parts = [np.geomspace(low, top, int(PER_DECADE * math.log10(top / low)) + 2)]
        for pole in poles[poles.imag > 0]:
            width = max(abs(pole.real), 1e-6 * pole.imag)
            parts += [pole.imag + width * NEAR, pole.imag - width * NEAR]
        w = np.unique(np.concatenate(parts))
        return w[(w > 0) & (w <= last)]


def loop_of_polynomials(numerator: Any, denominator: Any) -> FeedbackLoop:
    """Create the loop L(s) = numerator/denominator. Coefficients are sorted by falling powers of s."""
    from scipy.signal import tf2ss

    whole = [np.atleast_1d(np.asarray(p, float)) for p in (numerator, denominator)]
    num, den = (np.trim_zeros(p, "f") for p in whole)
    if not (np.isfinite(num).all() and np.isfinite(den).all() and den.any()) or len(num) > len(den):
        problem = f"{whole[0].tolist()} / {whole[1].tolist()} is not a proper transfer function"
        raise InputError(
            "loop",
            problem,
            fix="give finite coefficients by falling powers of s; the denominator must have the higher degree",
        )
    num = num if len(num) else np.zeros(1)
    if len(den) == 1:
        return FeedbackLoop(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[num[-1] / den[-1]]]))
    return FeedbackLoop(*tf2ss(num, den))


def loop_of_gain(A: Any, B: Any, K: Any) -> FeedbackLoop:
    """Create the loop of u = +K x around x' = A x + B u, with the sign of K from `lqr`."""
    A, B, K = (np.atleast_2d(np.asarray(M, float)) for M in (A, B, K))
    n, m = len(A), B.shape[1]
    if (A.shape, B.shape, K.shape) != ((n, n), (n, m), (m, n)):
        raise InputError(
            "loop",
            f"the shapes of A {A.shape}, B {B.shape}, K {K.shape} don't fit together",
            fix="give A (n, n), B (n, m), K (m, n)",
        )
    return FeedbackLoop(A, B, -K, np.zeros((m, m)))


def loop_of_law(vehicle: Any, law: Any, x: Any, state: Any = None) -> FeedbackLoop:
    """Linearise the loop of a law and a vehicle at a state at which the demand is constant.

    The law's internal state is held constant, so that the demand depends on the estimated state alone. For a law that
    switches between modes, the result is the loop of one mode.

    Args:
        vehicle: object with `dynamics(t, x, u)` whose input is the law's demand.
        law: object with `step(t, state, estimate)` -> (state, output), where output.demand is a record like the
            vehicle's input.
        x: state record, e.g. `law.equilibrium()`.
        state: internal state of the law; default: the state from `law.init`.

    Raises: InputError if the demand is not constant at x, because the vehicle then leaves the point.
    """
    memory = law.init(Key(np.uint32(0), np.uint32(0))) if state is None else state

    def demand(xs: Any) -> Any:
        estimate = Estimate(t=0, age=0.0, fresh=True, valid=True, state=unpack_record(x, xs), dt=1e-3)
        return law.step(0, memory, estimate)[1].demand

    start = jnp.asarray(record_vector(x), jnp.float64)
    once = jax.jit(
        lambda xs: (demand(xs), jax.jacfwd(lambda v: record_vector(demand(v)))(xs)),
        compiler_options=FAST_COMPILE_OPTIONS,
    )
    u, gain = once(start)
    linear = linearise(model_of_vehicle(vehicle, x, u))
    K = np.asarray(gain).reshape(len(entry_names(u)), len(start))
    loop = loop_of_gain(linear.A, linear.B, K)
    closed, rate, changes = loop.complementary_sensitivity().A, linear.drift, []
    for _ in range(len(start)):
        changes.append(np.abs(K @ rate).max())
        rate = closed @ rate
    if max(changes) > 1e-9 * max(np.abs(K).max(), 1.0):
        name = type(law).__name__
        problem = f"the demand of {name} must be constant at this state, but changes by {max(changes):.3g} per s"
        raise InputError("loop", problem, fix="give a trim: law.equilibrium(), or the result of design.trim")
    return loop
