"""Simulated autopilot: the two heading algorithms, figures 6.11 and 6.12.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 6.1.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from studies.hovercraft2006._flights import (
    LITERAL,
    REST,
    draw_figure,
    first_time,
    fly_ideal,
    fly_random_starts,
    fly_real,
)
from trimtab.laws.heading import TURN
from trimtab.study import Row, band, direction, inside, within

SECTION = "6.1"
ARM = 0.32
TOLERANCE = np.pi / 180
FIG = "[1] fig. 6.12"
FORM = (("autopilot.law.form", "literal"),)
AXES = {  # signal: (ideal, real), the ends of the axes of fig. 6.12
    "surge_velocity": ((-0.15, 0.05), (-0.4, 0.3)),
    "sway_velocity": ((-0.2, 0.2), (-0.2, 0.5)),
    "yaw_rate": ((-1.0, 1.5), (-1.5, 1.5)),
    "heading": ((0.0, 1.5), (0.0, 2.5)),
}
UNITS = {"surge_velocity": "m/s", "sway_velocity": "m/s", "yaw_rate": "rad/s", "heading": "rad"}


def rows() -> Iterator[Row]:
    """How each algorithm ends, ideal; the axes of figure 6.12; figure 6.11."""
    yield from _bang_bang()
    yield from _proportional()
    yield from _comparison_rows()
    yield from _random_start_rows()
    yield from _axes()
    yield from _moving_start_rows()


def figures(folder: Path) -> Iterator[Path]:
    """Figures 6.11 (out of a slide) and 6.12 (from rest), both algorithms, the proportional one as published."""
    yield draw_figure("fig-6.11-bang-bang", "heading-bang-bang", folder)
    yield draw_figure("fig-6.11-proportional", "heading-proportional", folder, FORM)
    yield draw_figure("fig-6.12-bang-bang", "heading-bang-bang", folder, REST)
    yield draw_figure("fig-6.12-proportional", "heading-proportional", folder, LITERAL)


def _bang_bang() -> Iterator[Row]:
    log = fly_ideal("heading-bang-bang", REST)
    error = np.abs(log["law.heading_error"][log.t > 30]).mean()
    about: dict[str, Any] = {"basis": "reference"}
    yield band(
        "fig-6.12/bang-error",
        "ideal bang-bang, mean |error| after 30 s",
        0.0168,
        error,
        FIG,
        low=0.012,
        high=0.020,
        unit="rad",
        **about,
    )
    switches = float(log["law.switches"][-1])
    yield direction("fig-6.12/bang-chatters", "ideal bang-bang, switches in 35 s", "chatters", switches, FIG, above=400)
    sway = abs(log["truth.sway_velocity"][-1])
    yield within(
        "fig-6.12/bang-sway",
        "ideal bang-bang, last |sway velocity|",
        0.05,
        sway,
        FIG,
        tolerance=0.01,
        unit="m/s",
        **about,
    )
    rate = log["truth.yaw_rate"]
    for end, value, got in (("least", -0.679, rate.min()), ("greatest", 1.163, rate.max())):
        yield within(
            f"fig-6.12/bang-{end}-rate",
            f"ideal bang-bang, {end} yaw rate",
            value,
            got,
            FIG,
            relative=0.02,
            unit="rad/s",
            **about,
        )


def _proportional() -> Iterator[Row]:
    log = fly_ideal("heading-proportional", LITERAL)
    about: dict[str, Any] = {"basis": "reference"}
    error = abs(log["law.heading_error"][-1])
    note = "It ends at the bad limit point of a reference that stands still (errata)."
    yield band(
        "fig-6.12/prop-error",
        "ideal proportional, steady |error|",
        0.0684,
        error,
        FIG,
        low=0.055,
        high=0.085,
        unit="rad",
        note=note,
        **about,
    )
    slide = log["truth.sway_velocity"][-1] / (-ARM * log["law.spin_reference"][-1])
    yield within(
        "fig-6.12/prop-slide",
        "ideal proportional, last sway velocity over -d times its reference",
        1.0,
        slide,
        FIG,
        tolerance=0.02,
        note=note,
        **about,
    )


def _comparison_rows() -> Iterator[Row]:
    bang, prop = fly_ideal("heading-bang-bang", REST), fly_ideal("heading-proportional", LITERAL)
    times = [float(first_time(log.t, np.abs(log["law.heading_error"]) <= TOLERANCE)) for log in (bang, prop)]
    about: dict[str, Any] = {"basis": "reference", "tolerance": 0.1, "unit": "s"}
    yield within("fig-6.12/bang-time", "ideal bang-bang, first within 1°", 1.1, times[0], FIG, **about)
    yield within("fig-6.12/prop-time", "ideal proportional, first within 1°", 3.3, times[1], FIG, **about)
    yield direction(
        "fig-6.12/slower", "proportional over bang-bang time to 1°", "slower", times[1] / times[0], FIG, above=1
    )
    sway = [abs(log["truth.sway_velocity"][-1]) for log in (prop, bang)]
    yield direction(
        "fig-6.12/slides-less",
        "proportional over bang-bang last |sway velocity|",
        "closer to zero",
        sway[0] / sway[1],
        FIG,
        below=1,
    )


def _random_start_rows() -> Iterator[Row]:
    place = "[1] section 2.3.3, step 8"
    late = fly_random_starts("literal")
    error = np.degrees(np.abs(late["law.heading_error"]))
    still = np.abs(late["truth.yaw_rate"]).max(axis=1) < 0.05
    frozen = still & (late["law.mode"][:, -1] == TURN) & (error[:, -1] > 1)
    about: dict[str, Any] = {"basis": "reference", "note": "As published, from 200 random starts, at 50 to 60 s."}
    yield within(
        "heading/freezes",
        "as published: share of runs that stand still off the heading",
        0.98,
        frozen.mean(),
        place,
        tolerance=0.05,
        **about,
    )
    median, most = np.quantile(error[:, -1], (0.5, 0.95))
    about["unit"] = "deg"
    yield within("heading/freezes-at", "as published: median |error|", 16.0, median, place, tolerance=3.0, **about)
    yield within("heading/freezes-within", "as published: 95 % of |error|", 29.0, most, place, tolerance=3.0, **about)
    error = np.degrees(np.abs(fly_random_starts("floored")["law.heading_error"]))
    about["note"] = "The default form, which keeps the reference at 0.8 rad/s or more, from the same starts."
    yield within(
        "heading/floored", "floored: 95 % of |error|", 1.0, np.quantile(error, 0.95), place, tolerance=0.05, **about
    )


def _axes() -> Iterator[Row]:
    at = FIG + ", axis"
    for name, settings in (("heading-bang-bang", REST), ("heading-proportional", LITERAL)):
        short = name.removeprefix("heading-")
        log, flown = fly_ideal(name, settings), fly_real(name, settings=settings)
        for signal, (narrow, (low, high)) in AXES.items():
            words, y = signal.replace("_", " "), log[f"truth.{signal}"]
            ident = f"fig-6.12/{short}-{signal}"
            what = f"ideal {short}, range of {words}"
            yield inside(f"{ident}-ideal", what, narrow, (y.min(), y.max()), at, unit=UNITS[signal])
            runs = flown[signal]
            share = ((runs.min(axis=1) >= low) & (runs.max(axis=1) <= high)).mean()
            what = f"real {short}, share of runs with {words} in {low:g} … {high:g} {UNITS[signal]}"
            yield direction(f"{ident}-real", what, "the run shown is", share, at, above=0.05, basis="axis")


def _moving_start_rows() -> Iterator[Row]:
    place = "[1] fig. 6.11"
    note = "The first state is not printed; this one is reconstructed and not the only one that fits (errata)."
    about: dict[str, Any] = {"unit": "rad", "note": note}
    bang, prop = (
        fly_ideal(*run)["truth.heading"][-1] for run in (("heading-bang-bang",), ("heading-proportional", FORM))
    )
    yield within("fig-6.11/bang-bang", "ideal bang-bang, last heading", 5.0, bang, place, tolerance=0.1, **about)
    what = "ideal proportional, last heading, up to where 95 % of its runs freeze"
    yield within("fig-6.11/proportional", what, 5.0, prop, place, tolerance=np.radians(29.0), **about)
