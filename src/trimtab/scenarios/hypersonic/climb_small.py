"""Climb 1 000 ft and gain 200 ft/s, with bending modes that no sensor measures, without noise."""

from trimtab.laws.path_command import FilteredClimb
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.hypersonic._flight import Filter, Integral, Internal, hypersonic_scenario


def scenario(filter: Filter = "tuned", internal: Internal = "noncausal", integral: Integral = "on") -> Scenario:
    """Return the scenario of the small climb. The simulated vehicle equals the vehicle model of law and filter."""
    climb = FilteredClimb(dh=1000.0, dV=200.0)
    name = "hypersonic/climb-small"
    return hypersonic_scenario(name, climb, 150.0, filter=filter, internal=internal, integral=integral)
