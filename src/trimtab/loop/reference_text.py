"""Reference paths written as text, as after ``--reference``: parsing, and use in a scenario.

circle(radius=1.5, period=20 s)             parameters of the class Circle, with or without units
eight(length=5, width=150 cm)               parameters of the class FigureEight, with or without units
waypoints(0 0, 3 0, 3 3 0.3; speed=0.4)     north and east (m) of each way-point. An optional third number is the speed
                                            (m/s) on the leg that ends at this way-point.
places(0 s: 0 0, 2 s: 1 0, …)               time, north and east (m) of each of at least six positions. An optional
                                            heading (rad) must be written for all positions or for none.
path.csv                                    CSV file with columns time [s], north [m], east [m], heading [deg]
"""

import re
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.interfaces import Reference
from trimtab.core.quantity import Part, Quantity, declarations
from trimtab.core.record import Option, replace
from trimtab.core.reference import DEGREE, Circle, FigureEight, PiecewisePath, interpolate_path, pass_waypoints
from trimtab.core.suggestions import closest
from trimtab.core.time import parse_time, to_seconds
from trimtab.core.units import parse_amount
from trimtab.logs.measurements import MeasuredColumn, read_measurements
from trimtab.loop.checks import check_values
from trimtab.loop.scenario import Scenario

PART = "reference"
SPEED = 0.4
"""Default speed on the legs between way-points (m/s)."""
FEWEST = DEGREE + 1
"""Smallest number of timed positions that determine a path."""
FORMS = (
    "circle(radius=1.5, period=20 s)",
    "eight(length=5, width=1.5, period=30 s)",
    "waypoints(0 0, 3 0, 3 3; speed=0.4)",
    "places(0 s: 0 0, 4 s: 0.17 0, 8 s: 0.95 0, 12 s: 2.05 0, 16 s: 2.83 0, 20 s: 3 0)",
    "path.csv",
    "autopilot.law.PATH=steps(0 s: 1, 5 s: 2)",
)
LATER = tuple(0.25 * 2**k for k in range(15))
"""Times (s) at which the start of a path is searched for a first motion, which gives the direction of the path."""
COLUMNS = (
    MeasuredColumn("time", "s", "time at each position"),
    MeasuredColumn("north", "m", "north coordinate of each position"),
    MeasuredColumn("east", "m", "east coordinate of each position"),
    MeasuredColumn("heading", "rad", "desired heading", needed=False, usual="deg"),
)
SHAPES: Mapping[str, Any] = MappingProxyType({"circle": Circle, "eight": FigureEight})
_CALL = re.compile(r"\s*(?P<name>\w+)\s*(\((?P<inside>.*)\))?\s*", re.DOTALL)


def parse_reference(text: str) -> Any:
    """Return the reference path that a text describes. The text may also be the name of a CSV file.

    Raises: InputError for an invalid text. The message says what to type instead.
    """
    if text.endswith(".csv"):
        return _read_path(text)
    match = _CALL.fullmatch(text)
    parsers: dict[str, Callable[[str], Any]] = {"waypoints": _parse_waypoints, "places": _parse_places}
    name = match["name"] if match else ""
    if match and name in SHAPES:
        return _parse_shape(SHAPES[name], match["inside"] or "")
    if match and name in parsers and match["inside"]:
        return parsers[name](match["inside"])
    near = closest(name, [*SHAPES, *parsers], 1)
    fix = next((argument(PART, form) for form in FORMS if near and form.startswith(near[0])), argument(PART, FORMS[0]))
    hint = "; the name of a file must end in .csv" if re.fullmatch(r"\s*[^\s(]+\.\w+\s*", text) else ""
    raise InputError(argument_name(PART), f"{text!r} is not a reference path{hint}", choices=FORMS, fix=fix)


def plain_text(text: str) -> str:
    """Return the text of a reference path. The name of a file is replaced by the positions in the file, as text.
    Therefore a replay does not need the file.
    """
    if not text.endswith(".csv"):
        return text
    table = read_measurements(text, COLUMNS, series=True)
    headings = [f" {h!r}" for h in np.asarray(table["heading"]).tolist()] if "heading" in table else [""] * len(table)
    rows = zip(*(np.asarray(table[n]).tolist() for n in ("time", "north", "east")), headings, strict=True)
    return f"places({', '.join(f'{t!r}: {north!r} {east!r}{heading}' for t, north, east, heading in rows)})"


def with_reference(scenario: Scenario, text: str) -> Scenario:
    """Return the scenario with a new reference path for its law.

    The vehicle starts at rest at the start of the path, with the nose in the direction of the path, or at the path's
    heading if the path has headings.

    Raises: InputError for a law that cannot follow a reference.
    """
    law = scenario.autopilot.law
    if not isinstance(declarations(law).get("reference"), Part) or not isinstance(law.reference, Reference):
        problem = f"the law of {scenario.name}, {type(law).__name__}, cannot follow a path"
        fix = f"fly hovercraft/track with {argument(PART, text)}; to change a number: {argument(PART, FORMS[-1])}"
        raise InputError(argument_name(PART), problem, fix=fix)
    path = parse_reference(text)
    autopilot = replace(scenario.autopilot, law=replace(law, reference=path))
    arm = float(getattr(getattr(law, "model", None), "percussion_arm", 0.0))
    north, east, heading = start_pose(path, arm)
    initial = replace(scenario.initial, north=north, east=east, heading=heading)
    return replace(scenario, autopilot=autopilot, initial=initial)


