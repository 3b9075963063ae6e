"""Floor with obstacles: distance of a point from the nearest obstacle, and the file that describes the floor.

[floor]                              limits in metres, in the world frame W
north = [-4, 4]
east = [-4, 4]
[craft]
radius = 0.4                         radius of a circle about the centre of mass that encloses the craft
[start]
north = -3
east = -3
heading = "90 deg"                   optional; a number is in radians; default: the initial direction of the route
[goal]
north = 3
east = 3
[[circle]]
north = 0
east = 0
radius = 0.8
[[polygon]]
corners = [[1, 1], [2, 1], [2, 2]]
"""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.suggestions import closest
from trimtab.core.units import parse_amount
from trimtab.core.user_file import read_user_text

SECTIONS = {
    "floor": ("north", "east"),
    "craft": ("radius",),
    "start": ("north", "east", "heading"),
    "goal": ("north", "east"),
    "circle": ("north", "east", "radius"),
    "polygon": ("corners",),
}
"""Sections of a file -> settings of the section."""
FIX = """write e.g.
[floor]
north = [-4, 4]
east = [-4, 4]
[craft]
radius = 0.4
[start]
north = -3
east = -3
[goal]
north = 3
east = 3
[[circle]]
north = 0
east = 0
radius = 0.8"""


class ObstacleFloor(NamedTuple):
    """Rectangular floor with obstacles (m, in W). north, east: limits (from, to).  circles: (n, 3), north, east,
    radius. polygons: each (k, 2), corners in clockwise or anticlockwise order.
    """

    north: tuple[float, float]
    east: tuple[float, float]
    circles: Any
    polygons: tuple[Any, ...] = ()

    def clearance(self, places: Any) -> Any:
        """Return the distance (n,) of points (n, 2) from the nearest obstacle or edge of the floor. The distance is
        negative inside an obstacle or outside the floor."""
        p = np.asarray(places, np.float64)
        edges = [p[:, 0] - self.north[0], self.north[1] - p[:, 0], p[:, 1] - self.east[0], self.east[1] - p[:, 1]]
        circles = [np.hypot(p[:, 0] - n, p[:, 1] - e) - r for n, e, r in np.reshape(self.circles, (-1, 3))]
        return np.min([*edges, *circles, *(_polygon_distance(c, p) for c in self.polygons)], axis=0)


class PlanTask(NamedTuple):
    """Planning task: start and goal (m, W), the floor, and the radius of the craft (m).

    heading: heading of the nose at the start (rad); None for the initial direction of the route.
    """

    floor: ObstacleFloor
    start: tuple[float, float]
    goal: tuple[float, float]
    radius: float
    heading: float | None = None


def read_task(path: str | Path) -> PlanTask:
    """Return the planning task described by a file.

    Raises: InputError if the file cannot be read, if a section or a value is missing, if a section is unknown, or if a
    value is not valid. The message contains an example of a correct text.
    """
    part = str(path)
    try:
        content = tomllib.loads(read_user_text(path))
    except FileNotFoundError:
        raise InputError(part, "the file does not exist", fix=FIX) from None
    except OSError as error:
        raise InputError(part, f"cannot be read: {error.strerror or error}", fix=FIX) from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(part, f"is not valid TOML: {error}", fix=FIX) from None
    return parse_task(content, part)


def parse_task(content: Mapping[str, Any], part: str = "plan") -> PlanTask:
    """Return the planning task described by a file's content; raise InputError if the content is not valid."""
    for name in content:
        if name not in SECTIONS:
            near = closest(name, SECTIONS, 1) or list(SECTIONS)
            raise InputError(part, f"unknown section [{name}]", choices=SECTIONS, fix=f"[{near[0]}]")
    floor = ObstacleFloor(
        north=_span(content, part, "north"),
        east=_span(content, part, "east"),
        circles=np.array([_circle(c, where) for where, c in _obstacles(content, part, "circle")]),
        polygons=tuple(_corners(c, where) for where, c in _obstacles(content, part, "polygon")),
    )
    start, goal, craft = (_section(content, part, name) for name in ("start", "goal", "craft"))
    heading = start.get("heading")
    return PlanTask(
        floor=floor,
        start=(_number(start, f"{part} [start]", "north"), _number(start, f"{part} [start]", "east")),
        goal=(_number(goal, f"{part} [goal]", "north"), _number(goal, f"{part} [goal]", "east")),
        radius=_positive(craft, f"{part} [craft]", "radius"),
        heading=None if heading is None else _angle(heading, f"{part} [start] heading"),
    )


