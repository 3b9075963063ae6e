"""Shortest paths of a car with a minimum turning radius (Dubins paths).

A shortest path has at most three pieces: arcs of the minimum radius to the left (L) or right (R), and straight lines
(S). The word of a path is the sequence of its letters. Only the words LSL, RSR, LSR, RSL, RLR and LRL can be shortest.
All six paths are constructed geometrically, and the shortest is chosen.

[1] is L. E. Dubins, "On curves of minimal length with a constraint on average curvature, and with prescribed initial
and terminal positions and tangents", American Journal of Mathematics 79 (1957) 497-516.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, quantity, record
from trimtab.core.reference import ReferencePoint

WORDS = ("LSL", "RSR", "LSR", "RSL", "RLR", "LRL")
TURNS: Mapping[str, float] = MappingProxyType({"L": -1.0, "S": 0.0, "R": 1.0})
"""Sign of the curvature for each letter of a path: left, straight, right. Right is clockwise seen from above."""
TINY = 1e-9
"""Tolerance for rounding: an arc this close to a full turn (rad), or a line this short (in radii), counts as zero."""


@record
class DubinsPath:
    """Reference along a path of three pieces, arcs or straight lines, at constant speed. After the end of the path, the
    reference continues straight ahead.

    Frames:  W; headings clockwise from north.    Source:  [1].
    """

    north: Scalar = quantity("m", "North coordinate of the path's start.", frame="W", default=0.0)
    east: Scalar = quantity("m", "East coordinate of the path's start.", frame="W", default=0.0)
    heading: Scalar = quantity("rad", "Heading at the path's start.", kind="angle", frame="W", default=0.0)
    radius: Scalar = quantity("m", "Radius of the path's arcs.", default=1.0, above=0)
    speed: Scalar = quantity("m/s", "Speed along the path.", default=1.0, above=0)
    turns: Any = quantity(
        "1", "Direction of each of the path's pieces: -1 left, 0 straight, 1 right.", shape=(3,), default=np.zeros(3)
    )
    lengths: Any = quantity("m", "Length of each of the path's pieces.", shape=(3,), default=np.zeros(3), low=0)

    @property
    def length(self) -> Any:
        """Return the total length of the path (m)."""
        return self.lengths[0] + self.lengths[1] + self.lengths[2]

    def at(self, t: Any) -> ReferencePoint:
        """Return the reference point at the time t (s)."""
        left = jnp.maximum(self.speed * t, 0.0)
        north, east, heading, curvature = self.north, self.east, self.heading, 0.0
        for k in range(3):
            bend = self.turns[k] / self.radius
            curvature = jnp.where((left >= 0) & (left < self.lengths[k]), bend, curvature)
            north, east, heading = _advance((north, east, heading), bend, jnp.clip(left, 0.0, self.lengths[k]))
            left = left - self.lengths[k]
        north, east, heading = _advance((north, east, heading), 0.0, jnp.maximum(left, 0.0))
        c, s = jnp.cos(heading), jnp.sin(heading)
        ahead, right = jnp.stack([c, s]), jnp.stack([-s, c])
        V, rate = self.speed, self.speed * curvature
        return ReferencePoint(
            place=jnp.stack([north, east]),
            velocity=V * ahead,
            acceleration=V * rate * right,
            jerk=-V * rate**2 * ahead,
            snap=-V * rate**3 * right,
            heading=heading,
            has_heading=jnp.asarray(True),
        )


def dubins_path(word: str, start: Any, goal: Any, radius: float, speed: float = 1.0) -> DubinsPath | None:
    """Return the shortest path with a given sequence of pieces, or None if no such path leads to the goal.

    Args:
        word: letters of the three pieces, one of WORDS, e.g. "LSR".
        start: north, east (m), heading (rad) (3,).
        goal: north, east (m), heading (rad) (3,).
        radius: radius of the arcs (m).
        speed: speed along the path (m/s).

    Raises:
        InputError: if the word is unknown, or the radius is not above 0.
    """
    if word not in WORDS:
        raise InputError("word", f"unknown sequence of pieces {word!r}", choices=WORDS, fix=f"write {WORDS[0]}")
    if not radius > 0:
        raise InputError("radius", f"the radius must be above 0, got {radius:g} m", fix="give a radius such as 1.0")
    start, goal = np.asarray(start, np.float64), np.asarray(goal, np.float64)
    signs = np.array([TURNS[letter] for letter in word])
    first, last = (
        pose[:2] + sign * radius * _right(pose[2])
        for pose, sign in zip((start, goal), (signs[0], signs[2]), strict=True)
    )
    between = (last - first) / radius
    if word[1] != "S":
        candidates = _three_arcs(signs[0], between)
    elif np.hypot(*between) < TINY:  # the first and last circle coincide, so the line has no length
        candidates = [(float(start[2]), float(start[2]), 0.0)] if signs[0] == signs[2] else []
    else:
        candidates = _straight(signs, between)
    best: Any = None
    for h1, h2, straight in candidates:
        arcs = [_arc(signs[0] * (h1 - start[2])), straight, _arc(signs[2] * (goal[2] - h2))]
        if word[1] != "S":
            arcs[1] = _arc(signs[1] * (h2 - h1))
        if best is None or sum(arcs) < sum(best):
            best = arcs
    if best is None:
        return None
    north, east, heading = (float(v) for v in start)
    return DubinsPath(north, east, heading, radius, speed, signs, radius * np.array(best))


def shortest_path(start: Any, goal: Any, radius: float, speed: float = 1.0) -> DubinsPath:
    """Return the shortest path between two poses. Arguments are as in `dubins_path`.

    Raises:
        InputError: if the radius is not above 0.
    """
    paths = [dubins_path(word, start, goal, radius, speed) for word in WORDS]
    return min((path for path in paths if path is not None), key=lambda path: path.length)


def word_of(path: DubinsPath) -> str:
    """Return the letters of a path's three pieces, e.g. "LSR"."""
    return "".join({v: k for k, v in TURNS.items()}[float(turn)] for turn in path.turns)


