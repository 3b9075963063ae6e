"""Fly the large climb with noise of the angular accelerometer, 0.01 rad/s^2 per sample."""

from trimtab.laws.path_command import FilteredClimb
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.hypersonic._flight import Filter, Integral, Internal, Truth, hypersonic_scenario


def scenario(
    filter: Filter = "tuned", internal: Internal = "noncausal", integral: Integral = "on", truth: Truth = "paper"
) -> Scenario:
    """Return the scenario of the large climb with noise. The simulated vehicle equals the model.

    The paper does not state the size of the noise, so the size is our choice.
    """
    climb = FilteredClimb(dh=5000.0, dV=1000.0)
    name = "hypersonic/noise"
    return hypersonic_scenario(
        name, climb, 200.0, noise="on", filter=filter, internal=internal, integral=integral, truth=truth
    )
