"""Margins of a loop that is closed over a link, against constant delay, varying delay, and lost packets.

`delay_margin`: the largest constant delay. This is the smallest ratio of phase margin to crossover frequency over all
crossovers.

`jitter_margin`: the largest tau for which the loop is proved stable for every delay that varies within [0, tau]. The
condition is sufficient, not necessary: the loop may also be stable for larger variations.

`mean_square`: spread of a controlled signal caused by lost packets.

    x(k+1) = w(k) if the packet arrives,  a x(k) + w(k) if it is lost;   w white noise of variance 1

A command that arrives brings x to zero within one step. After a loss, the loop is open for one step. A packet is sent
again up to `retransmissions` times within its step. Each try is lost with probability q. With one retransmission, a
step gets no command with probability q^2, and E x^2 stays bounded if |a| q < 1. These functions allow any number of
retransmissions; [1] has one.

This code runs offline and uses LAPACK and scipy.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section
5.3.3, eqs. 5.2 and 5.3; [2] S. Skogestad, I. Postlethwaite, "Multivariable feedback control", Wiley 2005, section 2.4.3
for one signal, 4.9.3 (eigenvalue loci) for several; [3] C.-Y. Kao, B. Lincoln, "Simple stability criteria for systems
with time-varying delays", Automatica 40 (2004), theorems 1 and 2; [4] A. Cervin, B. Lincoln, J. Eker, K.-E. Årzén,
G. Buttazzo, "The jitter margin and its application in the design of real-time control systems", RTCSA 2004.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.design.loop_transfer import FeedbackLoop

PEAKS, PEAK_SHARE_MIN = 12, 0.7
"""Number of highest peaks on the frequency grid that are refined, and smallest size of a refined peak relative to the
highest peak."""
CROSSOVER_DISTANCES = np.geomspace(1e-6, 0.3, 60)
"""Relative distances of extra frequencies from a crossover frequency. T has a peak near a crossover if the delay is
near the delay margin."""


class Crossover(NamedTuple):
    """Crossover, at which an eigenvalue of L has size 1: frequency (rad/s), phase margin (rad), tolerated delay (s)."""

    frequency: float
    phase_margin: float
    delay: float


class DelayMargin(NamedTuple):
    """Delay margin of a loop.

    delay: the loop is stable for every constant delay below this (s); infinite if no delay destabilises the loop.
    crossovers: all crossovers, by rising delay. The first crossover determines the margin. At this delay, the closed
    loop has a pair of poles on the imaginary axis, at the crossover frequency.
    """

    delay: float
    crossovers: tuple[Crossover, ...]


def delay_margin(loop: FeedbackLoop) -> DelayMargin:
    """Compute the delay margin of a continuous loop, for the same delay in all of its signals.

    A closed-loop pole at j w, det(I + exp(-j w tau) L(j w)) = 0, requires an eigenvalue of L(j w) with size 1. Then
    tau = phase margin / w.

    Raises: InputError if the loop is sampled, or not stable without delay.
    """
    if loop.period:
        fix = "give a continuous loop, or use jitter_margin_samples for a sampled loop"
        raise InputError("delay_margin", f"the loop must be continuous, but is sampled every {loop.period} s", fix=fix)
    loop.require_stable("delay_margin")
    if np.abs(np.linalg.eigvals(loop.D)).max(initial=0.0) >= 1:
        return DelayMargin(0.0, ())  # L has size 1 or more at all high frequencies, so every delay is too long
    crossovers = []
    for w, k in _crossings(loop):
        (value,) = _eigenvalue_loci(loop, [w])[:, k]
        phase = (np.angle(value) + math.pi) % (2 * math.pi)
        crossovers.append(Crossover(float(w), float(phase), float(phase / w)))
    crossovers.sort(key=lambda c: c.delay)
    return DelayMargin(crossovers[0].delay if crossovers else math.inf, tuple(crossovers))


def _eigenvalue_loci(loop: FeedbackLoop, w: Any) -> Any:
    """Return the eigenvalues of L (len(w), m), sorted by rising size, so that each column's size is continuous in w."""
    values = np.linalg.eigvals(loop.frequency_response(w))
    return np.take_along_axis(values, np.argsort(np.abs(values), axis=1), axis=1)


