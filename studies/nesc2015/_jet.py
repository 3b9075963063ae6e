"""Cases of the F-16: in trim, with changes of height, speed, course and track, and on circles where longitudes meet."""

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import fsolve

import trimtab
from studies.nesc2015._autopilot import (
    TRIM_ANGLE,
    TRIM_STICK,
    Command,
    circle_date_line,
    circle_pole,
    control,
    move,
)
from studies.nesc2015._data import FOOT
from studies.nesc2015._flights import name_signals
from trimtab.core.integrate import rk4
from trimtab.core.record import replace
from trimtab.core.rotation import DEG, from_euler
from trimtab.environment.geodetic import ECCENTRICITY2, SEMI_MAJOR
from trimtab.vehicles.f16 import F16, F16Controls
from trimtab.vehicles.rigid_body import FlightCondition, RigidBodyState

STEP = 0.005
"""Step of RK4 (s). The autopilot runs four times per step, as if it were continuous."""
JET = F16()
KITTY_HAWK = (36.01916667, -75.67444444, 10_013.0)
"""Initial latitude, longitude (deg) and altitude (ft)."""
NORTH_EAST, FAST = (400.0, 400.0), (1414.213562, 1414.213562)
"""Initial velocity over the ground, north and east (ft/s)."""
AIRSPEED = 287.98158203
"""Equivalent airspeed of 565.6854 ft/s at 10 013 ft (knots)."""
SLOWER = 5.0
"""Step of the commanded airspeed (knots). [1]'s model file says 10, the simulations use 5, and one of them 11."""


class Trim(NamedTuple):
    """Level flight without acceleration along the track or down, and without pitch acceleration.

    pitch: rad.  stick: -1 to 1, aft.  throttle: 0 to 1.  state: at time zero.
    """

    pitch: float
    stick: float
    throttle: float
    state: RigidBodyState


class JetCase(NamedTuple):
    """Case of the F-16.  title: description.  place: latitude, longitude (deg), altitude (ft).

    velocity: north, east (ft/s).  seconds: duration.  command: function of time (s) and flight that returns the
    autopilot's command; None keeps the surfaces in trim.  own_trim: True if the autopilot's design angle is that of the
    trim computed here.
    """

    title: str
    place: tuple[float, float, float]
    velocity: tuple[float, float]
    seconds: int
    command: Any = None
    own_trim: bool = False


def start_level(place: tuple[float, float, float], velocity: tuple[float, float], pitch: Any) -> RigidBodyState:
    """Return a level initial state, nose along the track, that rotates with the local vertical."""
    latitude, longitude, altitude = place[0] * DEG, place[1] * DEG, place[2] * FOOT
    v = np.array([*velocity, 0.0]) * FOOT
    angles = jnp.stack([jnp.zeros_like(pitch), pitch, jnp.arctan2(v[1], v[0]) + 0 * pitch])
    x = JET.body.start(latitude, longitude, altitude, velocity=v, angles=angles, rate=np.zeros(3), over_ground=True)
    s2 = np.sin(latitude) ** 2
    east = SEMI_MAJOR / np.sqrt(1 - ECCENTRICITY2 * s2) + altitude
    north = SEMI_MAJOR * (1 - ECCENTRICITY2) / (1 - ECCENTRICITY2 * s2) ** 1.5 + altitude
    plumb = np.array([v[1] / east, -v[0] / north, -v[1] * np.tan(latitude) / east])
    return replace(x, rate=x.rate + from_euler(*angles).T @ plumb)


def trim(place: tuple[float, float, float], velocity: tuple[float, float]) -> Trim:
    """Return pitch, stick and throttle of level steady flight."""
    along = np.array(velocity) / np.hypot(*velocity)

    @jax.jit
    def residual(z: Any) -> Any:
        pitch, stick, throttle = z
        x = start_level(place, velocity, pitch)
        d = JET.dynamics(0.0, x, move(stick, 0.0, 0.0, throttle))
        change = jax.jvp(lambda x: JET.flight(0.0, x).velocity, (x,), (d,))[1]
        return jnp.stack([change[:2] @ along, change[2], d.rate[1]])

    begin = [2.65 * DEG, TRIM_STICK, 0.14]
    pitch, stick, throttle = np.asarray(fsolve(residual, begin, xtol=1e-12)).tolist()
    return Trim(pitch, stick, throttle, start_level(place, velocity, jnp.asarray(pitch)))


