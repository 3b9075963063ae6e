"""Simulated autopilot: the two heading algorithms, figures 6.11 and 6.12.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, sections 2.3, 6.1.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from studies.hovercraft2006._flights import (
    LITERAL,
    MOVING,
    REST,
    UNITS,
    Settings,
    draw_flights,
    first_seed,
    first_time,
    fly_ideal,
    fly_random_starts,
    fly_real,
)
from studies.hovercraft2006._source import reference_row
from trimtab.laws.heading import TURN
from trimtab.study import Row, direction, inside, overlaps

SECTION = "6.1"
TOLERANCE = np.pi / 180
"""Tolerance of the heading (rad): [1] section 6.1.6."""
FIG = "[1] fig. 6.12"
FORM = (*MOVING, ("autopilot.law.form", "literal"))
AXES = {
    "surge_velocity": ((-0.15, 0.05), (-0.4, 0.3)),
    "sway_velocity": ((-0.2, 0.2), (-0.2, 0.5)),
    "yaw_rate": ((-1.0, 1.5), (-1.5, 1.5)),
    "heading": ((0.0, 1.5), (0.0, 2.5)),
}
"""Signal -> limits of its axis in fig. 6.12, ideal and real."""
TICKS = {"surge_velocity": (0.05, 0.1), "sway_velocity": (0.1, 0.1), "yaw_rate": (0.5, 0.5), "heading": (0.5, 0.5)}
"""Signal -> tick spacing of these axes, ideal and real.

