"""Messages about a vehicle's pose, which Foxglove and Lichtblick show on a map and in a 3-D scene.

    /tf        foxglove.FrameTransform   the vehicle's frame in the world frame W (north, east, down), and W in "map"
                                         (east, north, up)
    /scene     foxglove.SceneUpdate      a box and an arrow fixed in the vehicle's frame, once
    /location  foxglove.LocationFix      latitude, longitude and height, if the origin of W on the earth is known

Poses are taken from the rows of a log and reduced to 20 transforms and 5 locations per second.
Source: Foxglove's message schemas (docs.foxglove.dev), and JSON Schema 2020-12.
"""

import json
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.time import ms
from trimtab.logs.messages import NS_PER_SECOND, NS_PER_TICK, Topic

POSE_COLUMNS = 9
"""Number of columns of a pose: position in W (m, 3), roll, pitch, yaw, latitude, longitude (rad) and height (m).
Unknown values are NaN."""
TRANSFORM_PERIOD, PLACE_PERIOD = ms(50), ms(200)
MAP, WORLD = "map", "world"
HALF = math.sqrt(0.5)
NED_IN_ENU = (0.0, HALF, HALF, 0.0)
"""Quaternion w, x, y, z of the rotation from the axes north, east, down to the axes east, north, up."""
NO_TURN = (1.0, 0.0, 0.0, 0.0)
BODY_COLOR, NOSE_COLOR = (0.2, 0.5, 0.9, 1.0), (0.9, 0.3, 0.1, 1.0)
BODY_SIZE, NOSE_LENGTH = (0.6, 0.35, 0.15), 0.5
"""Size of the box and length of the arrow that represent the vehicle in the scene (m), chosen for visibility."""


def _numbers(*names: str) -> dict[str, Any]:
    properties = {name: {"type": "number"} for name in names}
    return {"type": "object", "properties": properties, "required": list(names)}


def _object(properties: Mapping[str, Any], title: str = "") -> dict[str, Any]:
    whole = {"type": "object", "properties": dict(properties), "required": list(properties)}
    return {"title": title, **whole} if title else whole


