"""Fly the hovercraft with inertial unit, ultrasonic network and filters, and assess the navigation."""

import numpy as np

from trimtab.logs.navigation import assess_navigation, state_series
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue


def main() -> None:
    """Drive forward, with the radio in the loop."""
    scenario, _ = catalogue.load_scenario("hovercraft/forward", {"navigation": "ins"})
    log = simulate(scenario, seed=1)
    for name, state in state_series(log).items():
        if state.error is not None:
            late = state.t > 5
            rms = np.sqrt(np.mean(state.error[late] ** 2))
            unit = log.unit(f"truth.{name}")
            print(f"{name:15s} rms error {rms:.4f} {unit:6s} the filter says {state.sigma[late].mean():.4f}")
    judged = assess_navigation(log)
    assert judged is not None
    print(f"navigation: {judged.verdict}")


if __name__ == "__main__":
    main()
