"""Navigate a figure eight in the air with inertial unit and satellite receiver, with delayed fixes and an outage."""

import math
from typing import Annotated, Any, Literal

import jax
import numpy as np

from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.core.record import replace
from trimtab.core.rotation import DEG, to_euler
from trimtab.core.time import ms, seconds
from trimtab.estimators.inertial.error_state import SpatialStart
from trimtab.estimators.inertial.gnss_inertial import GnssInertial
from trimtab.estimators.inertial.gnss_measurements import GnssNoise
from trimtab.laws.turntable import Turntable
from trimtab.links.wire import Wire
from trimtab.logs.metrics import Target
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World
from trimtab.sensors.gnss import Gnss, Outages
from trimtab.sensors.gnss_ranges import GnssRanges
from trimtab.sensors.imu import AccelerometerErrors, GyroErrors, Imu
from trimtab.vehicles.closed_path import ClosedPath
from trimtab.vehicles.rotating_platform import PlatformDrive

Aiding = Annotated[
    Literal["fixes", "ranges"],
    {
        "fixes": "the receiver measures position and velocity, and nothing during the outage",
        "ranges": "the receiver measures pseudoranges and range rates to eight satellites, and to two in the outage",
    },
]
TICK = ms(1)
LAP = 2 * math.pi / 20
"""Angular rate on the path (rad/s): one lap in 20 s."""
OUTAGE = Outages(start=seconds(9), length=seconds(4))
CORRELATED = 0.3
"""Standard deviation of the GNSS receiver's time-correlated position error (m)."""


def industrial_imu() -> Imu:
    """Return a good micromachined inertial unit with a sampling rate of 1 kHz.

    Its errors are our assumptions, typical of data sheets.
    """
    return Imu(
        accelerometer=AccelerometerErrors(noise=2e-3, turn_on_bias=0.05, bias_walk=2e-4, range=160.0),
        gyro=GyroErrors(noise=2e-4, turn_on_bias=0.3 * DEG, bias_walk=1e-5, range=35.0),
        period=TICK,
    )


def scenario(gnss: Aiding = "fixes") -> Scenario:
    """Return the scenario of the figure eight in the air. All parameters are our choice.

    A lap takes 20 s. The inertial unit is sampled at 1 kHz. The receiver measures five fixes per second, which arrive
    with a delay of 120 ms, and has an outage of 4 s.
    """
    path = ClosedPath(coordinated=LAP)
    first = jax.tree.map(lambda number: np.round(number, 12), path.at(0.0, LAP))  # the same bits on each machine
    receiver = Gnss(outages=OUTAGE, correlated=CORRELATED)
    if gnss == "ranges":
        receiver = GnssRanges(outages=OUTAGE, correlated=CORRELATED)
    world = World(
        vehicle=path,
        sensors={"imu": industrial_imu(), "gnss": receiver},
        downlink=Wire(),
        uplink=Wire(period=ms(10)),
        actuators=DirectActuation(neutral_input=PlatformDrive(rate=LAP), period=ms(10)),
    )
    navigation = GnssInertial(aiding=gnss, receiver=GnssNoise(constant=CORRELATED), start=rough_start(path, first))
    autopilot = Autopilot(estimator=navigation, law=Turntable(rate=LAP, ramp=0.0), allocation=DirectAllocation())
    return Scenario(
        world=world,
        autopilot=autopilot,
        initial=first,
        duration=seconds(20),
        targets=(Target("truth.rate", LAP, 0.01),),
        name="navigation/aerial",
    )


def rough_start(path: ClosedPath, first: Any) -> SpatialStart:
    """Return the filter's initial estimate. Most values differ from the true state by about one standard deviation."""
    start = SpatialStart()
    angles = np.asarray(to_euler(path.rotation(first.angle)))
    off = np.array([0.6, -0.8, 1.0]) * [start.sigma_tilt, start.sigma_tilt, start.sigma_heading]
    return replace(
        start,
        angles=np.round(angles + off, 6),
        velocity=np.round(first.velocity + start.sigma_velocity * np.array([0.5, -0.8, 0.4]), 6),
        position=np.round(first.position + start.sigma_position * np.array([-0.7, 0.9, 0.5]), 6),
    )
