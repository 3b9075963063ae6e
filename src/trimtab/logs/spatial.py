"""Readable signals of a flight in three dimensions: roll, pitch, yaw, altitude and speeds, from the true state in a
log.

A quaternion and a position vector are hard to read in a table or plot. Therefore the readable signals are derived from
signals of the true state, which are recognised by their declarations:

    attitude   (4,), unit 1, frame WB or IB: a quaternion, scalar first
    position   (3,), m, frame of the attitude, W or I      velocity  (3,), m/s, frame W, I or B
    rate       (3,), rad/s, frame B

A state that contains the angles themselves is recognised by the names `roll` and `pitch`. Its other signals are then
recognised by their names in `DECLARED`.

Derived signals are in the log as `flight.roll` etc., in SI units and radians. In a world frame W, angles and velocities
are relative to W. Over the rotating earth, in an inertial frame I, they are relative to north, east and down at the
vehicle. The altitude is then above the ellipsoid, and north and east are in the tangent plane at the origin.

Source: Diebel, "Representing attitude", Stanford 2006; Stevens, Lewis, Johnson, "Aircraft control and simulation", 1.6.
"""

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.quantity import Quantity
from trimtab.logs.log import LazyMapping, Log

FLIGHT, TRUTH = "flight.", "truth."
DECLARED: Mapping[str, Quantity] = {
    "roll": Quantity("rad", "Roll angle, positive to the right; unwrapped.", "WB", "angle"),
    "pitch": Quantity("rad", "Pitch angle, positive nose up.", "WB", "angle"),
    "yaw": Quantity("rad", "Yaw angle from north, clockwise from above; unwrapped.", "WB", "angle"),
    "roll_rate": Quantity("rad/s", "Roll rate, about the axis to the nose.", "B"),
    "pitch_rate": Quantity("rad/s", "Pitch rate, about the axis to starboard.", "B"),
    "yaw_rate": Quantity("rad/s", "Yaw rate, about the axis down.", "B"),
    "altitude": Quantity(
        "m", "Altitude above the origin of W; over the rotating earth, altitude above the ellipsoid.", "W"
    ),
    "north": Quantity("m", "Distance north of the origin of W.", "W"),
    "east": Quantity("m", "Distance east of the origin of W.", "W"),
    "ground_speed": Quantity("m/s", "Horizontal speed over the ground."),
    "climb": Quantity("m/s", "Climb rate, positive upward.", "W"),
    "air_speed": Quantity("m/s", "Speed relative to the air, which moves with the wind in the settings."),
}
"""Name of a derived signal -> its declaration, in the order of display."""
FLIGHT_DECLARED: Mapping[str, Quantity] = {FLIGHT + name: declared for name, declared in DECLARED.items()}
"""Path of a derived signal in a log -> its declaration."""
ANGLES, RATES = ("roll", "pitch", "yaw"), ("roll_rate", "pitch_rate", "yaw_rate")


POSE = {"north", "east", "altitude", *ANGLES}
UNPAIRED = {"north", "east", "heading", "yaw_rate", "depth"}
"""Signals whose references are drawn in the plan view or in panels of their own, not with the signal."""


def referenced_signal(path: str) -> str:
    """Return the name X for the path `law.X_reference` of a reference signal, or "" for other paths.

    The reference is drawn together with the signal X.
    """
    name = path.removeprefix("law.").removesuffix("_reference")
    return name if path == f"law.{name}_reference" and name not in UNPAIRED else ""


class SpatialSignals(NamedTuple):
    """Paths of the signals of a vehicle's motion in three dimensions. The path of a missing signal is "".

    frame: frame of attitude and position, "W" or "I".  velocity_frame: frame of the velocity, or "" without a velocity.
    """

    attitude: str
    position: str
    velocity: str
    rate: str
    frame: str
    velocity_frame: str


def find_spatial(shapes: Mapping[str, tuple[int, ...]], declared: Mapping[str, Quantity]) -> SpatialSignals | None:
    """Return the signals of a vehicle's motion in three dimensions, or None without an attitude signal.

    Args:
        shapes: path of each signal -> its shape at one instant.
        declared: path of each signal -> its declaration.
    """

    def pick(unit: str, size: int, *frames: str) -> str:
        fitting = [p for p, shape in shapes.items() if shape == (size,) and p in declared and declared[p].unit == unit]
        return next((p for frame in frames for p in fitting if declared[p].frame == frame), "")

    attitude = pick("1", 4, "WB", "IB")
    if not attitude:
        return None
    frame = declared[attitude].frame[0]
    position, velocity, rate = pick("m", 3, frame), pick("m/s", 3, frame, "B"), pick("rad/s", 3, "B")
    return SpatialSignals(attitude, position, velocity, rate, frame, declared[velocity].frame if velocity else "")


