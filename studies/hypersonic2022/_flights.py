"""Flights that several files of the study use. Command tables of equal length save compilations.

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
"""Signals of a plotted flight."""
LONG = 200.0
"""Duration (s) of flights whose scenario does not define one."""
SETTLED = 20.0
"""Time (s) after which errors are evaluated, when the filter's initial error has decayed."""
SHORT = 60.0
"""Duration (s) of the oracle's flights with noise."""
BRISK = (1e-5, 1.0, 1e-5, 1.0)
"""Process noise Q_eta of a filter between the tuned and the accurate filter."""
SMALL, MEDIUM, LARGE, LARGEST = (1000.0, 200.0), (3000.0, 500.0), (5000.0, 1000.0), (10000.0, 1500.0)
"""Climbs: change of altitude (ft) and of speed (ft/s)."""
CRUISE = (0.0, 0.0)
SOURCE: Any = {"filter": "equal", "integral": "off"}
"""Settings that reproduce [1]: no integral action, and equal process noise for both modes."""
FLIGHT_DIGITS = 2e-3
"""Relative tolerance of noise-free flights compared with the oracle's, which uses no table of the internal motion."""
MODES = ("eta1", "eta1_rate", "eta2", "eta2_rate")
KEPT = (
    *("law.h_error", "law.V_error", "law.saturated", "actuators.u.Phi", "actuators.u.delta_e", "truth.alpha"),
    *(f"{end}.{mode}" for mode in MODES for end in ("truth", "estimate.state")),
)
"""Signals kept of each flight. They are few because several hundred flights are in memory at once."""


@dataclasses.dataclass(frozen=True)
class RunSignals:
    """Signals of many runs.  t: times (samples,) in s.  signals: log path -> values (runs, samples, …)."""

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
        """Return the mean over the last 10 s of each run (runs,): the final value with little noise."""
        return self.window(path, self.t[-1] - 10).mean(axis=1)

    def mode_error(self, after: float, until: float = np.inf) -> Any:
        """Return the largest error of the estimated eta1 of each run (runs,)."""
        off = self.window("estimate.state.eta1", after, until) - self.window("truth.eta1", after, until)
        return np.abs(off).max(axis=1)

    @property
    def is_saturated(self) -> Any:
        """Return True for each run in which an input ever reached its limit (runs,)."""
        return self["law.saturated"].any(axis=1)


def fly_seeds(scenario: Scenario, runs: int = 1, length: float | None = None, period: int = ms(20)) -> RunSignals:
    """Fly seeds 0 … runs - 1 of a scenario, for its own duration or `length` (s), logged once per period."""
    wanted = None if length is None else seconds(length)
    batch = simulate_batch(scenario, seeds=range(runs), signals=KEPT, log=True, log_period=period, duration=wanted)
    return RunSignals(to_seconds(batch.ticks), batch.log)


@cache
def fly_climb(
    climb: tuple[float, float], runs: int = 1, length: float = LONG, brisk: bool = False, **options: Any
) -> RunSignals:
    """Fly a climb (ft, ft/s) with options in addition to SOURCE. brisk: use BRISK as the filter's Q."""
    return fly_seeds(build_climb(climb, brisk=brisk, **options), runs, length)


def build_climb(climb: tuple[float, float], brisk: bool = False, **options: Any) -> Scenario:
    """Return the scenario of a climb."""
    dh, dV = climb
    made = hypersonic_scenario("hypersonic/study", FilteredClimb(dh=dh, dV=dV), LONG, **SOURCE | options)
    return change_filter(made, Q=BRISK) if brisk else made


def change_filter(scenario: Scenario, **changes: Any) -> Scenario:
    """Return the scenario with these parameters of the modal filter changed."""
    autopilot = scenario.autopilot
    return replace(scenario, autopilot=replace(autopilot, estimator=replace(autopilot.estimator, **changes)))


def change_robust(scenario: Scenario, **changes: Any) -> Scenario:
    """Return the scenario with these parameters of the robust terms changed."""
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
    """Return the smallest and the largest value over the runs."""
    return float(np.min(values)), float(np.max(values))
