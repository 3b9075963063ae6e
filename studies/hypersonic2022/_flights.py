"""Flights that several groups look at, each flown once; the command's table is always as long, so little is compiled.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206.
"""

import dataclasses
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from trimtab.core.record import replace
from trimtab.core.time import ms, seconds, to_seconds
from trimtab.laws.path_command import FilteredClimb
from trimtab.loop.scenario import Scenario
from trimtab.run.simulate import simulate_batch
from trimtab.scenarios.hypersonic._flight import hypersonic_scenario

SIGNALS = ("truth", "law", "actuators", "estimate.state")
"""Seed of a plotted flight."""
LONG = 200.0
"""Length of flights without a scenario's own length (s)."""
SETTLED = 20.0
"""Time from which errors count (s), after the filter's first error."""
SHORT = 60.0
"""Length of the oracle's flights with noise (s)."""
BRISK = (1e-5, 1.0, 1e-5, 1.0)
"""Q_eta of a filter between the tuned and the accurate one."""
SMALL, MEDIUM, LARGE, LARGEST = (1000.0, 200.0), (3000.0, 500.0), (5000.0, 1000.0), (10000.0, 1500.0)
"""Climbs in ft and ft/s."""
CRUISE = (0.0, 0.0)
SOURCE: Any = {"filter": "equal", "integral": "off"}
"""Settings that reproduce [1]: no integral action, and one noise for both modes."""
FLIGHT_DIGITS = 2e-3
"""Relative tolerance of flights without noise against the oracle's, which tabulates no inner motion."""
MODES = ("eta1", "eta1_rate", "eta2", "eta2_rate")
KEPT = (
    *("law.h_error", "law.V_error", "law.saturated", "actuators.u.Phi", "actuators.u.delta_e", "truth.alpha"),
    *(f"{end}.{mode}" for mode in MODES for end in ("truth", "estimate.state")),
)
"""Signals of the flights for rows; several hundred flights are in memory at once."""


@dataclasses.dataclass(frozen=True)
class RunSignals:
    """Runs of a scenario. t: (samples,) in s.  signals: path -> (runs, samples, …)."""

    t: Any
    signals: Mapping[str, Any]

    def __getitem__(self, path: str) -> Any:
        """Return a signal by its path, (runs, samples, …)."""
        return self.signals[path]

    def window(self, path: str, after: float, until: float = np.inf) -> Any:
        """Return the part of a signal with after < t <= until (s)."""
        return self[path][:, (self.t > after) & (self.t <= until)]

    def rms(self, path: str, after: float = SETTLED, until: float = np.inf) -> Any:
        """Return the rms of each run over after < t <= until (s), (runs,)."""
        return np.sqrt((self.window(path, after, until) ** 2).mean(axis=1))

    def peak(self, path: str, after: float = SETTLED) -> Any:
        """Return the largest magnitude of each run after a time (s), (runs,)."""
        return np.abs(self.window(path, after)).max(axis=1)

    def final_mean(self, path: str) -> Any:
        """Return the mean of each run over its last 10 s, (runs,), as the last value without noise."""
        return self.window(path, self.t[-1] - 10).mean(axis=1)

    def mode_error(self, after: float, until: float = np.inf) -> Any:
        """Return the largest error of the estimated eta1 of each run (runs,)."""
        off = self.window("estimate.state.eta1", after, until) - self.window("truth.eta1", after, until)
        return np.abs(off).max(axis=1)

    @property
    def is_saturated(self) -> Any:
        """Return whether a limit ever held the input of each run (runs,)."""
        return self["law.saturated"].any(axis=1)


def fly_seeds(scenario: Scenario, runs: int = 1, length: float | None = None, period: int = ms(20)) -> RunSignals:
    """Fly seeds 0 … runs - 1 of a scenario, for its own length or another (s), with rows a period apart."""
    wanted = None if length is None else seconds(length)
    batch = simulate_batch(scenario, seeds=range(runs), signals=KEPT, log=True, log_period=period, duration=wanted)
    return RunSignals(to_seconds(batch.ticks), batch.log)


@cache
def fly_climb(
    climb: tuple[float, float], runs: int = 1, length: float = LONG, brisk: bool = False, **options: Any
) -> RunSignals:
    """Fly a climb (ft, ft/s) with options besides SOURCE. brisk: with BRISK as the filter's Q."""
    return fly_seeds(build_climb(climb, brisk=brisk, **options), runs, length)


def build_climb(climb: tuple[float, float], brisk: bool = False, **options: Any) -> Scenario:
    """Return the scenario of a climb."""
    dh, dV = climb
    made = hypersonic_scenario("hypersonic/study", FilteredClimb(dh=dh, dV=dV), LONG, **SOURCE | options)
    return change_filter(made, Q=BRISK) if brisk else made


def change_filter(scenario: Scenario, **changes: Any) -> Scenario:
    """Return the scenario with other parameters in the filter of the modes."""
    autopilot = scenario.autopilot
    return replace(scenario, autopilot=replace(autopilot, estimator=replace(autopilot.estimator, **changes)))


def change_robust(scenario: Scenario, **changes: Any) -> Scenario:
    """Return the scenario with other parameters in the robust terms."""
    autopilot = scenario.autopilot
    law = replace(autopilot.law, robust=replace(autopilot.law.robust, **changes))
    return replace(scenario, autopilot=replace(autopilot, law=law))


def change_period(scenario: Scenario, period: int) -> Scenario:
    """Return the scenario, sampled and controlled at another period."""
    world, autopilot = scenario.world, scenario.autopilot
    parts: dict[str, Any] = {n: replace(getattr(world, n), period=period) for n in ("downlink", "uplink", "actuators")}
    sensors = {name: replace(sensor, period=period) for name, sensor in world.sensors.items()}
    world = replace(world, sensors=sensors, max_step=min(period, ms(5)), **parts)
    autopilot = replace(autopilot, period=period, estimator=replace(autopilot.estimator, period=period))
    return replace(
        scenario, world=world, autopilot=autopilot, truth_sensor=replace(scenario.truth_sensor, period=period)
    )


def extent(values: Any) -> tuple[float, float]:
    """Return smallest and largest of the runs."""
    return float(np.min(values)), float(np.max(values))
