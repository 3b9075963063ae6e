"""Allan variance of a sensor at rest: noise coefficients with uncertainties, and Q and R for a filter.

The output of a still sensor is modelled as white noise, flicker and random walk, all Gaussian:

    sigma²(tau) = N²/tau + (2 ln 2/pi) B² + K² tau/3

N: angle (velocity) random walk; B: bias instability; K: rate (acceleration) random walk.

The Allan variances at different averaging times tau are correlated, because they share the same data. Their covariance
is computed exactly, from second differences of the summed output, and weights the fit of the coefficients. The stated
errors therefore match the scatter over repeated logs.

Source: IEEE Std 952-1997, annex C, for the coefficients; Greenhall, IEEE Trans. UFFC 38 (1991), and Riley, NIST SP 1065
(2008), section 5, for the overlapping estimator and its covariance.
"""

import functools
import math
from typing import Any

import numpy as np
from scipy.optimize import nnls
from scipy.special import gammaincinv

from trimtab.core.errors import InputError, argument
from trimtab.core.record import Scalar, part, quantity, record

FLICKER = 2 * math.log(2) / math.pi
NORMAL95 = 1.959963984540054
ROUNDS = 8
FINEST = 32
"""Minimum number of lags, within the shorter of two averaging times, for the covariance of their Allan variances."""
KNOCK = 10.0
"""Largest accepted difference of two successive samples, in standard deviations of such differences.

Gaussian noise exceeds this limit with probability 1e-23.
"""
MISFIT = 10.0
"""Largest accepted misfit of the fit: weighted sum of squares, divided by the degrees of freedom.

A good log has about 1.
"""
REPEATED = 0.7
"""Largest accepted share of equal samples. Independent samples reach it at a resolution of 2.7 times the standard
deviation of the noise."""
ONE_STEP = 1.2
"""Largest mean change of a signal, in steps of its resolution, at which a filter explains that samples are repeated."""
STUCK = 20
"""Smallest number of equal samples that count as stuck, or as saturated."""
WINDOW = 1000
"""Number of samples over which drift is neglected."""
LEAST_CHANGE = 1e-100
"""Smallest plausible range of the samples of a signal. The largest one is its reciprocal."""
MEDIAN = 0.6744897501960817
"""Median of the absolute value of a standard normal number."""


@record
class Coefficient:
    """Noise coefficient of a sensor with its uncertainty. Source: this module."""

    value: Scalar = quantity("1", "Estimated noise coefficient; 0 if the log shows no such noise.")
    standard_error: Scalar = quantity("1", "Standard error. If the estimate is near 0: upper limit divided by 1.96.")
    low: Scalar = quantity("1", "Lower limit of the coefficient's 95 % interval.")
    high: Scalar = quantity("1", "Upper limit of the coefficient's 95 % interval.")


@record
class AllanFit:
    """Allan deviation of a sensor at rest, and noise model fitted to it. U: unit of the logged samples (rad/s or m/s²).

    Source: IEEE Std 952-1997, annex C; this module.
    """

    white: Coefficient = part("White noise N (U/Hz^0.5), also called angle or velocity random walk.")
    flicker: Coefficient = part("Flicker noise B (U), also called bias instability.")
    walk: Coefficient = part("Random walk K of the bias (U/s^0.5), also called rate or acceleration random walk.")
    tau: Any = quantity("s", "Averaging times (n,).")
    deviation: Any = quantity("U", "Overlapping Allan deviation at each averaging time (n,).")
    model: Any = quantity("U", "Allan deviation of the fitted model at each averaging time (n,).")
    freedom: Any = quantity("1", "Equivalent degrees of freedom of each Allan deviation (n,), from the fitted model.")
    misfit: Scalar = quantity(
        "1", "Weighted squared misfit of the model, divided by the degrees of freedom. A good model has about 1."
    )
    sampling_period: Scalar = quantity("s", "Time between two samples of the log.")


@record
class FilterNoise:
    """Noise variances of one sensor axis for a filter with time step dt. U: unit of a sample. Source: this module."""

    sample_variance: Scalar = quantity(
        "U^2", "Measurement noise R of a sample that the filter uses as a measurement: N²/dt."
    )
    integral_variance: Scalar = quantity(
        "(U s)^2", "Process noise Q of one step, for a state that integrates samples: N² dt."
    )
    bias_variance: Scalar = quantity(
        "U^2", "Process noise Q of one step, for the bias: K² dt, plus a term for flicker."
    )


