"""Follow way-points in a current by line of sight, with a model ship that is steered from the shore over a radio."""

from typing import Annotated, Any, Literal

import numpy as np

from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.core.record import replace
from trimtab.core.reference import Circle, FigureEight, PiecewisePath
from trimtab.core.time import ms, seconds
from trimtab.environment.current import Current
from trimtab.environment.wind import Wind
from trimtab.estimators.passthrough import Passthrough
from trimtab.laws.line_of_sight import LineOfSight
from trimtab.links.latency import MeasuredLatency, gamma_table
from trimtab.links.wire import Wire
from trimtab.logs.metrics import Target
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.reference_text import start_pose
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World
from trimtab.sensors.planar_pose import NoisyPlanarPose, PlanarPose
from trimtab.vehicles.surface_vessel import SurfaceVessel, VesselControls, VesselState, WindLoad

Path = Annotated[
    Literal["waypoints", "circle", "eight"],
    {
        "waypoints": "three straight legs with corners of 53 degrees",
        "circle": "circle of radius 5 m",
        "eight": "figure eight of 20 m by 12 m",
    },
]
Links = Annotated[
    Literal["radio", "none"],
    {
        "radio": "latency of about 80 ms each way with 20 ms of jitter, 2 % of packets lost",
        "none": "no radio link, because the autopilot is on board",
    },
]
Weather = Annotated[
    Literal["current", "breeze", "calm"],
    {
        "current": "a current of 0.14 m/s from the north-east",
        "breeze": "a current of 0.14 m/s from the north-east, and a wind of 4 m/s",
        "calm": "no current and no wind",
    },
]
TICK = ms(50)
PLACES = ((0.0, 0.0), (12.0, 0.0), (18.0, 8.0), (60.0, 8.0))
"""North and east (m) of the way-points."""
SPEED = 0.58


def scenario(reference: Path = "waypoints", links: Links = "radio", weather: Weather = "current") -> Scenario:
    """Return the path following scenario. The vessel is that of Skjetne, Smogeli and Fossen (2004).

    Path, radio, weather and gains are our choice. The vessel starts 1.5 m to starboard of the path, at 0.5 m/s.
    """
    paths: dict[str, Any] = {
        "waypoints": straight_legs(PLACES, SPEED),
        "circle": Circle(radius=5.0, period=54.0, north=5.0),
        "eight": FigureEight(length=20.0, width=12.0, period=100.0, north=10.0),
    }
    vessel = SurfaceVessel()
    if weather != "calm":
        vessel = replace(vessel, current=Current(north=-0.1, east=-0.1))
    if weather == "breeze":
        vessel = replace(vessel, wind=WindLoad(wind=Wind(north=-2.8, east=2.8)))
    path = paths[reference]
    north, east, heading = start_pose(path, 0.0)
    beside = north - 1.5 * np.sin(heading), east + 1.5 * np.cos(heading)
    initial = VesselState(
        surge_velocity=0.5, north=round(beside[0], 6), east=round(beside[1], 6), heading=heading, shaft_speed=90.0
    )
    world = World(
        vehicle=vessel,
        sensors={
            "navigation": NoisyPlanarPose(
                position_noise=0.03, velocity_noise=0.02, heading_noise=0.01, rate_noise=0.01, period=TICK
            )
        },
        downlink=_link(links),
        uplink=_link(links),
        actuators=DirectActuation(neutral_input=VesselControls(0.0, 0.0), period=TICK),
        max_step=TICK,
    )
    autopilot = Autopilot(Passthrough("navigation"), LineOfSight(reference=path), DirectAllocation(), TICK)
    return Scenario(
        world=world,
        autopilot=autopilot,
        initial=initial,
        duration=seconds(60),
        targets=(Target("law.cross_track", 0.0, 0.4), Target("truth.surge_velocity", SPEED, 0.1)),
        truth_sensor=PlanarPose(),
        name="vessel/path",
    )


def straight_legs(places: tuple[tuple[float, float], ...], speed: float) -> PiecewisePath:
    """Return a path of straight legs between way-points, at constant speed (m/s). The corners are not rounded.

    places: north and east (m) of each way-point.
    """
    x = np.asarray(places)
    legs = np.diff(x, axis=0)
    times = np.append(0.0, np.cumsum(np.sqrt((legs**2).sum(axis=1)))) / speed
    pieces = np.zeros((len(legs), 6, 3))
    pieces[:, 0, :2], pieces[:, 1, :2] = x[:-1], legs / np.diff(times)[:, None]
    return PiecewisePath(times, pieces, False)


def _link(links: Links) -> Any:
    if links == "none":
        return Wire(period=TICK)
    latency = np.round(gamma_table(mean=0.08, sd=0.02, shift=0.04), 5)
    return MeasuredLatency(latency=latency, loss=0.02, send_period=TICK, period=TICK, capacity=16)
