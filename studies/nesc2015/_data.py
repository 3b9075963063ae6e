"""Trajectories of NASA's simulations in SI units, and the band that they span."""

import csv
import functools
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.rotation import DEG

DATA = Path(__file__).parent / "data"
FOOT, SLUG, POUND = 0.3048, 14.593902937206365, 4.4482216152605
KNOT, RANKINE = 1852 / 3600, 5 / 9


class Signal(NamedTuple):
    """Signal of NASA's simulations. name, unit: in this study.  factor: from NASA's unit to this unit."""

    name: str
    unit: str
    factor: float


SIGNALS: dict[str, Signal] = {
    "feVelocity_ft_s_X": Signal("velocity north", "m/s", FOOT),
    "feVelocity_ft_s_Y": Signal("velocity east", "m/s", FOOT),
    "feVelocity_ft_s_Z": Signal("velocity down", "m/s", FOOT),
    "altitudeMsl_ft": Signal("height", "m", FOOT),
    "longitude_deg": Signal("longitude", "rad", DEG),
    "latitude_deg": Signal("latitude", "rad", DEG),
    "localGravity_ft_s2": Signal("gravitation", "m/s^2", FOOT),
    "eulerAngle_deg_Yaw": Signal("yaw", "rad", DEG),
    "eulerAngle_deg_Pitch": Signal("pitch", "rad", DEG),
    "eulerAngle_deg_Roll": Signal("roll", "rad", DEG),
    "bodyAngularRateWrtEi_deg_s_Roll": Signal("roll rate", "rad/s", DEG),
    "bodyAngularRateWrtEi_deg_s_Pitch": Signal("pitch rate", "rad/s", DEG),
    "bodyAngularRateWrtEi_deg_s_Yaw": Signal("yaw rate", "rad/s", DEG),
    "speedOfSound_ft_s": Signal("speed of sound", "m/s", FOOT),
    "airDensity_slug_ft3": Signal("density", "kg/m^3", SLUG / FOOT**3),
    "ambientPressure_lbf_ft2": Signal("pressure", "Pa", POUND / FOOT**2),
    "ambientTemperature_dgR": Signal("temperature", "K", RANKINE),
    "aero_bodyForce_lbf_X": Signal("aerodynamic force X", "N", POUND),
    "aero_bodyForce_lbf_Y": Signal("aerodynamic force Y", "N", POUND),
    "aero_bodyForce_lbf_Z": Signal("aerodynamic force Z", "N", POUND),
    "aero_bodyMoment_ftlbf_L": Signal("aerodynamic moment L", "N m", POUND * FOOT),
    "aero_bodyMoment_ftlbf_M": Signal("aerodynamic moment M", "N m", POUND * FOOT),
    "aero_bodyMoment_ftlbf_N": Signal("aerodynamic moment N", "N m", POUND * FOOT),
    "mach": Signal("Mach number", "1", 1.0),
    "trueAirspeed_nmi_h": Signal("airspeed", "m/s", KNOT),
}
"""Signals by NASA's names."""


class Band(NamedTuple):
    """Band of NASA's simulations for one signal of a case.

    t: (n,) s.  low, high: least and greatest at each instant (n,).  middle: the median (n,).  simulations: their names.
    values: signal of each simulation (k, n). Angles are within half a turn of the first simulation's.
    """

    t: Any
    low: Any
    high: Any
    middle: Any
    simulations: tuple[str, ...]
    values: Any


@functools.cache
def read_case(case: str) -> dict[str, dict[str, Any]]:
    """Return simulation -> signal -> (n,) in SI units, with "time" (n,); NaN where a value was not given."""
    with (DATA / f"{case}.csv").open(encoding="utf-8", newline="") as lines:
        heading, *rows = csv.reader(lines)
    found: dict[str, dict[str, Any]] = {}
    for simulation in sorted({row[0] for row in rows}):
        table = np.array([[float(x or "nan") for x in row[1:]] for row in rows if row[0] == simulation])
        signals = {name: table[:, 1 + i] * SIGNALS[name].factor for i, name in enumerate(heading[2:])}
        found[simulation] = {"time": table[:, 0], **signals}
    return found


def band_of(case: str, signal: str) -> Band:
    """Return the band over the instants shared by all simulations that give the signal."""
    given = {k: x for k, x in read_case(case).items() if not np.isnan(x[signal]).any()}
    t = functools.reduce(np.intersect1d, (x["time"] for x in given.values()))
    values = np.stack([x[signal][np.isin(x["time"], t)] for x in given.values()])
    if SIGNALS[signal].unit == "rad":
        values = values[0] + turn_near(values - values[0])
    return Band(t, values.min(0), values.max(0), np.median(values, axis=0), tuple(given), values)


def turn_near(angle: Any) -> Any:
    """Return angles (rad) wrapped to -pi to pi."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
