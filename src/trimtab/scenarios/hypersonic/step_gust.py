"""Reject a constant disturbance of pitching moment, drag or lift that starts in cruise."""

from typing import Literal

from trimtab.core.record import replace
from trimtab.laws.path_command import FilteredClimb
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.hypersonic._flight import Filter, Integral, Noise, hypersonic_scenario
from trimtab.vehicles.hypersonic import Disturbance, Hypersonic

Kind = Literal["lift", "drag", "moment", "large-moment"]
START = 20.0


def scenario(kind: Kind = "lift", integral: Integral = "on", filter: Filter = "tuned", noise: Noise = "on") -> Scenario:
    """Return the scenario with a loss of lift of 2 % of the weight, 88 lbf/ft of drag, or a moment of 500 or 5000 lbf.

    The forces and moments are per foot of the vehicle's width. The paper (Aerospace 2022, 9(4), 206) lists such
    disturbances as future work. Their sizes are our choice.
    """
    craft = Hypersonic()
    felt = {
        "lift": Disturbance(normal=-0.02 * craft.m * craft.g, start=START),
        "drag": Disturbance(along=-88.0, start=START),
        "moment": Disturbance(moment=500.0, start=START),
        "large-moment": Disturbance(moment=5000.0, start=START),
    }
    plant = replace(craft, disturbance=felt[kind])
    name, cruise = "hypersonic/step-gust", FilteredClimb()
    return hypersonic_scenario(name, cruise, 100.0, plant=plant, integral=integral, filter=filter, noise=noise)
