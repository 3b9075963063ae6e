"""Closed loop under disturbances: impulses and steps of moment and force, with and without integral action.

[1] names such disturbances as further work. Their sizes are chosen here. The vehicle cruises at its trim, without
noise, and the disturbance starts after 20 s.
[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, its conclusions.
"""

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np

from studies.hypersonic2022._flights import FLIGHT_DIGITS, MEDIUM, RunSignals, build_climb, extent, fly_seeds
from studies.hypersonic2022._oracle import reference, reference_flag
from trimtab.core.record import replace
from trimtab.scenarios.hypersonic import impulse, step_gust
from trimtab.study import Row

SECTION = "simulation, further work"
PLACE = "[1] conclusions, further work"
ONSET = 20.0
CASES = {
    "impulse/moment": "moment impulse, 0.4 rad/s² for 50 ms",
    "impulse/normal-force": "normal-force impulse, 20 ft/s in 50 ms",
    "step/moment": "step moment 500 lbf",
    "step/large-moment": "step moment 5000 lbf",
    "step/drag": "step drag 88 lbf/ft",
    "step/lift": "step lift -2 % of the weight",
}
DIGITS: Any = {"relative": FLIGHT_DIGITS, "tolerance": 1e-4}
"""Relative tolerance, and absolute tolerance for errors near zero: a ten-thousandth of their unit."""
IMPULSES = "impulse/moment", "impulse/normal-force"
PRICE = "Cost of the filter's bandwidth: the filter takes the moment for modal motion."


def rows() -> Iterator[Row]:
    """Yield rows on peaks, remaining errors, settling, the filter's response to an impulse, and weaker coupling."""
    for name in CASES:
        yield from _case(name)
    for name in IMPULSES:
        flown = _fly_case(name)
        got, what = (
            _time_inside(flown.t, flown["law.h_error"][0]),
            f"{CASES[name]}: time until error of h stays below 1 ft",
        )
        yield reference(f"{name}/inside", what, got, PLACE, tolerance=0.021, unit="s")
    yield from _filter()
    yield from _coupling()


@cache
def _fly_case(name: str, integral: str = "off", filter: str = "equal") -> RunSignals:
    group, kind = name.split("/")
    options: dict[str, Any] = {"kind": kind, "integral": integral, "filter": filter, "noise": "off"}
    make: Any = impulse.scenario if group == "impulse" else step_gust.scenario
    return fly_seeds(make(**options))


def _case(name: str) -> Iterator[Row]:
    words, flown, integral = CASES[name], _fly_case(name), _fly_case(name, "on")
    for signal, unit in (("h", "ft"), ("V", "ft/s")):
        path, about = f"law.{signal}_error", {"unit": unit, **DIGITS}
        peak, end = flown.peak(path, ONSET)[0], flown.final_mean(path)[0]
        yield reference(f"{name}/peak-{signal}", f"{words}: peak error of {signal}", peak, PLACE, **about)
        yield reference(f"{name}/end-{signal}", f"{words}: error of {signal} at the end", end, PLACE, **about)
    id, helped, about = f"{name}/integral", f"{words}, integral action", {"unit": "ft", **DIGITS}
    peak, end = integral.peak("law.h_error", ONSET)[0], integral.final_mean("law.h_error")[0]
    yield reference(f"{id}/peak-h", f"{helped}: peak error of h", peak, PLACE, **about)
    yield reference(f"{id}/end-h", f"{helped}: error of h at the end", end, PLACE, **about)
    for key, what, flight in ((name, words, flown), (id, helped, integral)):
        yield reference_flag(f"{key}/saturated", f"{what}: an input reaches its limit", flight.is_saturated[0], PLACE)


def _time_inside(t: Any, h: Any) -> float:
    outside = np.flatnonzero((np.abs(h) > 1.0) & (t > ONSET))
    return float(t[outside[-1]]) - ONSET if len(outside) else 0.0


def _filter() -> Iterator[Row]:
    """Yield the effect of an unmodelled moment on the filter."""
    unit, name = "(slug ft)^1/2", "impulse/moment"
    equal, printed = _fly_case(name), _fly_case(name, filter="printed")
    got, what = equal.mode_error(ONSET)[0], "moment impulse, equal noise: largest error of η1"
    yield reference("filter/equal", what, got, PLACE, name=f"{name}/mode", unit=unit, note=PRICE, **DIGITS)
    got, what = printed.mode_error(ONSET)[0], "moment impulse, printed Q and R: largest error of η1"
    yield reference("filter/printed", what, got, PLACE, name="filter/printed/mode", unit=unit, **DIGITS)
    swing = np.degrees(equal.window("actuators.u.delta_e", ONSET))
    for part, (end, got) in enumerate(zip(("least", "most"), extent(swing), strict=True)):
        about: Any = {"name": f"{name}/elevator", "part": part, "unit": "deg", "note": PRICE, **DIGITS}
        yield reference(f"filter/elevator-{end}", f"moment impulse, equal noise: elevator, {end}", got, PLACE, **about)


def _coupling() -> Iterator[Row]:
    """Yield a plant whose modes couple to pitch 20 % less than modelled."""
    medium = build_climb(MEDIUM)
    craft = medium.world.vehicle
    modes = replace(craft.modes, psi1=0.8 * craft.modes.psi1, psi2=0.8 * craft.modes.psi2)
    weaker = replace(medium, world=replace(medium.world, vehicle=replace(craft, modes=modes)))
    got, what = float(fly_seeds(weaker).rms("law.h_error")[0]), "ψ of the plant 20 % less, +3000 ft: error of h"
    yield reference("coupling/weaker", what, got, PLACE, name="coupling/weaker/h", relative=FLIGHT_DIGITS, unit="ft")
