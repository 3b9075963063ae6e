"""Response of a gyro to a changing angular rate: a difference equation with a delay, fitted to a sweep, and inverted.

    y_k = b0 u_{k-D} - a1 y_{k-1} - a2 y_{k-2} + o

The fit minimises the output error: it compares the gyro with the model's simulated output, not with a prediction from
the gyro's last samples.
The parameters of the fit (reflection coefficients) keep both poles inside the unit circle. Apart from its delay the
model has zeros only at 0, so it is minimum phase and its inverse is stable.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, eq. 6.2.

Source: Ljung, "System identification", 1999, section 4.2 (output error) and 8.5 (its covariance).
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from trimtab.core.errors import InputError
from trimtab.logs.measurements import MeasuredColumn, Measurements, refuse_wrong_step
from trimtab.loop.calibration import Calibration, Covariance, Entry

COLUMNS = (
    MeasuredColumn("time", "s", "evenly spaced time, which may start at any value"),
    MeasuredColumn("reference", "rad/s", "true rate, e.g. from an encoder", -100, 100, most=0.05),
    MeasuredColumn("gyro", "rad/s", "rate measured by the gyro", -100, 100, most=0.05),
)
MOST_DELAY = 8
"""Largest delay of the gyro that the fit tries, in samples."""
SETTLE = 4
"""Number of samples at the start of a log that the fit ignores, because they depend on angular rates before the log."""
INSIDE = 0.999
"""Largest magnitude of a reflection coefficient in the fit. This limit keeps the poles inside the unit circle."""
WILD = 12.0
"""Deviation of a sample from the fitted model, in standard deviations, above which the log is rejected."""
GAIN_MIN = 0.5
"""Smallest plausible static gain. The largest one is its reciprocal."""
NAMES = ("IdentifiedGyro.b0", "IdentifiedGyro.a1", "IdentifiedGyro.a2")


class GyroFit(NamedTuple):
    """Fitted model of a gyro. b0, a1, a2: coefficients.  covariance: covariance of b0, a1, a2 (3, 3).

    delay: delay in samples.  offset: offset (rad/s).  period: time between samples (s).  deviation: standard deviation
    of the output error (rad/s).  freedom: degrees of freedom of the fit.  fitted: the model's output (n,).  highest:
    frequency (Hz) below which the reference has 99 % of its power.
    """

    b0: float
    a1: float
    a2: float
    covariance: Any
    delay: int
    offset: float
    period: float
    deviation: float
    freedom: int
    fitted: Any
    highest: float

    def gain(self) -> float:
        """Return the gain of the gyro at a constant angular rate."""
        return self.b0 / (1 + self.a1 + self.a2)

    def response(self, frequency: Any) -> Any:
        """Return the gyro's complex gain, including the delay, at frequencies (Hz)."""
        z1 = np.exp(-2j * np.pi * np.asarray(frequency) * self.period)
        return self.b0 * z1**self.delay / (1 + self.a1 * z1 + self.a2 * z1**2)

    def inverse(self, y: Any) -> Any:
        """Return the rates (n,) that cause the gyro's samples y (n,): u_k = (y_k + a1 y_{k-1} + a2 y_{k-2})/b0.

        The delay is not corrected.
        """
        return lfilter([1.0, self.a1, self.a2], [self.b0], np.asarray(y) - self.offset)


def fit_gyro(data: Measurements) -> GyroFit:
    """Fit delay, coefficients and offset of a gyro to a frequency sweep. data: readings with the columns `COLUMNS`.

    Raises: InputError if times are not evenly spaced, if samples are too few, or if the gyro does not follow the
    reference.
    """
    t, u, y = data["time"], data["reference"], data["gyro"]
    where = f"file {data.file!r}"
    refuse_wrong_step(data.file, t)
    steps = np.diff(t)
    period = float(np.median(steps)) if len(steps) else 0.0
    uneven = np.flatnonzero(np.abs(steps - period) > 0.02 * period)
    if len(t) < 200 or len(uneven):
        what = f"{len(t)} samples are too few for a fit" if len(t) < 200 else ""
        line = "" if what else f"line {data.lines[uneven[0] + 1]} comes {steps[uneven[0]]:.6g} s after the line before,"
        problem = what or f"{line} but the usual step is {period:.6g} s"
        raise InputError(where, problem, fix="log a sweep of 200 evenly spaced samples or more, without gaps")
    fits = [_fit_delay(u, y, delay) for delay in range(MOST_DELAY + 1)]
    delay = int(np.argmin([fit.cost for fit in fits]))
    best = fits[delay]
    n = len(u) - delay - SETTLE
    freedom = n - 4
    deviation = float(np.sqrt(2 * best.cost / freedom))
    if deviation > 0.5 * np.std(y):
        problem = f"the best model's rms error is {deviation:.3g} rad/s; the gyro signal's deviation is {np.std(y):.3g}"
        fix = "check that reference and gyro have the same axis, the same sign, and the units in their headings"
        raise InputError(where, problem, fix=fix)
    _refuse_wild(data, best.fun, delay)
    b0, a1, a2, offset = _coefficients(best.x)
    toward = _coefficient_slopes(best.x)
    P = toward @ np.linalg.pinv(best.jac.T @ best.jac) @ toward.T * deviation**2
    spectrum = np.abs(np.fft.rfft(u - u.mean()))
    power = np.cumsum(spectrum**2)
    highest = float(np.fft.rfftfreq(len(u), period)[np.searchsorted(power, 0.99 * power[-1])])
    fitted = _simulate(best.x, u, delay)
    fit = GyroFit(b0, a1, a2, P[:3, :3], delay, offset, period, deviation, freedom, fitted, highest)
    if not GAIN_MIN <= fit.gain() <= 1 / GAIN_MIN:
        problem = f"the static gain of the gyro must be {GAIN_MIN:g} to {1 / GAIN_MIN:g}, got {fit.gain():.4g}"
        fix = "check that reference and gyro have the same axis, the same sign, and the units in their headings"
        raise InputError(where, problem, fix=fix)
    return fit


