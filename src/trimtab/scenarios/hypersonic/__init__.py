"""Scenarios of the air-breathing hypersonic vehicle, and functions to build further scenarios of this vehicle. Example:

from trimtab.laws.path_command import FilteredClimb
from trimtab.scenarios.hypersonic import hypersonic_scenario

def scenario():
    return hypersonic_scenario("mine", FilteredClimb(dh=2000.0, dV=300.0), 120.0, filter="adaptive")
"""

from trimtab.scenarios.hypersonic._flight import hypersonic_scenario
from trimtab.scenarios.hypersonic._internal import linear_table, noncausal_table, preview_internal, sylvester_internal

__all__ = ["hypersonic_scenario", "linear_table", "noncausal_table", "preview_internal", "sylvester_internal"]
