"""Consistency of a filter: averages of NIS and NEES against chi-square bounds, and whiteness of innovations.

A sigma is the standard deviation that the filter computes for an error. A filter is consistent if its errors match the
sigmas, optimistic if the errors are larger than the sigmas suggest, and pessimistic if the errors are smaller. Errors
of one run are correlated in time, so that a thousand samples may count as only ten independent draws. Therefore an
average over one run is judged by the effective number of independent draws. A factor is the ratio of errors to sigmas.

Source: [4] Bar-Shalom, Li, Kirubarajan, "Estimation with applications to tracking and navigation", Wiley 2001, section
5.4; [6] Ljung, Box, "On a measure of lack of fit in time series models", Biometrika 65 (1978); [9] Bayley, Hammersley,
"The effective number of independent observations in an autocorrelated time series", J. R. Statist. Soc. B 8 (1946),
here for squares of Gaussian numbers; [10] Madras, Sokal, "The pivot algorithm", J. Stat. Phys. 50 (1988), appendix C,
for the range over which correlations are summed.
"""

from typing import Any, NamedTuple

import numpy as np
from scipy import special

from trimtab.core.errors import InputError

CONSISTENT, OPTIMISTIC, PESSIMISTIC, UNDECIDED = "consistent", "optimistic", "pessimistic", "undecided"
MEANINGS = {
    CONSISTENT: "the errors match the sigmas",
    OPTIMISTIC: "the errors are larger than the sigmas predict",
    PESSIMISTIC: "the errors are smaller than the sigmas predict",
    UNDECIDED: "too few data",
}
"""Meaning of each verdict."""
HONEST, TELLING = 1.1, 2.0
"""Limits for the confidence interval of the ratio of errors to sigmas. If the interval is above HONEST, the filter is
optimistic. If the interval is below 1/HONEST, the filter is pessimistic. Otherwise the filter is consistent if the
interval is between 1/TELLING and TELLING. If the interval is wider, the data are too few for a verdict."""
FEW = 10
"""Effective number of independent draws below which a verdict on one run can only be `optimistic` or `undecided`."""
WINDOW = 6
"""Maximum lag of the autocorrelations that are summed, as a multiple of the correlation time."""


class Consistency(NamedTuple):
    """Verdict on the average of NIS or NEES over runs.

    mean: average of NIS or NEES.  expected: expected average for a consistent filter, i.e. the degrees of freedom.
    low, high: bounds within which the average of a consistent filter lies with the given probability.
    inside: fraction of the instants at which the average over the runs lies within the bounds for a single instant.
    verdict: consistent, optimistic or pessimistic.
    """

    mean: float
    expected: int
    low: float
    high: float
    inside: float
    verdict: str