def _list_of(items: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": dict(items)}


TEXT, REAL, TRUTH = {"type": "string"}, {"type": "number"}, {"type": "boolean"}
TIME = _object({"sec": {"type": "integer"}, "nsec": {"type": "integer"}})
VECTOR, QUATERNION, COLOR = _numbers(*"xyz"), _numbers(*"xyzw"), _numbers(*"rgba")
POSE = _object({"position": VECTOR, "orientation": QUATERNION})
CUBE = _object({"pose": POSE, "size": VECTOR, "color": COLOR})
ARROW_LENGTHS = ("shaft_length", "shaft_diameter", "head_length", "head_diameter")
ARROW = _object({"pose": POSE, **dict.fromkeys(ARROW_LENGTHS, REAL), "color": COLOR})
EMPTY = _list_of({"type": "object"})
PRIMITIVES = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
ENTITY = _object(
    {
        "timestamp": TIME,
        "frame_id": TEXT,
        "id": TEXT,
        "lifetime": TIME,
        "frame_locked": TRUTH,
        "metadata": EMPTY,
        **dict.fromkeys(PRIMITIVES, EMPTY),
        "arrows": _list_of(ARROW),
        "cubes": _list_of(CUBE),
    }
)
TRANSFORM_SCHEMA = _object(
    {
        "timestamp": TIME,
        "parent_frame_id": TEXT,
        "child_frame_id": TEXT,
        "translation": VECTOR,
        "rotation": QUATERNION,
    },
    "foxglove.FrameTransform",
)
SCENE_SCHEMA = _object({"deletions": EMPTY, "entities": _list_of(ENTITY)}, "foxglove.SceneUpdate")
PLACE_SCHEMA = _object(
    {
        "timestamp": TIME,
        "frame_id": TEXT,
        **dict.fromkeys(("latitude", "longitude", "altitude"), REAL),
        "position_covariance": {"type": "array", "items": REAL, "minItems": 9, "maxItems": 9},
        "position_covariance_type": {"type": "integer"},
    },
    "foxglove.LocationFix",
)
TRANSFORMS, SCENE, PLACES = range(3)
"""Indices of the topics in the result of `frame_topics`."""


def frame_topics() -> list[Topic]:
    """Return the topics of the pose messages, at the indices TRANSFORMS, SCENE and PLACES."""
    named = {"/tf": TRANSFORM_SCHEMA, "/scene": SCENE_SCHEMA, "/location": PLACE_SCHEMA}
    return [Topic(name, {}, schema["title"], json.dumps(schema).encode()) for name, schema in named.items()]


class FrameMessage(NamedTuple):
    """Message about a pose. topic: index of the topic.  time: time (ns).  text: content as JSON."""

    topic: int
    time: int
    text: bytes


class FrameWriter:
    """Converter of poses in the rows of a log to messages."""

    def __init__(self, child: str) -> None:
        """Create a converter. child: name of the vehicle's frame."""
        self._child = child
        self._transform_time = self._place_time = -(2**62)
        self._has_scene = False

    def begin_file(self) -> None:
        """Prepare for a new file, at the start of which the constant messages are repeated."""
        self._has_scene = False

    def messages(self, ticks: Any, poses: Any, epoch: int) -> list[FrameMessage]:
        """Return the messages for n rows of a log.

        ticks: times (n,) in 100 ns.  poses: (n, POSE_COLUMNS).  epoch: time of day at time zero (ns).
        """
        messages = list[FrameMessage]()
        for t, pose in zip(ticks.tolist(), poses.tolist(), strict=True):
            if t - self._transform_time < TRANSFORM_PERIOD or not all(map(math.isfinite, pose[:6])):
                continue
            self._transform_time, time = t, epoch + t * NS_PER_TICK
            if not self._has_scene:
                self._has_scene = True
                messages.append(_message(TRANSFORMS, time, _transform(time, MAP, WORLD, (0.0, 0.0, 0.0), NED_IN_ENU)))
                messages.append(_message(SCENE, time, _scene(time, self._child)))
            turn = _round(quaternion(pose[3:6]), 7)
            place = _transform(time, WORLD, self._child, _round(pose[:3], 4), turn)
            messages.append(_message(TRANSFORMS, time, place))
            if t - self._place_time >= PLACE_PERIOD and all(map(math.isfinite, pose[6:])):
                self._place_time = t
                messages.append(_message(PLACES, time, _location(time, self._child, pose[6:])))
        return messages


def quaternion(attitude: Any) -> tuple[float, float, float, float]:
    """Return the quaternion (w, x, y, z) of the rotation from body frame B to world frame W.

    attitude: roll, pitch, yaw (rad), of the rotation sequence 3-2-1.
    """
    (cr, cp, cy), (sr, sp, sy) = (tuple(f(a / 2) for a in attitude) for f in (math.cos, math.sin))
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def roll_pitch_yaw(q: Any) -> tuple[float, float, float]:
    """Return roll, pitch, yaw (3-2-1, rad) of a quaternion (w, x, y, z) of any length, or NaN for length zero."""
    w, x, y, z = q
    n = w * w + x * x + y * y + z * z
    if not n > 0:
        return math.nan, math.nan, math.nan
    up = min(1.0, max(-1.0, 2 * (w * y - x * z) / n))
    return (
        math.atan2(w * x + y * z, n / 2 - x * x - y * y),
        math.asin(up),
        math.atan2(w * z + x * y, n / 2 - y * y - z * z),
    )


def no_pose() -> Any:
    """Return a pose whose values are all unknown (NaN)."""
    return np.full(POSE_COLUMNS, np.nan)


def _message(topic: int, time: int, content: Mapping[str, Any]) -> FrameMessage:
    return FrameMessage(topic, time, json.dumps(content, separators=(",", ":")).encode())


def _round(numbers: Any, digits: int) -> tuple[float, ...]:
    return tuple(round(x, digits) for x in numbers)


def _time(time: int) -> dict[str, int]:
    sec, nsec = divmod(time, NS_PER_SECOND)
    return {"sec": sec, "nsec": nsec}


def _pose(position: Any, turn: Any) -> dict[str, Any]:
    return {"position": dict(zip("xyz", position, strict=True)), "orientation": dict(zip("wxyz", turn, strict=True))}


def _transform(time: int, parent: str, child: str, position: Any, turn: Any) -> dict[str, Any]:
    pose = _pose(position, turn)
    frames = {"parent_frame_id": parent, "child_frame_id": child}
    return {"timestamp": _time(time), **frames, "translation": pose["position"], "rotation": pose["orientation"]}


def _location(time: int, child: str, place: Any) -> dict[str, Any]:
    latitude, longitude = (round(math.degrees(angle), 9) for angle in place[:2])
    where = {"latitude": latitude, "longitude": longitude, "altitude": round(place[2], 4)}
    unknown = {"position_covariance": [0.0] * 9, "position_covariance_type": 0}
    return {"timestamp": _time(time), "frame_id": child, **where, **unknown}


def _scene(time: int, child: str) -> dict[str, Any]:
    body = {"pose": _pose((0.0, 0.0, 0.0), NO_TURN), "size": dict(zip("xyz", BODY_SIZE, strict=True))}
    lengths = dict(zip(ARROW_LENGTHS, (0.6 * NOSE_LENGTH, 0.05, 0.4 * NOSE_LENGTH, 0.12), strict=True))
    nose = {"pose": _pose((0.0, 0.0, 0.0), NO_TURN), **lengths, "color": dict(zip("rgba", NOSE_COLOR, strict=True))}
    return {
        "deletions": [],
        "entities": [
            {
                "timestamp": _time(time),
                "frame_id": child,
                "id": child,
                "lifetime": _time(0),
                "frame_locked": True,
                "metadata": [],
                **{name: [] for name in PRIMITIVES},
                "cubes": [body | {"color": dict(zip("rgba", BODY_COLOR, strict=True))}],
                "arrows": [nose],
            }
        ],
    }