def step_at(t: Any, begin: float, size: float) -> Any:
    """Return a step: zero before `begin` (s), then `size`."""
    return jnp.where(t >= begin, size, 0.0)


def track_offset(flight: FlightCondition) -> Any:
    """Return the distance (ft) to the right of a line north-east from Kitty Hawk, on a flat map around it."""
    latitude, longitude = KITTY_HAWK[0] * DEG, KITTY_HAWK[1] * DEG
    s2 = np.sin(latitude) ** 2
    north = (flight.latitude - latitude) * SEMI_MAJOR * (1 - ECCENTRICITY2) / (1 - ECCENTRICITY2 * s2) ** 1.5
    across = SEMI_MAJOR / np.sqrt(1 - ECCENTRICITY2 * s2) * jnp.cos(flight.latitude)
    return ((flight.longitude - longitude) * across - north) / np.sqrt(2) / FOOT


@functools.cache
def jet_cases() -> Mapping[str, JetCase]:
    """Return the cases of the F-16 by NASA's numbers."""

    def hold(altitude: Any = 0.0, speed: Any = 0.0, course: Any = 0.0, offset: Any = 0.0) -> Command:
        return Command(KITTY_HAWK[2] + altitude, AIRSPEED + speed, 45.0 + course, offset)

    def change(title: str, seconds: int, command: Any) -> JetCase:
        return JetCase(f"F-16, {title}", KITTY_HAWK, NORTH_EAST, seconds, command, own_trim=True)

    high = (*KITTY_HAWK[:2], 30_013.0)
    pole, line = (89.95, -45.0, 10_000.0), (0.0, -179.95, 10_000.0)
    speed = 563.6427816
    return {
        "11": JetCase("F-16 trimmed at Mach 0.5", KITTY_HAWK, NORTH_EAST, 180),
        "12": JetCase("F-16 trimmed at Mach 2", high, FAST, 180),
        "13p1": change("100 ft up", 20, lambda t, f: hold(altitude=step_at(t, 5, 100))),
        "13p2": change("slower", 20, lambda t, f: hold(speed=step_at(t, 5, -SLOWER))),
        "13p3": change("15 degrees to the right", 30, lambda t, f: hold(course=step_at(t, 15, 15))),
        "13p4": change(
            "2000 ft to the right", 60, lambda t, f: hold(offset=jnp.where(t >= 20, track_offset(f) - 2000, 0.0))
        ),
        "15": JetCase(
            "F-16 about the north pole", pole, (0.0, speed), 180, lambda t, f: Command(10_000, 287, *circle_pole(f))
        ),
        "16": JetCase(
            "F-16 about the date line", line, (speed, 0.0), 180, lambda t, f: Command(10_000, 287, *circle_date_line(f))
        ),
    }


@functools.cache
def fly_jet(case: str, step: float = STEP) -> dict[str, Any]:
    """Return the signals of a case by NASA's names, once per second, with "time". The loop is compiled to C."""
    _, place, velocity, seconds, command, own_trim = jet_cases()[case]
    level, n = trim(place, velocity), round(1 / step)
    design = level.pitch / DEG if own_trim else TRIM_ANGLE

    def steer(t: Any, flight: FlightCondition) -> F16Controls:
        if command is None:
            return move(level.stick, 0.0, 0.0, level.throttle)
        return control(flight, command(t, flight), stick=level.stick, throttle=level.throttle, design=design)

    def advance(i: Any, carry: Any) -> Any:
        k, x = carry
        t = k * 1.0 + i * step
        return k, rk4(lambda s, y: JET.dynamics(s, y, steer(t, JET.flight(s, y))), t, x, step)

    def second(x: RigidBodyState, k: Any) -> Any:
        flight = JET.flight(k * 1.0, x)
        row = name_signals(flight, x.rate, JET.air_wrench(flight.flow, steer(k * 1.0, flight)))
        return jax.lax.fori_loop(0, n, advance, (k, x))[1], row

    def go(x: RigidBodyState) -> dict[str, Any]:
        return jax.lax.scan(second, x, jnp.arange(seconds + 1))[1]

    rows = trimtab.compile(go, level.state)(level.state)
    return {"time": np.arange(seconds + 1.0), **{name: np.asarray(row) for name, row in rows.items()}}
