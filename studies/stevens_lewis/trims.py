"""Trims of the F-16: straight and level with three positions of the centre of mass, a turn, and a pull-up.

All trims are at 502 ft/s and sea level. The turn is level and without side force, at 0.3 rad/s. The pull-up passes
through level flight at 0.3 rad/s.
"""

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any, NamedTuple

from trimtab.core.record import replace
from trimtab.core.rotation import DEG
from trimtab.design.model import model_of_vehicle
from trimtab.design.trim import Trim, trim
from trimtab.study import Row, within
from trimtab.vehicles.f16 import F16Controls
from trimtab.vehicles.f16_flat_earth import F16FlatEarth, F16State
from trimtab.vehicles.imperial import FOOT

SECTION = "table 3.6-3"
LEVEL = ("alpha", "pitch", "power", "elevator", "throttle")
PULL_UP = (*LEVEL, "beta", "aileron", "rudder")
TURN = (*PULL_UP, "roll", "roll_rate", "pitch_rate", "yaw_rate")


class TrimCase(NamedTuple):
    """Printed trim.

    title: description.  centre: centre of mass (chords).  free: unknowns.  rates: required derivatives.
    pitch_rate: rad/s.

    printed: name -> number of [1], with its figures; angles in rad, surfaces in degrees.
    """

    title: str
    centre: float
    free: tuple[str, ...]
    rates: Mapping[str, float]
    pitch_rate: float
    printed: Mapping[str, str]


CASES = {
    "nominal": TrimCase(
        "level, centre at 0.35", 0.35, LEVEL, {}, 0.0, {"alpha": "0.03691", "throttle": "0.1385", "elevator": "-0.7588"}
    ),
    "forward": TrimCase(
        "level, centre at 0.30", 0.30, LEVEL, {}, 0.0, {"alpha": "0.03936", "throttle": "0.1485", "elevator": "-1.931"}
    ),
    "aft": TrimCase(
        "level, centre at 0.38",
        0.38,
        LEVEL,
        {},
        0.0,
        {"alpha": "0.03544", "throttle": "0.1325", "elevator": "-0.05590"},
    ),
    "turn": TrimCase(
        "turn at 0.3 rad/s, centre at 0.30",
        0.30,
        TURN,
        {"yaw": 0.3},
        0.0,
        {
            "alpha": "0.2485",
            "roll": "1.367",
            "pitch": "0.05185",
            "roll_rate": "-0.0155",
            "pitch_rate": "0.2934",
            "yaw_rate": "0.06071",
            "throttle": "0.8499",
            "elevator": "-6.256",
            "aileron": "0.09891",
            "rudder": "-0.4218",
        },
    ),
    "pull-up": TrimCase(
        "pull-up, centre at 0.30",
        0.30,
        PULL_UP,
        {"pitch": 0.3},
        0.3,
        {"alpha": "0.3006", "throttle": "1.023", "elevator": "-7.082", "rudder": "0.01655"},
    ),
}
FIGURES = 2.5e-4
"""Relative tolerance of a search that stops before rounding error. Half of the last printed digit is added."""
OPEN = {
    ("turn", "aileron"): "Off by 0.005 degrees, not explained. The residuals of the computed trim are 1e-10.",
    ("turn", "rudder"): "Off by 0.0007 degrees, not explained.",
    ("pull-up", "rudder"): "Off by 0.00002 degrees, not explained.",
}
SURFACES = ("elevator", "aileron", "rudder")
UNITS = {"alpha": "rad", "roll": "rad", "pitch": "rad", "throttle": "1"} | dict.fromkeys(SURFACES, "deg")


@cache
def find_trim(name: str) -> Trim:
    """Return the trim of a case."""
    case = CASES[name]
    craft = replace(F16FlatEarth(), centre=case.centre)
    x = replace(F16State(*[0.0] * 13), speed=502 * FOOT, alpha=0.1, pitch=0.1, power=0.3, pitch_rate=case.pitch_rate)
    turns = "roll" in case.free
    if turns:
        x = replace(x, alpha=0.24, roll=1.37, pitch=0.05, pitch_rate=0.29, yaw_rate=0.06, power=0.6)
    wanted: dict[str, Any] = {"path": lambda x, u: x.pitch - x.alpha}
    if turns:
        wanted = {"side": lambda x, u: craft.loads(x, u).wrench.force[1] / craft.mass}
    model = model_of_vehicle(craft, x, F16Controls(-0.05, 0.0, 0.0, 0.5), outputs=wanted)
    return trim(
        model,
        free=case.free,
        derivatives=case.rates,
        loose=["north", "east"],
        outputs=dict.fromkeys(wanted, 0.0),
    ).require_trim()


def rows() -> Iterator[Row]:
    """Yield the printed numbers of each trim, except angles that are zero."""
    for name, case in CASES.items():
        level = find_trim(name)
        states, inputs = F16State.__dataclass_fields__, F16Controls.__dataclass_fields__
        values = dict(zip((*states, *inputs), (*level.x.tolist(), *level.u.tolist()), strict=True))
        for what, text in case.printed.items():
            yield within(
                f"{name}/{what}",
                f"{case.title}: {what.replace('_', ' ')}",
                float(text),
                values[what] / DEG if what in SURFACES else values[what],
                "[1] table 3.6-3",
                tolerance=0.5 * 10.0 ** -len(text.partition(".")[2]),
                relative=FIGURES,
                unit=UNITS.get(what, "rad/s"),
                must_hold=(name, what) not in OPEN,
                note=OPEN.get((name, what), ""),
            )