class FlightSource(NamedTuple):
    """Source signals from which `flight.roll` etc. are computed, in a log or in a campaign.

    signals: signals of a state with a quaternion, or None.  named: name in DECLARED -> path of the source signal, for a
    state that contains roll, pitch and yaw.
    """

    signals: SpatialSignals | None
    named: Mapping[str, str]

    @property
    def paths(self) -> tuple[str, ...]:
        """Return the paths of the source signals."""
        return tuple(p for p in (self.signals[:4] if self.signals else self.named.values()) if p)

    def work_out(
        self, t: Any, rows: Mapping[str, Any], ends: Mapping[str, Any], end: float, parameters: Mapping[str, Any]
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return `flight.roll` etc. of one flight, each (n,), and the final value of each.

        The final values are computed only if `ends` contains all source signals.

        Args:
            t: instants (n,) (s).
            rows: path of a source signal -> values (n, …).
            ends: path of a source signal -> value (…) at the end of the flight.
            end: time of the end of the flight (s).
            parameters: parameters of the run, as in `work_out_flight`.
        """
        rows, n = {p: np.asarray(rows[p], float) for p in self.paths}, len(t)
        has_end = all(p in ends for p in self.paths)
        if has_end:
            rows = {p: np.concatenate([x, np.asarray(ends[p], float)[None]]) for p, x in rows.items()}
            t = np.append(t, end)
        if self.signals:
            numbers = work_out_flight(self.signals, t, rows, parameters)
        else:
            numbers = _complete({name: np.array(rows[path]) for name, path in self.named.items()}, t)
        flight = {FLIGHT + name: values for name, values in numbers.items()}
        return {p: x[:n] for p, x in flight.items()}, {p: x[-1] for p, x in flight.items()} if has_end else {}

    def flight_paths(self, shapes: Mapping[str, tuple[int, ...]], parameters: Mapping[str, Any]) -> list[str]:
        """Return the paths of the derived signals that can be computed. shapes: path of a signal -> shape."""
        any_rows = {p: np.full((2, *shapes[p]), 7e6) for p in self.paths}
        return list(self.work_out(np.arange(2.0), any_rows, {}, 2.0, parameters)[0])


def find_flight(shapes: Mapping[str, tuple[int, ...]], declared: Mapping[str, Quantity]) -> FlightSource | None:
    """Return the source signals of a flight, or None for a vehicle that moves in a plane and for a swarm.

    Args:
        shapes: path of each signal -> its shape at one instant. Only signals of the truth are used.
        declared: declarations of the signals.
    """
    truth = {p: shape for p, shape in shapes.items() if p.startswith(TRUTH)}
    signals, named = find_spatial(truth, declared), find_named((p for p, s in truth.items() if s == ()), TRUTH)
    return FlightSource(signals, named) if signals or named else None


def find_logged_flight(log: Log) -> FlightSource | None:
    """Return the source signals of a flight in the true state of a log, as `find_flight` does."""
    return find_flight({p: log[p].shape[1:] for p in log.paths if p.startswith(TRUTH)}, log.declarations)


def find_named(paths: Iterable[str], prefix: str) -> dict[str, str]:
    """Return the name in DECLARED -> path of the signal, for a state that contains roll and pitch, else {}."""
    known = set(paths)
    found = {name: prefix + name for name in DECLARED if prefix + name in known}
    return found if {"roll", "pitch"} <= found.keys() else {}


def flight_sources(log: Log) -> set[str]:
    """Return the paths of the source signals of the flight in a log."""
    found = find_logged_flight(log)
    return set(found.paths) if found else set()


def with_flight(log: Log) -> Log:
    """Return a log with `flight.roll` etc. added, for a vehicle that moves in three dimensions.

    Other logs are returned unchanged.
    """
    found = find_logged_flight(log)
    if found is None or f"{FLIGHT}roll" in log:
        return log
    rows, end = {p: log[p] for p in found.paths}, float(log.metadata.get("duration_s", log.t[-1] if len(log) else 0.0))
    return _extend(log, *found.work_out(log.t, rows, log.final, end, log.metadata.get("parameters") or {}))


def spatial_poses(log: Log) -> Any:
    """Return the vehicle's poses (n, 9) for `logs.frames`, or None if attitude or position is unknown.

    A pose is position, roll, pitch and yaw in W, then latitude, longitude and height. The last three are NaN unless the
    vehicle flies over the rotating earth.
    """
    signals, named = find_logged_flight(log) or (None, {})
    if named.keys() >= POSE:
        north, east, altitude, *angles = (log[named[n]] for n in ("north", "east", "altitude", *ANGLES))
        return np.stack([north, east, -altitude, *angles, *[np.full(len(log), np.nan)] * 3], axis=1)
    if signals is None or not signals.position:
        return None
    R, place, globe = rotation_matrices(log[signals.attitude]), log[signals.position], np.full((len(log), 3), np.nan)
    if signals.frame == "I":
        local = _locate(log.t, place, log.metadata.get("parameters") or {})
        R, place, globe = local.tangent_axes @ R, local.position, local.globe
    return np.concatenate([place, np.stack(euler_angles(R), axis=1), globe], axis=1)


def _complete(numbers: dict[str, Any], t: Any) -> dict[str, Any]:
    """Return the signals with roll and yaw unwrapped, and with missing speeds computed from position differences."""
    for name in ("roll", "yaw"):
        if name in numbers:
            numbers[name] = np.unwrap(numbers[name])
    if len(t) > 1:
        slopes = {n: np.gradient(numbers[n], t) for n in ("north", "east", "altitude") if n in numbers}
        if {"north", "east"} <= slopes.keys():
            numbers.setdefault("ground_speed", np.hypot(slopes["north"], slopes["east"]))
        if "altitude" in slopes:
            numbers.setdefault("climb", slopes["altitude"])
    return {name: numbers[name] for name in DECLARED if name in numbers}


def _extend(log: Log, flight: Mapping[str, Any], ends: Mapping[str, Any]) -> Log:
    """Return a log with additional signals. The existing signals are read from the file only when requested."""
    for values in flight.values():
        values.setflags(write=False)

    def read(path: str) -> Any:
        return flight[path] if path in flight else log.signals[path]

    declared = {**log.declarations, **{p: FLIGHT_DECLARED[p] for p in flight}}
    signals = LazyMapping[Any](dict.fromkeys([*flight, *log.paths]), read)
    about = LazyMapping[Any](log.metadata, log.metadata.__getitem__)
    return Log.of_flight(log.t, log.ticks, signals, declared, about, {**log.final, **ends})


def display_unit(path: str, unit: str) -> tuple[str, float]:
    """Return the unit in which a signal is displayed, and the factor of conversion to this unit.

    Degrees are used for the angles and rates in `flight.`, and for headings, such as `law.heading_error`.
    """
    is_heading = path.rpartition(".")[2].startswith("heading") and unit == "rad"
    in_degrees = is_heading or (path.startswith(FLIGHT) and unit.startswith("rad"))
    return (unit.replace("rad", "deg"), math.degrees(1.0)) if in_degrees else (unit, 1.0)


def work_out_flight(
    signals: SpatialSignals, t: Any, rows: Mapping[str, Any], parameters: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the signals of DECLARED that can be computed from existing source signals, each (n,).

    Args:
        signals: paths of the source signals.
        t: instants (n,) (s).
        rows: path of a signal -> its values (n, …).
        parameters: path -> parameter of the run. The frame I needs the parameters of earth, origin and wind.
    """
    R, found = rotation_matrices(rows[signals.attitude]), dict[str, Any]()
    place: Any = rows.get(signals.position)
    velocity: Any = rows.get(signals.velocity)
    if signals.velocity_frame == "B":
        velocity = np.einsum("nij,nj->ni", R, velocity)
    if signals.frame == "I" and place is not None:
        local = _locate(t, place, parameters)
        R, place = local.axes @ R, local.position
        found["altitude"] = local.globe[:, 2]
        if velocity is not None:
            velocity = np.einsum("nij,nj->ni", local.axes, velocity - local.turning)
        if velocity is not None and local.wind is not None:
            found["air_speed"] = np.sqrt(np.sum((velocity - local.wind) ** 2, axis=1))
    if place is not None:
        found = {"altitude": -place[:, 2], **found, "north": place[:, 0], "east": place[:, 1]}
    if velocity is not None:
        found |= {"ground_speed": np.hypot(velocity[:, 0], velocity[:, 1]), "climb": -velocity[:, 2]}
    if signals.rate:
        found |= dict(zip(RATES, rows[signals.rate].T, strict=True))
    found |= dict(zip(ANGLES, euler_angles(R), strict=True))
    return {name: np.array(found[name], float) + 0.0 for name in DECLARED if name in found}


def place_parameters(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters of a run that `work_out_flight` needs: path -> value."""
    return {p: v for p, v in parameters.items() if any(f".{part}." in p for part in ("earth", "origin", "wind"))}


class _Local(NamedTuple):
    """Position of a vehicle over the rotating earth, at n instants.

    axes: R_NI (n, 3, 3), rotation from I to the frame N (north, east, down at the vehicle).  tangent_axes: R_WI
    (n, 3, 3), rotation from I to the frame W (north, east, down at the origin).  position: position relative to the
    origin, in W (n, 3) (m).  globe: latitude, longitude (rad) and height above the ellipsoid (m) (n, 3).  turning:
    velocity of the rotating earth at the vehicle, in I (n, 3).  wind: wind velocity in N (n, 3), or None.
    """

    axes: Any
    tangent_axes: Any
    position: Any
    globe: Any
    turning: Any
    wind: Any


def _locate(t: Any, p_I: Any, parameters: Mapping[str, Any]) -> _Local:
    """Return the positions over the earth for positions p_I (n, 3) (m) in the inertial frame at times t (n,) (s).

    parameters: path -> parameter of the run. The earth is that of the parameters, or WGS 84 if they contain none.
    """
    from trimtab.environment import geodetic  # imports JAX, which few logs need

    found = (p.removesuffix("earth.rate") for p in parameters if p.endswith(".earth.rate"))
    head = next(found, "")

    def of(name: str, otherwise: float) -> float:
        return float(parameters.get(head + name, otherwise))

    rate, shape = of("earth.rate", geodetic.RATE), {"semi_major": of("earth.semi_major", geodetic.SEMI_MAJOR)}
    shape["flattening"] = of("earth.flattening", geodetic.FLATTENING)
    origin = [of(f"origin.{name}", 0.0) for name in ("latitude", "longitude", "height")]
    c, s, o = np.cos(rate * t), np.sin(rate * t), np.zeros(len(t))
    R_EI = np.moveaxis(np.array([[c, s, o], [-s, c, o], [o, o, o + 1]]), -1, 0)
    p_E = np.einsum("nij,nj->ni", R_EI, p_I)
    latitude, longitude, height = map(np.asarray, geodetic.from_ecef(p_E.T, **shape))
    R_NE = np.transpose(np.asarray(geodetic.ned_axes(latitude, longitude)), (2, 1, 0))
    R_WE = np.asarray(geodetic.ned_axes(np.float64(origin[0]), np.float64(origin[1]))).T
    from_origin = p_E - np.asarray(geodetic.to_ecef(*map(np.float64, origin), **shape))
    wind = None
    if f"{head}wind.north" in parameters:
        level = [of(f"wind.{d}", 0.0) + of(f"wind.{d}_shear", 0.0) * height for d in ("north", "east")]
        wind = np.stack([*level, o], axis=1)
    turning = rate * np.stack([-p_I[:, 1], p_I[:, 0], o], axis=1)
    globe = np.stack([latitude, longitude, height], axis=1)
    return _Local(R_NE @ R_EI, R_WE @ R_EI, from_origin @ R_WE.T, globe, turning, wind)


def rotation_matrices(q: Any) -> Any:
    """Return rotation matrices (n, 3, 3) of quaternions (n, 4), scalar first, of any length except zero."""
    w, x, y, z = np.asarray(q, float).T
    with np.errstate(divide="ignore", invalid="ignore"):
        s = 2 / (w * w + x * x + y * y + z * z)
        rows = (
            (1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)),
            (s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)),
            (s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)),
        )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def euler_angles(R_WB: Any) -> tuple[Any, Any, Any]:
    """Return roll, pitch, yaw (rad), each (n,), of rotation matrices (n, 3, 3); roll and yaw are unwrapped.

    If the nose points straight up or down, roll and yaw cannot be distinguished, and roll is 0.
    """
    up = R_WB[:, 2, 0]
    singular = np.abs(up) > 1 - 1e-12
    roll = np.where(singular, 0.0, np.arctan2(R_WB[:, 2, 1], R_WB[:, 2, 2]))
    yaw = np.where(singular, np.arctan2(-R_WB[:, 0, 1], R_WB[:, 1, 1]), np.arctan2(R_WB[:, 1, 0], R_WB[:, 0, 0]))
    return np.unwrap(roll), -np.arcsin(np.clip(up, -1, 1)), np.unwrap(yaw)
