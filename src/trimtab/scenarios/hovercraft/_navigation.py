"""Navigation of the hovercraft: the thesis's model of navigation errors, or the navigation system itself.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, sections
5.4, 5.5 and 6.1. Reconstructed: the hall, where beacons and units sit, and errors of survey and temperature.
"""

from collections.abc import Mapping
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np

from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.record import replace
from trimtab.core.time import ms, seconds
from trimtab.environment.acoustics import Air
from trimtab.estimators.inertial.aided import Intake
from trimtab.estimators.inertial.coupled import AidedInertialCoupled
from trimtab.estimators.inertial.direct import AidedInertialDirect
from trimtab.estimators.inertial.dual_filter import InertialNoise
from trimtab.estimators.inertial.feedback import AidedInertialFeedback
from trimtab.estimators.inertial.feedforward import AidedInertialFeedforward
from trimtab.estimators.inertial.mechanisation import InertialStart
from trimtab.estimators.passthrough import Passthrough
from trimtab.estimators.ranging.particle import Particle
from trimtab.estimators.ranging.position import PAIR, RangingPosition
from trimtab.estimators.ranging.tightly_coupled import TightlyCoupled
from trimtab.estimators.ranging.ultrasonic_inertial import UltrasonicInertial
from trimtab.links.slave_bus import SlaveBus
from trimtab.loop.relayed_sensor import RelayedSensor
from trimtab.sensors.imu import Imu
from trimtab.sensors.magnetometer import Magnetometer
from trimtab.sensors.navigation_errors import NavigationErrors
from trimtab.sensors.time_of_flight import Beacons, Medium
from trimtab.sensors.ultrasonic_ranging import UltrasonicRanging

Positioning = Literal["ins", "ins-magnetometer", "ins-coupled", "ins-feedforward", "ins-direct", "tight", "particle"]
"""Navigations that estimate the position."""
Kind = Literal["errors", Positioning]
Navigation = Annotated[
    Kind,
    {
        "errors": "the thesis's model of its navigation errors",
        "ins": "IMU, fixes of the ultrasonic network, dual filters with feedback of the estimated errors",
        "ins-magnetometer": "ins with the heading from the magnetometer instead of two ultrasonic units",
        "ins-coupled": "one filter for heading and motion, so that positions also correct the heading",
        "ins-feedforward": "the dual filters as in the thesis: errors are subtracted outside the navigation",
        "ins-direct": "dual filters of the state itself, not of its errors",
        "tight": "tightly coupled: each raw range goes into one filter with the IMU",
        "particle": "a particle filter that uses raw ranges and the IMU",
    },
]
FORMS: dict[str, Any] = {
    "ins": AidedInertialFeedback,
    "ins-magnetometer": AidedInertialFeedback,
    "ins-coupled": AidedInertialCoupled,
    "ins-feedforward": AidedInertialFeedforward,
    "ins-direct": AidedInertialDirect,
}
"""INS form that receives the fixes."""

Bus = Literal["none", "slave"]
"""slave: the ultrasonic units are connected to a second microcontroller, and their samples pass a slow bus to the one
with the radio. none: their samples arrive at once."""

CEILING, SPACING = 4.0, 3.4
"""Height of the beacons and distance between them (m): three or more are received all over the floor, mostly four."""
NOISE = InertialNoise(
    gyro=1.6e-4,
    gyro_walk=1e-6,
    forward=6.8e-3,
    starboard=6.8e-3,
    force_walk=3e-4,
    position_constant=0.008,
    heading_constant=0.012,
)
"""IMU: the maker's white noise; walks that cover scale factor, misalignment and bandwidth in manoeuvres."""
START = InertialStart(sigma_gyro_bias=0.02, sigma_force_bias=0.15)
IMU = Imu.microstrain_3dm_gx1()
INTAKE = Intake(gap=ms(150), lag=seconds(round(np.sqrt(2) / (2 * np.pi * float(IMU.gyro.bandwidth)), 4)))
"""A link with jitter has gaps longer than the usual 40 ms; the IMU's readings are 7.5 ms old: its low pass."""
MESSAGE = 5 + 1 + 6 * 3
"""Bytes of a ping on the bus: header, unit, and number and range of each beacon that replied, six at most below these
beacons."""
SLAVE = SlaveBus(size=MESSAGE, queue=ms(40), capacity=42)
"""A ping is at most 31 ms in transit, and the next one comes 100 ms later: nothing waits, nothing is dropped."""
Floor = tuple[float, float, float, float]
"""Default floor: north from, to, east from, to (m)."""


def hall_beacons(floor: Floor) -> Beacons:
    """Return beacons on a square grid below the ceiling."""
    south, north, west, east = floor

    def across(low: float, high: float) -> Any:
        n = int(np.ceil((high - low) / SPACING))
        return (low + high - n * SPACING) / 2 + SPACING * np.arange(n + 1)

    grid = [(x, y, -CEILING) for x in across(south, north) for y in across(west, east)]
    return Beacons(map=np.array(grid), survey_error=0.005)


def choose_navigation(
    navigation: Navigation, errors: NavigationErrors | None, floor: Floor, bus: Bus = "none"
) -> tuple[Mapping[str, Any], Any]:
    """Return the sensors by name, and the estimator that reads them.

    Args:
        navigation: name of the navigation.
        errors: the error model, the thesis's when None.
        floor: over which the vehicle may move (m).
        bus: what lies between the ultrasonic units and the radio.
    """
    if navigation == "errors":
        if bus != "none":
            problem = "the bus needs ultrasonic units: this navigation is the error model"
            raise InputError(
                argument_name("settings", "bus"),
                problem,
                fix=f"{argument('navigation', 'ins')} {argument('settings', 'slave', 'bus')}",
            )
        return {"navigation": errors or NavigationErrors()}, Passthrough("navigation")
    beacons = hall_beacons(floor)
    medium = Medium(actual=replace(Air(), temperature=293.65))  # half a degree warmer than assumed
    ranging: Any = UltrasonicRanging(beacons=beacons, units=PAIR, clients=2, medium=medium)
    if bus == "slave":
        ranging = RelayedSensor(inner=ranging, bus=SLAVE)
    sensors = {"imu": IMU, "ranging": ranging}
    if navigation == "ins-magnetometer":
        sensors["magnetometer"] = Magnetometer.microstrain_3dm_gx1()
    return sensors, _make_estimator(navigation, beacons.map)


def _make_estimator(navigation: Kind, beacons: Any) -> Any:
    """Return the estimator on IMU and ranges; the raw-range filters consider constant errors themselves.

    The tightly coupled one begins as the INS does, not from its own closed form: that waits for a gyro which
    `hovercraft/zero-velocity` saturates until a law brakes it, and the law for an estimate.
    """
    if navigation in ("tight", "particle"):
        noise = replace(NOISE, position_constant=0.0, heading_constant=0.0)
        form: Any = partial(TightlyCoupled, begins="given") if navigation == "tight" else Particle
        intake = replace(form().intake, gap=INTAKE.gap, lag=INTAKE.lag)
        return form(intake=intake, noise=noise, start=START, beacons=beacons, units=PAIR)
    magnetometer = "magnetometer" if navigation == "ins-magnetometer" else ""
    noise = replace(NOISE, heading_constant=0.0) if magnetometer else NOISE
    return UltrasonicInertial(
        positioning=RangingPosition(beacons=beacons, units=PAIR),
        inertial=FORMS[navigation](noise=noise, start=START, intake=INTAKE),
        magnetometer=magnetometer,
    )
