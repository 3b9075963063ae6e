"""Fly with the feedback gain printed in the paper. With either sign, the vehicle is lost within seconds."""

from typing import Literal

from trimtab.laws.path_command import FilteredClimb
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.hypersonic._flight import Filter, hypersonic_scenario
from trimtab.vehicles.hypersonic_printed import K_PRINTED

Sign = Literal["minus", "plus"]


def scenario(sign: Sign = "minus", filter: Filter = "printed") -> Scenario:
    """Return the scenario with the gain K of the paper (Aerospace 2022, 9(4), 206).

    sign: "minus" for v = -K e, "plus" for v = +K e as in eq. 13 of the paper, where e is the tracking error and v the
    commanded acceleration. `trimtab reproduce` shows why neither loop is stable.
    """
    gain = {"minus": -1.0, "plus": 1.0}[sign] * K_PRINTED
    climb = FilteredClimb(dh=1000.0, dV=200.0)
    return hypersonic_scenario("hypersonic/printed-gains", climb, 20.0, filter=filter, K=gain)
