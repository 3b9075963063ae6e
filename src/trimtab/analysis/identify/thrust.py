"""Calibration of a fan's thrust with a force gauge: coefficient, loss by the rudder behind the fan, reverse thrust.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc, stdtrit

from trimtab.analysis.identify.regression import LinearFit, fit_linear
from trimtab.analysis.identify.rudder import RUDDER_MAX, refuse_few, source_of
from trimtab.core.errors import InputError
from trimtab.core.rotation import DEG
from trimtab.logs.measurements import MeasuredColumn, Measurements
from trimtab.loop.calibration import Calibration, Covariance, Entry, index_name

THRUST_COLUMNS = (
    MeasuredColumn("rudder", "rad", "rudder angle", -RUDDER_MAX, RUDDER_MAX, usual="deg"),
    MeasuredColumn("speed", "rpm", "speed of the fan", 0, 60_000, most=1000),
    MeasuredColumn("force", "N", "thrust, read from the gauge", -0.5, 100, most=0.02),
)
REVERSE_COLUMNS = (
    MeasuredColumn("speed", "rpm", "speed of the fan, the same for forward and reverse thrust", 0, 60_000, most=1000),
    MeasuredColumn("forward", "N", "forward thrust", 0, 100, most=0.02),
    MeasuredColumn("reverse", "N", "reverse thrust, as a positive number", 0, 100, most=0.005),
)
SATURATED = 3
"""Minimum number of readings at the highest expected forces that equal the greatest reading of a saturated gauge."""
AT_END = 0.9
"""Minimum share of readings at the highest expected forces that equal the greatest reading of a saturated gauge.

