"""Fly hovercraft in formation. Each craft measures its own state, and receives messages of the others by radio."""

import math
from typing import Annotated, Any, Literal

import numpy as np

from trimtab.actuators.allocation import ThrustVectorAllocation
from trimtab.actuators.drive import FanDrive
from trimtab.core.signals import Estimate, PeerMessage, Peers, PeerView
from trimtab.core.time import NEVER, ms, seconds
from trimtab.estimators.passthrough import Passthrough
from trimtab.laws.formation import Formation
from trimtab.links.wire import Wire
from trimtab.logs.metrics import Target
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.peer_radio import Arena, PeerRadio, PerfectSwarmNavigation, SwarmNavigation
from trimtab.loop.scenario import Scenario
from trimtab.loop.swarm import Each, Swarm, SwarmActuators, SwarmAllocation
from trimtab.loop.world import World
from trimtab.sensors.planar_pose import NoisyPlanarPose, PlanarPose, PlanarPoseState
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

Craft = Literal["5", "3", "10", "100"]
Route = Annotated[
    Literal["circle", "fixed"], {"circle": "the leader moves on a circle", "fixed": "the leader keeps its position"}
]
Start = Annotated[
    Literal["rows", "swapped"],
    {
        "rows": "craft start in rows, 2.4 m apart, each near its position in the formation",
        "swapped": "each craft starts opposite its position in the formation, so that all paths cross",
    },
]
SPACING = 3.0
"""Distance between neighbouring positions of the formation (m)."""
RADIUS = 4.0
"""Radius of the leader's circle (m)."""
TICK, PERIOD = ms(5), ms(20)


def scenario(craft: Craft = "5", route: Route = "circle", start: Start = "rows") -> Scenario:
    """Return the formation scenario. All parameters are our choice.

    The radio has slots of 5 ms, a latency of 20 ms, and loses a tenth of all messages.
    """
    n = int(craft)
    places = hexagonal_places(n)
    own = {"number": np.arange(n, dtype=np.int32), "north": places[:, 0], "east": places[:, 1]}
    law = Formation(radius=RADIUS if route == "circle" else 0.0, **own)
    silence = PeerMessage(np.full(n, NEVER), *np.zeros((4, n)))
    world = World(
        vehicle=Swarm(Hovercraft(), n),
        sensors={
            "craft": SwarmNavigation(Each(NoisyPlanarPose(period=TICK), n), PeerRadio(n, TICK, loss=0.1)),
            "arena": Arena(places[:, 0], places[:, 1], period=PERIOD),
        },
        downlink=Wire(period=TICK),
        uplink=Wire(period=PERIOD),
        actuators=SwarmActuators(Each(FanDrive(period=PERIOD), n), silence),
        max_step=TICK,
    )
    autopilot = Autopilot(
        estimator=Passthrough("craft"),
        law=Each(law, n, tuple(own)),
        allocation=SwarmAllocation(Each(ThrustVectorAllocation(), n)),
        period=PERIOD,
    )
    return Scenario(
        world=world,
        autopilot=autopilot,
        initial=_initial_state(places, start, law),
        duration=seconds(60 if n <= 10 else 150),
        targets=(
            Target("sensors.arena.value.spacing", SPACING, 0.5),
            Target("sensors.arena.value.formation_error", 0.0, 0.5),
        ),
        truth_sensor=PerfectSwarmNavigation(Each(PlanarPose(), n)),
        name="swarm/formation",
    )


def craft_step(t: Any, state: Any, own: Any, heard: Any, number: Any, north: Any, east: Any) -> tuple[Any, Any, Any]:
    """Run the law and the allocation of one craft at integer time t. This function can be exported to the craft's
    firmware.

    Args:     state: state of the law.    own: estimated PlanarPoseState.    heard: newest message of each of n craft.
              number: number of the craft.    north, east: position of the craft relative to craft 0 (m).
    Returns:  new state of the law, DriveCommand, and PeerMessage to broadcast.
    """
    law = Formation(number=number, north=north, east=east, radius=RADIUS)
    estimate = Estimate(t=t, age=0.0, fresh=True, valid=True, state=PeerView(own, Peers(heard)))
    state, out = law.step(t, state, estimate)
    return state, ThrustVectorAllocation().step(t, (), out.demand.act)[1], out.demand.message


example = {
    "craft_step": (
        np.int64(0),
        Formation().init(None),
        PlanarPoseState(*np.zeros(6)),
        (np.arange(5), *np.linspace(0.0, 9.0, 20).reshape(4, 5)),
        np.int32(1),
        3.0,
        0.0,
    )
}
"""Example arguments for `trimtab export trimtab.scenarios.swarm.formation:craft_step`, for five craft."""


def hexagonal_places(n: int) -> Any:
    """Return the n points of a hexagonal lattice nearest to the origin, (n, 2) (m). The first point is the origin."""
    reach = math.isqrt(n) + 2
    i, j = (v.ravel() for v in np.meshgrid(range(-reach, reach + 1), range(-reach, reach + 1)))
    north, east = SPACING * math.sqrt(3) / 2 * i, SPACING * (j + i / 2)
    order = np.lexsort((np.arctan2(east, north).round(6), (north**2 + east**2).round(6)))
    return np.stack([north, east], axis=1)[order[:n]]


def _initial_state(places: Any, start: str, law: Formation) -> HovercraftState:
    from scipy import optimize  # the import takes a fifth of a second, and only this start needs it

    n = len(places)
    if start == "swapped":
        north, east = -places.T
    else:
        wide = math.ceil(math.sqrt(n))
        row, column = np.divmod(np.arange(n), wide)
        rows = 2.4 * (np.stack([row, column], axis=1) - (wide - 1) / 2)
        away = ((places[:, None] - rows) ** 2).sum(axis=2)
        north, east = rows[optimize.linear_sum_assignment(away)[1]].T
    shift = float(law.radius)
    zero = np.zeros(n)
    return HovercraftState(zero, zero, zero, north + shift, east, zero)
