"""Feedback of a predicted state, which removes a constant delay between command and plant from the loop.

    x' = A x + B u(t - delay)     u(t) = K z(t)     z(t) = e^(A delay) x(t) + integral of e^(A s) B u(t - s), s < delay

z is the predicted state at the arrival of the current command. The predicted state obeys z' = A z + B u, without delay.
The loop therefore has the poles of A + B K for any delay, and even a plant that is faster than the delay can be
stabilised. The command is held over a period. The delay need not be a whole number of periods. This code runs offline
and uses LAPACK.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, eq. 5.1;
[2] A. Manitius, A. Olbrot, "Finite spectrum assignment problem for systems with delays", IEEE Trans. Automatic Control
24 (1979); [3] K. J. Åström, B. Wittenmark, "Computer-controlled systems", Prentice Hall 1997, section 2.3.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm

from trimtab.core.errors import InputError
from trimtab.design.poles import sorted_poles

ON_A_PERIOD = 1e-9
"""Distance from a whole number of periods, in periods, up to which a delay counts as a whole number of periods."""


class PredictiveFeedback(NamedTuple):
    """Feedback of the predicted state, u(k) = state_gain x(k) + sum of input_gains[j] u(k - 1 - j).

    state_gain: K e^(A delay) (m, n).  input_gains: (N, m, m), for the N commands in transit, newest first. A, B:
    matrices of the plant.  K: (m, n).  delay: design delay (s).  period: time for which a command is held (s).
    """

    state_gain: Any
    input_gains: Any
    A: Any
    B: Any
    K: Any
    delay: float
    period: float

    def command(self, x: Any, sent: Any) -> Any:
        """Return u (m,) from the state x (n,) and the commands in transit `sent` (N, m), newest first."""
        return self.state_gain @ x + np.einsum("jab,jb->a", self.input_gains, np.asarray(sent))

    def loop_matrix(self, delay: float | None = None) -> Any:
        """Return the matrix that advances (x, commands in transit) by one period of the closed loop.

        delay: actual delay of the plant (s); None for the design delay.
        """
        actual = self.delay if delay is None else delay
        n, m = self.B.shape
        weights = _arriving_weights(self.A, self.B, self.period, actual)
        held = max(len(self.input_gains), len(weights) - 1)
        F = np.zeros((n + held * m,) * 2)
        command = np.zeros((m, len(F)))
        command[:, :n] = self.state_gain
        for j, gain in enumerate(self.input_gains):
            command[:, n + j * m : n + (j + 1) * m] = gain
        F[:n, :n] = expm(self.A * self.period)
        F[:n] += weights[0] @ command
        for j, weight in enumerate(weights[1:]):
            F[:n, n + j * m : n + (j + 1) * m] += weight
        if held:
            F[n : n + m] = command
            F[n + m :, n : n + (held - 1) * m] = np.eye((held - 1) * m)
        return F

    def poles(self, delay: float | None = None) -> Any:
        """Return the poles of the sampled loop, sorted by falling magnitude.

        At the design delay, these are the poles of the loop without delay, and poles at 0 for the commands in transit.
        """
        poles = sorted_poles(self.loop_matrix(delay))
        return poles[np.argsort(-np.abs(poles), kind="stable")]


def compensate_delay(A: Any, B: Any, K: Any, delay: float, period: float) -> PredictiveFeedback:
    """Compute the predictive feedback that replaces u = K x if the plant receives commands with a constant delay.

    Args:
        A: (n, n).
        B: (n, m).
        K: (m, n), designed without delay, u = +K x.
        delay: time from the sampling of the state to the arrival of the command (s), constant, 0 or more.
        period: time for which a command is held (s).

    Raises: InputError if the shapes of the matrices don't fit together, or if a time is not valid.
    """
    A, B, K = (np.asarray(M, float) for M in (A, B, K))
    n, m = B.shape if B.ndim == 2 else (0, 0)
    if A.shape != (n, n) or K.shape != (m, n) or n == 0:
        problem = f"the shapes of A {A.shape}, B {B.shape}, K {K.shape} don't fit together"
        raise InputError("compensate_delay", problem, fix="give A (n, n), B (n, m), K (m, n)")
    if not (0 <= delay < math.inf and 0 < period < math.inf):
        problem = f"the delay must be at least 0 s and the period above 0 s, got {delay} s and {period} s"
        raise InputError("compensate_delay", problem, fix="give e.g. delay=0.05, period=0.01")
    gains = [K @ weight for weight in _waiting_weights(A, B, period, delay)]
    return PredictiveFeedback(K @ expm(A * delay), np.array(gains).reshape(-1, m, m), A, B, K, delay, period)


def plain_feedback(A: Any, B: Any, K: Any, period: float) -> PredictiveFeedback:
    """Return the feedback u = K x without compensation, for comparison; `poles(delay)` shows the effect of a delay."""
    return compensate_delay(A, B, K, 0.0, period)


def _waiting_weights(A: Any, B: Any, period: float, delay: float) -> list[Any]:
    """Return the input matrix (n, m) of each command in transit, newest first, for the state when the current one
    arrives."""
    count = math.ceil(delay / period - ON_A_PERIOD)
    return [_integral(A, B, max((j - 1) * period, 0.0), min(j * period, delay)) for j in range(1, count + 1)]


def _arriving_weights(A: Any, B: Any, period: float, delay: float) -> list[Any]:
    """Return the input matrix (n, m) of each command, newest first, for the plant's state at the end of the current
    period."""
    count = math.ceil(delay / period - ON_A_PERIOD)
    late = (
        delay - (count - 1) * period if count else 0.0
    )  # time within a period at which the newer of two commands takes over
    oldest, newer = _integral(A, B, period - late, period), _integral(A, B, 0.0, period - late)
    weights = [np.zeros_like(np.asarray(B, float)) for _ in range(count + 1)]
    weights[count] = weights[count] + oldest
    weights[max(count - 1, 0)] = weights[max(count - 1, 0)] + newer
    return weights


def _integral(A: Any, B: Any, low: float, high: float) -> Any:
    """Return the integral of e^(A s) B over s from low to high (n, m)."""
    n, m = B.shape
    whole = np.zeros((n + m, n + m))
    whole[:n, :n], whole[:n, n:] = A, B
    return expm(A * low) @ expm(whole * (high - low))[:n, n:]