def _crossings(loop: FeedbackLoop) -> list[tuple[float, int]]:
    """Return (frequency, eigenvalue index) of each crossover.

    The grid is refined where the size of an eigenvalue approaches 1 and turns back.
    """
    from scipy.optimize import brentq

    solve: Any = brentq

    def size(w: float, k: int) -> float:
        return float(np.log(np.abs(_eigenvalue_loci(loop, [w])[0, k])))

    w = loop.grid()
    with np.errstate(divide="ignore"):
        sizes = np.log(np.abs(_eigenvalue_loci(loop, w)))
    crossings = []
    for k in range(sizes.shape[1]):
        at, own = _insert_turning_points(w, sizes[:, k], lambda v, k=k: size(v, k))
        passes = np.flatnonzero(np.sign(own[:-1]) * np.sign(own[1:]) < 0)
        crossings += [(float(solve(size, at[i], at[i + 1], args=(k,), xtol=1e-14, rtol=1e-13)), k) for i in passes]
        crossings += [(float(v), k) for v in at[own == 0]]
    return crossings


def _insert_turning_points(w: Any, values: Any, function: Callable[[float], float]) -> tuple[Any, Any]:
    """Return grid and values, with a point added at each extremum where the values approach 0 and turn back."""
    from scipy.optimize import minimize_scalar

    side, rising = np.sign(values), np.diff(np.abs(values)) > 0
    at, own = list(w), list(values)
    for i in np.flatnonzero(~rising[:-1] & rising[1:]) + 1:
        if side[i - 1] == side[i] == side[i + 1]:
            near: Any = minimize_scalar(
                lambda v, sign=side[i]: sign * function(v),
                bounds=(w[i - 1], w[i + 1]),
                method="bounded",
                options={"xatol": 1e-10 * w[i]},
            )
            at.append(float(near.x))
            own.append(float(side[i] * near.fun))
    order = np.argsort(at)
    return np.asarray(at)[order], np.asarray(own)[order]


def jitter_margin(loop: FeedbackLoop, *, delay: float = 0.0) -> float:
    """Return the largest tau (s) for which the loop is proved stable for every time-varying delay in
    [delay, delay + tau].

        |T(j w)| < 1/(tau w) for all w                                                              [3, theorem 1]

    with T = (I + L e)^-1 L e, e = exp(-j w delay). For several signals, which all have the same delay, |T| is the
    largest singular value.

    Args:
        loop: continuous loop.
        delay: constant part of the delay (s).

    Returns:
        0 if the constant delay alone is too long, or L does not fall at high frequencies.

    Raises: InputError if the loop is sampled, or not stable without delay.
    """
    if not (math.isfinite(delay) and delay >= 0):
        raise InputError("jitter_margin", f"the constant delay must be at least 0 s, got {delay} s", fix="delay=0.0")
    limit = delay_margin(loop)
    if delay >= limit.delay or loop.D.any():
        return 0.0

    def gain(w: Any) -> Any:
        return w * _largest_singular_value(loop.frequency_response(w) * np.exp(-1j * w * delay)[:, None, None])

    near = np.array([c.frequency for c in limit.crossovers])
    w = np.unique(
        np.concatenate([loop.grid(), near, *(near * (1 + s * d) for s in (-1, 1) for d in CROSSOVER_DISTANCES)])
    )
    far = float(np.linalg.norm(loop.C @ loop.B, 2))  # limit of w T for large w
    return 1 / max(_refine_peak(gain, w), far, np.finfo(float).tiny)


def jitter_margin_samples(loop: FeedbackLoop) -> float:
    """Return the bound N: the loop is stable for every delay of 0 to N whole periods that varies from sample to sample.

        |T(e^jw)| < 1/(N |e^jw - 1|) for all w                                                      [3, theorem 2]

    Args:
        loop: sampled loop, see `FeedbackLoop.discretise`.

    Returns:
        The bound as a real number; every whole number of periods below the bound is safe.

    Raises: InputError if the loop is continuous, or not stable without delay.
    """
    if not loop.period:
        fix = "loop.discretise(period), or jitter_margin for a continuous loop"
        raise InputError("jitter_margin_samples", "the loop is continuous", fix=fix)
    loop.require_stable("jitter_margin_samples")

    def gain(w: Any) -> Any:
        return np.abs(np.exp(1j * w * loop.period) - 1) * _largest_singular_value(loop.frequency_response(w))

    return 1 / max(_refine_peak(gain, loop.grid()), np.finfo(float).tiny)


