"""An average over one run, judged by how many independent draws it is worth.

Errors of one run hang together in time, so that a thousand samples may be worth ten draws. A factor is by how much
errors exceed what the filter says; from 1/1.1 to 1.1 is honest for any purpose.

Source: [9] Bayley, Hammersley, "The effective number of independent observations in an autocorrelated time series",
J. R. Statist. Soc. B 8 (1946), here for squares of Gaussian numbers; [10] Madras, Sokal, "The pivot algorithm",
J. Stat. Phys. 50 (1988), appendix C, for how far correlations are summed.
"""

from typing import Any, NamedTuple

import numpy as np

from trimtab.logs.consistency import CONSISTENT, OPTIMISTIC, PESSIMISTIC, chi_square_quantile

UNDECIDED = "undecided"
HONEST, TELLING = 1.1, 2.0
"""A factor up to the first is as good as 1; a verdict `consistent` excludes factors of the second."""
FEW = 10
"""Fewer draws than these say nothing but that errors are too large: the number itself is not well known then."""
WINDOW = 6
"""Correlations are summed over so many times the correlation time that they sum to."""


class Judged(NamedTuple):
    """An average of squares of normalised numbers, against the bounds of a consistent filter.

    mean: of NIS, or of squared errors over sigma squared, for one instant.  expected: of a consistent filter.
    low, high: bounds of that average.  draws: how many independent squares it is worth.
    factor: errors over sigmas.  factor_low, factor_high: its interval.  verdict: consistent, optimistic (sigmas too
    small), pessimistic (too large) or undecided, where a factor of two could not be told.
    """

    mean: float
    expected: int
    low: float
    high: float
    draws: float
    factor: float
    factor_low: float
    factor_high: float
    verdict: str


def effective_draws(z: Any) -> Any:
    """Of each column of z (n, m), by how many independent Gaussian numbers' squares its mean square is known: (m,).

    n over 1 + 2 sum (1 - k/n) rho_k², up to where rho is lost in its own noise; about zero, so that a lasting error
    is one draw, however often it is looked at. A column of zeros is one draw, too: it says nothing.
    """
    n = len(z)
    spectrum = np.fft.rfft(z, 2 * n, axis=0)
    sums = np.fft.irfft(np.abs(spectrum) ** 2, axis=0)[:n]
    rho = sums / (n - np.arange(n))[:, None] / np.maximum(sums[0] / n, np.finfo(float).tiny)
    weight = (1 - np.arange(n) / n)[:, None]
    tau = 2 * np.cumsum(weight * np.minimum(rho * rho, 1.0), axis=0) - 1
    enough = np.arange(n)[:, None] >= WINDOW * tau
    enough[-1] = True
    draws = n / np.maximum(np.take_along_axis(tau, np.argmax(enough, axis=0)[None], axis=0)[0], 1.0)
    return np.where(sums[0] > 0, draws, 1.0)


def judge_average(mean: Any, draws: Any, dof: int, tail: float) -> Judged:
    """What the average of a sum of squares of normalised numbers says.

    Args:
        mean: of the sum.
        draws: what each of the squares in it is worth (dof,).
        dof: how many squares are summed.
        tail: probability of each side outside the bounds.
    """
    N = float(np.sum(draws))
    low, high = chi_square_quantile(np.array([tail, 1 - tail]), N) / N
    factor = np.sqrt(mean / dof)
    least, most = factor / np.sqrt(high), factor / np.sqrt(max(low, np.finfo(float).tiny))
    verdict = UNDECIDED
    if least > HONEST:
        verdict = OPTIMISTIC
    elif np.min(draws) < FEW:
        pass
    elif most < 1 / HONEST:
        verdict = PESSIMISTIC
    elif least > 1 / TELLING and most < TELLING:
        verdict = CONSISTENT
    numbers = (mean, dof, low * dof, high * dof, N, factor, least, most)
    return Judged(*(float(x) if i != 1 else x for i, x in enumerate(numbers)), verdict)  # pyright: ignore
