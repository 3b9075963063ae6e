"""The jitter margin: every delay that varies in [0, tau], however it does, leaves the loop stable.

Offline code: LAPACK and scipy. Sufficient, not necessary: what the theorem does not promise may still be stable.

Source: [1] C.-Y. Kao, B. Lincoln, "Simple stability criteria for systems with time-varying delays", Automatica 40
(2004), theorems 1 and 2; [2] A. Cervin, B. Lincoln, J. Eker, K.-E. Årzén, G. Buttazzo, "The jitter margin and its
application in the design of real-time control systems", RTCSA 2004; [3] Z. Kulis, "Feedback control of a hovercraft
over a wireless link", University of Maryland, 2006, section 5.3.3.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from trimtab.core.errors import InputError
from trimtab.design.delay_margin import delay_margin
from trimtab.design.loop_transfer import Loop

PEAKS, CLOSE = 12, 0.7
"""How many of the grid's highest peaks are looked at closer, and how high they must be beside the highest."""


def jitter_margin(loop: Loop, *, delay: float = 0.0) -> float:
    """tau (s): stable for every delay in [delay, delay + tau] that varies with time.

        |T(j w)| < 1/(tau w) for all w                                                              [1, theorem 1]

    with T = (I + L e)^-1 L e, e = exp(-j w delay), and its largest singular value where there are several signals, all
    of which take the same delay.

    Args:
        loop: continuous.
        delay: the part of the delay that is always there (s).

    Returns:
        0 where the constant delay alone is too long, or where L passes all frequencies.

    Raises: InputError where the loop is sampled, or not stable without delay.
    """
    if not (math.isfinite(delay) and delay >= 0):
        raise InputError("jitter_margin", f"delay {delay} s", fix="give a constant delay of 0 s or more")
    limit = delay_margin(loop)
    if delay >= limit.delay or loop.D.any():
        return 0.0

    def gain(w: Any) -> Any:
        return w * _size(loop.response(w) * np.exp(-1j * w * delay)[:, None, None])

    near = np.array([c.frequency for c in limit.crossovers])
    w = np.unique(np.concatenate([loop.grid(), near, *(near * (1 + s * d) for s in (-1, 1) for d in NEARER)]))
    far = float(np.linalg.norm(loop.C @ loop.B, 2))  # w T as w grows
    return 1 / max(_highest(gain, w), far, np.finfo(float).tiny)


NEARER = np.geomspace(1e-6, 0.3, 60)
"""Frequencies beside a crossover, in parts of it: there T peaks when the constant delay is near its margin."""


def jitter_margin_samples(loop: Loop) -> float:
    """N: stable for every whole number of periods in [0, N], varying from sample to sample.

        |T(e^jw)| < 1/(N |e^jw - 1|) for all w                                                      [1, theorem 2]

    Args:
        loop: sampled, see `Loop.sampled`.

    Returns:
        The bound as a real number: all whole N below it are safe.

    Raises: InputError where the loop is continuous, or not stable without delay.
    """
    if not loop.period:
        fix = "loop.sampled(period), or jitter_margin for a continuous loop"
        raise InputError("jitter_margin_samples", "the loop is continuous", fix=fix)
    loop.require_stable("jitter_margin_samples")

    def gain(w: Any) -> Any:
        return np.abs(np.exp(1j * w * loop.period) - 1) * _size(loop.response(w))

    return 1 / max(_highest(gain, loop.grid()), np.finfo(float).tiny)


def _size(L: Any) -> Any:
    """Largest singular value of (I + L)^-1 L at each frequency, (k, m, m) -> (k,)."""
    return np.linalg.norm(np.linalg.solve(np.eye(L.shape[-1]) + L, L), 2, axis=(1, 2))


def _highest(gain: Callable[[Any], Any], w: Any) -> float:
    from scipy.optimize import minimize_scalar

    values = gain(w)
    inner = np.flatnonzero((values[1:-1] >= values[:-2]) & (values[1:-1] >= values[2:])) + 1
    best = float(values.max())
    inner = inner[values[inner] > CLOSE * best]
    for i in inner[np.argsort(-values[inner])][:PEAKS]:
        found: Any = minimize_scalar(
            lambda v: -float(gain(np.array([v]))[0]),
            bounds=(w[i - 1], w[i + 1]),
            method="bounded",
            options={"xatol": 1e-12 * w[i]},
        )
        best = max(best, -float(found.fun))
    return best
