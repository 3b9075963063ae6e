"""The largest constant delay that a loop stands: phase margin over crossover frequency, over all crossovers.

Offline code: LAPACK and scipy.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section
5.3.3; [2] S. Skogestad, I. Postlethwaite, "Multivariable feedback control", Wiley 2005, section 2.4.3 for one signal,
4.9.3 (eigenvalue loci) for several.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.design.loop_transfer import Loop


class Crossover(NamedTuple):
    """A frequency (rad/s) at which an eigenvalue of L has size 1, its phase margin (rad), and their quotient (s)."""

    frequency: float
    phase_margin: float
    delay: float


class DelayMargin(NamedTuple):
    """Stable for every constant delay below `delay` (s; infinite where no delay does harm).

    crossovers: all of them, by rising delay; the first decides. At its delay a pair of poles sits at its frequency.
    """

    delay: float
    crossovers: tuple[Crossover, ...]


def delay_margin(loop: Loop) -> DelayMargin:
    """The delay margin of a continuous loop, the same delay in all of its signals.

    det(I + exp(-j w tau) L(j w)) = 0 only where an eigenvalue of L(j w) has size 1; then tau = phase margin / w.

    Raises: InputError where the loop is sampled, or not stable without delay.
    """
    if loop.period:
        fix = "give the continuous loop; jitter_margin_samples is for sampled ones"
        raise InputError("delay_margin", f"the loop is sampled each {loop.period} s", fix=fix)
    loop.require_stable("delay_margin")
    if np.abs(np.linalg.eigvals(loop.D)).max(initial=0.0) >= 1:
        return DelayMargin(0.0, ())  # of size 1 and more at every high frequency: no delay is short enough
    found = []
    for w, k in _crossings(loop):
        (value,) = _loci(loop, [w])[:, k]
        phase = (np.angle(value) + math.pi) % (2 * math.pi)
        found.append(Crossover(float(w), float(phase), float(phase / w)))
    found.sort(key=lambda c: c.delay)
    return DelayMargin(found[0].delay if found else math.inf, tuple(found))


def _loci(loop: Loop, w: Any) -> Any:
    """Eigenvalues of L (len(w), m), by rising size: their sizes are continuous in w."""
    values = np.linalg.eigvals(loop.response(w))
    return np.take_along_axis(values, np.argsort(np.abs(values), axis=1), axis=1)


def _crossings(loop: Loop) -> list[tuple[float, int]]:
    """(frequency, which) where a locus passes size 1; the grid is refined where one comes near it and turns."""
    from scipy.optimize import brentq

    solve: Any = brentq

    def size(w: float, k: int) -> float:
        return float(np.log(np.abs(_loci(loop, [w])[0, k])))

    w = loop.grid()
    with np.errstate(divide="ignore"):
        sizes = np.log(np.abs(_loci(loop, w)))
    found = []
    for k in range(sizes.shape[1]):
        at, own = _with_turns(w, sizes[:, k], lambda v, k=k: size(v, k))
        passes = np.flatnonzero(np.sign(own[:-1]) * np.sign(own[1:]) < 0)
        found += [(float(solve(size, at[i], at[i + 1], args=(k,), xtol=1e-14, rtol=1e-13)), k) for i in passes]
        found += [(float(v), k) for v in at[own == 0]]
    return found


def _with_turns(w: Any, values: Any, function: Callable[[float], float]) -> tuple[Any, Any]:
    """Grid and values, and between them the point next to 0 wherever the values come towards 0 and turn back."""
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
