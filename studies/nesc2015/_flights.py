"""Cases of falling and shot bodies: bodies, earth models, winds and initial states, and signals by NASA's names."""

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import trimtab
from studies.nesc2015._data import FOOT, SLUG
from trimtab.core.integrate import rk4
from trimtab.core.record import replace
from trimtab.core.rotation import DEG
from trimtab.environment.earth import Earth, round_earth
from trimtab.environment.wind import Wind
from trimtab.vehicles.rigid_body import NO_WRENCH, BluntBody, FlightCondition, RigidBody, RigidBodyState, Wrench

STEP = 0.01
"""Step of RK4 (s). Half of it changes no signal by more than 1e-9 of its size (test)."""
BALL = RigidBody(mass=SLUG, inertia=np.full(3, 3.6 * SLUG * FOOT**2))
DRAG = BluntBody(area=0.1963495 * FOOT**2, drag=0.1, span=FOOT, chord=FOOT)
"""Ball of half a foot in diameter. Its inertia, 3.6 slug ft², is not that of a solid ball."""
DRAGGED_BALL = replace(BALL, aerodynamics=DRAG)
BRICK = RigidBody(mass=0.155404754 * SLUG, inertia=np.array([0.00189422, 0.006211019, 0.007194665]) * SLUG * FOOT**2)
DAMPING = BluntBody(
    area=0.22222 * FOOT**2,
    drag=0.0,
    span=0.33333 * FOOT,
    chord=0.66667 * FOOT,
    roll_damping=-1.0,
    pitch_damping=-1.0,
    yaw_damping=-1.0,
)
"""Damping of the brick. NASA's file has a drag of 0.01, but the forces of its simulations show that it was omitted."""


class Case(NamedTuple):
    """Case.  body: body that flies.  start: initial state.  title: description of the case."""

    body: RigidBody
    start: RigidBodyState
    title: str


def _drop(body: RigidBody, rate: Any = (0.0, 0.0, 0.0)) -> RigidBodyState:
    """Return an initial state at 30 000 ft, latitude and longitude zero, level, nose north.

    rate: relative to I (rad/s).
    """
    none = np.zeros(3)
    return body.start(0.0, 0.0, 30_000 * FOOT, velocity=none, angles=none, rate=rate, over_ground=False)


def _shoot(body: RigidBody, course: float) -> RigidBodyState:
    """Return an initial state at sea level that climbs at 45° on a course (rad) from north.

    The body is level, at rest.
    """
    speed = 1000 * FOOT
    velocity = speed * np.array([np.cos(course), np.sin(course), -1.0])
    angles, none = np.array([0.0, 0.0, course]), np.zeros(3)
    return body.start(0.0, 0.0, 0.0, velocity=velocity, angles=angles, rate=none, over_ground=True)


@functools.cache
def cases() -> Mapping[str, Case]:
    """Return the cases by NASA's numbers."""
    tumbling = np.array([10.0, 20.0, 30.0]) * DEG
    damped = replace(BRICK, aerodynamics=DAMPING)
    still, turning = (replace(DRAGGED_BALL, earth=round_earth(rate)) for rate in (0.0, Earth().rate))
    breeze = replace(DRAGGED_BALL, wind=Wind(east=20 * FOOT))
    shear = replace(DRAGGED_BALL, wind=Wind(east=-20 * FOOT, east_shear=0.003))
    return {
        "01": Case(BALL, _drop(BALL), "a ball dropped, without drag"),
        "02": Case(BRICK, _drop(BRICK, tumbling), "a brick that tumbles"),
        "03": Case(damped, _drop(damped, tumbling), "a brick that tumbles, damped by the air"),
        "04": Case(still, _drop(still, tumbling), "a ball with drag over a round earth that does not rotate"),
        "05": Case(turning, _drop(turning, tumbling), "a ball with drag over a round earth that rotates"),
        "06": Case(DRAGGED_BALL, _drop(DRAGGED_BALL), "a ball with drag over the ellipsoid"),
        "07": Case(breeze, _drop(breeze), "a ball with drag over the ellipsoid in a steady wind"),
        "08": Case(shear, _drop(shear), "a ball with drag over the ellipsoid in a wind that grows with height"),
        "09": Case(DRAGGED_BALL, _shoot(DRAGGED_BALL, 90 * DEG), "a ball shot eastward"),
        "10": Case(DRAGGED_BALL, _shoot(DRAGGED_BALL, 0.0), "a ball shot northward"),
    }


def name_signals(flight: FlightCondition, rate: Any, wrench: Wrench) -> dict[str, Any]:
    """Return signals by NASA's names, in SI units.

    rate: relative to I (3,) (rad/s).  wrench: force and moment of the air.
    """
    air = flight.flow.air
    return {
        **{f"feVelocity_ft_s_{axis}": flight.velocity[i] for i, axis in enumerate("XYZ")},
        "altitudeMsl_ft": flight.height,
        "longitude_deg": flight.longitude,
        "latitude_deg": flight.latitude,
        "localGravity_ft_s2": flight.gravity,
        **{f"eulerAngle_deg_{name}": flight.angles[i] for i, name in enumerate(("Roll", "Pitch", "Yaw"))},
        **{f"bodyAngularRateWrtEi_deg_s_{name}": rate[i] for i, name in enumerate(("Roll", "Pitch", "Yaw"))},
        "speedOfSound_ft_s": air.sound_speed,
        "airDensity_slug_ft3": air.density,
        "ambientPressure_lbf_ft2": air.pressure,
        "ambientTemperature_dgR": air.temperature,
        **{f"aero_bodyForce_lbf_{axis}": wrench.force[i] for i, axis in enumerate("XYZ")},
        **{f"aero_bodyMoment_ftlbf_{axis}": wrench.moment[i] for i, axis in enumerate("LMN")},
        "mach": flight.flow.mach,
        "trueAirspeed_nmi_h": flight.flow.speed,
    }


def signals(body: RigidBody, t: Any, x: RigidBodyState) -> dict[str, Any]:
    """Return signals of a body in the air by NASA's names, in SI units."""
    flight = body.flight(t, x)
    wrench = body.aerodynamics.wrench(flight.flow) if body.aerodynamics is not None else NO_WRENCH
    return name_signals(flight, x.rate, wrench)


@functools.cache
def fly(case: str, seconds: int = 30, step: float = STEP) -> dict[str, Any]:
    """Return the signals of a case by NASA's names, once per second (seconds + 1,), with "time".

    The loop is compiled to C.
    """
    body, start, _ = cases()[case]
    n = round(1 / step)

    def go(body: RigidBody, x: RigidBodyState) -> dict[str, Any]:
        def advance(i: Any, carry: Any) -> Any:
            k, x = carry
            t = k * 1.0 + i * step
            return k, rk4(lambda s, y: body.dynamics(s, y, NO_WRENCH), t, x, step)

        def second(x: RigidBodyState, k: Any) -> Any:
            row = signals(body, k * 1.0, x)
            return jax.lax.fori_loop(0, n, advance, (k, x))[1], row

        return jax.lax.scan(second, x, jnp.arange(seconds + 1))[1]

    rows = trimtab.compile(go, body, start)(body, start)
    return {"time": np.arange(seconds + 1.0), **{name: np.asarray(row) for name, row in rows.items()}}