The share is below 1 so that one outlier does not hide saturation.
"""
DIVISIONS = 1.5
"""Largest difference of two forces, in scale divisions of the gauge, at which the gauge may show equal readings."""
RISE = 0.5
"""Smallest plausible rise of the force with the square of the speed, as a fraction of the fitted coefficient."""
SWEEP, SWEPT = 5, 2 * DEG
"""Number of different rudder angles from which on their range must exceed `SWEPT` (rad), to detect a wrong unit."""
UNLIKELY = 0.001
"""Significance level. At a smaller p-value, the thrust is considered not proportional to cos(theta - offset)."""
CUBIC = 4


class ThrustFit(NamedTuple):
    """Fitted thrust F = c n² eta(theta) at speed n (krpm) and rudder angle theta.

    angles: rudder angles (m,), rad.  by_angle: c eta at each angle (m,), N/krpm².  errors: standard errors of by_angle.
    coefficient, standard_error: c and its standard error, N/krpm².  chance: p-value of the test that by_angle follows
    the formula eta = cos(theta - offset). fit: fit of c to all readings.
    """

    angles: Any
    by_angle: Any
    errors: Any
    coefficient: float
    standard_error: float
    chance: float
    fit: LinearFit

    def follows_formula(self) -> bool:
        """Return True if the readings agree with a thrust proportional to cos(theta - offset)."""
        return self.chance >= UNLIKELY


def fit_thrust(data: Measurements, offset: float) -> ThrustFit:
    """Fit thrust as a quadratic in speed: at each rudder angle, and for all angles with eta = cos(theta - offset).

    Source: [1] chapter 4.

    Args:
        data: readings with the columns `THRUST_COLUMNS`.
        offset: rudder angle at which the thrust is largest (rad), from `rudder.fit_hull_angle`.

    Raises: InputError if there are too few readings, if the gauge was saturated, or if the angles hardly differ.
    """
    refuse_few(data, 2, "a quadratic")
    theta, n, F = data["rudder"], data["speed"] * 1e-3, data["force"]
    if len(np.unique(theta)) >= SWEEP and np.ptp(theta) < SWEPT:
        problem = f"column 'rudder' has {len(np.unique(theta))} angles, but all are within {np.ptp(theta) / DEG:.2g}°"
        raise InputError(f"file {data.file!r}", problem, fix="check the unit in the heading: rudder [deg]")
    eta = np.cos(theta - offset)
    refuse_saturation(data, "force", n * n * eta)
    fit = fit_linear((n * n * eta)[:, None], F)
    kept = fit.kept
    _refuse_no_rise(data, float(fit.value[0]), kept)
    angles = np.unique(np.round(theta / DEG, 1)) * DEG
    by_angle, errors, misfit, freedom = [], [], 0.0, 0
    for angle in angles:
        of = kept & (np.abs(theta - angle) < 0.06 * DEG)
        square = float(np.sum(n[of] ** 4))
        if square == 0:
            problem = f"at rudder {angle / DEG:.1f}° all readings with the fan turning disagree with the others"
            raise InputError(f"file {data.file!r}", problem, fix="measure this angle again")
        c = float(np.sum(n[of] ** 2 * F[of])) / square
        error = fit.deviation / np.sqrt(square)
        by_angle.append(c)
        errors.append(error)
        expected = float(fit.value[0]) * np.cos(angle - offset)
        misfit, freedom = misfit + ((c - expected) / error) ** 2, freedom + 1
    chance = float(chdtrc(freedom - 1, misfit)) if freedom > 1 else 1.0
    c, error = float(fit.value[0]), float(fit.standard_errors()[0])
    return ThrustFit(angles, np.array(by_angle), np.array(errors), c, error, chance, fit)


def _refuse_no_rise(data: Measurements, coefficient: float, kept: Any) -> None:
    """Raise InputError if the force is negative, or does not rise with the square of the speed at equal angles.

    Args:
        data: readings with the columns `THRUST_COLUMNS`.
        coefficient: fitted thrust per square of the speed (N/krpm²).
        kept: False for outliers (n,).
    """
    where = f"file {data.file!r}"
    if coefficient <= 0:
        fix = "write a force that pulls the craft forward as a positive number"
        raise InputError(where, f"column 'force' is negative: the fit is {coefficient:.4g} N/krpm²", fix=fix)
    angle = np.round(data["rudder"][kept] / DEG, 1)
    x, F = (data["speed"][kept] * 1e-3) ** 2, data["force"][kept]
    for each in np.unique(angle):
        of = angle == each
        x[of], F[of] = x[of] - x[of].mean(), F[of] - F[of].mean()
    square, freedom = float(x @ x), len(x) - len(np.unique(angle)) - 1
    if freedom < 1 or np.ptp(x) < 1:
        return
    rise = float(x @ F) / square
    error = float(np.sqrt(np.sum((F - rise * x) ** 2) / freedom / square))
    if rise + stdtrit(freedom, 1 - UNLIKELY) * error < RISE * coefficient:
        problem = f"at equal rudder angles the force changes by {rise:.3g} N/krpm² with the square of the speed,"
        problem += f" but a thrust of {coefficient:.3g} N/krpm² fits the readings"
        fix = "check if the gauge is saturated or sticks, and if 'speed' and 'force' were read at the same time"
        raise InputError(where, problem, fix=fix)


class ReverseFit(NamedTuple):
    """Fitted ratio of reverse to forward thrust: y3 n³ + y2 n² + y1 n + y0, n in krpm.

    coefficients: y3 … y0 (4,).  covariance: covariance of the coefficients (4, 4).  slowest: lowest measured speed
    (rpm). Below this speed the cubic is not valid.
    """

    coefficients: Any
    covariance: Any
    slowest: float
    fit: LinearFit


def fit_reverse(data: Measurements, gauge_error: float) -> ReverseFit:
    """Fit the ratio of reverse to forward thrust as a cubic of the speed, [1] eq. 4.4.

    Args:
        data: readings with the columns `REVERSE_COLUMNS`, at the same speeds in both directions.
        gauge_error: standard deviation of a reading (N). It determines the weight of each ratio in the fit.
    """
    refuse_few(data, CUBIC, "a cubic")
    zero = data["forward"] <= 0
    if zero.any():
        problem = f"{data.name_lines(zero)}: the forward thrust is zero, so the ratio is undefined"
        raise InputError(f"file {data.file!r}", problem, fix="leave out speeds at which the gauge reads zero")
    for gauge in ("forward", "reverse"):
        refuse_saturation(data, gauge, data["speed"] ** 2)
    n, y = data["speed"] * 1e-3, data["reverse"] / data["forward"]
    if np.median(y) > 1:
        problem = f"reverse thrust exceeds forward thrust in {data.name_lines(y > 1)}"
        raise InputError(
            f"file {data.file!r}", problem, fix="check if the headings 'forward' and 'reverse' are swapped"
        )
    if len(np.unique(n)) < CUBIC + 1:
        problem = f"{len(np.unique(n))} different speeds are too few for a cubic"
        raise InputError(f"file {data.file!r}", problem, fix="measure at 5 speeds or more")
    weight = data["forward"] / (gauge_error * np.sqrt(1 + y * y))
    powers = np.stack([n**3, n**2, n, np.ones_like(n)], 1)
    fit = fit_linear(powers * weight[:, None], y * weight)
    slowest, fastest = float(np.min(data["speed"])), float(np.max(data["speed"]))
    grid = np.linspace(slowest, fastest, 200) * 1e-3
    thrust = grid**2 * np.polyval(fit.value, grid)
    bad = np.flatnonzero((thrust <= 0) | (np.gradient(thrust) <= 0))
    if len(bad):
        problem = f"the fitted reverse thrust does not rise at {1e3 * grid[bad[0]]:.0f} rpm, so it has no inverse"
        fix = "measure at more speeds, or leave out the lowest speeds, at which the gauge hardly moves"
        raise InputError(f"file {data.file!r}", problem, fix=fix)
    return ReverseFit(fit.value, fit.covariance, slowest, fit)


def refuse_saturation(data: Measurements, gauge: str, rising: Any) -> None:
    """Raise InputError if the gauge was saturated, i.e. if its greatest reading occurs at clearly different forces.

    Args:
        data: readings, with a column `speed`.
        gauge: column with the readings of the gauge.
        rising: expected force at each reading (n,), up to a common factor.
    """
    F = data[gauge]
    greatest, down = float(np.max(F)), np.argsort(-rising, kind="stable")
    top = np.isclose(F, greatest, rtol=0, atol=1e-9)
    share = np.cumsum(top[down]) / np.arange(1, len(F) + 1)
    end = down[: np.flatnonzero(share >= AT_END)[-1] + 1] if top[down[0]] else down[:0]
    end = end[top[end]]
    if len(end) < SATURATED or greatest <= 0:
        return
    steps = np.diff(np.unique(np.round(F, 6))).tolist()
    division = min([greatest, *steps])
    if greatest * (rising[end[0]] / rising[end[-1]] - 1) > DIVISIONS * division:
        n = data["speed"][end]
        lines = data.name_lines(np.isin(np.arange(len(F)), end))
        problem = f"{lines}: column {gauge!r} is {greatest:.4g} in each line, while 'speed' rises from"
        problem += f" {np.min(n):.6g} to {np.max(n):.6g}; the gauge is saturated"
        raise InputError(f"file {data.file!r}", problem, fix="leave these lines out, or use a larger gauge")


def thrust_calibration(data: Measurements, thrust: ThrustFit) -> Calibration:
    """Return a calibration of the thrust: coefficient and maximum speed.

    If eta does not follow the formula, the calibration includes the thrust at each rudder angle.
    """
    about: dict[str, Any] = {"source": source_of(data, thrust.fit), "procedure": "thrust"}
    known = {"freedom": thrust.fit.freedom}
    c = Entry(thrust.coefficient, "N/krpm^2", thrust.standard_error, **known, **about)
    entries: dict[str, Entry] = {"Thruster.coefficient": c}
    entries["Thruster.speed_max_rpm"] = Entry(float(np.max(data["speed"])), "rpm", **about)
    if not thrust.follows_formula():
        entries["thrust.angles"] = Entry(thrust.angles.tolist(), "rad", **about)
        each = Entry(thrust.by_angle.tolist(), "N/krpm^2", thrust.errors.tolist(), **known, **about)
        entries["thrust.by_angle"] = each
    return Calibration(entries)


def reverse_calibration(data: Measurements, reverse: ReverseFit) -> Calibration:
    """Return a calibration of the reverse thrust: the cubic, and the lowest speed at which the cubic is valid."""
    about: dict[str, Any] = {"source": source_of(data, reverse.fit), "procedure": "reverse"}
    name, errors = "Thruster.reverse_ratio", np.sqrt(np.diagonal(reverse.covariance))
    entries: Mapping[str, Entry] = {
        name: Entry(reverse.coefficients.tolist(), "1", errors.tolist(), freedom=reverse.fit.freedom, **about),
        "Thruster.reverse_low_rpm": Entry(reverse.slowest, "rpm", **about),
    }
    names = tuple(index_name(name, (i,)) for i in range(CUBIC))
    return Calibration(entries, (Covariance(names, reverse.covariance.tolist(), "reverse"),))