def _largest_singular_value(L: Any) -> Any:
    """Return the largest singular value of (I + L)^-1 L at each frequency, (k, m, m) -> (k,)."""
    return np.linalg.norm(np.linalg.solve(np.eye(L.shape[-1]) + L, L), 2, axis=(1, 2))


def _refine_peak(gain: Callable[[Any], Any], w: Any) -> float:
    from scipy.optimize import minimize_scalar

    values = gain(w)
    inner = np.flatnonzero((values[1:-1] >= values[:-2]) & (values[1:-1] >= values[2:])) + 1
    best = float(values.max())
    inner = inner[values[inner] > PEAK_SHARE_MIN * best]
    for i in inner[np.argsort(-values[inner])][:PEAKS]:
        peak: Any = minimize_scalar(
            lambda v: -float(gain(np.array([v]))[0]),
            bounds=(w[i - 1], w[i + 1]),
            method="bounded",
            options={"xatol": 1e-12 * w[i]},
        )
        best = max(best, -float(peak.fun))
    return best


def mean_square_growth(a: Any, q: Any, *, retransmissions: int = 1) -> Any:
    """Return the growth factor of E x^2 in one step, a^2 q^(1 + retransmissions). Below 1, E x^2 is bounded.

    Args:
        a: pole of the plant for one step; array of any shape.
        q: probability that one try is lost, 0 to 1; array whose shape broadcasts with the shape of a.
        retransmissions: number of tries after the first.
    """
    a, q = np.asarray(a, float), np.asarray(q, float)
    if not (np.isfinite(a).all() and ((q >= 0) & (q <= 1)).all()):
        raise InputError(
            "packet_loss",
            f"a must be finite and q within 0 to 1, got a = {a}, q = {q}",
            fix="give a finite pole and a probability from 0 to 1",
        )
    if retransmissions < 0 or retransmissions != int(retransmissions):
        raise InputError(
            "packet_loss",
            f"retransmissions must be a whole number of at least 0, got {retransmissions!r}",
            fix="give e.g. 1",
        )
    return a**2 * q ** (1 + retransmissions)


def mean_squares(a: float, q: float, steps: int, *, start: float = 0.0, retransmissions: int = 1) -> Any:
    """Return the mean square E[x^2] of the plant's state after 0, 1, …, `steps` steps, of shape (steps + 1,).

    The values are exact: E[x(k+1)^2] = growth * E[x(k)^2] + 1.

    Args:
        a: the plant's pole, per step.
        q: probability that one try is lost.
        steps: number of steps.
        start: mean square at the start, E x(0)^2.
        retransmissions: number of tries after the first.
    """
    g = float(mean_square_growth(a, q, retransmissions=retransmissions))
    squares = np.empty(steps + 1)
    squares[0] = start
    for k in range(steps):
        squares[k + 1] = g * squares[k] + 1
    return squares


def mean_square(a: Any, q: Any, *, retransmissions: int = 1) -> Any:
    """Return the limit of E x^2 after many steps, e.g. 1/(1 - a^2 q^2) with one retransmission; infinite if E x^2
    diverges [1, eq. 5.3]."""
    g = mean_square_growth(a, q, retransmissions=retransmissions)
    return np.where(g < 1, 1 / np.where(g < 1, 1 - g, 1.0), np.inf)


def critical_loss(a: Any, *, retransmissions: int = 1) -> Any:
    """Return the loss probability q of one try above which E x^2 grows without bound, e.g. 1/|a| with one
    retransmission.

    The result is 1 for a stable plant, whose E x^2 stays bounded at any loss probability.
    """
    size = np.maximum(np.abs(np.asarray(a, float)), 1.0)
    return size ** (-2.0 / (1 + retransmissions))
