"""Autopilot of the F-16's cases: two linear-quadratic regulators, and their commands.

Its gains are those of F16_control.dml and F16_gnc.dml of [1], per knot, degree and rad/s, for 10 013 ft and 287.8
knots. The true state is fed back. The autopilot has no estimator and no internal state.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from studies.nesc2015._data import FOOT, KNOT
from trimtab.core.rotation import DEG, wrap
from trimtab.environment.atmosphere import standard_atmosphere
from trimtab.vehicles.f16 import F16Controls, flow_angles
from trimtab.vehicles.rigid_body import FlightCondition

ALONG = np.array(
    [
        [-0.063009074230494, 0.113230403179271, 10.113432224566077, 3.154983341632913],
        [0.997260602961658, -0.025467711176391, 1.213308488207827, 0.208744369535208],
    ]
)
"""Gains of stick and throttle over speed (knots), angle of attack (deg), pitch rate (rad/s), pitch (deg)."""
ASIDE = np.array(
    [
        [3.078043941515770, 0.032365863044163, 4.557858908828332, 0.589443156647647],
        [-0.705817452754520, -0.256362860634868, -1.073666149713151, 0.822114635953878],
    ]
)
"""Gains of stick and pedals over roll, sideslip (deg), roll rate, yaw rate (rad/s)."""
TRIM_STICK, TRIM_ANGLE = 0.1296382327486013, 2.653813535191715
"""Stick at the design point, and angle of attack there, which equals pitch (deg)."""
SEA_DENSITY = standard_atmosphere(0.0).density
MILE, DEGREE = 6076.12, 60 * 6076.12
"""Length of a nautical mile, and of a degree of latitude (ft)."""


class Command(NamedTuple):
    """Commands that the autopilot holds.

    altitude: ft.  speed: equivalent airspeed, knots.  course: deg from north.  offset: to the right of the track, ft.
    """

    altitude: Any
    speed: Any
    course: Any
    offset: Any


def control(flight: FlightCondition, command: Command, *, stick: Any, throttle: Any, design: Any) -> F16Controls:
    """Return surfaces and throttle. stick, throttle: in trim.  design: angle of attack and pitch in trim (deg)."""
    alpha, beta = (angle / DEG for angle in flow_angles(flight.flow))
    roll, pitch, yaw = flight.angles / DEG
    p, q, r = flight.flow.rate
    speed = flight.flow.speed * jnp.sqrt(flight.flow.air.density / SEA_DENSITY) / KNOT
    climb = jnp.clip(-0.05 * (flight.height / FOOT - command.altitude), -5, 5)
    course = command.course + jnp.clip(-0.01 * command.offset, -30, 30)
    off = wrap((beta + yaw - course) * DEG) / DEG
    bank = jnp.clip(-10 * off, -30, 30)
    along = -ALONG @ jnp.stack([speed - command.speed, alpha - design, q, pitch - design - climb])
    aside = -ASIDE @ jnp.stack([roll - bank, beta, p, r])
    return move(stick + along[0], aside[0], aside[1], throttle + along[1])


def move(stick: Any, lateral: Any, pedals: Any, throttle: Any) -> F16Controls:
    """Return surfaces from the pilot's controls: stick aft and to the right, right pedal, -1 to 1; throttle 0 to 1."""
    aileron = -21.5 * jnp.clip(lateral, -1, 1)
    return F16Controls(
        elevator=-25 * jnp.clip(stick, -1, 1) * DEG,
        aileron=aileron * DEG,
        rudder=(-30 * jnp.clip(pedals, -1, 1) + 0.008 * aileron) * DEG,
        throttle=jnp.clip(throttle, 0, 1),
    )


def circle_pole(flight: FlightCondition) -> tuple[Any, Any]:
    """Return course (deg) and offset (ft) from a circle of three miles about the north pole."""
    return 90.0, DEGREE * (90 - flight.latitude / DEG) - 3 * MILE


def circle_date_line(flight: FlightCondition) -> tuple[Any, Any]:
    """Return course (deg) and offset (ft) from an anticlockwise circle of three miles about 0° N, 180° E."""
    longitude = flight.longitude / DEG
    north = flight.latitude / DEG * DEGREE
    east = jnp.where(longitude > 0, longitude - 180, longitude + 180) * DEGREE * jnp.cos(flight.latitude)
    return -jnp.arctan2(north, east) / DEG, jnp.sqrt(north**2 + east**2) - 3 * MILE