Extremes of both algorithms lie within one tick of the limits.
"""
LAWS: dict[str, tuple[str, Settings]] = {
    "bang-bang": ("heading-bang-bang", REST),
    "proportional": ("heading-proportional", LITERAL),
}


def rows() -> Iterator[Row]:
    """Yield the final state of each algorithm without faults, the axes of figure 6.12, and figure 6.11."""
    yield from _bang_bang()
    yield from _proportional()
    yield from _comparison_rows()
    yield from _random_start_rows()
    yield from _axes()
    yield from _moving_start_rows()


def figures(folder: Path) -> Iterator[Path]:
    """Plot figures 6.11 (start in a slide) and 6.12 (start at rest) with both algorithms as published."""
    moving = {"bang-bang": ("heading-bang-bang", MOVING), "proportional": ("heading-proportional", FORM)}
    for figure, laws in (("fig-6.11", moving), ("fig-6.12", LAWS)):
        for short, (name, settings) in laws.items():
            log, words = fly_ideal(name, settings), ("ideal", "real, first seed")
            t, real = first_seed(fly_real(name, settings=settings))
            if figure == "fig-6.11":
                real["truth.heading"] = np.mod(real["truth.heading"], 2 * np.pi)  # as the navigation reports it
            flights = dict(zip(words, ((log.t, log), (t, real)), strict=True))
            limits: dict[str, Any] = {s: dict(zip(words, ends, strict=True)) for s, ends in AXES.items()}
            if figure == "fig-6.11":
                limits = {s: dict.fromkeys(words) for s in AXES} | {"heading": {words[0]: None, words[1]: (0, 7)}}
            title = f"[1] {figure.replace('-', '. ')}: {short}"
            yield draw_flights(folder / f"{figure}-{short}.png", title, flights, limits)


def _bang_bang() -> Iterator[Row]:
    log = fly_ideal("heading-bang-bang", REST)
    rad: dict[str, Any] = {"unit": "rad", "tolerance": 1e-4}
    error = np.abs(log["law.heading_error"][log.t > 30]).mean()
    yield reference_row("fig-6.12/bang-error", "ideal bang-bang, mean |error| after 30 s", error, FIG, **rad)
    switches = float(log["law.switches"][log.t <= 1.5].max()), float(log["law.switches"][-1])
    what = "ideal bang-bang, switches per second after the first 1.5 s"
    often = (switches[1] - switches[0]) / (log.t[-1] - 1.5)
    yield direction("fig-6.12/bang-chatters", what, "chatters", often, FIG, above=10.0, unit="1/s")
    sway = abs(log["truth.sway_velocity"][-1])
    what = "ideal bang-bang, last |sway velocity|"
    yield reference_row("fig-6.12/bang-sway", what, sway, FIG, tolerance=5e-4, unit="m/s")
    rate = log["truth.yaw_rate"]
    for end, value in (("least", rate.min()), ("greatest", rate.max())):
        what = f"ideal bang-bang, {end} yaw rate"
        yield reference_row(f"fig-6.12/bang-{end}-rate", what, value, FIG, tolerance=1e-4, unit="rad/s")


def _proportional() -> Iterator[Row]:
    log = fly_ideal("heading-proportional", LITERAL)
    note = "The flight ends at the bad limit point, where the reference stays constant (errata)."
    error, sway = abs(log["law.heading_error"][-1]), abs(log["truth.sway_velocity"][-1])
    what = "ideal proportional, steady |error|"
    yield reference_row("fig-6.12/prop-error", what, error, FIG, tolerance=1e-4, unit="rad", note=note)
    what = "ideal proportional, last |sway velocity|"
    yield reference_row("fig-6.12/prop-sway", what, sway, FIG, tolerance=1e-4, unit="m/s", note=note)


def _comparison_rows() -> Iterator[Row]:
    bang, prop = fly_ideal("heading-bang-bang", REST), fly_ideal("heading-proportional", LITERAL)
    times = [float(first_time(log.t, np.abs(log["law.heading_error"]) <= TOLERANCE)) for log in (bang, prop)]
    about: dict[str, Any] = {"tolerance": 2e-3, "unit": "s"}
    yield reference_row("fig-6.12/bang-time", "ideal bang-bang, first within 1°", times[0], FIG, **about)
    yield reference_row("fig-6.12/prop-time", "ideal proportional, first within 1°", times[1], FIG, **about)
    yield direction(
        "fig-6.12/slower", "time to 1°, proportional divided by bang-bang", "stated", times[1] / times[0], FIG, above=1
    )
    sway = [abs(log["truth.sway_velocity"][-1]) for log in (prop, bang)]
    yield direction(
        "fig-6.12/slides-less",
        "last |sway velocity|, proportional divided by bang-bang",
        "closer to zero",
        sway[0] / sway[1],
        FIG,
        below=1,
    )


def _random_start_rows() -> Iterator[Row]:
    place = "[1] section 2.3, step 8 of the proportional algorithm"
    late = fly_random_starts("literal")
    error = np.degrees(np.abs(late["law.heading_error"]))
    still = np.abs(late["truth.yaw_rate"]).max(axis=1) < 0.05
    frozen = still & (late["law.mode"][:, -1] == TURN) & (error[:, -1] > 1)
    about: dict[str, Any] = {"note": "Law as published, from 200 random starts, evaluated at 50 to 60 s."}
    what = "as published: share of runs that stop away from the target heading"
    yield reference_row("heading/freezes", what, frozen.mean(), place, tolerance=0.05, **about)
    median, most = np.quantile(error[:, -1], (0.5, 0.95))
    about |= {"unit": "deg", "tolerance": 3.0}
    yield reference_row("heading/freezes-at", "as published: median |error|", median, place, **about)
    yield reference_row("heading/freezes-within", "as published: 95 % of |error|", most, place, **about)


def _axes() -> Iterator[Row]:
    ideal = [fly_ideal(name, settings) for name, settings in LAWS.values()]
    real = [fly_real(name, settings=settings) for name, settings in LAWS.values()]
    for signal, both in AXES.items():
        for side, (low, high), tick in zip(("ideal", "real"), both, TICKS[signal], strict=True):
            if side == "ideal":
                y = np.concatenate([log[f"truth.{signal}"] for log in ideal])[None]
            else:
                y = np.concatenate([flown[signal] for flown in real], axis=1)
            ends = {"least": (y.min(axis=1), (low, low + tick)), "greatest": (y.max(axis=1), (high - tick, high))}
            if signal == "heading":
                del ends["least"]  # the initial heading
            if (side, signal) == ("real", "sway_velocity"):
                del ends["least"]  # also met by every perturbed vehicle
            for end, (values, at) in ends.items():
                yield _axis_end_row(side, end, signal, values, at)


def _axis_end_row(side: str, end: str, signal: str, values: Any, at: tuple[float, float]) -> Row:
    about: dict[str, Any] = {"unit": UNITS[signal]}
    if (side, end, signal) == ("ideal", "greatest", "surge_velocity"):
        note = "No ideal run ever moves forward, whatever the gains; the author may have set the axis by hand."
        about |= {"must_hold": False, "note": note}
        at = 1e-3, at[1]
    if (side, end, signal) == ("real", "greatest", "sway_velocity"):
        about |= {"must_hold": False, "note": "The runs slide a third less to starboard than the axis shows."}
    of = "2 … 98 % of runs" if side == "real" else "of both algorithms"
    what = f"{side}, {end} {signal.replace('_', ' ')}, {of}"
    pair = np.quantile(values, (0.02, 0.98))
    return overlaps(f"fig-6.12/axis-{side}-{end}-{signal}", what, at, pair, f"{FIG}, axis", **about)


def _moving_start_rows() -> Iterator[Row]:
    place = "[1] fig. 6.11"
    note = "The initial state is not printed. This one is reconstructed, and others fit as well (errata)."
    circles = (
        "The unwrapped true heading turns one full circle more. The figure may show the heading from the navigation, "
        "which is below 2 pi by definition."
    )
    for short, run in (("bang-bang", ("heading-bang-bang", MOVING)), ("proportional", ("heading-proportional", FORM))):
        last = fly_ideal(*run)["truth.heading"][-1]
        about: dict[str, Any] = {"unit": "rad", "note": note, "tolerance": 2e-3}
        yield reference_row(f"fig-6.11/{short}", f"ideal {short}, last heading", last, place, **about)
        flown = fly_real(run[0], settings=run[1])["heading"]
        what = f"real {short}, range of heading, median of runs"
        middle = np.median(flown.min(axis=1)), np.median(flown.max(axis=1))
        about = {"unit": "rad", "must_hold": False, "note": circles}
        yield inside(f"fig-6.11/{short}-axis", what, (0.0, 7.0), middle, f"{place}, axis", **about)
