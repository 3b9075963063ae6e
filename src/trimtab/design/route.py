"""Smooth, timed route between obstacles for a craft of given width.

A route is searched on a grid and shortened by straight lines. The corners of the route are rounded as far as obstacles
allow. Speeds follow from limits of speed and acceleration. If no route exists, the error reports the width of the
widest passage.

Source: P. Hart, N. Nilsson, B. Raphael, "A formal basis for the heuristic determination of minimum cost paths", IEEE
Trans. Systems Science and Cybernetics 4 (1968) 100; the widest way: M. Pollack, "The maximum capacity through a
network", Operations Research 8 (1960) 733.
"""

import heapq
import itertools
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import BSpline
from scipy.optimize import least_squares

from trimtab.core.errors import InputError
from trimtab.design.obstacles import ObstacleFloor, PlanTask

GRID = 0.1
"""Distance between neighbouring points of the search grid (m)."""
LARGEST = 10_000.0
"""Largest area of a floor (m^2): a million points of the search grid."""
MARGINS = (0.3, 0.2, 0.12, 0.06)
"""Margins (m) between craft and obstacles, tried in this order. The first margin for which a route exists is used."""
SPACING = 0.05
"""Distance between consecutive points of a route (m)."""
CONTROL = 0.4
"""Distance between the control points of the spline (m)."""
WEIGHTS = 0.2, 1.0, 0.15
"""Weights, in the smoothing of a route, of the route's first, second and third derivative by arc length (1, m, m^2)."""
ROOMS = (0.0, 200.0), (0.3, 5.0)
"""Two penalties, in the smoothing of a route, for missing clearance: desired clearance beyond the craft's radius and
margin (m), and weight of the missing clearance (1/m)."""


class Tempo(NamedTuple):
    """Limits of the motion along a route. speed: maximum speed (m/s).  along, across: maximum acceleration along the
    route and in curves (m/s^2).
    """

    speed: float = 0.5
    along: float = 0.1
    across: float = 0.1


class Route(NamedTuple):
    """Timed route. times: (n,) (s).  places: points (n, 2) (m), in W.  margin: clearance from obstacles beyond the
    craft's radius (m)."""

    times: Any
    places: Any
    margin: float


class _Grid(NamedTuple):
    """Search grid. places: points (rows, columns, 2).  clearance: distance from obstacles of each point (rows,
    columns)."""

    places: Any
    clearance: Any

    def nearest(self, place: Any) -> tuple[int, int]:
        """Return row and column of the grid point that is nearest to a given point."""
        away = ((self.places - np.asarray(place)) ** 2).sum(axis=2)
        row, column = np.unravel_index(np.argmin(away), away.shape)
        return int(row), int(column)


def find_route(task: PlanTask, tempo: Tempo | None = None, part: str = "plan") -> Route:
    """Find a route that begins and ends at rest.

    Raises: InputError if the start or the goal is too close to an obstacle, or if every passage is too narrow.
    """
    floor, tempo = task.floor, tempo or Tempo()
    _refuse_size(floor, part)
    _refuse_ends(task, part)
    grid = _make_grid(floor)
    ends = grid.nearest(task.start), grid.nearest(task.goal)
    for margin in MARGINS:
        room = task.radius + margin
        cells = _search(grid, *ends, room)
        if cells is not None:
            middle = [grid.places[cell] for cell in cells[1:-1]]
            corners = np.array([task.start, *middle, task.goal])
            places = _smooth(floor, _shortcut(floor, corners, room), room)
            return Route(_times(places, tempo), places, margin)
    widest = 2 * _widest(grid, *ends)
    problem = f"no route for a craft of radius {task.radius:g} m: the widest passage is {widest:.2f} m, but "
    problem += f"{2 * (task.radius + MARGINS[-1]):.2f} m are needed, including {100 * MARGINS[-1]:g} cm on either side"
    fix = f"move an obstacle, or plan for a craft of radius {max(widest / 2 - MARGINS[-1] - 0.01, 0.01):.2f} m"
    raise InputError(part, problem, fix=fix)


