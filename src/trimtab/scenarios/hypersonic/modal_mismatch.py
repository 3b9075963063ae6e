"""A plant whose modes of bending are 10 % off what filter and law believe, with noise."""

from typing import Literal

from trimtab.core.record import replace
from trimtab.laws.path_command import FilteredClimb
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.hypersonic._flight import Filter, Noise, hypersonic_scenario
from trimtab.vehicles.hypersonic import Hypersonic

Frequency = Literal["1.10", "0.90", "1.05", "0.95", "1.02", "0.98", "1.00"]


def scenario(frequency: Frequency = "1.10", filter: Filter = "tuned", noise: Noise = "on") -> Scenario:
    """Both frequencies of the plant times `frequency`. With the printed settings of the filter the vehicle is lost."""
    craft = Hypersonic()
    plant = replace(craft, modes=craft.modes.detune(float(frequency)))
    climb = FilteredClimb(dh=3000.0, dV=500.0)
    return hypersonic_scenario("hypersonic/modal-mismatch", climb, 150.0, plant=plant, filter=filter, noise=noise)
