"""Closed loop under disturbances: impulses and steps of moment and force, with and without integral action.

[1] names them as further work; sizes are chosen. Cruise at the trim with the tuned filter and noise, onset after 20 s.
[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, its conclusions.
"""

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np

from studies.hypersonic2022._flights import MEDIUM, RunSignals, build_climb, extent, fly_seeds
from trimtab.core.record import replace
from trimtab.scenarios.hypersonic import impulse, step_gust
from trimtab.study import Row, at_most, direction, same, within

SECTION = "simulation, further work"
PLACE = "[1] conclusions, further work"
REFERENCE: dict[str, Any] = {"basis": "reference"}
SEEDS = 5
ONSET = 20.0
CASES = {
    "impulse/moment": ("moment impulse, 0.4 rad/s² for 50 ms", 3.9, 0.24, 0.0, 0.0, 3.4),
    "impulse/normal-force": ("normal-force impulse, 20 ft/s in 50 ms", 31.1, 0.50, 0.0, 0.0, 27.5),
    "step/moment": ("step moment 500 lbf", 1.7, 0.04, 1.70, -0.032, 0.9),
    "step/large-moment": ("step moment 5000 lbf", 16.9, 0.33, 16.9, -0.33, 8.8),
    "step/drag": ("step drag 88 lbf/ft", 0.4, 0.60, 0.36, -0.593, 0.2),
    "step/lift": ("step lift -2 % of the weight", 8.7, 0.05, -8.67, 0.048, 4.6),
}
"""Words; without integral action peak |h| (ft), |V| (ft/s), last errors of h and V; with it peak |h|."""
FLOOR_H, FLOOR_V = 0.03, 0.002
"""What noise leaves of an error's mean over 10 s (ft, ft/s)."""
INSIDE = {"impulse/moment": 12.6, "impulse/normal-force": 22.0}
"""Time (s) after which the error of h stays below 1 ft."""
PRICE = "What the tuned filter's bandwidth costs: it takes the moment for modes."


def rows() -> Iterator[Row]:
    """Peaks, what is left, settling, what the filter makes of an impulse, weaker coupling."""
    for name in CASES:
        yield from _case(name)
    for name, want in INSIDE.items():
        flown = _fly_case(name)
        got = float(np.median([_time_inside(flown.t, h) for h in flown["law.h_error"]]))
        what = f"{CASES[name][0]}: error of h below 1 ft for good after"
        yield within(f"{name}/inside", what, want, got, PLACE, tolerance=0.3, unit="s", **REFERENCE)
    yield from _filter()
    yield from _coupling()


@cache
def _fly_case(name: str, integral: str = "off", filter: str = "tuned") -> RunSignals:
    group, kind = name.split("/")
    options: dict[str, Any] = {"kind": kind, "integral": integral, "filter": filter}
    make: Any = impulse.scenario if group == "impulse" else step_gust.scenario
    return fly_seeds(make(**options), SEEDS)


def _case(name: str) -> Iterator[Row]:
    words, h, V, end_h, end_V, helped = CASES[name]
    flown, integral = _fly_case(name), _fly_case(name, "on")
    about: dict[str, Any] = dict(REFERENCE)
    for signal, want, floor, unit in (("h", h, FLOOR_H, "ft"), ("V", V, FLOOR_V, "ft/s")):
        got = float(np.median(flown.peak(f"law.{signal}_error", ONSET)))
        digit = 0.051 if signal == "h" else 0.0051
        what = f"{words}: peak error of {signal}"
        tolerance = digit + floor
        yield within(f"{name}/peak-{signal}", what, want, got, PLACE, tolerance=tolerance, unit=unit, **about)
    for signal, want, floor, unit in (("h", end_h, FLOOR_H, "ft"), ("V", end_V, FLOOR_V, "ft/s")):
        got = float(np.median(flown.final_mean(f"law.{signal}_error")))
        what = f"{words}: error of {signal} at the end"
        tolerance = floor + 0.01 * abs(want)
        yield within(f"{name}/end-{signal}", what, want, got, PLACE, tolerance=tolerance, unit=unit, **about)
    got = float(np.median(integral.peak("law.h_error", ONSET)))
    what = f"{words}, integral action: peak error of h"
    yield within(f"{name}/integral-peak", what, helped, got, PLACE, tolerance=0.051 + FLOOR_H, unit="ft", **about)
    got = float(np.abs(integral.final_mean("law.h_error")).max())
    what = f"{words}, integral action: error of h at the end, largest of {SEEDS} seeds"
    yield at_most(f"{name}/integral-end", what, "no offset", got, PLACE, high=FLOOR_H, unit="ft", **about)
    limited = bool(flown.is_saturated.any() or integral.is_saturated.any())
    yield same(f"{name}/saturated", f"{words}: a limit holds the input", False, limited, PLACE, **about)


def _time_inside(t: Any, h: Any) -> float:
    outside = np.flatnonzero((np.abs(h) > 1.0) & (t > ONSET))
    return float(t[outside[-1]]) - ONSET if len(outside) else 0.0


def _filter() -> Iterator[Row]:
    """What an unmodelled moment looks like to the filter."""
    unit, name = "(slug ft)^1/2", "impulse/moment"
    tuned, printed = _fly_case(name), _fly_case(name, filter="printed")
    got = float(np.median(tuned.mode_error(ONSET)))
    what = "moment impulse, tuned: largest error of η1"
    yield within("filter/tuned", what, 1.8, got, PLACE, tolerance=0.15, unit=unit, note=PRICE, **REFERENCE)
    got = float(np.median(printed.mode_error(ONSET)))
    what = "the same with printed Q and R"
    yield within("filter/printed", what, 0.22, got, PLACE, tolerance=0.01, unit=unit, **REFERENCE)
    swing = np.degrees(tuned.window("actuators.u.delta_e", ONSET))
    for end, want, got in zip(("least", "most"), (6.5, 23.6), extent(swing), strict=True):
        what = f"moment impulse, tuned: elevator, {end} of {SEEDS} seeds"
        yield within(
            f"filter/elevator-{end}", what, want, got, PLACE, tolerance=1.0, unit="deg", note=PRICE, **REFERENCE
        )


def _coupling() -> Iterator[Row]:
    """A plant whose modes touch pitch 20 % less than believed."""
    medium = build_climb(MEDIUM, filter="tuned")
    craft = medium.world.vehicle
    modes = replace(craft.modes, psi1=0.8 * craft.modes.psi1, psi2=0.8 * craft.modes.psi2)
    weaker = replace(medium, world=replace(medium.world, vehicle=replace(craft, modes=modes)))
    got = float(fly_seeds(weaker).rms("law.h_error")[0])
    what = "ψ of the plant 20 % less, +3000 ft: error of h"
    yield direction("coupling/weaker", what, "harmless, 0.002 ft", got, PLACE, below=0.003, unit="ft", **REFERENCE)
