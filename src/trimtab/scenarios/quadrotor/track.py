"""Fly a quadrotor: follow a circle, eight or helix, hover, recover from upside down, fly with a stopped rotor."""

from typing import Annotated, Any, Literal

import numpy as np

from trimtab.actuators.rotor_allocation import RotorAllocation, RotorDrive
from trimtab.core.errors import InputError, argument
from trimtab.core.record import replace
from trimtab.core.reference import Circle, FigureEight
from trimtab.core.spatial_reference import FixedPlace, Helix, LevelPath
from trimtab.core.time import ms, seconds
from trimtab.design.relaxed_hover import relaxed_axes
from trimtab.estimators.passthrough import Passthrough
from trimtab.laws.geometric_tracking import GeometricTracking
from trimtab.laws.neural_policy import NeuralPolicy
from trimtab.laws.rotor_loss import RotorLossTracking
from trimtab.links.wire import DelayChain
from trimtab.logs.metrics import Target
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.fault_text import inject_faults
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World
from trimtab.sensors.multirotor_state import MultirotorStateSensor
from trimtab.vehicles.quadrotor import Multirotor, MultirotorState, Rotors

Trajectory = Annotated[
    Literal["circle", "eight", "helix", "place", "recovery"],
    {
        "circle": "circle of radius 1.5 m, one lap in 5 s",
        "eight": "figure eight of 5 m by 1.5 m, one lap in 8 s",
        "helix": "helix of Lee et al. (2010) at half the speed, with the nose to the north",
        "place": "hover at a position, after a start half a metre away",
        "recovery": "hover at a position, after a start upside down",
    },
]
MotorFault = Annotated[
    Literal["works", "1-fails", "2-fails", "3-fails", "4-fails"],
    {"works": "all four rotors work"}
    | {f"{k}-fails": f"rotor {k} stops at 2 s and stays stopped" for k in range(1, 5)},
]
LawChoice = Annotated[
    Literal["geometric", "neural"],
    {"geometric": "geometric law of Lee et al. (2010)", "neural": "small neural network trained on the geometric law"},
]
PERIOD = ms(5)
RATIO = 0.3
"""Thrust of the rotor opposite a failed rotor, as a fraction of the thrust of each of the other two rotors."""
LONGEST = 25.0
"""Maximum feedback force of the law (N). The force is limited, because the rotors cannot produce less than their
minimum thrust."""
HEIGHT = 3.0
"""Height of the reference paths above the ground (m)."""
CRAFT = replace(
    Multirotor(),
    rotors=replace(Rotors(), torque_ratio=0.026, inertia=6e-5),
    lag=0.02,
    drag=np.array([0.3, 0.3, 0.2]),
    turning_drag=np.array([0.01, 0.01, 0.04]),
)
"""Quadrotor of Lee et al. (2010). Its propellers have a ratio of torque to thrust of 0.026 m, which is typical of 15
inch propellers. Lag, drag and the rotors' inertia are our assumptions."""


def scenario(trajectory: Trajectory = "circle", motor: MotorFault = "works", law: LawChoice = "geometric") -> Scenario:
    """Return the quadrotor scenario. Mass, inertia, arm lengths and gains are those of Lee et al. (2010).

    Sensors, radio, lag, drag and limits are our assumptions.
    """
    if law == "neural" and motor != "works":
        raise InputError(
            "law",
            "the neural network was not trained for flight with a failed rotor",
            fix=f"{argument('settings', 'geometric', 'law')} {argument('settings', motor, 'motor')}",
        )
    reference = make_reference(trajectory)
    tracking = GeometricTracking(craft=CRAFT, reference=reference, most=LONGEST)
    axes = np.round(relaxed_axes(CRAFT, RATIO), 9)  # rounded, for the same numbers on every machine
    flies: Any = RotorLossTracking(tracking, axes)
    if law == "neural":
        flies = NeuralPolicy(craft=CRAFT, reference=reference)
    world = World(
        vehicle=CRAFT,
        sensors={"state": MultirotorStateSensor(period=PERIOD)},
        downlink=DelayChain(period=PERIOD, steps=1),
        uplink=DelayChain(period=PERIOD, steps=1),
        actuators=RotorDrive(period=PERIOD),
        max_step=PERIOD,
    )
    autopilot = Autopilot(Passthrough("state"), flies, RotorAllocation(craft=CRAFT), period=PERIOD)
    flown = Scenario(
        world=world,
        autopilot=autopilot,
        initial=first_state(trajectory, reference),
        duration=seconds(10),
        targets=(Target("law.distance", 0.0, 0.1),),
        name="quadrotor/track",
    )
    return flown if motor == "works" else inject_faults(flown, [f"actuators:speed[{int(motor[0]) - 1}] off @ 2 s"])


def make_reference(trajectory: str) -> Any:
    """Return the reference path of a trajectory with the given name."""
    if trajectory == "circle":
        return LevelPath(Circle(period=5.0, ease=3.0), height=HEIGHT)
    if trajectory == "eight":
        return LevelPath(FigureEight(period=8.0, ease=3.0), height=HEIGHT)
    above = (0.0, 0.0, -HEIGHT)
    return Helix(w=np.pi / 2, turn=0.0, origin=above) if trajectory == "helix" else FixedPlace(above)


def first_state(trajectory: str, reference: Any) -> MultirotorState:
    """Return the initial state for a trajectory.

    For "place" the start is half a metre from the reference, and for "recovery" upside down. All other trajectories
    start in hover at the start of the reference path.
    """
    place = np.asarray(reference.at(0.0).place)
    hover = CRAFT.hover(place)
    if trajectory == "place":
        return replace(hover, position=place + np.array([0.3, -0.4, 0.0]))
    if trajectory == "recovery":
        return replace(hover, attitude=np.array([np.cos(1.3), np.sin(1.3), 0.0, 0.0]))
    return hover
