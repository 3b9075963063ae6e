"""Navigation of the hovercraft: a model of navigation errors, or a simulated navigation system with its sensors.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, sections
5.4, 5.5 and 6.1. The hall, the positions of beacons and ultrasonic units, and the errors of beacon survey and air
temperature are our own choice.
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
"""Navigation systems that estimate the position."""
Kind = Literal["errors", Positioning]
Navigation = Annotated[
    Kind,
    {
        "errors": "true state with random errors from the thesis's model of navigation errors",
        "ins": "INS with IMU, ultrasonic fixes and dual filters, whose estimated errors are fed back to the INS",
        "ins-magnetometer": "INS as in ins, but with heading from a magnetometer instead of ultrasonic units",
        "ins-coupled": "INS with one filter for heading and motion, so that position fixes also correct the heading",
        "ins-feedforward": "INS with the dual filters of the thesis; estimated errors are subtracted from its output",
        "ins-direct": "INS with dual filters that estimate the state instead of its errors",
        "tight": "tightly coupled filter that uses the IMU and each raw range",
        "particle": "particle filter that uses the IMU and each raw range",
    },
]
FORMS: dict[str, Any] = {
    "ins": AidedInertialFeedback,
    "ins-magnetometer": AidedInertialFeedback,
    "ins-coupled": AidedInertialCoupled,
    "ins-feedforward": AidedInertialFeedforward,
    "ins-direct": AidedInertialDirect,
}
"""Name of the navigation system -> class of the INS that processes the position fixes."""

Bus = Literal["none", "slave"]
"""Bus between the ultrasonic units and the radio on board the hovercraft.

slave: the units are connected to a second microcontroller, and a slow bus carries the samples to the
microcontroller with the radio. none: the samples reach the radio without delay.
"""

CEILING, SPACING = 4.0, 3.4
"""Height of the beacons above the floor, and distance between beacons (m). An ultrasonic unit receives at least
three beacons everywhere on the floor, and four beacons in most positions."""
NOISE = InertialNoise(
    gyro=1.6e-4,
    gyro_walk=1e-6,
    forward=6.8e-3,
    starboard=6.8e-3,
    force_walk=3e-4,
    position_constant=0.008,
    heading_constant=0.012,
)
"""Noise of the IMU that the filter assumes.

The white noise is from the data sheet. The random walks are larger, to cover errors of scale factor, misalignment and
bandwidth during manoeuvres.
"""
START = InertialStart(sigma_gyro_bias=0.02, sigma_force_bias=0.15)
IMU = Imu.microstrain_3dm_gx1()
INTAKE = Intake(gap=ms(150), lag=seconds(round(np.sqrt(2) / (2 * np.pi * float(IMU.gyro.bandwidth)), 4)))
"""Selection of the samples for the filter. Gaps of up to 150 ms between samples are allowed, because a radio link with
jitter has longer gaps than the usual 40 ms. The lag is that of the IMU's low-pass filter, 7.5 ms."""
MESSAGE = 5 + 1 + 6 * 3
"""Size (bytes) of one measurement on the bus: header, number of the unit, and number and range of each beacon that
replied. At most six beacons reply."""
SLAVE = SlaveBus(size=MESSAGE, queue=ms(40), capacity=42)
"""Bus of the second microcontroller. The transmission of a message takes at most 31 ms, and messages are sent every
100 ms. Therefore no message waits in the queue or is dropped."""
Floor = tuple[float, float, float, float]
"""Limits of the floor area (m): south, north, west, east."""


def hall_beacons(floor: Floor) -> Beacons:
    """Return beacons on a square grid under the ceiling of a hall, above all of the floor area."""
    south, north, west, east = floor

    def across(low: float, high: float) -> Any:
        n = int(np.ceil((high - low) / SPACING))
        return (low + high - n * SPACING) / 2 + SPACING * np.arange(n + 1)

    grid = [(x, y, -CEILING) for x in across(south, north) for y in across(west, east)]
    return Beacons(map=np.array(grid), survey_error=0.005)


def choose_navigation(
    navigation: Navigation, errors: NavigationErrors | None, floor: Floor, bus: Bus = "none"
) -> tuple[Mapping[str, Any], Any]:
    """Return the sensors, by name, and the estimator of a navigation system.

    Args:
        navigation: name of the navigation system.
        errors: model of navigation errors, used only for navigation "errors". None: the model of the thesis.
        floor: floor area on which the vehicle may move (m).
        bus: bus between the ultrasonic units and the radio.
    """
    if navigation == "errors":
        if bus != "none":
            problem = 'the bus carries ultrasonic samples, but navigation "errors" has no ultrasonic units'
            raise InputError(
                argument_name("settings", "bus"),
                problem,
                fix=f"{argument('navigation', 'ins')} {argument('settings', 'slave', 'bus')}",
            )
        return {"navigation": errors or NavigationErrors()}, Passthrough("navigation")
    beacons = hall_beacons(floor)
    medium = Medium(actual=replace(Air(), temperature=293.65))  # half a degree warmer than the estimator assumes
    ranging: Any = UltrasonicRanging(beacons=beacons, units=PAIR, clients=2, medium=medium)
    if bus == "slave":
        ranging = RelayedSensor(inner=ranging, bus=SLAVE)
    sensors = {"imu": IMU, "ranging": ranging}
    if navigation == "ins-magnetometer":
        sensors["magnetometer"] = Magnetometer.microstrain_3dm_gx1()
    return sensors, _make_estimator(navigation, beacons.map)


def _make_estimator(navigation: Kind, beacons: Any) -> Any:
    """Return the estimator that uses the IMU and the ultrasonic ranges.

    The filters of raw ranges ("tight", "particle") model constant errors themselves. The tightly coupled filter starts
    from the given initial state, as the INS does. It could estimate the initial state only if the gyro were not
    saturated. In `hovercraft/zero-velocity`, the gyro is saturated until the law has braked the craft, but the law
    waits for an estimate.
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
