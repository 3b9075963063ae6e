"""Friction from a coast-down: the decreasing speed of a craft that spins or glides freely.

    J r' = -(c0 tanh(r/r0) + c1 r + c2 |r| r)        m u' = -(c0 tanh(u/u0) + c1 u + c2 |u| u)

The speeds of the model are fitted to the measured speeds (output error). The initial speed of each trial is also
fitted. Coefficients are never negative.

Source: the form is that of `vehicles.hovercraft.Friction`; the fit, Ljung, "System identification", 1999, section 7.2.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from trimtab.core.errors import InputError
from trimtab.logs.measurements import TRIAL, MeasuredColumn, Measurements, refuse_spikes, refuse_wrong_step
from trimtab.loop.calibration import Calibration, Covariance, Entry

SPIN_COLUMNS = (
    MeasuredColumn("time", "s", "time, which may start at any value"),
    MeasuredColumn("yaw_rate", "rad/s", "yaw rate", -50, 50, most=0.2),
)
GLIDE_COLUMNS = (
    MeasuredColumn("time", "s", "time, which may start at any value"),
    MeasuredColumn("speed", "m/s", "speed", -50, 50, most=0.1),
)
NAMES = ("coulomb", "viscous", "quadratic")
UNITS = {"torque": ("N m", "N m s", "N m s^2"), "force": ("N", "N s/m", "N s^2/m^2")}


class FrictionFit(NamedTuple):
    """Fitted friction. coefficients: Coulomb, viscous and quadratic coefficient (3,), in `UNITS`.

    covariance: covariance of the coefficients (3, 3).  trials: times, speeds and fitted speeds of each trial.
    deviation: standard deviation of a speed reading.  freedom: degrees of freedom of the fit.
    kind: "torque" for a spin or "force" for a glide.  inertia: moment of inertia (kg m²) or mass (kg).
    """

    coefficients: Any
    covariance: Any
    trials: tuple[tuple[Any, Any, Any], ...]
    deviation: float
    freedom: int
    kind: str
    inertia: float

    def standard_errors(self) -> Any:
        """Return the standard errors of the friction coefficients (3,)."""
        return np.sqrt(np.diagonal(self.covariance))


def split_trials(data: Measurements, speed: str) -> list[tuple[Any, Any]]:
    """Return times and speeds of each trial. The column `trial` numbers the trials; without it there is one trial."""
    lines = np.asarray(data.lines)
    which = data[TRIAL] if TRIAL in data else np.zeros(len(data))
    trials = []
    for name in dict.fromkeys(which.tolist()):
        t, v = data["time"][which == name], data[speed][which == name]
        if len(t) < 8:
            problem = f"trial {name!r} has only {len(t)} readings"
            raise InputError(
                f"file {data.file!r}", problem, fix="log at least 8 readings, better 100, from full speed to rest"
            )
        falls = np.flatnonzero(np.diff(t) <= 0)
        if len(falls):
            at = lines[which == name][falls[0] : falls[0] + 2]
            problem = f"trial {name!r}, line {at[1]}, column 'time': {t[falls[0] + 1]:.9g} s must be after"
            problem += f" {t[falls[0]]:.9g} s of line {at[0]}"
            fix = "sort the lines by time, number the trials in a column trial, and check that headings are not swapped"
            raise InputError(f"file {data.file!r}", problem, fix=fix)
        refuse_wrong_step(data.file, t, f"trial {name!r}, ")
        refuse_spikes(data.select(which == name), speed)
        trials.append((t - t[0], v))
    return trials


def fit_coast_down(
    trials: Sequence[tuple[Any, Any]], inertia: float, kind: str, slip: float, inertia_error: float = 0.0
) -> FrictionFit:
    """Fit Coulomb, viscous and quadratic friction to coast-down trials.

    Args:
        trials: for each trial, times (n,) that start at 0 and speeds (n,), in rad/s or m/s.
        inertia: moment of inertia (kg m²) for a spin, mass (kg) for a glide.
        kind: "torque" for a spin, "force" for a glide.
        slip: speed scale of Coulomb friction: c0 tanh(speed/slip).
        inertia_error: standard error of the inertia, to which all coefficients are proportional.
    """
    size = max(float(np.max(np.abs(v))) for _, v in trials)
    falls = max(float(np.abs(v[:3]).mean() - np.abs(v[-3:]).mean()) for _, v in trials)
    if falls < 0.1 * size:
        problem = f"the speed falls by only {max(falls, 0.0):.3g} from {size:.3g}, so this is not a coast-down"
        raise InputError(
            "friction", problem, fix="let the craft slow down without thrust, to a third of its speed or to rest"
        )
    rates = _scales(trials, size)
    start = np.concatenate([0.3 * np.ones(3), [v[0] for _, v in trials]])
    low = np.concatenate([np.zeros(3), np.full(len(trials), -np.inf)])

    def residuals(p: Any) -> Any:
        speeds = (_coast(p[:3] * rates, p[3 + i], t, slip) for i, (t, _) in enumerate(trials))
        return np.concatenate([m - v for m, (_, v) in zip(speeds, trials, strict=True)])

    best = least_squares(residuals, start, bounds=(low, np.inf), x_scale="jac", method="trf", xtol=1e-12, ftol=1e-12)
    p = best.x
    freedom = len(best.fun) - len(p)
    deviation = float(np.sqrt(best.fun @ best.fun / freedom))
    J = best.jac
    free = np.concatenate([p[:3] > 1e-6, np.ones(len(trials), bool)])
    P = np.zeros((len(p), len(p)))
    P[np.ix_(free, free)] = np.linalg.pinv(J[:, free].T @ J[:, free]) * deviation**2
    scale = rates * inertia
    fitted = tuple((t, v, _coast(p[:3] * rates, p[3 + i], t, slip)) for i, (t, v) in enumerate(trials))
    values = np.where(p[:3] > 1e-6, p[:3], 0.0) * scale
    covariance = P[:3, :3] * np.outer(scale, scale) + np.outer(values, values) * (inertia_error / inertia) ** 2
    return FrictionFit(values, covariance, fitted, deviation, freedom, kind, inertia)


def friction_calibration(file: str, fit: FrictionFit) -> Calibration:
    """Return a calibration of `Friction`: the coefficients and their covariance."""
    names = tuple(f"Friction.{fit.kind}_{name}" for name in NAMES)
    source = f"{file}: {len(fit.trials)} coast-down{'s' if len(fit.trials) > 1 else ''}, inertia {fit.inertia:.5g}"
    about: dict[str, Any] = {"freedom": fit.freedom, "source": source, "procedure": f"{fit.kind} friction"}
    errors = fit.standard_errors()
    entries = {
        n: Entry(float(v), unit, float(e), **about)
        for n, v, e, unit in zip(names, fit.coefficients, errors, UNITS[fit.kind], strict=True)
    }
    return Calibration(entries, (Covariance(names, fit.covariance.tolist(), about["procedure"]),))


def _scales(trials: Sequence[tuple[Any, Any]], size: float) -> Any:
    """Return a rough size (3,) of each coefficient/inertia, as if that kind of friction alone slowed the craft."""
    times = [max(float(t[-1]), 1e-3) for t, _ in trials]
    rate = 1.0 / min(times)
    return np.array([rate * size, rate, rate / size])


def _coast(c: Any, v0: float, t: Any, slip: float) -> Any:
    """Return speeds (n,) at times t (n,) under v' = -(c0 tanh(v/slip) + c1 v + c2 |v| v), from the speed v0.

    The integration step is small enough for the fastest decay, that by Coulomb friction at speeds below `slip`.
    """
    longest = min(0.02, 0.5 / (c[0] / slip + c[1] + 2 * c[2] * abs(v0) + 1e-9))
    v, out = float(v0), np.empty(len(t))
    c0, c1, c2 = (float(x) for x in c)

    def slope(x: float) -> float:
        return -(c0 * math.tanh(x / slip) + c1 * x + c2 * abs(x) * x)

    for k, now in enumerate(t):
        span = float(now - t[k - 1]) if k else 0.0
        steps = math.ceil(span / longest)
        for _ in range(steps):
            h = span / steps
            a = slope(v)
            b = slope(v + h / 2 * a)
            d = slope(v + h / 2 * b)
            v += h / 6 * (a + 2 * b + 2 * d + slope(v + h * d))
        out[k] = v
    return out
