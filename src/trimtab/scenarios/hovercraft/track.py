"""Track a timed path from rest: a circle, a figure eight, or way-points."""

from typing import Annotated, Literal

from trimtab.core.record import replace
from trimtab.core.reference import Circle, FigureEight, pass_waypoints
from trimtab.laws.path_tracking import PathTracking
from trimtab.laws.receding_horizon import RecedingHorizon
from trimtab.logs.metrics import Target
from trimtab.loop.reference_text import start_pose
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.hovercraft._navigation import Bus, Positioning
from trimtab.scenarios.hovercraft._thesis import Craft, Equipment, Fan, Links, Supervision, hovercraft_scenario
from trimtab.scenarios.hovercraft.pose import SLOW
from trimtab.sensors.planar_pose import PlanarPose
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

Path = Annotated[
    Literal["circle", "eight", "waypoints"],
    {
        "circle": "circle of radius 1.5 m, one lap in 20 s",
        "eight": "figure eight of 5 m by 1.5 m, one lap in 30 s; the thrust reverses at the crossing",
        "waypoints": "three straight legs of 3 m at 0.4 m/s, with rest at both ends",
    },
]
Progress = Annotated[
    Literal["time", "path"],
    {
        "time": "the reference point on the path moves with the clock",
        "path": "the reference point waits if the craft is behind, and moves faster if the craft is ahead",
    },
]
TrackingLaw = Annotated[
    Literal["lyapunov", "horizon"],
    {
        "lyapunov": "turn the nose to the required thrust direction; proved stable without limits of fan and rudder",
        "horizon": "predictive control; every 20 ms, the next 2.6 s are optimised within the limits of fan and rudder",
    },
]
NEAR = 0.2
"""Position error (m) up to which the craft counts as on the path."""
PLACES = ((0, 0), (3, 0), (3, 3), (0, 4))
"""North and east (m) of the way-points."""


def scenario(
    reference: Path = "circle",
    law: TrackingLaw = "lyapunov",
    progress: Progress = "time",
    links: Links = "chain",
    navigation: Positioning = "ins",
    supervisor: Supervision = "none",
    bus: Bus = "none",
    craft: Craft = "thesis",
    fan: Fan = "reversible",
) -> Scenario:
    """Return the path tracking scenario. Path and law are our choice.

    The craft starts at rest at the beginning of the path, with the nose in the direction of the path.
    """
    path = (
        pass_waypoints(PLACES, 0.4)
        if reference == "waypoints"
        else {"circle": Circle, "eight": FigureEight}[reference]()
    )
    lyapunov = PathTracking(reference=path, progress=progress, rest=SLOW)
    chosen = lyapunov if law == "lyapunov" else RecedingHorizon(reference=path)
    north, east, heading = start_pose(path, float(Hovercraft().percussion_arm))
    initial, floor = HovercraftState(north=north, east=east, heading=heading), (-6, 8, -6, 8)
    equipment = Equipment(links, navigation, supervisor, bus, craft, fan)
    near = Target("law.position_error", 0.0, NEAR)
    flown = hovercraft_scenario("hovercraft/track", chosen, initial, 90, (near,), equipment, floor=floor)
    return replace(flown, truth_sensor=PlanarPose())