def overlapping_variance(y: Any, averages: Any) -> Any:
    """Return the overlapping Allan variance (k,) of samples y (n,). m (k,): numbers of samples to average over.

    Source: Riley, NIST SP 1065, eq. 9.
    """
    x = np.concatenate([[0.0], np.cumsum(np.asarray(y, np.float64) - np.mean(y))])
    second = [x[2 * m :] - 2 * x[m:-m] + x[: -2 * m] for m in averages]
    return np.array([np.mean(z * z) / (2.0 * m * m) for z, m in zip(second, averages, strict=True)])


def octave_averages(samples: int) -> tuple[int, ...]:
    """Return numbers of samples to average over: 1, 2, 4, … up to an eighth of the log.

    Longer averages are too uncertain.
    """
    return tuple(2**k for k in range(max(int(math.log2(samples / 8)), 0) + 1))


def fit_allan(y: Any, sampling_period: float, averages: tuple[int, ...] | None = None) -> AllanFit:
    """Compute the Allan deviation of a sensor at rest, and fit noise coefficients by generalised least squares.

    Args:
        y: at least 128 evenly spaced samples (n,) of one axis. Their mean has no effect, but a slow ramp has.
        sampling_period: time between two samples (s).
        averages: numbers of samples to average over. Default: 1, 2, 4, … up to an eighth of the log.
    """
    y = np.asarray(y, np.float64)
    if y.ndim != 1 or len(y) < 128 or not np.isfinite(y).all():
        problem = f"got samples of shape {y.shape}, with {int((~np.isfinite(y)).sum())} values that are not finite"
        raise InputError("allan", problem, fix="pass at least 128 evenly spaced samples of one axis, without gaps")
    chosen = tuple(averages or octave_averages(len(y)))
    if min(chosen) < 1 or max(chosen) > len(y) // 3 or len(chosen) < 4:
        problem = f"got averages over {chosen} samples, for a log of {len(y)} samples"
        raise InputError("allan", problem, fix=f"pass at least 4 whole numbers from 1 to {len(y) // 3}")
    if not np.ptp(y) > 0:
        raise InputError("allan", "every sample is the same", fix="log the samples at the sensor's full resolution")
    m = np.array(chosen, np.float64)
    variance = overlapping_variance(y, chosen)
    basis, moments = _variance_basis(m), _moments(len(y), chosen)
    theta = nnls(basis / variance[:, None], np.ones(len(m)))[0]
    covariance = _covariance(theta, moments)
    for _ in range(ROUNDS):
        whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        theta = nnls(whiten @ basis, whiten @ variance)[0]
        covariance = _covariance(theta, moments)
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    error = np.sqrt(np.diag(np.linalg.inv((whiten @ basis).T @ (whiten @ basis))))
    rest = whiten @ (variance - basis @ theta)
    dt = float(sampling_period)
    units = (dt, 1.0, 1 / dt)
    white, flicker, walk = (_coefficient(v * u, e * u) for v, e, u in zip(theta, error, units, strict=True))
    model = basis @ theta
    return AllanFit(
        white=white,
        flicker=flicker,
        walk=walk,
        tau=m * dt,
        deviation=np.sqrt(variance),
        model=np.sqrt(model),
        freedom=2 * model**2 / np.diag(covariance),
        misfit=float(rest @ rest) / (len(m) - len(theta)),
        sampling_period=dt,
    )


def confidence_interval(fit: AllanFit) -> tuple[Any, Any]:
    """Return lower and upper limits (n,) of the Allan deviations' 95 % confidence intervals, for error bars."""
    tail = (1 - 0.95) / 2
    low, high = (2 * gammaincinv(fit.freedom / 2, part) for part in (1 - tail, tail))  # quantiles of chi squared
    return fit.deviation * np.sqrt(fit.freedom / low), fit.deviation * np.sqrt(fit.freedom / high)


def filter_noise(fit: AllanFit, sampling_period: float | None = None) -> FilterNoise:
    """Compute the discrete noise of a filter with time step `sampling_period` (s). Default: the log's sampling period.

    Flicker noise has no model of finite order. It is replaced by a random walk with the same Allan variance at the
    averaging time tau = N²/(0.44 B²), at which white noise and flicker are equally large. The filter then trusts a bias
    estimate for about the time tau.
    """
    dt = fit.sampling_period if sampling_period is None else float(sampling_period)
    N2, B2, K2 = fit.white.value**2, fit.flicker.value**2, fit.walk.value**2
    floor = FLICKER * B2
    share = 3 * floor * min(floor / N2, 1 / fit.sampling_period) if N2 > 0 else 3 * floor / fit.sampling_period
    return FilterNoise(sample_variance=N2 / dt, integral_variance=N2 * dt, bias_variance=(K2 + share) * dt)


