"""Come to rest at a position and heading two metres away, by swings about the centre of percussion or in six steps."""

from typing import Annotated, Literal

from trimtab.core.record import replace
from trimtab.core.rotation import DEG
from trimtab.laws.pose import Pose
from trimtab.laws.pose_steps import PoseBySteps
from trimtab.logs.metrics import Target
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.hovercraft._navigation import Bus, Positioning
from trimtab.scenarios.hovercraft._thesis import Craft, Equipment, Fan, Links, Supervision, hovercraft_scenario
from trimtab.sensors.planar_pose import PlanarPose
from trimtab.vehicles.hovercraft import HovercraftState

SLOW = Pose(
    k=0.8,
    c=0.25,
    speed=0.5,
    kh=1.0,
    kr=3.0,
    turn_rate=0.6,
    aligned=0.1,
    near=0.3,
    rest_speed=0.15,
    far=0.6,
    leave_speed=0.5,
    swing=0.15,
    f=1.0,
    h=0.1,
    s0=0.01,
)
"""Pose law with gains for a loop delay of 80 ms and a fan that produces a side force only with forward thrust."""
PoseLaw = Annotated[
    Literal["swing", "steps"],
    {
        "swing": "law of trimtab: brake, aim, drive, then hold the pose by swinging the nose",
        "steps": "law of the thesis, which repeats a sequence of six steps",
    },
]


def scenario(
    law: PoseLaw = "swing",
    links: Links = "chain",
    navigation: Positioning = "ins",
    supervisor: Supervision = "none",
    bus: Bus = "none",
    craft: Craft = "thesis",
    fan: Fan = "reversible",
) -> Scenario:
    """Return the scenario of section 2.3.1 in the thesis (Kulis 2006). Initial state and duration are our choice."""
    equipment = Equipment(links, navigation, supervisor, bus, craft, fan)
    chosen = SLOW if law == "swing" else PoseBySteps()
    initial = HovercraftState(north=-1.5, east=1.5, heading=60 * DEG)
    targets = (Target("truth.north", 0.0, 0.6), Target("truth.east", 0.0, 0.6), Target("truth.heading", 0.0, 15 * DEG))
    flown = hovercraft_scenario("hovercraft/pose", chosen, initial, 90, targets, equipment, floor=(-8, 8, -8, 8))
    return replace(flown, truth_sensor=PlanarPose())