def _refuse_size(floor: ObstacleFloor, part: str) -> None:
    sides = [float(high - low) for low, high in (floor.north, floor.east)]
    if sides[0] * sides[1] > LARGEST:
        problem = f"the floor of {sides[0]:g} m by {sides[1]:g} m is too large: at most {LARGEST:g} m^2 can be searched"
        raise InputError(part, problem, fix="write a smaller floor, with lengths in metres")


def _refuse_ends(task: PlanTask, part: str) -> None:
    for name, place in (("start", task.start), ("goal", task.goal)):
        left = float(task.floor.clearance([place])[0])
        if left < task.radius:
            where = (
                "lies in an obstacle or beyond the floor" if left < 0 else f"is {left:.2f} m from the nearest obstacle"
            )
            problem = f"the {name} {place[0]:g} {place[1]:g} {where}; the craft's radius is {task.radius:g} m"
            raise InputError(
                part, problem, fix=f"move the {name} to a place with at least {task.radius + 0.1:g} m around it"
            )
    if np.hypot(*np.subtract(task.start, task.goal)) < SPACING:
        problem = f"start and goal are less than {100 * SPACING:g} cm apart"
        raise InputError(part, problem, fix="move the goal away from the start")


def _make_grid(floor: ObstacleFloor) -> _Grid:
    rows = np.arange(floor.north[0], floor.north[1] + GRID / 2, GRID)
    columns = np.arange(floor.east[0], floor.east[1] + GRID / 2, GRID)
    places = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=2)
    return _Grid(places, floor.clearance(places.reshape(-1, 2)).reshape(places.shape[:2]))


STEPS = [(a, b, GRID * float(np.hypot(a, b))) for a, b in itertools.product((-1, 0, 1), repeat=2) if a or b]


def _search(grid: _Grid, start: tuple[int, int], goal: tuple[int, int], room: float) -> "list[tuple[int, int]] | None":
    """Return the cells of a shortest route with a clearance of at least `room` except at its ends, or None if none
    exists."""
    free = grid.clearance >= room
    free[start] = free[goal] = True
    best, came = {start: 0.0}, {start: start}
    queue, done = [(0.0, start)], set()
    while queue:
        _, cell = heapq.heappop(queue)
        if cell == goal:
            way = [cell]
            while way[-1] != start:
                way.append(came[way[-1]])
            return way[::-1]
        if cell in done:
            continue
        done.add(cell)
        for a, b, length in STEPS:
            near = cell[0] + a, cell[1] + b
            if not (0 <= near[0] < free.shape[0] and 0 <= near[1] < free.shape[1]) or not free[near]:
                continue
            cost = best[cell] + length
            if cost < best.get(near, np.inf):
                best[near], came[near] = cost, cell
                ahead = GRID * float(np.hypot(near[0] - goal[0], near[1] - goal[1]))
                heapq.heappush(queue, (cost + ahead, near))
    return None


def _widest(grid: _Grid, start: tuple[int, int], goal: tuple[int, int]) -> float:
    """Return the largest clearance (m) that a route can keep everywhere."""
    best = {start: float(grid.clearance[start])}
    queue = [(-best[start], start)]
    while queue:
        width, cell = heapq.heappop(queue)
        if cell == goal:
            return max(-width, 0.0)
        if -width < best[cell]:
            continue
        for a, b, _ in STEPS:
            near = cell[0] + a, cell[1] + b
            if 0 <= near[0] < grid.clearance.shape[0] and 0 <= near[1] < grid.clearance.shape[1]:
                wide = min(-width, float(grid.clearance[near]))
                if wide > best.get(near, -np.inf):
                    best[near] = wide
                    heapq.heappush(queue, (-wide, near))
    return 0.0


def _shortcut(floor: ObstacleFloor, corners: Any, room: float) -> Any:
    """Return the corners of the route, without those that a straight line with enough clearance can skip."""
    kept, at = [corners[0]], 0
    while at < len(corners) - 1:
        ahead = len(corners) - 1
        while ahead > at + 1:
            line = _resample(corners[[at, ahead]], SPACING / 2)
            ends = min(float(v) for v in floor.clearance(corners[[at, ahead]]))
            if floor.clearance(line).min() >= min(room, ends):
                break
            ahead -= 1
        kept.append(corners[ahead])
        at = ahead
    return np.array(kept)