def gyro_calibration(data: Measurements, fit: GyroFit) -> Calibration:
    """Return the gyro's calibration entries: coefficients, and the delay, which the inverse model does not correct."""
    source = f"{data.file}: {len(data)} samples each {1e3 * fit.period:.6g} ms, up to {fit.highest:.3g} Hz"
    about: dict[str, Any] = {"freedom": fit.freedom, "source": source, "procedure": "gyro"}
    errors = np.sqrt(np.diagonal(fit.covariance))
    values = zip(NAMES, (fit.b0, fit.a1, fit.a2), errors, strict=True)
    entries = {n: Entry(float(v), "1", float(e), **about) for n, v, e in values}
    entries["gyro.delay"] = Entry(fit.delay * fit.period, "s", source=source, procedure="gyro")
    return Calibration(entries, (Covariance(NAMES, fit.covariance.tolist(), "gyro"),))


def _refuse_wild(data: Measurements, rest: Any, delay: int) -> None:
    """Raise InputError if a sample deviates from the model far more than the other samples do."""
    off = np.abs(np.asarray(rest) - np.median(rest))
    usual = 1.4826 * float(np.median(off))
    if float(off.max()) > WILD * max(usual, 1e-12):
        line = int(data.lines[int(np.argmax(off)) + delay + SETTLE])
        problem = f"line {line}: the gyro deviates by {off.max():.3g} rad/s from its model, usually by {usual:.2g};"
        problem += " this sample, or the reference just before it, is probably wrong"
        raise InputError(
            f"file {data.file!r}", problem, fix="replace the sample by its neighbours' mean, or cut the log"
        )


def _fit_delay(u: Any, y: Any, delay: int) -> Any:
    def residuals(p: Any) -> Any:
        return (_simulate(p, u, delay) - y)[delay + SETTLE :]

    start = np.array([np.std(y) / max(np.std(u), 1e-12), -0.5, 0.2, float(np.mean(y) - np.mean(u))])
    return least_squares(residuals, start, x_scale="jac", xtol=1e-12, ftol=1e-12)


def _coefficients(p: Any) -> tuple[float, float, float, float]:
    """Return b0, a1, a2, offset.

    p: gain at a constant rate, two numbers whose tanh are the reflection coefficients, and offset.
    """
    k1, k2 = INSIDE * np.tanh(p[1]), INSIDE * np.tanh(p[2])
    a1, a2 = float(k1 * (1 + k2)), float(k2)
    return float(p[0] * (1 + a1 + a2)), a1, a2, float(p[3])


def _coefficient_slopes(p: Any) -> Any:
    """Return the Jacobian (4, 4) of `_coefficients`, by central differences."""
    h = 1e-6
    steps = (h * row for row in np.eye(4))
    return np.stack([(np.array(_coefficients(p + e)) - np.array(_coefficients(p - e))) / (2 * h) for e in steps], 1)


def _simulate(p: Any, u: Any, delay: int) -> Any:
    b0, a1, a2, offset = _coefficients(p)
    late = np.concatenate([np.full(delay, u[0]), u[: len(u) - delay]]) if delay else u
    steady = b0 * u[0] / (1 + a1 + a2)
    start = [-a1 * steady - a2 * steady, -a2 * steady]
    return lfilter([b0], [1.0, a1, a2], late, zi=start)[0] + offset
