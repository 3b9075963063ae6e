"""Flights of the real vehicle, compared with a simulation that includes actuators, links, navigation and friction.

The thesis's model has no friction. One parameter, a viscous torque, was fitted here to one observation, the rate of
the spin. The text's other statements on the flights are checked with this torque. Results are medians over 200 seeds.
[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 6.2.2.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from studies.hovercraft2006._flights import (
    REST,
    UNITS,
    Settings,
    TruthSignals,
    draw_flights,
    first_seed,
    first_time,
    fly_real,
)
from trimtab.study import Row, band, direction, within

SECTION = "6.2.2"
PLACE = "[1] section 6.2.2"
TORQUE = 0.055
"""Viscous torque (N m s) with which the simulated vehicle spins as slowly as the real one."""
FRICTION: Settings = (("world.vehicle.friction.torque_viscous", str(TORQUE)),)
TURN: Settings = (
    *REST,
    ("initial.heading", str(1.5 * math.pi)),
    ("autopilot.law.target", str(0.5 * math.pi)),
    ("autopilot.law.wrapping", "none"),
)
"""Turn from 270° back to 90°, [1] figs. 6.25 and 6.26."""
HALF_TURNS: dict[str, tuple[str, Settings]] = {
    "bang-bang": ("heading-bang-bang", TURN),
    "proportional": ("heading-proportional", (*TURN, ("autopilot.law.form", "literal"))),
}
AGAINST = "Friction of this size contradicts the way in which J was measured, so it is off by default (errata)."


def rows() -> Iterator[Row]:
    """Yield the slow spin, and the effect of friction in yaw on the other flights."""
    yield from _spin()
    yield from _rest()
    yield from _straight()
    yield from _half_turn()


def _spin() -> Iterator[Row]:
    plain, slow = fly_real("spin"), fly_real("spin", settings=FRICTION)
    about: dict[str, Any] = {"tolerance": 0.1, "unit": "rad/s"}
    why = "The thesis's model has no friction. With friction (next row) the spin is as slow as observed."
    rate = _late_mean(plain, "yaw_rate")
    what = "yaw rate of the vehicle, 3 rad/s commanded"
    yield within("spin/rate", what, 1.75, rate, PLACE, must_hold=False, note=why, **about)
    rate = _late_mean(slow, "yaw_rate")
    what = f"yaw rate of the vehicle, 3 rad/s commanded, with {TORQUE:g} N m s of viscous torque"
    yield within("friction/spin", what, 1.75, rate, PLACE, basis="input", note=f"Fitted. {AGAINST}", **about)
    sway = _late_mean(slow, "sway_velocity")
    what = "sway velocity in the spin with viscous torque"
    yield direction("friction/sway", what, "small, negative", sway, PLACE, above=-0.1, below=-0.02, unit="m/s")
    times = [float(np.median(first_time(f.t, f["yaw_rate"] > 0.9 * _late_mean(f, "yaw_rate")))) for f in (slow, plain)]
    note = "With friction, 90 % of the slower spin is reached just as soon. Friction in yaw alone does not explain 2 s."
    yield within(
        "friction/spin-longer",
        "time to reach the spin, with friction minus without",
        2.0,
        times[0] - times[1],
        PLACE,
        tolerance=1.0,
        unit="s",
        basis="text",
        must_hold=False,
        note=note,
    )


def _rest() -> Iterator[Row]:
    stops = [
        float(np.median(first_time(f.t, np.abs(f["yaw_rate"]) < 0.32)))
        for f in (fly_real("zero-velocity", settings=FRICTION), fly_real("zero-velocity"))
    ]
    what = "time to stop turning, with friction minus without"
    yield direction("friction/stop", what, "stated", stops[0] - stops[1], PLACE, below=0.0, unit="s")


def _straight() -> Iterator[Row]:
    forward = [_late_mean(f, "surge_velocity") for f in (fly_real("forward", settings=FRICTION), fly_real("forward"))]
    what = "forward speed with friction divided by that without"
    note = "Speeds that differ by less than 3 % count as equal."
    yield band(
        "friction/forward",
        what,
        "stated",
        forward[0] / forward[1],
        PLACE,
        low=0.97,
        high=1.03,
        basis="text",
        note=note,
    )
    error = _late_mean(fly_real("reverse", settings=FRICTION), "surge_velocity") + 1.98 / 2.6
    note = "Friction in yaw gives no steady error. Drag would, but also in forward flight, where none was observed."
    what = "steady error of surge velocity in reverse"
    yield direction("reverse/error", what, "present", error, PLACE, above=0.03, unit="m/s", must_hold=False, note=note)


def _half_turn() -> Iterator[Row]:
    flights = {short: fly_real(name, settings=(*s, *FRICTION)) for short, (name, s) in HALF_TURNS.items()}
    times = {}
    for short, flown in flights.items():
        off = np.abs(flown["heading"] - 0.5 * np.pi)
        times[short] = float(np.median(first_time(flown.t, off < np.radians(5))))
    place = "[1] section 6.2.2, figs. 6.25 and 6.26"
    note = "Times that differ by less than 25 % count as similar."
    yield band(
        "heading/270-to-90",
        "turn from 270° to 90°: time to 5°, proportional divided by bang-bang",
        "similar",
        times["proportional"] / times["bang-bang"],
        place,
        low=0.75,
        high=1.25,
        basis="text",
        note=note,
    )


def _late_mean(flown: TruthSignals, signal: str) -> float:
    """Return the mean of a signal over the last third of a flight, as the median over runs."""
    return float(np.median(flown[signal][:, flown.t > flown.t[-1] * 2 / 3].mean(axis=1)))


def figures(folder: Path) -> Iterator[Path]:
    """Plot figures 6.21 to 6.27: each flight on the published model, and with friction in yaw."""
    flights: dict[str, tuple[str, Settings]] = {
        name: (name, ()) for name in ("zero-velocity", "forward", "reverse", "spin")
    }
    flights |= {f"270-to-90-{short}": run for short, run in HALF_TURNS.items()}
    for what, (name, settings) in flights.items():
        columns = {
            "model of the thesis, first seed": first_seed(fly_real(name, settings=settings)),
            f"with {TORQUE:g} N m s in yaw": first_seed(fly_real(name, settings=(*settings, *FRICTION))),
        }
        limits = {signal: dict.fromkeys(columns) for signal in UNITS if signal != "heading" or "270" in what}
        yield draw_flights(folder / f"hardware-{what}.png", f"[1] section 6.2.2: {what}", columns, limits)