def _resample(places: Any, spacing: float) -> Any:
    """Return evenly spaced points along the lines between the given points."""
    lengths = np.append(0.0, np.cumsum(np.hypot(*np.diff(places, axis=0).T)))
    count = max(int(np.ceil(lengths[-1] / spacing)), 1) + 1
    along = np.linspace(0.0, lengths[-1], count)
    return np.column_stack([np.interp(along, lengths, places[:, k]) for k in range(2)])


def _smooth(floor: ObstacleFloor, corners: Any, room: float) -> Any:
    """Return points along a smooth route near the given corners.

    The route is a spline of degree 5 with little curvature and, where possible, extra clearance.
    """
    lines = _resample(corners, SPACING)
    length, degree = SPACING * (len(lines) - 1), 5
    count = max(int(np.ceil(length / CONTROL)), degree + 1) + 1
    knots = np.concatenate([np.zeros(degree), np.linspace(0.0, length, count - degree + 1), np.full(degree, length)])
    along = np.linspace(0.0, length, len(lines))
    spline = BSpline(knots, np.eye(count), degree)
    basis: list[Any] = [spline(along, k) for k in range(4)]
    fixed = np.linalg.lstsq(basis[0], lines, rcond=None)[0]
    fixed[0], fixed[-1] = lines[0], lines[-1]
    wanted = np.minimum(room, floor.clearance(lines[[0, -1]]).min())
    share = np.sqrt(1 / len(lines))

    def controls(free: Any) -> Any:
        return np.vstack([fixed[:1], free.reshape(-1, 2), fixed[-1:]])

    def residuals(free: Any) -> Any:
        c = controls(free)
        smooth = [w * share * (b @ c).ravel() for w, b in zip(WEIGHTS, basis[1:], strict=True)]
        left = floor.clearance(basis[0] @ c) - wanted
        return np.concatenate([*smooth, *(w * share * np.maximum(more - left, 0.0) for more, w in ROOMS)])

    smooth = [w * share * np.kron(b[:, 1:-1], np.eye(2)) for w, b in zip(WEIGHTS, basis[1:], strict=True)]

    def jacobian(free: Any) -> Any:
        places = basis[0] @ controls(free)
        left, away = floor.clearance(places) - wanted, _directions(floor, places)
        slope = -(basis[0][:, 1:-1, None] * away[:, None, :]).reshape(len(places), -1)
        return np.vstack([*smooth, *(w * share * (left < more)[:, None] * slope for more, w in ROOMS)])

    solve: Any = least_squares
    found = solve(residuals, fixed[1:-1].ravel(), jacobian, method="lm", max_nfev=100)
    return _resample(basis[0] @ controls(found.x), SPACING)


def _directions(floor: ObstacleFloor, places: Any) -> Any:
    """Return the gradient (n, 2) of the floor's clearance at the points (n, 2)."""
    h = 1e-6
    return np.column_stack(
        [(floor.clearance(places + d) - floor.clearance(places - d)) / (2 * h) for d in h * np.eye(2)]
    )


def _times(places: Any, tempo: Tempo) -> Any:
    """Return the time at each point (n,) of a motion from rest to rest, as fast as the limits in `tempo` allow."""
    step = np.hypot(*np.diff(places, axis=0).T)
    turn = np.zeros(len(places))
    direction = np.unwrap(np.arctan2(*np.diff(places, axis=0).T[::-1]))
    turn[1:-1] = np.abs(np.diff(direction)) / np.maximum((step[1:] + step[:-1]) / 2, 1e-9)
    width = max(int(0.3 / SPACING), 1)
    turn = np.array([turn[max(k - width, 0) : k + width + 1].mean() for k in range(len(turn))])
    speed = np.minimum(tempo.speed, np.sqrt(tempo.across / np.maximum(turn, 1e-6)))
    speed[0] = speed[-1] = 0.0
    for k in range(1, len(speed)):
        speed[k] = min(speed[k], float(np.sqrt(speed[k - 1] ** 2 + 2 * tempo.along * step[k - 1])))
    for k in range(len(speed) - 2, -1, -1):
        speed[k] = min(speed[k], float(np.sqrt(speed[k + 1] ** 2 + 2 * tempo.along * step[k])))
    return np.append(0.0, np.cumsum(2 * step / np.maximum(speed[1:] + speed[:-1], 1e-6)))
