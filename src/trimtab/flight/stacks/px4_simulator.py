"""Messages between PX4 and its simulator, as MAVLink 2: the simulator sends sensor samples, and PX4 answers with
actuator commands.

    HIL_SENSOR (107)             to PX4: inertial unit each time, magnetometer and pressures if their bits are set
    HIL_GPS (113)                to PX4: a position fix
    HIL_ACTUATOR_CONTROLS (93)   from PX4: motors 0 to 1, servos -1 to 1, flags for armed and for lockstep

In lockstep, PX4 waits for each sample, and its clock is the time in HIL_SENSOR.
Source: https://docs.px4.io/main/en/simulation/, "Simulator MAVLink API"; PX4-Autopilot,
src/modules/simulation/simulator_mavlink/SimulatorMavlink.cpp; https://mavlink.io/en/messages/common.html.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from trimtab.core.time import UNITS_PER_SECOND
from trimtab.flight.mavlink.definitions import Message, read_definitions
from trimtab.flight.mavlink.dialect import STANDARD, Dialect
from trimtab.flight.stacks.ardupilot_json import PhysicsState

PX4 = Path(__file__).with_name("px4.xml")
CHANNELS = 16
INERTIAL, MAGNETIC, PRESSURES = 0b111_111, 0b111 << 6, 0b1111 << 9
"""Bits of the field fields_updated for three groups of values: acceleration and angular rate; magnetic field;
pressures, height and temperature."""
ARMED, LOCKSTEP = 128, 1
"""Bit of the field `mode` that means armed, and bit of the field `flags` that means lockstep."""
GAUSS, HECTOPASCAL, ICE = 1e-4, 100.0, 273.15
PER_MICROSECOND = UNITS_PER_SECOND // 1_000_000
FIX_3D, SATELLITES, ACCURACY = 3, 12, 100
"""Quality of a simulated position fix under an open sky: type of fix, number of satellites, and accuracy (cm)."""


class ControlFrame(NamedTuple):
    """Actuator commands from PX4. time: time (µs) of PX4's clock.  controls: values of PX4's 16 outputs.

    is_locked: True if PX4 waits for the next sample (lockstep)."""

    time: int
    controls: tuple[float, ...]
    is_armed: bool
    is_locked: bool


class Surroundings(NamedTuple):
    """Surroundings of the vehicle: geographic position (rad, m), state of the air (Pa, K), and earth's magnetic field
    in the body frame B (T)."""

    latitude: float
    longitude: float
    height: float
    pressure: float
    dynamic_pressure: float
    temperature: float
    field: Sequence[float]


def simulator_dialect() -> Dialect:
    """Return the MAVLink dialect that contains the standard messages and the messages of PX4's simulators."""
    standard, own = STANDARD.read_text("utf-8"), PX4.read_text("utf-8")
    definitions = read_definitions(standard) | read_definitions(own)
    return Dialect(standard + own, definitions, {d.id: d for d in definitions.values()}, {}, {})


def read_controls(message: Message) -> ControlFrame | str:
    """Return the content of a message HIL_ACTUATOR_CONTROLS, or a text with the reason if the content is not valid."""
    controls = message.get("controls")
    if not all(map(math.isfinite, controls)):
        return f"PX4's output {[*map(math.isfinite, controls)].index(False) + 1} is not a finite number"
    mode, flags = message.get("mode"), message.get("flags")
    return ControlFrame(message.get("time_usec"), controls, bool(mode & ARMED), bool(flags & LOCKSTEP))


def sensor_fields(t: int, state: PhysicsState, around: Surroundings, updated: int) -> Mapping[str, Any]:
    """Return the fields of HIL_SENSOR for a motion at t (100 ns). updated: bits of the groups of values that are
    new."""
    axes = "xyz"
    force = {f"{a}acc": x for a, x in zip(axes, state.specific_force, strict=True)}
    rate = {f"{a}gyro": x for a, x in zip(axes, state.angular_rate, strict=True)}
    field = {f"{a}mag": x / GAUSS for a, x in zip(axes, around.field, strict=True)}
    return {
        **{"time_usec": t // PER_MICROSECOND, **force, **rate, **field},
        "abs_pressure": around.pressure / HECTOPASCAL,
        "diff_pressure": around.dynamic_pressure / HECTOPASCAL,
        "pressure_alt": around.height,
        "temperature": around.temperature - ICE,
        "fields_updated": updated,
    }


def fix_fields(t: int, state: PhysicsState, around: Surroundings) -> Mapping[str, Any]:
    """Return the fields of HIL_GPS for a motion at t (100 ns)."""
    north, east, down = (round(100 * v) for v in state.velocity)
    course = math.degrees(math.atan2(state.velocity[1], state.velocity[0])) % 360
    return {
        "time_usec": t // PER_MICROSECOND,
        "fix_type": FIX_3D,
        "lat": round(math.degrees(around.latitude) * 1e7),
        "lon": round(math.degrees(around.longitude) * 1e7),
        "alt": round(around.height * 1e3),
        "eph": ACCURACY,
        "epv": ACCURACY,
        "vel": round(100 * math.hypot(*state.velocity[:2])),
        "vn": north,
        "ve": east,
        "vd": down,
        "cog": round(100 * course) % 36000,
        "satellites_visible": SATELLITES,
    }
