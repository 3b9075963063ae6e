"""Conversion of a vehicle's state to the fields of the standard messages that ground stations show. The functions have
no state of their own.

Times `now` are by the vehicle's clock, in 100 ns. Other arguments are in SI units, as in `core.signals.Motion`.
Source: https://mavlink.io/en/messages/common.html.
"""

import math
import re
from collections.abc import Mapping, Sequence
from enum import IntFlag
from typing import Any, NamedTuple

from trimtab import __version__
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.protocol import Capability

Vector = Sequence[float]
Fields = Mapping[str, Any]
UNITS_PER_MS, UNITS_PER_US = 10_000, 10
UNKNOWN_16, UNKNOWN_8 = 0xFFFF, 0xFF
SERVOS, RECEIVER = 16, 18
LOW_PULSE, PULSE_RANGE = 1000, 1000
"""Shortest pulse width of a servo, and width of the pulse range (µs)."""
ON_GROUND = 1
APPROACH = ("approach_x", "approach_y", "approach_z")
BATTERY_CELLS, UNKNOWN_TEMPERATURE = 10, 32767
UNKNOWN_OF_BATTERY = ("current_battery", "current_consumed", "energy_consumed", "battery_remaining")
GAUSS_PER_TESLA = 1e4
CAPABILITIES = Capability.COMMAND_INT | Capability.FILES | Capability.MAVLINK2 | Capability.PARAMETERS_AS_FLOAT


class Health(IntFlag):
    """Bits of MAV_SYS_STATUS_SENSOR, one for each component of a vehicle whose health is reported."""

    GYRO = 1
    ACCELEROMETER = 2
    MAGNETOMETER = 4
    MOTORS = 0x8000
    RECEIVER = 0x10000
    FENCE = 0x100000
    ARMING_CHECK = 0x10000000


class VehicleMotion(NamedTuple):
    """Motion of a vehicle: position in the world frame W; attitude as roll, pitch and yaw; velocity and angular
    velocity in the body frame B."""

    p_WB: Vector
    attitude: Vector
    v_WB_B: Vector
    w_WB_B: Vector


class Place(NamedTuple):
    """Geographic position: latitude and longitude (rad), height above sea level (m)."""

    latitude: float
    longitude: float
    height: float


def attitude(now: int, motion: VehicleMotion) -> Fields:
    """Return the fields of ATTITUDE. Angles are from -pi to pi."""
    angles = dict(zip(("roll", "pitch", "yaw"), map(_wrap_angle, motion.attitude), strict=True))
    rates = zip(("rollspeed", "pitchspeed", "yawspeed"), motion.w_WB_B, strict=True)
    return {"time_boot_ms": _milliseconds(now)} | angles | dict(rates)


def local_position(now: int, motion: VehicleMotion) -> Fields:
    """Return the fields of LOCAL_POSITION_NED: position and velocity in the world frame W."""
    place = zip("xyz", motion.p_WB, strict=True)
    velocity = zip(("vx", "vy", "vz"), rotate_to_world(motion.attitude, motion.v_WB_B), strict=True)
    return {"time_boot_ms": _milliseconds(now)} | dict(place) | dict(velocity)


def global_position(now: int, motion: VehicleMotion, place: Place, home: VehicleMotion) -> Fields:
    """Return the fields of GLOBAL_POSITION_INT, with the height above sea level and the height above the home
    position."""
    velocity = rotate_to_world(motion.attitude, motion.v_WB_B)
    return {
        "time_boot_ms": _milliseconds(now),
        **_place_fields(place, ("lat", "lon", "alt")),
        "relative_alt": round((home.p_WB[2] - motion.p_WB[2]) * 1e3),
        **{name: round(v * 100) for name, v in zip(("vx", "vy", "vz"), velocity, strict=True)},
        "hdg": round(math.degrees(motion.attitude[2]) * 100) % 36_000,
    }


