"""Fly a scenario from Python: ideal and real, then with each imperfection switched off in turn."""

import numpy as np

from trimtab.core.time import ms
from trimtab.run.simulate import simulate, simulate_many
from trimtab.scenarios import catalogue

scenario, _ = catalogue.load_scenario("hovercraft/forward")

log = simulate(scenario, seed=1)
print(log)
print("final surge velocity:", log.final["truth.surge_velocity"], log.unit("truth.surge_velocity"))


def wander(flown) -> float:
    """Return the standard deviation of sway (m/s) after 8 s, median over ten seeds."""
    logs = simulate_many(flown, seeds=range(10), log_period=ms(20), signals=("truth",))
    return float(np.median([one.between(8, 15)["truth.sway_velocity"].std() for one in logs]))


print(f"{'nothing':20s} {wander(scenario):.4f} m/s")
for fault in scenario.imperfections():
    print(f"{fault:20s} {wander(scenario.without(fault)):.4f} m/s")