def start_pose(path: Reference, arm: float) -> tuple[float, float, float]:
    """Return north (m), east (m) and heading (rad) of a craft at the start of a path.

    The heading is that of the path, or the direction of the path if the path has no headings. The point of the craft
    that is at the start of the path lies `arm` (m) ahead of the centre of mass.
    """
    start = path.at(0.0)
    first = np.asarray(start.place)
    way = np.zeros(2)
    for soon in LATER:
        way = np.asarray(path.at(soon).place) - first
        if np.hypot(*way) > 1e-3:
            break
    heading = float(start.heading) if start.has_heading else float(np.arctan2(way[1], way[0]))
    north, east = first - arm * np.array([np.cos(heading), np.sin(heading)])
    return float(north), float(east), heading


def _parse_shape(shape: Any, inside: str) -> Any:
    """Return the reference path of a shape with given parameters.

    shape: class of the path, Circle or FigureEight.
    inside: text between the brackets, e.g. ``radius=1.5, period=20 s``.
    """
    fields, declared = {}, declarations(shape)
    for item in filter(None, (piece.strip() for piece in inside.split(","))):
        name, equals, text = (word.strip() for word in item.partition("="))
        part = argument_name(PART, f"{shape.__name__}.{name}")
        if not equals or name not in declared:
            near = closest(name, declared, 1) or list(declared)
            fix = f"write e.g. {near[0]}={getattr(shape(), near[0])}"
            raise InputError(
                argument_name(PART), f"{item!r} is not a setting of {shape.__name__}", choices=declared, fix=fix
            )
        if name in fields:
            raise InputError(part, f"{name} is given twice", fix="write each setting once")
        if isinstance(declared[name], Option):
            if text not in ("true", "True", "false", "False"):
                raise InputError(part, f"{text!r} must be true or false", fix=f"{name}=true")
            fields[name] = text.lower() == "true"
            continue
        own = declared[name]
        assert isinstance(own, Quantity)
        fields[name] = parse_amount(part, text, own.unit)
    path = shape(**fields)
    try:
        check_values(path)
    except InputError as error:
        part, fix = (
            argument_name(PART, f"{shape.__name__}.{error.part}"),
            f"{error.part}={getattr(shape(), error.part)}",
        )
        raise InputError(part, error.problem, choices=error.choices, fix=f"write e.g. {fix}") from None
    return path


def _parse_waypoints(inside: str) -> PiecewisePath:
    """Return the path that a text of way-points describes, e.g. ``0 0, 3 0, 3 3 0.3; speed=0.4``."""
    points, _, rest = inside.partition(";")
    name, equals, text = (word.strip() for word in rest.partition("="))
    if rest.strip() and (name != "speed" or not equals):
        raise InputError(argument_name(PART), f"{rest.strip()!r} is not speed=NUMBER", fix=argument(PART, FORMS[2]))
    usual = _parse_finite(argument_name(PART, "speed"), text, "m/s") if equals else SPEED
    rows = [_parse_numbers(point, ("m", "m", "m/s"), FORMS[2]) for point in points.split(",")]
    speeds = [row[2] if len(row) == 3 else usual for row in rows[1:]]
    return pass_waypoints([row[:2] for row in rows], np.array(speeds))


def _parse_places(inside: str) -> PiecewisePath:
    """Return the path that a text of timed positions describes, e.g. ``0 s: 0 0, 2 s: 1 0``."""
    times, rows = [], []
    for item in inside.split(","):
        when, colon, what = item.partition(":")
        if not colon:
            raise InputError(
                argument_name(PART), f"{item.strip()!r} is not TIME: NORTH EAST", fix=argument(PART, FORMS[3])
            )
        times.append(float(to_seconds(parse_time(when))))
        if len(times) > 1 and times[-1] <= times[-2]:
            problem = f"time {times[-1]:g} s must be after {times[-2]:g} s, the time of the previous position"
            raise InputError(argument_name(PART), problem, fix="write the positions in rising order of time")
        rows.append(_parse_numbers(what, ("m", "m", "rad"), FORMS[3]))
    if len({len(row) for row in rows}) > 1:
        raise InputError(
            argument_name(PART),
            "some positions have a heading and some have none",
            fix="write a heading for each position, or for none",
        )
    places = np.array(rows)
    return _interpolate(times, places[:, :2], places[:, 2] if places.shape[1] == 3 else None)


def _read_path(file: str) -> PiecewisePath:
    table = read_measurements(file, COLUMNS, series=True)
    places = np.column_stack([table["north"], table["east"]])
    return _interpolate(table["time"], places, table.values.get("heading"))


def _interpolate(times: Any, places: Any, headings: Any) -> PiecewisePath:
    """Return the path through positions. From one position to the next, the heading turns by at most half a turn."""
    if len(places) < FEWEST:
        problem = f"a path through timed positions needs at least {FEWEST} of them, got {len(places)}"
        raise InputError(argument_name(PART), problem, fix=argument(PART, FORMS[3]))
    return interpolate_path(times, places, None if headings is None else np.unwrap(headings))


def _parse_numbers(text: str, units: tuple[str, str, str], form: str) -> list[float]:
    """Return two or three numbers, e.g. ``3 0`` or ``3m 0m 90deg``."""
    words = text.split()
    if len(words) not in (2, 3):
        problem = f"{text.strip()!r} must be 2 or 3 numbers with spaces between them, got {len(words)}"
        raise InputError(argument_name(PART), problem, fix=argument(PART, form))
    return [_parse_finite(argument_name(PART), word, unit) for word, unit in zip(words, units, strict=False)]


def _parse_finite(part: str, text: str, unit: str) -> float:
    number = parse_amount(part, text, unit)
    if not np.isfinite(number):
        raise InputError(part, f"{text} is not finite", fix=f"write a number, in {unit}")
    return number
