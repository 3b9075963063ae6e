"""Moment of inertia about the vertical axis, from the spin-up of a vehicle that is held and then released.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, quantity, record


@record
class SpinUpTrial:
    """One spin-up trial: the vehicle is released while fan speed and rudder angle are constant.

    Frames:  rudder angle from the body's x axis, slope positive clockwise.    Source: [1] section 4.3.3, table 4.2.
    """

    rudder_angle: Scalar = quantity("rad", "Rudder angle theta.", kind="angle")
    force: Scalar = quantity("N", "Thrust, negative in reverse.")
    slope: Scalar = quantity("rad/s^2", "Initial slope of the yaw rate.")


@record
class SlopeFit:
    """Straight line through the start of a spin-up. Source: Press et al., "Numerical recipes", 3rd ed., sec. 15.2."""

    slope: Scalar = quantity("rad/s^2", "Slope of the yaw rate.")
    standard_error: Scalar = quantity("rad/s^2", "Standard error of the slope, computed from the residuals.")
    offset: Scalar = quantity("rad/s", "Yaw rate of the fitted line at the start of the time window.")
    residual: Scalar = quantity("rad/s", "Standard deviation of the yaw rate about the fitted line.")
    samples: Scalar = quantity("1", "Number of samples used in the line fit.", kind="count")


def lateral_force(force: Any, force_angle: Any) -> Any:
    """Return FY = -f sin psi (N, in B) of a thrust f (N) at force angle psi (rad). Source: [1] chapter 4."""
    return -force * np.sin(force_angle)


def moment_of_inertia(arm: Any, FY: Any, slope: Any) -> Any:
    """Return J = -d FY / (dr/dt) (kg m^2) from arm d (m), lateral force FY (N), slope dr/dt (rad/s^2).

    Source: [1] eq. 2.10.
    """
    return -arm * FY / slope


def trial_inertia(
    trial: SpinUpTrial, arm: Any, force_angle: Callable[[Any], Any], decimals: int | None = None
) -> tuple[Any, Any]:
    """Compute lateral force (N) and moment of inertia (kg m^2) of one trial.

    Args:
        trial: measured values.
        arm: distance from the centre of mass to the rudder pivot (m).
        force_angle: function from rudder angle to force angle, e.g. ``RudderGeometry().force_angle``.
        decimals: number of decimals to which the lateral force FY is rounded first; 2 reproduces [1] table 4.2. None
            for no rounding.
    """
    FY = lateral_force(trial.force, force_angle(trial.rudder_angle))
    FY = FY if decimals is None else np.round(FY, decimals)
    return FY, moment_of_inertia(arm, FY, trial.slope)


def fit_slope(t: Any, yaw_rate: Any, window: float = np.inf) -> SlopeFit:
    """Fit a least-squares line to the yaw rate of the first `window` seconds.

    Under a constant force the yaw rate rises along a straight line. Friction and a moving servo bend the curve, so keep
    the window short enough that the residuals look like noise. The standard error assumes independent residuals.

    Args:
        t: times (s), shape (n,), at least 3 in the window.
        yaw_rate: yaw rates (rad/s), shape (n,).
        window: length of the window (s), which starts at t[0].
    """
    t, r = np.asarray(t, np.float64), np.asarray(yaw_rate, np.float64)
    if t.ndim != 1 or t.shape != r.shape:
        raise InputError(
            "fit_slope", f"t has shape {t.shape}, yaw_rate has shape {r.shape}", fix="pass two lists of equal length"
        )
    if not (np.isfinite(t).all() and np.isfinite(r).all()):
        raise InputError(
            "fit_slope",
            "t or yaw_rate contains values that are not finite",
            fix="leave out the samples that are not finite",
        )
    inside = t - t[:1] <= window
    t, r = t[inside], r[inside]
    if len(t) < 3 or np.ptp(t) == 0:
        problem = f"{len(t)} samples in the window of {window:g} s are too few for a slope with standard error"
        raise InputError("fit_slope", problem, fix="use at least 3 samples at different times")
    centred = t - t.mean()
    spread = float(centred @ centred)
    slope = float(centred @ r) / spread
    rest = r - r.mean() - slope * centred
    residual = float(np.sqrt(rest @ rest / (len(t) - 2)))
    offset = float(r.mean() - slope * (t.mean() - t[0]))
    return SlopeFit(slope, residual / np.sqrt(spread), offset, residual, len(t))


class LinearPortion(NamedTuple):
    """Linear part of a spin-up.

    start: time of release (s).  window: duration of the linear rise (s).  fit: straight line fitted to the linear rise.
    """

    start: float
    window: float
    fit: SlopeFit


def find_linear_portion(t: Any, yaw_rate: Any) -> LinearPortion:
    """Find the time at which a vehicle is released, and the time window in which its yaw rate then rises linearly.

    The yaw rate is modelled as zero before the release and as a parabola r = s t + q t² after the release. The release
    is the instant with the best fit. The window is the longest in which the curvature changes the slope of a straight
    line (by q times the window) by less than half the slope's standard error, so that this error can be trusted.

    Args:
        t: times (s), shape (n,), at least 20, increasing.
        yaw_rate: yaw rates (rad/s), shape (n,). The vehicle must be at rest at first.
    """
    t, r = np.asarray(t, np.float64), np.asarray(yaw_rate, np.float64)
    if len(t) < 20 or not (np.isfinite(t).all() and np.isfinite(r).all()):
        problem = f"at least 20 samples, all finite, are needed to find a release and a rise; got {len(t)} samples"
        raise InputError("spin-up", problem, fix="log from before the release, 20 finite samples or more")
    top = float(np.max(np.abs(r)))
    low = r[: max(int(np.argmax(np.abs(r) >= 0.6 * top)) + 1, 8)]
    noise = float(np.median(np.abs(np.diff(r, 2)))) * 1.4826 / np.sqrt(6)
    if top < 8 * max(noise, 1e-12):
        problem = f"the yaw rate reaches only {top:.3g} rad/s, with noise of {noise:.3g}"
        raise InputError("spin-up", problem, fix="use more thrust or rudder, or log for longer")
    n = len(low)

    def fit_rise(k: int) -> tuple[float, float]:
        """Return squared misfit and curvature q of a yaw rate model that is 0 until sample k and then s t + q t²."""
        since = np.maximum(t[:n] - t[k], 0)
        A = np.stack([since, since**2], 1)
        b = np.linalg.lstsq(A, low, None)[0]
        return float(np.sum((low - A @ b) ** 2)), float(b[1])

    start = min(range(n - 4), key=lambda k: fit_rise(k)[0])
    rise = slice(start, start + 1 + int(np.argmax(np.abs(r[start:]) >= 0.9 * np.max(np.abs(r[start:])))))
    since, rates = t[rise] - t[start], r[rise]
    if len(since) < 6:
        raise InputError(
            "spin-up",
            f"the rise of the rate has only {len(since)} samples",
            fix="log at a higher rate, or use less thrust",
        )
    bend = abs(fit_rise(start)[1])
    step = float(np.median(np.diff(t)))
    window = (0.5 * noise * np.sqrt(12 * step) / max(bend, 1e-12)) ** 0.4
    window = float(np.clip(window, 5 * step, since[-1]))
    return LinearPortion(float(t[start]), window, fit_slope(since, rates, window))


def inertia_error(J: Any, fit: SlopeFit, force_error: Any = 0.0) -> Any:
    """Return the standard error (kg m^2) of J, from the slope's error and a relative error of the lateral force."""
    return abs(J) * np.sqrt((fit.standard_error / fit.slope) ** 2 + force_error**2)
