"""An F-16 climbs 30 m by its non-minimum-phase elevator: trimtab run examples/f16_climb.py:scenario"""

from typing import Annotated, Literal

import numpy as np

from trimtab import Scenario, Target, seconds
from trimtab.core.record import replace
from trimtab.core.rotation import DEG
from trimtab.design.model import model_of_vehicle
from trimtab.design.output_inversion import invert_output, smooth_course
from trimtab.loop.linear_laws import design_feedback, track_course
from trimtab.scenarios.f16._gains import level_flight
from trimtab.scenarios.f16.gcas import scenario as dive
from trimtab.scenarios.f16.gcas import surfaces
from trimtab.vehicles.f16 import F16Controls
from trimtab.vehicles.f16_flat_earth import F16FlatEarth, F16State
from trimtab.vehicles.imperial import FOOT

Course = Annotated[
    Literal["inverted", "altitude-alone"],
    {
        "inverted": "all states along the course, and the elevator, by stable inversion",
        "altitude-alone": "the wanted altitude, all else as in level flight: output feedback by the same gain",
    },
]
LIMITS = {"speed": 10.0, "alpha": 4 * DEG, "pitch": 4 * DEG, "pitch_rate": 12 * DEG, "altitude": 3.0}
LIMITS |= {"elevator": 5 * DEG, "aileron": 5 * DEG, "rudder": 5 * DEG, "throttle": 0.2}
CLIMB, BEGIN, END = 30.0, 1.5, 5.5


def scenario(course: Course = "inverted") -> Scenario:
    """Return a climb from 1.5 s on. The tail first pushes down, with a zero at +14 1/s."""
    craft, still = F16FlatEarth(), dive()
    level = level_flight(craft, 540 * FOOT, 1000 * FOOT)
    x, u = F16State(*level.x), F16Controls(*level.u)
    model = model_of_vehicle(craft, x, u, outputs=["altitude"]).keep(inputs=["elevator"])
    times, low = np.linspace(0, 9, 901), x.altitude
    wanted = smooth_course(times, {"altitude": (low, low + CLIMB)}, BEGIN, END, order=2)
    flown = invert_output(model, wanted)
    if course == "altitude-alone":
        alone = np.tile(level.x, (len(times), 1))
        alone[:, model.states.index("altitude")] = wanted.derivatives["altitude"][0]
        flown = flown._replace(x=alone, u=np.full_like(flown.u, u.elevator))
    law = track_course(design_feedback(craft, x, u, LIMITS), model, flown)
    world = replace(still.world, vehicle=craft, actuators=surfaces(u))
    return replace(
        still,
        world=world,
        autopilot=replace(still.autopilot, law=law),
        initial=x,
        duration=seconds(9),
        targets=(Target("truth.altitude", low + CLIMB, 1.0),),
        name="f16-climb",
    )
