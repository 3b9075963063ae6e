"""A plant that is not the model: lift 5 % up, pitch stiffness 5 % down, drag 10 % up, mass 2 % up, thrust 5 % down."""

from typing import Any

from trimtab.core.record import replace
from trimtab.laws.path_command import FilteredClimb
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.hypersonic._flight import Filter, Integral, Noise, Robust, hypersonic_scenario
from trimtab.vehicles.hypersonic import Hypersonic


def scenario(
    robust: Robust = "off", integral: Integral = "off", filter: Filter = "tuned", noise: Noise = "off"
) -> Scenario:
    """State feedback leaves an offset, which robust terms make smaller and integrals remove."""
    climb = FilteredClimb(dh=3000.0, dV=500.0)
    options: dict[str, Any] = {"robust": robust, "integral": integral, "filter": filter, "noise": noise}
    return hypersonic_scenario("hypersonic/mismatch", climb, 150.0, plant=off_nominal_plant(), **options)


def off_nominal_plant(times: float = 1.0) -> Hypersonic:
    """The plant, its differences from the model scaled by `times`."""
    craft = Hypersonic()
    air, engine = craft.forces.aerodynamics, craft.forces.propulsion
    air = replace(
        air,
        CL_a=air.CL_a * (1 + 0.05 * times),
        CM_a=air.CM_a * (1 - 0.05 * times),
        CD_0=air.CD_0 * (1 + 0.10 * times),
    )
    engine = replace(engine, b7=engine.b7 * (1 - 0.05 * times))
    forces = replace(craft.forces, aerodynamics=air, propulsion=engine)
    return replace(craft, forces=forces, m=craft.m * (1 + 0.02 * times))
