"""Closed loop: climbs without noise, control periods, and initial errors from which the loop recovers.

The figures of [1] are not available. Its text says that altitude and speed follow with practically no error. Rows
compare with the oracle's flights, as rms between 20 s and 200 s unless stated otherwise.
[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, its simulation.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from studies.hypersonic2022._flights import (
    CRUISE,
    FLIGHT_DIGITS,
    LARGE,
    LARGEST,
    LONG,
    MEDIUM,
    SHORT,
    SIGNALS,
    SMALL,
    RunSignals,
    build_climb,
    change_period,
    fly_climb,
    fly_seeds,
)
from studies.hypersonic2022._oracle import reference, reference_flag
from trimtab.core.record import replace
from trimtab.core.time import ms, seconds
from trimtab.run.simulate import simulate
from trimtab.study import Row, direction
from trimtab.vehicles.hypersonic import Hypersonic

SECTION = "simulation"
PLACE = "[1] simulation"
NOMINAL = SMALL, MEDIUM, LARGE, LARGEST
PERIODS = 5, 10, 20
"""Control periods (ms)."""
FIRST = {
    "h": ("altitude 1000 ft high", "h", 1000.0),
    "V": ("speed 50 ft/s high", "V", 50.0),
    "alpha": ("angle of attack 2 deg high", "alpha", math.radians(2)),
    "low-500": ("altitude 500 ft low", "h", -500.0),
    "low": ("altitude 1000 ft low", "h", -1000.0),
}
SURVIVED = 80.0
LOW = "Fuel and elevator are at their limits within half a second, and the angle of attack diverges."


def rows() -> Iterator[Row]:
    """Yield rows on nominal climbs, readings of k_i, control periods, and initial errors."""
    yield from _nominal()
    yield from _variants()
    yield from _first_errors()


def figures(folder: Path) -> Iterator[Path]:
    """Plot tracking, inputs, and modes with estimate and error. The observer without measurement is grey."""
    from trimtab.plots.tracking import plot_tracking

    folder.mkdir(parents=True, exist_ok=True)
    options: dict[str, Any] = {"noise": "on"}
    drawn = {
        "climb-printed-filter": (build_climb(LARGE, filter="printed"), LONG, "+5000 ft, printed Q and R, no noise"),
        "first-10-s-printed-filter": (
            build_climb(LARGE, filter="printed"),
            10.0,
            "first 10 s, printed Q and R, no noise",
        ),
        "first-10-s-accurate-filter": (
            build_climb(LARGE, filter="accurate", **options),
            10.0,
            "first 10 s, Q = 1e-5 I, noise",
        ),
        "climb-noise": (build_climb(LARGE, **options), LONG, "+5000 ft, tuned filter, noise"),
    }
    for name, (scenario, length, title) in drawn.items():
        path = folder / f"hypersonic-{name}.png"
        log = simulate(scenario, duration=seconds(length), log_period=ms(5), signals=SIGNALS)
        plot_tracking(log, path, title=f"[1] simulation: {title}")
        yield path


def _nominal() -> Iterator[Row]:
    claim = f"{PLACE}, tracking"
    for climb in NOMINAL:
        flown = fly_climb(climb, filter="printed")
        id, words = f"nominal/{climb[0]:g}", f"+{climb[0]:g} ft, +{climb[1]:g} ft/s"
        for name, unit in (("h", "ft"), ("V", "ft/s")):
            got, what = flown.rms(f"law.{name}_error")[0], f"{words}, error of {name}"
            yield reference(f"{id}/{name}", what, got, claim, relative=FLIGHT_DIGITS, unit=unit)
        yield reference_flag(f"{id}/saturated", f"{words}, an input reaches its limit", flown.is_saturated[0], claim)
    flown = fly_climb(LARGE, filter="printed")
    for name, bound, unit in (("h", 0.05, "ft"), ("V", 0.01, "ft/s")):
        got = flown.rms(f"law.{name}_error")[0]
        what = f"+5000 ft, +1000 ft/s, error of {name} vanishes"
        yield direction(f"claim/{name}", what, "stated", got, claim, below=bound, unit=unit)
    none = fly_climb(LARGE, filter="none")
    got = none.rms("law.h_error")[0]
    note = "Tracking of the exact model is good even without the filter, so it says nothing about the filter."
    yield direction(
        "claim/none",
        "+5000 ft, +1000 ft/s, no measurement, error of h",
        "stated",
        got,
        claim,
        below=0.05,
        unit="ft",
        note=note,
        basis="own",
    )
    most = fly_climb(LARGEST, filter="printed")["actuators.u.Phi"].max()
    what = "+10000 ft, +1500 ft/s, largest fuel ratio"
    yield reference("nominal/fuel", what, most, claim, relative=FLIGHT_DIGITS)


def _variants() -> Iterator[Row]:
    """Yield rows on readings of k_i, control periods, and the true state instead of the estimate."""
    medium = build_climb(MEDIUM, filter="printed")
    about: Any = {"relative": FLIGHT_DIGITS, "unit": "ft"}
    for period in PERIODS:
        flown = fly_seeds(medium if period == 5 else change_period(medium, ms(period)), length=SHORT)
        what = f"+3000 ft, +500 ft/s, error of h at {period} ms, 20-60 s"
        yield reference(f"period/{period}-ms", what, _altitude_error(flown), PLACE, **about)
    true = fly_seeds(medium.ideal(), length=SHORT)
    what = "+3000 ft, +500 ft/s, error of h at 5 ms, true state instead of estimate"
    yield reference("period/true-state", what, _altitude_error(true), PLACE, **about)
    craft = medium.world.vehicle
    for kmode in ("paper", "author"):
        plant = replace(craft, modes=replace(craft.modes, kmode=kmode))
        flown = fly_seeds(_replace_vehicle(medium, plant))
        what = f"+3000 ft, +500 ft/s, error of h, reading {kmode!r} of k_i"
        note = "Vehicle, filter and law use the same reading. The choice hardly matters."
        name = f"reading/{kmode}"
        yield reference(name, what, _altitude_error(flown), PLACE, name=f"{name}/h", note=note, **about)


def _altitude_error(flown: RunSignals) -> float:
    return float(flown.rms("law.h_error")[0])


def _replace_vehicle(scenario: Any, craft: Hypersonic) -> Any:
    """Return the scenario with this vehicle in world, filter and law, and with its internal motion solved."""
    from trimtab.scenarios.hypersonic._internal import noncausal_table

    autopilot = scenario.autopilot
    table, _ = noncausal_table(craft, autopilot.law.command, 200.0)
    law = replace(autopilot.law, craft=craft, internal=table)
    autopilot = replace(autopilot, law=law, estimator=replace(autopilot.estimator, craft=craft))
    return replace(scenario, world=replace(scenario.world, vehicle=craft), autopilot=autopilot)


def _first_errors() -> Iterator[Row]:
    cruise = build_climb(CRUISE)
    x = cruise.initial
    for name, (words, field, off) in FIRST.items():
        changes = {field: getattr(x, field) + off}
        if field == "alpha":
            changes["theta"] = x.theta + off
        flown = fly_seeds(replace(cruise, initial=replace(x, **changes)), length=SURVIVED)
        back = abs(float(flown["law.h_error"][0, -1])) < 0.01 and abs(float(flown["law.V_error"][0, -1])) < 0.01
        note = LOW if name == "low" else ""
        yield reference_flag(f"first/{name}", f"cruise from {words}: back on the path at 80 s", back, PLACE, note=note)