def home_position(now: int, p_WB: Vector, quaternion: Vector, place: Place) -> Fields:
    """Return the fields of HOME_POSITION, without an approach vector. quaternion: w, x, y, z of the rotation from the
    body frame B to the world frame W."""
    local = dict(zip("xyz", p_WB, strict=True)) | {"q": tuple(quaternion)}
    return {"time_usec": now // UNITS_PER_US} | _place_fields(place) | local | dict.fromkeys(APPROACH, math.nan)


def global_origin(now: int, origin: Place) -> Fields:
    """Return the fields of GPS_GLOBAL_ORIGIN: the geographic position of the origin of the world frame W."""
    return {"time_usec": now // UNITS_PER_US} | _place_fields(origin)


def _place_fields(place: Place, names: Sequence[str] = ("latitude", "longitude", "altitude")) -> dict[str, Any]:
    degrees = [round(math.degrees(angle) * 1e7) for angle in (place.latitude, place.longitude)]
    return dict(zip(names, [*degrees, round(place.height * 1e3)], strict=True))


def battery_status() -> Fields:
    """Return the fields of BATTERY_STATUS, all marked as unknown, because no vehicle in this package measures its
    battery."""
    voltages = (UNKNOWN_16,) * BATTERY_CELLS
    return {"voltages": voltages, "temperature": UNKNOWN_TEMPERATURE} | dict.fromkeys(UNKNOWN_OF_BATTERY, -1)


def vfr_hud(motion: VehicleMotion) -> Fields:
    """Return the fields of VFR_HUD. Wind is ignored: the airspeed is the speed relative to the ground."""
    north, east, down = rotate_to_world(motion.attitude, motion.v_WB_B)
    return {
        "airspeed": math.sqrt(sum(v * v for v in motion.v_WB_B)),
        "groundspeed": math.hypot(north, east),
        "heading": round(math.degrees(motion.attitude[2])) % 360,
        "alt": 0.0 - motion.p_WB[2],
        "climb": 0.0 - down,
    }


def inertial_sample(t: int, specific_force: Vector, angular_rate: Vector, field: Vector | None = None) -> Fields:
    """Return the fields of HIGHRES_IMU for a sample measured at t (100 ns). field: magnetic field (T), or None if it is
    not measured."""
    fields: dict[str, Any] = {"time_usec": t // UNITS_PER_US, "fields_updated": 0o77 if field is None else 0o777}
    for names, values in (("acc", specific_force), ("gyro", angular_rate), ("mag", field or (0.0, 0.0, 0.0))):
        fields |= {f"{axis}{names}": v for axis, v in zip("xyz", values, strict=True)}
    for axis in "xyz":
        fields[f"{axis}mag"] *= GAUSS_PER_TESLA
    return fields


def servo_outputs(now: int, shares: Vector) -> Fields:
    """Return the fields of SERVO_OUTPUT_RAW. The actuator commands, scaled to 0 (lowest) to 1 (highest), become pulse
    widths from 1 to 2 ms."""
    pulses = [round(LOW_PULSE + PULSE_RANGE * s) if math.isfinite(s) else 0 for s in shares[:SERVOS]]
    time = now // UNITS_PER_US & 0xFFFFFFFF
    return {"time_usec": time} | {f"servo{k + 1}_raw": pulse for k, pulse in enumerate(pulses)}


def receiver_channels(now: int, pulses: Vector) -> Fields:
    """Return the fields of RC_CHANNELS. pulses: pulse widths (s) of the safety pilot's radio receiver, NaN for a
    missing channel."""
    raw = [round(p * 1e6) if math.isfinite(p) else UNKNOWN_16 for p in pulses[:RECEIVER]]
    raw += [UNKNOWN_16] * (RECEIVER - len(raw))
    count = max((k + 1 for k, v in enumerate(raw) if v != UNKNOWN_16), default=0)
    named = {f"chan{k + 1}_raw": v for k, v in enumerate(raw)}
    return {"time_boot_ms": _milliseconds(now), "chancount": count, "rssi": UNKNOWN_8} | named


def system_health(has: Health, well: Health, lost: int, accepted: int, refused: int) -> Fields:
    """Return the fields of SYS_STATUS, without a battery. lost, accepted, refused: numbers of frames on the link so
    far.

    A vehicle without a fence reports its fence as healthy, because MAVProxy would otherwise report a breach.
    """
    share = 10_000 * lost // max(lost + accepted, 1)
    return {
        "onboard_control_sensors_present": has,
        "onboard_control_sensors_enabled": has,
        "onboard_control_sensors_health": has & well | Health.FENCE,
        "voltage_battery": UNKNOWN_16,
        "current_battery": -1,
        "battery_remaining": -1,
        "drop_rate_comm": share,
        "errors_comm": refused & 0xFFFF,
    }


def landed_state(is_held: bool) -> Fields:
    """Return the fields of EXTENDED_SYS_STATE. If `is_held`, the vehicle is on the ground. Otherwise the landed state
    is unknown."""
    return {"landed_state": ON_GROUND if is_held else 0}


def system_time(now: int, unix: float) -> Fields:
    """Return the fields of SYSTEM_TIME. unix: wall-clock time of the vehicle's computer (s since 1970)."""
    return {"time_unix_usec": int(unix * 1e6), "time_boot_ms": _milliseconds(now)}


def version_fields(endpoint: Endpoint) -> dict[str, Any]:
    """Return the fields of AUTOPILOT_VERSION: capabilities, version, hash of the dialect, session number and system
    id."""
    numbers = [min(int(n), 255) for n in re.findall(r"\d+", f"{__version__}.0.0")[:3]]
    return {
        "capabilities": CAPABILITIES,
        "flight_sw_version": int.from_bytes(bytes([*numbers, 0])),
        "flight_custom_version": endpoint.dialect.fingerprint,
        "uid": endpoint.session << 8 | endpoint.system,
    }


def rotate_to_world(attitude: Vector, of_body: Vector) -> tuple[float, float, float]:
    """Return the components of a vector in the world frame W, from its components in the body frame B: rotate by roll,
    then pitch, then yaw."""
    x, y, z = of_body
    (cr, cp, cy), (sr, sp, sy) = map(math.cos, attitude), map(math.sin, attitude)
    y, z = cr * y - sr * z, sr * y + cr * z
    x, z = cp * x + sp * z, -sp * x + cp * z
    return cy * x - sy * y, sy * x + cy * y, z


def _milliseconds(now: int) -> int:
    return now // UNITS_PER_MS & 0xFFFFFFFF


def _wrap_angle(angle: float) -> float:
    return math.remainder(angle, math.tau) if math.isfinite(angle) else angle
