"""Internal dynamics: the bounded internal motion, and the altitude error with each method to find it.

[1] takes the method from other work and linearises. The exact bounded solution is compared here with an oracle.
Errors are rms values after 20 s of the closed-loop climb by 5000 ft and 1000 ft/s.
[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eq. 7.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from studies.hypersonic2022._flights import FLIGHT_DIGITS, LARGE, fly_climb
from studies.hypersonic2022._oracle import reference
from trimtab.design.stable_inversion import bounded_residual
from trimtab.laws.path_command import FilteredClimb
from trimtab.scenarios.hypersonic._internal import SCALES, noncausal_table
from trimtab.study import Row, at_most, band, direction, within
from trimtab.vehicles.hypersonic import Hypersonic

SECTION = "eq. 7"
PLACE = "[1] eq. 7"
OWN: Any = {"basis": "own"}
AT = 30.0
WANTED = {
    "alpha": ("angle of attack", "rad"),
    "q": ("pitch rate", "rad/s"),
    "eta1": ("η1", "(slug ft)^1/2"),
    "eta1_rate": ("η1'", "(slug ft)^1/2/s"),
    "eta2": ("η2", "(slug ft)^1/2"),
    "eta2_rate": ("η2'", "(slug ft)^1/2/s"),
}
"""Quantities compared at AT, and their units."""
DT, SECONDS = 0.005, 60.0
LINEAR = "The paper uses this form, but only the exact form gives the practically vanishing error that it reports."


def rows() -> Iterator[Row]:
    """Yield rows on command and solution at 30 s, iteration, residual, ends of the solution, and closed-loop errors."""
    climb = FilteredClimb(dh=LARGE[0], dV=LARGE[1])
    _, report = noncausal_table(Hypersonic(), climb, SECONDS)
    yield from _values(climb, report)
    yield from _iteration(report)
    yield from _ends(report)
    yield from _closed_loop()


def _values(climb: FilteredClimb, report: Any) -> Iterator[Row]:
    place, at = f"{PLACE}, +5000 ft, +1000 ft/s, at 30 s", climb.at(AT)
    for name, words, got, unit in (("h", "commanded altitude", at.h, "ft"), ("V", "commanded speed", at.V, "ft/s")):
        yield reference(f"command/{name}", words, got, place, unit=unit, relative=1e-11)
    zeta = report.solution.zeta[round(AT / DT)]
    for (name, (words, unit)), got, size in zip(WANTED.items(), zeta, SCALES, strict=True):
        what, tolerance = f"bounded solution, {words}", 1e-8 * float(size)
        yield reference(f"at-30-s/{name}", what, got, place, tolerance=tolerance, unit=unit)


def _iteration(report: Any) -> Iterator[Row]:
    changes = np.array(report.solution.changes)
    count = len(changes)
    note = "Changes: " + ", ".join(f"{c:.1e}" for c in changes) + "."
    yield band("iteration/count", "number of iterations", "5-7", count, PLACE, low=5, high=7, note=note, **OWN)
    first = "change in the first iteration, relative to the states' sizes"
    yield within("iteration/first", first, 3e-2, changes[0], PLACE, tolerance=5e-3, **OWN)
    last = "change in the last iteration, relative to the states' sizes"
    yield at_most("iteration/last", last, 1e-10, changes[-1], PLACE, high=1e-10, **OWN)


def _ends(report: Any) -> Iterator[Row]:
    worst = float(np.abs(bounded_residual(report.solution, DT)).max())
    what = "central differences against the right-hand side, largest of any component"
    yield at_most("solution/residual", what, 4e-6, worst, PLACE, high=4e-6, **OWN)
    what = "central differences against the right-hand side, relative to the states' sizes"
    yield at_most("solution/scaled", what, 1e-5, report.residual, PLACE, high=1e-5, unit="1/s", **OWN)
    what = "start of the solution minus the trim there, relative to the states' sizes"
    yield at_most("solution/start", what, 0.0, report.left, PLACE, high=1e-9, **OWN)
    _, done = noncausal_table(Hypersonic(), FilteredClimb(dh=200.0, dV=40.0, wh=0.25, wV=0.25), 150.0, dt=0.01)
    what = "end of the solution minus the trim there, for a completed climb"
    yield at_most("solution/end", what, 0.0, done.right, PLACE, high=1e-8, **OWN)
    early = np.abs(report.solution.zeta[[800, 900], 0] - report.solution.zeta[0, 0]) / SCALES[0]
    growth = float(np.log(early[1] / early[0]) / (100 * DT))
    what = "growth of the angle of attack before the climb begins"
    yield reference("solution/early", what, growth, PLACE, name="internal/parker", relative=1e-5, unit="1/s")


def _closed_loop() -> Iterator[Row]:
    place = "[1] simulation, +5000 ft, +1000 ft/s"
    exact = fly_climb(LARGE, filter="printed")
    flown = {"noncausal": exact} | {f: fly_climb(LARGE, internal=f) for f in ("quasi-static", "linear", "sylvester")}
    h = {name: float(f.rms("law.h_error")[0]) for name, f in flown.items()}
    about: Any = {"unit": "ft", "relative": FLIGHT_DIGITS}
    words = "altitude's error, rms after 20 s, internal states"
    yield reference("tracking/exact", f"{words} exact", h["noncausal"], place, name="nominal/5000/h", **about)
    name = "tracking/quasi-static"
    yield reference(f"{name}/h", f"{words} quasi-static", h["quasi-static"], place, **about)
    still = float(flown["quasi-static"].peak("law.h_error")[0])
    yield reference(f"{name}/peak", "largest error of h, internal states quasi-static", still, place, **about)
    about |= {"note": LINEAR}
    yield reference("tracking/linear/h", f"{words} linear", h["linear"], place, **about)
    end = float(flown["linear"].final_mean("law.h_error")[0])
    yield reference(
        "tracking/linear/end", "mean error of h over the last 10 s, internal states linear", end, place, **about
    )
    note, what = "The causal form equals the bounded linear solution after the step.", "linear by Sylvester's equation"
    own: Any = {"relative": 0.01, "note": note, "unit": "ft", "basis": "own"}
    yield within("tracking/causal", f"{words} {what}", h["linear"], h["sylvester"], place, **own)
    steady = {name: abs(float(flown[name].final_mean("law.h_error")[0])) for name in ("noncausal", "linear")}
    claim = "[1] simulation: the error of altitude vanishes"
    exactly, nearly = (
        "altitude's error at the end, internal states exact",
        "altitude's error at the end, internal states linear",
    )
    yield direction("tracking/claim", exactly, "stated", steady["noncausal"], claim, below=0.01, unit="ft")
    yield direction(
        "tracking/claim-linear",
        nearly,
        "stated",
        steady["linear"],
        claim,
        below=0.01,
        unit="ft",
        must_hold=False,
        note=LINEAR,
    )