def _advance(pose: tuple[Any, Any, Any], bend: Any, s: Any) -> tuple[Any, Any, Any]:
    """Return north, east (m) and heading (rad) after a length s (m) at the curvature `bend` (1/m), which may be 0."""
    north, east, heading = pose
    half = bend * s / 2
    chord = s * jnp.where(half == 0, 1.0, jnp.sin(half) / jnp.where(half == 0, 1.0, half))
    return north + chord * jnp.cos(heading + half), east + chord * jnp.sin(heading + half), heading + 2 * half


def _right(heading: float) -> Any:
    """Return the unit vector (2,) to the right of a heading (rad)."""
    return np.array([-np.sin(heading), np.cos(heading)])


def _heading_of(right: Any) -> float:
    """Return the heading (rad) at which a vector (2,) points to the right."""
    return float(np.arctan2(-right[0], right[1]))


def _arc(angle: float) -> float:
    """Return the angle (rad) wrapped to [0, 2 pi)."""
    turn = float(np.mod(angle, 2 * np.pi))
    return 0.0 if 2 * np.pi - turn < TINY else turn


def _straight(signs: Any, between: Any) -> list[tuple[float, float, float]]:
    """Return [(heading (rad) at the start, heading at the end, length)] of the straight line between two circles, or an
    empty list if the line does not exist.

    between: vector from the first circle's centre to the last (2,). Lengths are in radii. The line is a common tangent
    of the circles. If the turns differ, it crosses between the circles.
    """
    direction, squared = float(np.arctan2(between[1], between[0])), float(between @ between)
    if signs[0] == signs[2]:
        return [(direction, direction, np.sqrt(squared))]
    if squared < 4:
        return []  # the circles overlap
    length = np.sqrt(squared - 4)
    heading = direction + float(signs[0]) * float(np.arctan2(2, length))
    return [(heading, heading, length)]


def _three_arcs(sign: float, between: Any) -> list[tuple[float, float, float]]:
    """Return, for each possible middle circle, the headings (rad) at which the path enters and leaves this circle."""
    distance = float(np.hypot(*between))
    if not 0 < distance <= 4:
        return []  # the circles are too far apart, or equal, so that no middle arc is needed
    across = np.array([-between[1], between[0]]) / distance * np.sqrt(4 - distance**2 / 4)
    middles = (between / 2 + across, between / 2 - across)
    return [(_heading_of(-sign * m), _heading_of(-sign * (m - between)), 0.0) for m in middles]
