"""Fly a vehicle that differs from its model: lift +5 %, pitch stiffness -5 %, drag +10 %, mass +2 %, thrust -5 %."""

from trimtab.core.record import replace
from trimtab.laws.path_command import FilteredClimb
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.hypersonic._flight import Filter, Integral, Noise, Robust, hypersonic_scenario
from trimtab.vehicles.hypersonic import Hypersonic


def scenario(
    robust: Robust = "off", integral: Integral = "on", filter: Filter = "tuned", noise: Noise = "off"
) -> Scenario:
    """Return the scenario with a vehicle that differs from the model.

    State feedback alone (`integral=off`) leaves a constant tracking error. Integral feedback removes this error, and
    the law's robust terms reduce it.
    """
    climb = FilteredClimb(dh=3000.0, dV=500.0)
    name, plant = "hypersonic/mismatch", off_nominal_plant()
    return hypersonic_scenario(
        name, climb, 150.0, plant=plant, robust=robust, integral=integral, filter=filter, noise=noise
    )


def off_nominal_plant(times: float = 1.0) -> Hypersonic:
    """Return the simulated vehicle that differs from the model. times: factor on all differences."""
    craft = Hypersonic()
    air, engine = craft.forces.aerodynamics, craft.forces.propulsion
    lift, stiffness, drag = air.CL_a * (1 + 0.05 * times), air.CM_a * (1 - 0.05 * times), air.CD_0 * (1 + 0.10 * times)
    air = replace(air, CL_a=lift, CM_a=stiffness, CD_0=drag)
    engine = replace(engine, b7=engine.b7 * (1 - 0.05 * times))
    forces = replace(craft.forces, aerodynamics=air, propulsion=engine)
    return replace(craft, forces=forces, m=craft.m * (1 + 0.02 * times))
