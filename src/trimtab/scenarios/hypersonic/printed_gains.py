"""Fly the printed feedback gain with either sign: the vehicle is lost within seconds."""

from typing import Literal

from trimtab.laws.path_command import FilteredClimb
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.hypersonic._flight import Filter, hypersonic_scenario
from trimtab.vehicles.hypersonic_printed import K_PRINTED

Sign = Literal["minus", "plus"]


def scenario(sign: Sign = "minus", filter: Filter = "printed") -> Scenario:
    """The paper's K, v = -K e or, as its eq. 13 has it, v = +K e: `trimtab reproduce` shows why neither is stable."""
    gain = {"minus": -1.0, "plus": 1.0}[sign] * K_PRINTED
    climb = FilteredClimb(dh=1000.0, dV=200.0)
    return hypersonic_scenario("hypersonic/printed-gains", climb, 20.0, filter=filter, K=gain)
