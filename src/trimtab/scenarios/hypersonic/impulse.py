"""Reject a short disturbance in cruise: an impulse of pitching moment, or of the force normal to the flight path."""

from typing import Literal

from trimtab.core.record import replace
from trimtab.laws.path_command import FilteredClimb
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.hypersonic._flight import Filter, Integral, Noise, hypersonic_scenario
from trimtab.vehicles.hypersonic import Disturbance, Hypersonic

Kind = Literal["moment", "normal-force"]
LENGTH, START = 0.05, 20.0


def scenario(
    kind: Kind = "moment", integral: Integral = "on", filter: Filter = "tuned", noise: Noise = "on"
) -> Scenario:
    """Return the scenario with a pitch acceleration of 0.4 rad/s^2 for 50 ms, or a gust that adds 20 ft/s in 50 ms.

    The paper on the vehicle (Aerospace 2022, 9(4), 206) lists such disturbances as future work. Their sizes are our
    choice.
    """
    craft = Hypersonic()
    if kind == "moment":
        felt = Disturbance(moment=0.4 * craft.Iyy, start=START, duration=LENGTH)
    else:
        felt = Disturbance(normal=20.0 / LENGTH * craft.m, start=START, duration=LENGTH)
    name, cruise, plant = "hypersonic/impulse", FilteredClimb(), replace(craft, disturbance=felt)
    return hypersonic_scenario(name, cruise, 100.0, plant=plant, integral=integral, filter=filter, noise=noise)