def _section(content: Mapping[str, Any], part: str, name: str) -> Mapping[str, Any]:
    section = content.get(name)
    if not isinstance(section, Mapping):
        raise InputError(part, f"[{name}] is missing", fix=FIX)
    _check_keys(section, f"{part} [{name}]", SECTIONS[name])
    return section


def _check_keys(section: Mapping[str, Any], part: str, known: tuple[str, ...]) -> None:
    """Raise InputError for a setting that is not known."""
    for key in section:
        if key not in known:
            raise InputError(part, f"unknown setting {key!r}", choices=known, fix=(closest(key, known, 1) or known)[0])


def _obstacles(content: Mapping[str, Any], part: str, name: str) -> list[tuple[str, Mapping[str, Any]]]:
    """Return each obstacle of a kind, after its name for error messages."""
    found: Any = content.get(name, [])
    if not isinstance(found, list) or not all(isinstance(one, Mapping) for one in found):
        raise InputError(part, f"[{name}] must be a list of sections, one for each {name}", fix=f"write [[{name}]]")
    named = [(f"{part} [[{name}]] {k + 1}", one) for k, one in enumerate(found)]
    for where, one in named:
        _check_keys(one, where, SECTIONS[name])
    return named


def _span(content: Mapping[str, Any], part: str, name: str) -> tuple[float, float]:
    span = _section(content, part, "floor").get(name)
    if not isinstance(span, list) or len(span) != 2 or not all(map(_is_number, span)) or not span[0] < span[1]:
        problem = f"{name} must be [FROM, TO] in metres with FROM below TO, got {span!r}"
        raise InputError(f"{part} [floor]", problem, fix=f"{name} = [-4, 4]")
    return float(span[0]), float(span[1])


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def _number(section: Mapping[str, Any], part: str, name: str) -> float:
    if name not in section:
        raise InputError(part, f"{name} is missing", fix=f"{name} = 1.5")
    value = section[name]
    if not _is_number(value):
        raise InputError(part, f"{name} must be a number of metres, got {value!r}", fix=f"{name} = 1.5")
    return float(value)


def _positive(section: Mapping[str, Any], part: str, name: str) -> float:
    value = _number(section, part, name)
    if value <= 0:
        raise InputError(part, f"{name} must be above 0, got {value:g}", fix=f"{name} = 0.4")
    return value


def _circle(section: Mapping[str, Any], part: str) -> list[float]:
    return [_number(section, part, "north"), _number(section, part, "east"), _positive(section, part, "radius")]


def _corners(section: Mapping[str, Any], part: str) -> Any:
    corners: Any = section.get("corners")
    rows: list[Any] = corners if isinstance(corners, list) else []
    if len(rows) < 3 or not all(isinstance(c, list) and len(c) == 2 and all(map(_is_number, c)) for c in rows):
        problem = f"corners must be three or more pairs [NORTH, EAST] in metres, got {corners!r}"
        raise InputError(part, problem, fix="corners = [[1, 1], [2, 1], [2, 2]]")
    return np.array(rows, np.float64)


def _angle(value: Any, part: str) -> float:
    """Convert a number (rad), or a text with a unit such as "90 deg", to an angle in rad of at most one turn."""
    fix = 'heading = "90 deg"'
    try:
        angle = parse_amount(part, value if isinstance(value, str) else repr(value), "rad")
    except InputError as error:
        raise InputError(part, f"must be an angle, got {value!r}", choices=error.choices, fix=fix) from None
    if not abs(angle) <= 2 * np.pi:
        unit = "" if isinstance(value, str) else " rad"
        raise InputError(part, f"must be an angle of at most one turn, got {value}{unit}", fix=fix)
    return angle


def _polygon_distance(corners: Any, p: Any) -> Any:
    """Return the distance (n,) of points p (n, 2) from a polygon's boundary. The distance is negative inside the
    polygon."""
    a, b = corners, np.roll(corners, -1, axis=0)
    along = b - a
    square = np.maximum((along**2).sum(axis=1), 1e-300)
    away = p[:, None, :] - a
    share = np.clip((away * along).sum(axis=2) / square, 0.0, 1.0)
    distance = np.sqrt(((away - share[..., None] * along) ** 2).sum(axis=2)).min(axis=1)
    crosses = (a[:, 0] > p[:, None, 0]) != (b[:, 0] > p[:, None, 0])
    rise = np.where(along[:, 0] == 0, 1.0, along[:, 0])
    left = p[:, None, 1] < a[:, 1] + along[:, 1] * (p[:, None, 0] - a[:, 0]) / rise
    inside = np.count_nonzero(crosses & left, axis=1) % 2 == 1
    return np.where(inside, -distance, distance)
