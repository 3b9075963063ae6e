"""Fly a vehicle whose modal frequencies differ by 10 % from the model of filter and law, with sensor noise."""

from typing import Literal

from trimtab.core.record import replace
from trimtab.laws.path_command import FilteredClimb
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.hypersonic._flight import Filter, Integral, Noise, Truth, hypersonic_scenario
from trimtab.vehicles.hypersonic import Hypersonic

Frequency = Literal["1.10", "0.90", "1.05", "0.95", "1.02", "0.98", "1.00"]


def scenario(
    frequency: Frequency = "1.10",
    filter: Filter = "tuned",
    noise: Noise = "on",
    integral: Integral = "on",
    truth: Truth = "paper",
) -> Scenario:
    """Return the scenario.

    frequency: factor on both modal frequencies of the simulated vehicle, relative to the model.

    With the filter settings printed in the paper (`filter=printed`), the vehicle is lost.
    """
    craft = Hypersonic()
    plant = replace(craft, modes=craft.modes.detune(float(frequency)))
    climb = FilteredClimb(dh=3000.0, dV=500.0)
    name = "hypersonic/modal-mismatch"
    return hypersonic_scenario(
        name, climb, 150.0, plant=plant, filter=filter, noise=noise, integral=integral, truth=truth
    )