class SingleRunConsistency(NamedTuple):
    """Verdict on the average of NIS, or of squared normalised errors, over a single run.

    mean: average over the instants.  expected: expected average for a consistent filter.
    low, high: bounds within which the average of a consistent filter lies with the given probability.
    draws: effective number of independent squares in the average.  factor: ratio of errors to sigmas.
    factor_low, factor_high: confidence interval of this ratio.  verdict: consistent, optimistic (sigmas too small),
    pessimistic (sigmas too large), or undecided if the data are too few to detect a factor of two.
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


class Whiteness(NamedTuple):
    """Autocorrelation of innovations, and a test of their whiteness.

    correlation: autocorrelation at lags 1, 2, … (lags,).  bound: bound for the magnitude of the autocorrelation of a
    white sequence at a single lag.  inside: fraction of the lags within this bound.  statistic: statistic of Ljung and
    Box over all lags.  p: probability that a white sequence has a larger statistic.  white: True if p is above
    1 - probability.
    """

    correlation: Any
    bound: float
    inside: float
    statistic: float
    p: float
    white: bool


class Convergence(NamedTuple):
    """Convergence of an estimate to the truth.

    time: time (s) from which on sigma stays below the required sigma, or None if it does not.  final: last error,
    divided by sigma.  inside: fraction of the samples after this time with an error below two sigmas.
    """

    time: float | None
    final: float
    inside: float


def chi_square_bounds(dof: int, n: int, probability: float = 0.95) -> tuple[float, float]:
    """Return bounds for the average of n independent chi-square numbers.

    The probabilities below the lower and above the upper bound are equal.

    Args:
        dof: degrees of freedom of each number.
        n: number of values in the average.
        probability: probability within the bounds, above 0 and below 1.

    Source: [4] section 5.4.2: n times the average is chi-square with n dof degrees of freedom.
    """
    if dof < 1 or n < 1 or not 0 < probability < 1:
        problem = f"dof and n must be at least 1, and probability within 0 to 1; got {dof}, {n}, {probability}"
        raise InputError("chi_square_bounds", problem, fix="use dof and n of 1 or more, and a probability in (0, 1)")
    tail = (1 - probability) / 2
    low, high = chi_square_quantile(np.array([tail, 1 - tail]), dof * n) / n
    return float(low), float(high)


def gate_threshold(dof: int, probability: float) -> float:
    """Return the threshold that the NIS of a consistent filter does not exceed with the given probability.

    dof: dimension of the measurement.
    """
    return float(chi_square_quantile(probability, dof))


def chi_square_quantile(probability: Any, dof: Any) -> Any:
    """Return the chi-square quantile for a probability. dof: degrees of freedom, not necessarily an integer.

    The function uses scipy.special, because importing scipy.stats takes longer than a run.
    """
    return 2 * special.gammaincinv(np.asarray(dof) / 2, probability)


def nees_verdict(nees: Any, dof: int, probability: float = 0.95) -> Consistency:
    """Return the verdict on the NEES of independent runs, by comparing its average over runs and time with bounds.

    Errors of one run are correlated in time, so more instants do not count as more independent draws. Therefore the
    chi-square bounds are those for the average over the runs at a single instant, which are rather too wide.

    Args:
        nees: NEES (runs, instants).
        dof: dimension of the error.
        probability: probability that the average of a consistent filter lies within the bounds.
    """
    values = _check_finite("nees", nees, 2)
    low, high = chi_square_bounds(dof, values.shape[0], probability)
    return _consistency(values.mean(axis=0), dof, low, high)


def nis_verdict(nis: Any, dof: int, probability: float = 0.95) -> Consistency:
    """Return the verdict on the NIS of one or several runs, by comparing its average over all updates with bounds.

    The innovations of a consistent filter are white, so each update counts as an independent draw.

    Args:
        nis: NIS (updates,) or (runs, updates) of each measurement, including rejected measurements.
        dof: dimension of the measurement.
        probability: probability that the average of a consistent filter lies within the bounds.
    """
    values = np.atleast_2d(_check_finite("nis", nis))
    low, high = chi_square_bounds(dof, values.size, probability)
    one = chi_square_bounds(dof, values.shape[0], probability)
    at_each = values.mean(axis=0)
    inside = float(np.mean((at_each >= one[0]) & (at_each <= one[1])))
    return _consistency(at_each, dof, low, high)._replace(inside=inside)


def whiteness(innovations: Any, lags: int = 20, probability: float = 0.95) -> Whiteness:
    """Return the result of a test of normalised innovations for whiteness.

    The test uses the autocorrelation at lags 1 to `lags`, and the statistic of Ljung and Box.

    Args:
        innovations: normalised innovations (updates,) or (updates, m), in the order of the measurements.
        lags: maximum lag, less than the number of updates.
        probability: probability that a white sequence passes the test.
    """
    y = _check_finite("innovations", innovations)
    y = y[:, None] if y.ndim == 1 else y
    n, m = y.shape
    if not 0 < lags < n:
        raise InputError("whiteness", f"{lags} lags are too many for {n} updates", fix="use fewer lags, or fly longer")
    power = np.sum(y * y)
    rho = np.array([np.sum(y[:-k] * y[k:]) / power for k in range(1, lags + 1)])
    effective = n * m - m * np.arange(1, lags + 1)  # number of products in each sum
    bound = float(special.ndtri((1 + probability) / 2) / np.sqrt(n * m))
    statistic = float(n * m * (n * m + 2) * np.sum(rho**2 / effective))
    p = float(special.gammaincc(lags / 2, statistic / 2))
    return Whiteness(rho, bound, float(np.mean(np.abs(rho) <= bound)), statistic, p, p > 1 - probability)


def convergence(t: Any, error: Any, sigma: Any, wanted: float) -> Convergence:
    """Return the convergence of an estimate, e.g. of a bias.

    Args:
        t: times in s (n,).
        error: estimate minus truth (n,).
        sigma: standard deviation of the error (n,) according to the filter.
        wanted: sigma below which the estimate counts as converged.
    """
    t, error, sigma = (_check_finite(name, x) for name, x in (("t", t), ("error", error), ("sigma", sigma)))
    above = np.flatnonzero(sigma >= wanted)
    first = int(above[-1]) + 1 if len(above) else 0
    final = float(error[-1] / sigma[-1])
    if first >= len(t):
        return Convergence(None, final, 0.0)
    return Convergence(float(t[first]), final, float(np.mean(np.abs(error[first:]) <= 2 * sigma[first:])))


def effective_draws(z: Any) -> Any:
    """Return the effective number of independent draws (m,) in the mean square of each column of z (n, m).

    This number is n / (1 + 2 sum (1 - k/n) rho_k²) for Gaussian numbers with autocorrelation rho_k at lag k, where the
    sum ends at WINDOW correlation times. The mean is not subtracted, so a constant error counts as one draw. A column
    of zeros also counts as one draw.
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


def assess_average(mean: Any, draws: Any, dof: int, tail: float) -> SingleRunConsistency:
    """Return the verdict on the average of a sum of squared normalised errors or innovations.

    Args:
        mean: average of the sum.
        draws: effective number of independent draws of each square (dof,).
        dof: number of squares in the sum.
        tail: probability below the lower bound, which equals the probability above the upper bound.
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
    low, high, least, most = (float(x) for x in (low * dof, high * dof, least, most))
    return SingleRunConsistency(float(mean), dof, low, high, N, float(factor), least, most, verdict)


def _consistency(at_each: Any, dof: int, low: float, high: float) -> Consistency:
    mean = float(at_each.mean())
    inside = float(np.mean((at_each >= low) & (at_each <= high)))
    verdict = OPTIMISTIC if mean > high else PESSIMISTIC if mean < low else CONSISTENT
    return Consistency(mean, dof, low, high, inside, verdict)


def _check_finite(name: str, values: Any, dimensions: int | None = None) -> Any:
    array = np.asarray(values, float)
    if not array.size or not np.isfinite(array).all() or (dimensions is not None and array.ndim != dimensions):
        problem = f"{name} must have finite numbers and the right axes, got an array of shape {array.shape}"
        raise InputError(
            "consistency",
            problem,
            fix="leave out instants without a measurement, and make the run the first axis of the array",
        )
    return array
