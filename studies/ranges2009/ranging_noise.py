"""Measured noise of the logs.

Ranges are compared with the distance to the true position at their time. A scale and a constant are fitted to each
radio, and the residuals are analysed. The rows also show how much of the odometry equals the truth. Errors that both
share cannot be detected by a test on these logs.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from studies.ranges2009._data import NAMES, read_plaza
from studies.ranges2009._pictures import draw_noise
from trimtab.study import Row, at_most, band, direction

SECTION = "data sets, part 1"
PLACE = "[1] the data"
SAME_WAY = 2e-4
"""Largest difference (m) at which a step of odometry counts as equal to that of the truth."""


class RangeNoise(NamedTuple):
    """Errors of the ranges of one log.

    distance, error: of each range in m (m,).  residual: error minus fit (m,).  beacon: index of the radio (m,).
    fits: fitted constant (m) and scale of each radio (4, 2).
    """

    distance: Any
    error: Any
    residual: Any
    beacon: Any
    fits: Any


def range_noise(name: str) -> RangeNoise:
    """Return the range errors, with a constant and a scale fitted to each radio by least squares."""
    p = read_plaza(name)
    north, east = (np.interp(p.range_t, p.t, x) for x in (p.north, p.east))
    distance = np.hypot(north - p.beacons[p.beacon, 0], east - p.beacons[p.beacon, 1])
    error, residual, fits = p.range - distance, np.empty(len(distance)), []
    for i in range(len(p.ids)):
        me = p.beacon == i
        A = np.stack([np.ones(me.sum()), distance[me]], axis=1)
        fit = np.linalg.lstsq(A, error[me], rcond=None)[0]
        residual[me] = error[me] - A @ fit
        fits.append(fit)
    return RangeNoise(distance, error, residual, p.beacon, np.array(fits))


def same_way(name: str) -> float:
    """Return the share of odometry steps whose length equals that of the true step."""
    p = read_plaza(name)
    true = np.hypot(np.diff(p.north), np.diff(p.east))
    return float(np.mean(np.abs(np.diff(p.distance) - true) < SAME_WAY))


def same_turn(name: str) -> float:
    """Return the largest difference between odometry's angle and the truth's heading since the start (rad)."""
    p = read_plaza(name)
    return float(np.max(np.abs(p.turn - (p.heading - p.heading[0]))))


def rows() -> Iterator[Row]:
    """Yield scale, spread, tails and autocorrelation of the ranges, and the share of odometry that equals the truth."""
    for name in NAMES:
        n = range_noise(name)
        z, count = n.residual / n.residual.std(), len(n.residual)
        noise = 2 / np.sqrt(count)  # two sigmas of a correlation of white noise
        lag = np.mean([np.corrcoef(r[:-1], r[1:])[0, 1] for r in (n.residual[n.beacon == i] for i in range(4))])
        yield band(
            f"{name}/scale", f"{name}: relative excess of the ranges", 0.068, n.fits[:, 1].mean(), PLACE,
            low=0.066, high=0.071, basis="own", note="Both logs use the same radios. Their scales agree within 0.4 %.",
        )  # fmt: skip
        yield band(
            f"{name}/sigma", f"{name}: residuals, standard deviation", 0.55, n.residual.std(), PLACE,
            low=0.52, high=0.58, unit="m", basis="own",
        )  # fmt: skip
        yield band(
            f"{name}/kurtosis", f"{name}: residuals, kurtosis (normal: 3)", 3.0, float(np.mean(z**4)), PLACE,
            low=3 - 2 * np.sqrt(24 / count), high=3 + 2 * np.sqrt(24 / count), basis="input",
        )  # fmt: skip
        yield at_most(
            f"{name}/outliers", f"{name}: share beyond four sigmas", 0.001, float(np.mean(np.abs(z) > 4)), PLACE,
            high=0.001, basis="own", note="Neither log has an outlier, so gates and heavy tails have no effect.",
        )  # fmt: skip
        yield band(
            f"{name}/memory", f"{name}: residuals, correlation with the same radio's next", 0.0, float(lag), PLACE,
            low=-noise, high=noise, basis="input", note="White, so a state for a correlated error is not needed.",
        )  # fmt: skip
        yield direction(
            f"{name}/way", f"{name}: share of odometry steps equal to the truth's within 0.2 mm", "nearly all",
            same_way(name), PLACE, above=0.9, basis="own",
            note="Odometry was derived from the ground truth, or the reverse. A real wheel slips.",
        )  # fmt: skip
    yield at_most(
        "Plaza1/turn", "Plaza1: odometry minus true turn", 0.0, same_turn("Plaza1"), PLACE,
        high=1e-9, unit="rad", basis="own", note="Equal numbers, so heading cannot be tested against this truth.",
    )  # fmt: skip
    yield direction(
        "Plaza2/turn", "Plaza2: odometry minus true turn", "drifts", same_turn("Plaza2"), PLACE, above=1.0,
        unit="rad", basis="own", note="Drift of 5.4 mrad/s, as of a gyro. The filter has to estimate it.",
    )  # fmt: skip


def figures(folder: Path) -> Iterator[Path]:
    """Plot the error over distance, and residuals with distribution and autocorrelation."""
    for name in NAMES:
        yield draw_noise(folder / f"noise-{name}.png", name, range_noise(name), read_plaza(name).ids)
