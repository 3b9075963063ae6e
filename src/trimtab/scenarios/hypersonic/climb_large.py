"""Climb 5 000 ft and gain 1 000 ft/s, with bending modes that no sensor measures, without noise."""

from trimtab.laws.path_command import FilteredClimb
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.hypersonic._flight import Filter, Integral, Internal, hypersonic_scenario


def scenario(filter: Filter = "tuned", internal: Internal = "noncausal", integral: Integral = "on") -> Scenario:
    """Return the scenario of the large climb. The simulated vehicle equals the vehicle model of law and filter.

    `hypersonic/noise` is the same climb with sensor noise.
    """
    climb = FilteredClimb(dh=5000.0, dV=1000.0)
    name = "hypersonic/climb-large"
    return hypersonic_scenario(name, climb, 200.0, filter=filter, internal=internal, integral=integral)
