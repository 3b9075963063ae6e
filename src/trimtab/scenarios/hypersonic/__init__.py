"""Scenarios of the air-breathing hypersonic vehicle, and what makes one of your own.

from trimtab.laws.path_command import FilteredClimb
from trimtab.scenarios.hypersonic import flight

def scenario():
    return flight("mine", FilteredClimb(dh=2000.0, dV=300.0), 120.0, filter="adaptive")
"""

from trimtab.scenarios.hypersonic._flight import flight
from trimtab.scenarios.hypersonic._internal import linear_table, noncausal_table, preview_internal, sylvester_internal
from trimtab.scenarios.hypersonic._level import level_trim

__all__ = ["flight", "level_trim", "linear_table", "noncausal_table", "preview_internal", "sylvester_internal"]
