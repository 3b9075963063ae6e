"""Calibration of an inertial unit's noise: parameters of the sensor models, and Q and R of a filter.

The sensor model has one noise value for all three axes, namely the root mean square of the axes' values. A planar
filter has separate values
for the axes that it uses: the gyro about the vertical, the accelerometers forward and to starboard. The sensor model
does not include flicker. The filter's bias walk includes the effect of flicker, see `allan.filter_noise`.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from scipy.special import chdtrc

from trimtab.analysis.identify.allan import FLICKER, NORMAL95, AllanFit, Coefficient, filter_noise
from trimtab.loop.calibration import Calibration, Entry

UNLIKELY = 0.001
"""Significance level: a noise difference between axes is reported if it occurs by chance with a smaller probability."""
AXES = "xyz"


class Triad(NamedTuple):
    """Names of the calibration entries of a three-axis sensor.

    unit: unit of a sample.  record: class name of the sensor model.

    white: axis -> name of the filter's parameter for the variance of a sample.
    walk: axes that the filter uses, and name of the filter's parameter for the bias random walk of these axes.
    """

    unit: str
    record: str
    white: Mapping[int, str]
    walk: tuple[tuple[int, ...], str]


TRIADS: Mapping[str, Triad] = {
    "gyro": Triad("rad/s", "GyroErrors", {2: "InertialNoise.gyro"}, ((2,), "InertialNoise.gyro_walk")),
    "accelerometer": Triad(
        "m/s^2",
        "AccelerometerErrors",
        {0: "InertialNoise.forward", 1: "InertialNoise.starboard"},
        ((0, 1), "InertialNoise.force_walk"),
    ),
}
SQUARES = {"rad/s": ("rad^2/s^2", "rad^2/s^3"), "m/s^2": ("m^2/s^4", "m^2/s^5")}
"""Unit of a sample -> unit of the sample's variance, and unit of a bias variance's growth per second."""


Number = tuple[float, str, float]
"""Value, unit and standard error of a calibrated parameter."""


class NoiseCalibration(NamedTuple):
    """Calibration of a sensor's noise.

    notes: sentences for the user about noise that the log or the sensor model lacks.
    """

    calibration: Calibration
    notes: tuple[str, ...]


def noise_calibration(
    triad: str, axes: Mapping[int, AllanFit], source: str, step: float | None = None
) -> NoiseCalibration:
    """Return the calibrated noise parameters of one three-axis sensor, from Allan fits of the axes at rest.

    Args:
        triad: "gyro" or "accelerometer".
        axes: axis (0, 1, 2 for x, y, z) -> fit in SI units, for at least one axis.
        source: description of the data.
        step: time step of the filter (s). None: the time between two samples of the log.
    """
    about: dict[str, Any] = {"source": source, "procedure": f"{triad} noise"}
    own, of_sensor = _sensor_numbers(TRIADS[triad], axes)
    entries = {name: Entry(value, unit, error, **about) for name, (value, unit, error) in own.items()}
    dt = float(next(iter(axes.values())).sampling_period) if step is None else step
    assumed, of_filter = _filter_numbers(triad, axes, dt)
    entries |= {name: Entry(value, unit, error, **about) for name, (value, unit, error) in assumed.items()}
    if assumed:
        entries[f"{triad}.step"] = Entry(dt, "s", **about)
    return NoiseCalibration(Calibration(entries), (*_compare_axes(triad, axes), *of_sensor, *of_filter))


def _sensor_numbers(to: Triad, axes: Mapping[int, AllanFit]) -> tuple[dict[str, Number], list[str]]:
    """Return the noise parameters of the sensor model, and notes for the user."""
    name, notes = f"{to.record}.bias_walk", list[str]()
    N2, of_N2 = _mean([_square(fit.white) for fit in axes.values()])
    K2, of_K2 = _mean([_square(fit.walk) for fit in axes.values()])
    found = {f"{to.record}.noise": (math.sqrt(N2), f"{to.unit}/Hz^0.5", of_N2 / (2 * math.sqrt(N2)))}
    if _is_shown(K2, of_K2):
        found[name] = math.sqrt(K2), f"{to.unit}/s^0.5", of_K2 / (2 * math.sqrt(K2))
    else:
        most = math.sqrt(K2 + NORMAL95 * of_K2)
        notes.append(
            f"{name} is not written: this log shows no random walk (at most {most:.3g} {to.unit}/s^0.5); log for longer"
        )
    flickers = [AXES[i] for i, fit in axes.items() if fit.flicker.low > 0]
    if flickers:
        most = max(float(fit.flicker.value) for fit in axes.values())
        notes.append(
            f"flicker of {most:.3g} {to.unit} in {', '.join(flickers)}: the sensor models do not include "
            "flicker, but the filter's noise parameters do"
        )
    return found, notes


def _filter_numbers(triad: str, axes: Mapping[int, AllanFit], dt: float) -> tuple[dict[str, Number], list[str]]:
    """Return the noise parameters of a filter with time step dt (s), and notes for the user."""
    to, found, notes = TRIADS[triad], dict[str, Number](), list[str]()
    variance, rate = SQUARES[to.unit]
    for axis, name in to.white.items():
        if axis in axes:
            square, error = _square(axes[axis].white)
            found[name] = square / dt, variance, error / dt
        else:
            notes.append(f"{name} is not written: the {triad}'s {AXES[axis]} axis is not in this log")
    used = [axes[i] for i in to.walk[0] if i in axes]
    if used:
        value, error = _mean([_walk_of_filter(fit) for fit in used])
        if _is_shown(value, error):
            found[to.walk[1]] = value, rate, error
        else:
            most = value + NORMAL95 * error
            notes.append(
                f"{to.walk[1]} is not written: this log shows no random walk (max {most:.3g} {rate}); log for longer"
            )
    return found, notes


def _is_shown(value: float, error: float) -> bool:
    """Return True if a squared noise coefficient is significant: its 95 % interval does not include 0."""
    return value > NORMAL95 * error


def _square(c: Coefficient) -> tuple[float, float]:
    """Return a squared coefficient, and the standard error of the square, computed from the interval's upper limit."""
    return float(c.value) ** 2, (float(c.high) ** 2 - float(c.value) ** 2) / NORMAL95


