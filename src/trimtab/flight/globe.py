"""Geographic position of a vehicle, from its position in the world frame W and the geographic position of W's origin.

No geographic position is sent until W's origin is set, by `trimtab vehicle --origin`, or by SET_GPS_GLOBAL_ORIGIN from
a ground station while the vehicle is disarmed. The geographic position is for maps; no sensor and no control law uses
it. Heights above sea level are treated as heights above the ellipsoid. This causes a relative error of distances of at
most 2e-5.
Source: https://mavlink.io/en/messages/common.html, GLOBAL_POSITION_INT, HOME_POSITION, GPS_GLOBAL_ORIGIN.
"""

import math
from collections.abc import Callable, Collection, Mapping
from typing import Any

from trimtab.compiler.compiled_block import compile_block
from trimtab.core.errors import InputError, argument, argument_name
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.protocol import Severity
from trimtab.flight.station import telemetry
from trimtab.flight.station.telemetry import Place, VehicleMotion
from trimtab.logs.frames import quaternion
from trimtab.run.blocks import place_block

DEGREES = 1e-7
"""Unit of MAVLink's latitudes and longitudes (degrees)."""
HIGHEST = 1e6
SET_ORIGIN = "SET_GPS_GLOBAL_ORIGIN"


def parse_origin(text: str) -> Place:
    """Return the geographic position in a text "LAT,LON,ALT", given in degrees and metres above sea level.

    Raises InputError for any other text.
    """
    try:
        latitude, longitude, height = map(float, text.split(","))
    except ValueError:
        raise InputError(
            argument_name("origin"),
            f"the position {text!r} must have the form LAT,LON,ALT",
            fix=argument("origin", "38.9897,-76.9378,20"),
        ) from None
    place = Place(math.radians(latitude), math.radians(longitude), height)
    if not is_on_globe(place):
        raise InputError(
            argument_name("origin"),
            f"{text!r}: latitude, longitude or height is out of range",
            fix="write LAT,LON,ALT: -90 to 90 degrees north, -180 to 180 degrees east, metres above the sea",
        )
    return place


def is_on_globe(place: Place) -> bool:
    """Return True if latitude, longitude and height are finite and within their limits."""
    limits = Place(math.pi / 2, math.pi, HIGHEST)
    return all(math.isfinite(v) and abs(v) <= limit for v, limit in zip(place, limits, strict=True))


class Globe:
    """Converter from positions in the world frame W to geographic positions, and MAVLink service that sets the
    geographic position of W's origin."""

    names: Collection[str] = (SET_ORIGIN,)

    def __init__(self, endpoint: Endpoint, motion: Callable[[], VehicleMotion], origin: Place | None = None) -> None:
        """Compile the block that computes the geographic position.

        motion: function that returns the vehicle's current motion.  origin: geographic position of W's origin, or None
        if it is unknown.
        """
        self._endpoint, self._motion = endpoint, motion
        self._block = compile_block(place_block())
        self._position: Any = self._block.reads["p_WB"]
        self.origin: Place | None = None
        self.home: VehicleMotion | None = None
        """Motion of the vehicle when it was last armed, or None before the first arming."""
        if origin is not None:
            self._set_origin(origin)

    def place(self, p_WB: Any) -> Place | None:
        """Return the geographic position of the point p_WB (m) in W, or None if the origin of W is not set."""
        if self.origin is None:
            return None
        self._block.inputs[self._position] = p_WB
        self._block.step()
        return Place(*(float(self._block.result(name)) for name in Place._fields))

    def mark_home(self) -> None:
        """Set home to the current position of the vehicle."""
        self.home = self._motion()

    def position_fields(self, now: int) -> Mapping[str, Any] | None:
        """Return the fields of the message GLOBAL_POSITION_INT, or None if the origin of W is not set."""
        motion = self._motion()
        place = self.place(motion.p_WB)
        return None if place is None else telemetry.global_position(now, motion, place, self._home(motion))

    def home_fields(self, now: int) -> Mapping[str, Any] | None:
        """Return the fields of the message HOME_POSITION, or None if the origin of W is not set."""
        home = self._home(self._motion())
        place = self.place(home.p_WB)
        return None if place is None else telemetry.home_position(now, home.p_WB, quaternion(home.attitude), place)

    def origin_fields(self, now: int) -> Mapping[str, Any] | None:
        """Return the fields of the message GPS_GLOBAL_ORIGIN, or None if the origin of W is not set."""
        return None if self.origin is None else telemetry.global_origin(now, self.origin)

    def answer(self, message: Message, now: int, *, is_armed: bool) -> list[bytes]:
        """Handle a request to change the geographic position of W's origin. The request is refused while the vehicle is
        armed.

        Return the packet with the current origin, and a text with the reason if the request is refused.
        """
        latitude, longitude = (math.radians(message.get(n) * DEGREES) for n in ("latitude", "longitude"))
        place = Place(latitude, longitude, message.get("altitude") * 1e-3)
        problem = (
            "the vehicle is armed" if is_armed else "" if is_on_globe(place) else "the coordinates are out of range"
        )
        if not problem:
            self._set_origin(place)
        fields, text = self.origin_fields(now), f"Origin not set: {problem}"
        said = [self._endpoint.pack("STATUSTEXT", {"severity": Severity.WARNING, "text": text})] if problem else []
        return ([] if fields is None else [self._endpoint.pack("GPS_GLOBAL_ORIGIN", fields)]) + said

    def due(self, now: int, *, is_armed: bool) -> list[bytes]:
        """Return no packets, because telemetry streams send all messages of this service."""
        return []

    def _home(self, motion: VehicleMotion) -> VehicleMotion:
        """Return the vehicle's motion when it was last armed, which defines home, or the current motion before the
        first arming."""
        return motion if self.home is None else self.home

    def _set_origin(self, origin: Place) -> None:
        for name, value in origin._asdict().items():
            self._block.parameters[name][...] = value
        self.origin = origin
