"""Internal dynamics: the bounded motion inside, and what each way to find it leaves of the altitude's error.

[1] takes the method from elsewhere and linearises; the exact bounded solution is held here against an independent
program. Errors are of the climb by 5000 ft and 1000 ft/s in closed loop, rms after 20 s.
[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eq. 7.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from studies.hypersonic2022._flights import LARGE, fly_climb
from trimtab.design.stable_inversion import bounded_residual
from trimtab.laws.path_command import FilteredClimb
from trimtab.scenarios.hypersonic._internal import SCALES, noncausal_table
from trimtab.study import Row, at_most, band, direction, same, within
from trimtab.vehicles.hypersonic import Hypersonic

SECTION = "eq. 7"
PLACE = "[1] eq. 7"
REFERENCE: dict[str, Any] = {"basis": "reference"}
AT = 30.0
WANTED = {
    "alpha": ("angle of attack", 0.0220153134, 5e-11, "rad"),
    "q": ("pitch rate", -9.409e-6, 5e-10, "rad/s"),
    "eta1": ("η1", 0.804015540, 5e-10, "(slug ft)^1/2"),
    "eta1_rate": ("η1'", -4.8789e-3, 5e-8, "(slug ft)^1/2/s"),
    "eta2": ("η2", 0.855558791, 5e-10, "(slug ft)^1/2"),
    "eta2_rate": ("η2'", -5.949e-4, 5e-8, "(slug ft)^1/2/s"),
}
"""Of the independent program at 30 s: words, value, half of its last digit, unit."""
DT, SECONDS = 0.005, 60.0
LINEAR = "The paper's: its practically vanishing error needs the exact form."


def rows() -> Iterator[Row]:
    """Command and bounded solution at 30 s, iteration, residual, ends, and errors in closed loop."""
    climb = FilteredClimb(dh=LARGE[0], dV=LARGE[1])
    _, report = noncausal_table(Hypersonic(), climb, SECONDS)
    yield from _values(climb, report)
    yield from _iteration(report)
    yield from _ends(report)
    yield from _closed_loop()


def _values(climb: FilteredClimb, report: Any) -> Iterator[Row]:
    place, at = f"{PLACE}, +5000 ft, +1000 ft/s, at 30 s", climb.at(AT)
    for name, words, want, got, unit in (
        ("h", "commanded altitude", 85328.212272, at.h, "ft"),
        ("V", "commanded speed", 7893.233969, at.V, "ft/s"),
    ):
        yield within(f"command/{name}", words, want, got, place, tolerance=5e-7, unit=unit, **REFERENCE)
    zeta = report.solution.zeta[round(AT / DT)]
    for (name, (words, want, digit, unit)), got in zip(WANTED.items(), zeta, strict=True):
        yield within(
            f"at-30-s/{name}", f"bounded solution, {words}", want, got, place, tolerance=digit, unit=unit, **REFERENCE
        )


def _iteration(report: Any) -> Iterator[Row]:
    changes = np.array(report.solution.changes)
    count = len(changes)
    yield band("iteration/count", "iterations", "5-7", count, PLACE, low=5, high=7, **REFERENCE)
    first = "change of the first one, in sizes of the states"
    yield within("iteration/first", first, 3e-2, changes[0], PLACE, tolerance=5e-3, **REFERENCE)
    slowest = float((changes[1:] / changes[:-1]).max())
    note = "Changes: " + ", ".join(f"{c:.1e}" for c in changes) + "."
    what = "change of one over that of the one before, largest"
    yield at_most("iteration/ratio", what, "about 0.02", slowest, PLACE, high=0.1, note=note, **REFERENCE)
    last = "change of the last one"
    yield at_most("iteration/last", last, 1e-10, changes[-1], PLACE, high=1e-10, **REFERENCE)


def _ends(report: Any) -> Iterator[Row]:
    worst = float(np.abs(bounded_residual(report.solution, DT)).max())
    what = "central differences against the right-hand side, largest of any component"
    yield at_most("solution/residual", what, 4e-6, worst, PLACE, high=4e-6, **REFERENCE)
    what = "the same in sizes of the states"
    yield at_most("solution/scaled", what, 1e-5, report.residual, PLACE, high=1e-5, unit="1/s", **REFERENCE)
    what = "start of the solution against the trim there, in sizes of the states"
    yield at_most("solution/start", what, 0.0, report.left, PLACE, high=1e-9, **REFERENCE)
    _, done = noncausal_table(Hypersonic(), FilteredClimb(dh=200.0, dV=40.0, wh=0.25, wV=0.25), 150.0, dt=0.01)
    what = "end of the solution against the trim there, of a climb that is over"
    yield at_most("solution/end", what, 0.0, done.right, PLACE, high=1e-8, **REFERENCE)
    unstable = report.solution.unstable
    yield same("solution/unstable", "modes solved backward in time", 1, int(unstable), PLACE, **REFERENCE)
    early = np.abs(report.solution.zeta[[800, 900], 0] - report.solution.zeta[0, 0]) / SCALES[0]
    growth = float(np.log(early[1] / early[0]) / (100 * DT))
    what = "growth of the angle of attack before the climb begins"
    yield within("solution/early", what, 3.2894, growth, PLACE, relative=1e-3, unit="1/s", **REFERENCE)


def _closed_loop() -> Iterator[Row]:
    place = "[1] simulation, +5000 ft, +1000 ft/s"
    exact = fly_climb(LARGE, filter="printed")
    flown = {"noncausal": exact} | {f: fly_climb(LARGE, internal=f) for f in ("quasi-static", "linear", "sylvester")}
    h = {name: float(f.rms("law.h_error")[0]) for name, f in flown.items()}
    about: dict[str, Any] = {"unit": "ft", "basis": "reference"}
    words = "altitude's error, rms after 20 s, internal states"
    yield within("tracking/exact", f"{words} exact", 0.0037, h["noncausal"], place, tolerance=1e-4, **about)
    yield within("tracking/still", f"{words} quasi-static", 0.65, h["quasi-static"], place, tolerance=0.01, **about)
    still = float(flown["quasi-static"].peak("law.h_error")[0])
    yield within("tracking/still-most", "its largest", 1.6, still, place, tolerance=0.05, **about)
    yield within("tracking/linear", f"{words} linear", 10.5, h["linear"], place, tolerance=0.1, note=LINEAR, **about)
    end = float(flown["linear"].final_mean("law.h_error")[0])
    yield within("tracking/linear-end", "its end", -11.4, end, place, tolerance=0.1, **about)
    note = "The causal form; after the step it is the bounded linear solution."
    yield within(
        "tracking/causal",
        f"{words} linear by Sylvester's equation",
        h["linear"],
        h["sylvester"],
        place,
        relative=0.01,
        note=note,
        **about,
    )
    steady = {name: abs(float(flown[name].final_mean("law.h_error")[0])) for name in ("noncausal", "linear")}
    claim = "[1] simulation: the error of altitude vanishes"
    exactly, nearly = "altitude's error at the end, internal states exact", "altitude's error at the end, linear"
    yield direction("tracking/claim", exactly, "vanishes", steady["noncausal"], claim, below=0.01, unit="ft")
    yield direction(
        "tracking/claim-linear",
        nearly,
        "vanishes",
        steady["linear"],
        claim,
        below=0.01,
        unit="ft",
        must_hold=False,
        note=LINEAR,
    )
