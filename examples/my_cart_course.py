"""The cart of my_cart.py follows a course of half a metre exactly: trimtab run examples/my_cart_course.py:scenario"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from my_cart import Cart, CartState, Push
from my_cart import scenario as upright

from trimtab import Scenario, Target, seconds
from trimtab.core.record import replace
from trimtab.design.model import model_of_vehicle
from trimtab.design.output_inversion import invert_output, smooth_course
from trimtab.loop.linear_laws import track_course


def scenario(assumed=None) -> Scenario:
    """Return a move from 2 s on within 1.5 s. The pole leans before the cart moves."""
    still = upright(assumed)
    model = model_of_vehicle(assumed or Cart(), CartState(), Push(), outputs=["position"])
    course = smooth_course(np.linspace(0, 6, 1201), {"position": (0.0, 0.5)}, 2.0, 3.5, order=2)
    inversion = invert_output(model, course, end=([0.5, 0, 0, 0], [0.0]))
    law = track_course(still.autopilot.law, model, inversion, every=4)
    flown = replace(still, autopilot=replace(still.autopilot, law=law), initial=CartState(), duration=seconds(6))
    return replace(flown, targets=(Target("truth.position", 0.5, 0.01),))