def _mean(squares: Sequence[tuple[float, float]]) -> tuple[float, float]:
    n = len(squares)
    return sum(s for s, _ in squares) / n, math.sqrt(sum(e * e for _, e in squares)) / n


def _walk_of_filter(fit: AllanFit) -> tuple[float, float]:
    """Return the growth of the bias variance per second, including flicker, and the standard error of this growth."""
    (N2, _), (B2, of_B2), (_, of_K2) = _square(fit.white), _square(fit.flicker), _square(fit.walk)
    dt, floor = float(fit.sampling_period), FLICKER * B2
    value = float(filter_noise(fit).bias_variance) / dt
    slope = 6 * FLICKER * floor / N2 if N2 > 0 and floor / N2 < 1 / dt else 3 * FLICKER / dt
    return value, math.hypot(of_K2, slope * of_B2)


def _compare_axes(triad: str, axes: Mapping[int, AllanFit]) -> list[str]:
    """Return a note if the axes differ in white noise by more than chance explains."""
    squares = {AXES[i]: _square(fit.white) for i, fit in axes.items()}
    mean = _mean(list(squares.values()))[0]
    misfit = sum(((s - mean) / e) ** 2 for s, e in squares.values())
    if len(squares) < 2 or float(chdtrc(len(squares) - 1, misfit)) > UNLIKELY:
        return []
    each = ", ".join(f"{axis} {math.sqrt(s):.4g}" for axis, (s, _) in squares.items())
    return [(f"the {triad}'s axes differ in white noise ({each}); the sensor model uses their root mean square")]