def refuse_motion(name: str, y: Any, fit: AllanFit) -> None:
    """Raise InputError if samples show that the sensor was not at rest.

    Sensor noise has Gaussian differences and an Allan deviation of the fitted form. A knock, a step or a motion of the
    sensor violates this. A slow and steady motion that looks like a random walk cannot be detected.

    Args:
        name: name of the sensor axis, for errors.  y: samples (n,) of the axis.  fit: result of `fit_allan` for these
            samples.

    Source: this module; the scale of the differences is computed from the median, so that a few knocks do not
    change the scale: Huber, "Robust statistics", Wiley 1981.
    """
    change = np.diff(np.asarray(y, np.float64))
    usual = float(np.median(np.abs(change - np.median(change)))) / MEDIAN
    size = np.abs(change - np.median(change))
    if usual > 0 and size.max() > KNOCK * usual:
        at = float((np.argmax(size) + 1) * fit.sampling_period)
        jump = size.max()
        problem = f"changes by {jump:.3g} within one sample, {jump / usual:.0f} times the usual change, at {at:.2f} s"
        raise InputError(f"signal {name!r}", problem, fix="keep the sensor still, or cut the log there")
    if fit.misfit > MISFIT:
        off = np.abs(np.log(fit.deviation / fit.model))
        problem = f"is not the noise of a sensor at rest: at {fit.tau[np.argmax(off)]:.3g} s the Allan deviation is"
        problem += (
            f" {fit.deviation[np.argmax(off)]:.3g}, but that of the fitted noise is {fit.model[np.argmax(off)]:.3g}"
        )
        problem += f" (misfit {fit.misfit:.0f}, 1 is good)"
        fix = "keep the sensor still and its temperature steady; for a sensor that filters its output, add "
        fix += argument("shortest", "TIME")
        raise InputError(f"signal {name!r}", problem, fix=fix)


def refuse_stuck(name: str, y: Any, period: float) -> None:
    """Raise InputError for a signal that is stuck or saturated, whose resolution is too coarse, or that is implausible.

    Args:
        name: name of the signal.
        y: samples (n,).
        period: time between two samples (s).
    """
    y = np.asarray(y, np.float64)
    starts = np.flatnonzero(np.append(True, np.diff(y) != 0))
    runs = np.diff(np.append(starts, len(y)))
    repeated, k = 1 - len(starts) / len(y), int(np.argmax(runs))
    problem = fix = ""
    values, counts = np.unique(y, return_counts=True)
    if not LEAST_CHANGE < np.ptp(y) < 1 / LEAST_CHANGE:
        problem, fix = f"changes by {np.ptp(y):.3g}, which is not plausible", "correct the values, or their unit"
    elif repeated > REPEATED and _mean_steps(y) > ONE_STEP:
        problem = f"{100 * repeated:.0f} % of the samples equal the one before, must be at most {100 * REPEATED:.0f} %"
        fix = "log each sample once"
    elif runs[k] > max(STUCK, _longest_run(np.delete(y, slice(starts[k], starts[k] + runs[k])))):
        problem = f"is {y[starts[k]]:.6g} in {runs[k]} successive samples from {starts[k] * period:.2f} s on"
        fix = "check why the sensor or the logger is stuck, or cut the log there"
    elif len(values) < 3:
        problem, fix = f"has only the values {values[0]:.6g} and {values[-1]:.6g}", "log at full resolution"
    elif (share := _share_of_equal(y)) > REPEATED:
        problem = f"has the resolution {np.min(np.diff(values)):.3g}, which is too coarse: two samples are equal with"
        problem += f" a probability of {share:.2f}, must be at most {REPEATED:g}"
        fix = "log at full resolution, or set a smaller range"
    else:
        for end, inside in ((0, 1), (-1, -2)):
            if counts[end] > STUCK + 3 * counts[inside]:
                problem = f"is saturated: {counts[end]} of {len(y)} samples are {values[end]:.6g}, the"
                problem += f" {'least' if end == 0 else 'greatest'} value"
                fix = "increase the range of the sensor or of the logger"
    if problem:
        raise InputError(f"signal {name!r}", problem, fix=fix)


