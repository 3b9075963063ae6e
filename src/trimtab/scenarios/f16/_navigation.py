"""Navigation of the F-16: instruments that measure all values that the law reads, or a filter of IMU, GNSS and air
data.

The sensor positions and the sensor errors are our assumptions, without a source.
"""

from typing import Annotated, Any, Literal

import numpy as np

from trimtab.core.record import replace
from trimtab.core.rotation import DEG
from trimtab.core.time import ms, seconds
from trimtab.estimators.inertial.air_inertial import AirInertial
from trimtab.estimators.inertial.error_state import SpatialStart
from trimtab.estimators.inertial.gnss_inertial import GnssInertial
from trimtab.estimators.passthrough import Passthrough
from trimtab.sensors.air_data import AirData
from trimtab.sensors.flight_instruments import FlightInstruments
from trimtab.sensors.gnss import Gnss, Outages
from trimtab.sensors.imu import AccelerometerErrors, GyroErrors, Imu
from trimtab.vehicles.f16_flat_earth import GRAVITY, F16State
from trimtab.vehicles.imperial import FOOT

Navigation = Annotated[
    Literal["instruments", "gnss-inertial"],
    {
        "instruments": "instruments that measure all values that the law reads, each with its own error",
        "gnss-inertial": "error-state filter of inertial unit, delayed GNSS fixes, pitot tube and flow vanes",
    },
]
TICK = ms(10)
STATION = (15 * FOOT, 0.0, 0.0)
"""Position of the accelerometers relative to the centre of mass, in body axes (m)."""
ANTENNA = (10 * FOOT, 0.0, -4 * FOOT)
"""Position of the GNSS antenna, behind the cockpit, relative to the centre of mass, in body axes (m)."""
OUTAGE = Outages(start=seconds(2), length=ms(2500))
"""Outage of the GNSS receiver while the aircraft rolls and pulls up, because the antenna does not face the sky then."""
INSTRUMENTS = FlightInstruments(
    lever_arm=STATION,
    speed_noise=0.5,
    vane_noise=0.1 * DEG,
    altitude_noise=1.0,
    attitude_noise=0.05 * DEG,
    rate_noise=0.1 * DEG,
    load_noise=0.01,
    speed_bias=1.0,
    vane_bias=0.25 * DEG,
    altitude_bias=5.0,
    attitude_bias=0.2 * DEG,
    rate_bias=0.05 * DEG,
    load_bias=0.01,
    period=TICK,
)
"""Instruments of medium quality. The error sizes are our assumptions, without a source."""


def equipment(navigation: str, first: F16State) -> tuple[dict[str, Any], Any]:
    """Return the sensors, by name, and the estimator of a navigation system. first: initial state of the aircraft."""
    if navigation == "instruments":
        return {"instruments": INSTRUMENTS}, Passthrough("instruments")
    down = (0.0, 0.0, GRAVITY)
    unit = Imu(
        accelerometer=AccelerometerErrors(noise=2e-3, turn_on_bias=0.05, bias_walk=2e-4, range=160.0),
        gyro=GyroErrors(noise=2e-4, turn_on_bias=0.05 * DEG, bias_walk=1e-5, range=35.0),
        lever_arm=STATION,
        gravity=down,
        period=TICK,
    )
    sensors = {"imu": unit, "gnss": Gnss(lever_arm=ANTENNA, outages=OUTAGE), "air": AirData(upwash=0.0, period=TICK)}
    inertial = GnssInertial(
        start=aligned_start(first),
        lever_arm=np.subtract(ANTENNA, STATION),
        gravity=down,
        slots=24,
        samples_per_propagation=2,
    )
    return sensors, AirInertial(inertial=inertial, lever_arm=STATION)


def aligned_start(first: F16State) -> SpatialStart:
    """Return the filter's initial estimate, as it would be after a long flight.

    Most values differ from the true state by about one standard deviation.
    """
    start = SpatialStart(sigma_tilt=0.3 * DEG, sigma_heading=1.0 * DEG, sigma_position=1.0, sigma_gyro_bias=0.05 * DEG)
    tilt, heading = start.sigma_tilt, start.sigma_heading
    angles = np.array([first.roll, first.pitch, first.yaw], float)
    place = np.array([first.north, first.east, -first.altitude], float)
    return replace(
        start,
        angles=np.round(angles + np.array([0.7 * tilt, -0.6 * tilt, 0.8 * heading]), 6),
        velocity=np.round(_velocity(first) + start.sigma_velocity * np.array([0.5, -0.8, 0.4]), 6),
        position=np.round(place + _ahead(angles) + start.sigma_position * np.array([-0.7, 0.9, 0.5]), 6),
    )


def _rotation(angles: Any) -> Any:
    """Return the rotation matrix R_WB (3, 3) for roll, pitch, yaw (rad).

    It is computed with numpy, so that the result is the same, bit for bit, on every machine.
    """
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles), np.sin(angles)
    return np.array(
        [
            [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
            [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
            [-sp, sr * cp, cr * cp],
        ]
    )


def _ahead(angles: Any) -> Any:
    """Return the vector (3,) from the centre of mass to the inertial unit (m), in the world frame W."""
    return _rotation(angles) @ np.asarray(STATION)


def _velocity(x: F16State) -> Any:
    """Return the velocity (3,) of the centre of mass (m/s) in the world frame W, for flight without sideslip.

    The aircraft does not rotate, so this is also the velocity of the inertial unit.
    """
    along = x.speed * np.array([np.cos(x.alpha), 0.0, np.sin(x.alpha)])
    return _rotation(np.array([x.roll, x.pitch, x.yaw], float)) @ along
