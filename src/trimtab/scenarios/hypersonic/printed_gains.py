"""What the printed feedback gain does to this vehicle, with either sign: it loses it within seconds."""

from typing import Literal

from trimtab.laws.path_command import FilteredClimb
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.hypersonic._flight import Filter, hypersonic_scenario
from trimtab.vehicles.hypersonic_printed import K_PRINTED

Sign = Literal["minus", "plus"]


def scenario(sign: Sign = "minus", filter: Filter = "printed") -> Scenario:
    """The source's K, v = -K e or, as its eq. 13 says, v = +K e: `trimtab reproduce` shows why neither holds."""
    gain = {"minus": -1.0, "plus": 1.0}[sign] * K_PRINTED
    climb = FilteredClimb(dh=1000.0, dV=200.0)
    return hypersonic_scenario("hypersonic/printed-gains", climb, 20.0, filter=filter, K=gain)