def _windows(y: Any) -> Any:
    """Return the samples in windows (k, n) of about `WINDOW` samples. Samples that fill no window are left out."""
    count = max(len(y) // WINDOW, 1)
    return y[: len(y) // count * count].reshape(count, -1)


def _mean_steps(y: Any) -> float:
    """Return the mean change of a signal between two different samples, in steps of its resolution.

    A repeated sample of a low-pass filtered signal is followed by a change of one step. A sample that was logged
    several times is followed by a change of any number of steps.
    """
    change = np.abs(np.diff(y))
    change = change[change > 0]
    if not len(change):
        return 1.0
    return float(np.mean(change) / np.quantile(change, 0.01))


def _longest_run(y: Any) -> float:
    """Return the largest number of equal samples in a row that noise of a coarse resolution plausibly explains.

    A sample is repeated most often while the mean is in the middle of a step. The share of repeated samples is then
    about the square of the probability of this step, with which a run continues.
    """
    if len(y) < 2:
        return 0.0
    share = float(np.quantile((np.diff(_windows(y)) == 0).mean(axis=1), 0.9))
    share = min(share, REPEATED if _mean_steps(y) > ONE_STEP else 1.0)
    return math.log(1e-9 / len(y)) / math.log(min(max(math.sqrt(share), 0.05), 0.999))


def _share_of_equal(y: Any) -> float:
    """Return the probability that two samples from one window are equal."""
    shares = [np.unique(window, return_counts=True)[1] / len(window) for window in _windows(y)]
    return float(np.mean([share @ share for share in shares]))


def _coefficient(square: float, error: float) -> Coefficient:
    """Return a noise coefficient, computed from the squared coefficient and the standard error of the square.

    The limits of the coefficient's interval are the square roots of those of the square's interval.
    """
    high = math.sqrt(square + NORMAL95 * error)
    value = math.sqrt(square)
    near_zero = square < error
    return Coefficient(
        value=value,
        standard_error=high / NORMAL95 if near_zero else error / (2 * value),
        low=math.sqrt(max(square - NORMAL95 * error, 0.0)),
        high=high,
    )


def _kernels(lag: Any) -> Any:
    """Return generalised covariances (3, …) of the summed output, for unit white noise, flicker and random walk."""
    size = np.abs(lag)
    flicker = size**2 * np.log(np.where(size > 0, size, 1.0)) / (2 * math.pi)
    return np.stack([-size / 2, flicker, (size**3 - size) / 12])


def _variance_basis(m: Any) -> Any:
    """Return the Allan variance (n, 3) of unit white noise, flicker and random walk, for averages of m samples (n,)."""
    return ((2 * _kernels(2 * m) - 8 * _kernels(m)) / (2 * m * m)).T


@functools.lru_cache(maxsize=8)
def _moments(samples: int, averages: tuple[int, ...]) -> Any:
    """Return T (n, n, 3, 3). theta' T[i, j] theta is the covariance of Allan variances i and j, see `_covariance`."""
    n = len(averages)
    T = np.zeros((n, n, 3, 3))
    for i in range(n):
        for j in range(i + 1):
            T[i, j] = _pair_moments(samples + 1, averages[i], averages[j])
            T[j, i] = T[i, j]
    return T


def _pair_moments(points: int, m1: int, m2: int) -> Any:
    """Return the block T[i, j] (3, 3) of `_moments` for averages of m1 and m2 samples. points: length of the sum.

    The block is 2/(4 m1² m2² M1 M2) times a sum over all pairs of second differences of products of covariances.
    """
    M1, M2 = points - 2 * m1, points - 2 * m2
    stride = max(1, min(m1, m2) // FINEST)
    low, high = max(-(M2 - 1), -3 * m1 - m2), min(M1 - 1, 3 * m2 + m1)
    lag = np.arange(low, high + 1, stride, dtype=np.float64)
    covariance = np.zeros((3, len(lag)))
    for p, a in enumerate((1, -2, 1)):
        for q, b in enumerate((1, -2, 1)):
            covariance += a * b * _kernels(lag + p * m1 - q * m2)
    pairs = np.maximum(np.minimum(M1, M2 + lag) - np.maximum(0, lag), 0)
    total = stride * (covariance * pairs) @ covariance.T
    return total * 2 / (4.0 * m1**2 * m2**2 * M1 * M2)


def _covariance(theta: Any, moments: Any) -> Any:
    """Return the covariance (n, n) of the Allan variances. theta (3,): N², B² and K² of the noise.

    A small diagonal term keeps the covariance positive definite.
    """
    C = np.einsum("c,ijcd,d->ij", theta, moments, theta)
    return C + np.diag(1e-9 * np.diag(C))
