"""Flights of the simulated autopilot that several files of the study use. Each is simulated once."""

import dataclasses
from collections.abc import Mapping
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from studies.hovercraft2006._pictures import Panel, draw_panels
from trimtab.core.record import replace
from trimtab.core.time import ms, seconds, to_seconds
from trimtab.logs.log import Log
from trimtab.loop.scenario import Scenario
from trimtab.loop.settings import with_settings
from trimtab.run.simulate import simulate, simulate_batch
from trimtab.scenarios import catalogue
from trimtab.sensors.navigation_errors import NavigationErrors

SEEDS = range(200)
Settings = tuple[tuple[str, str], ...]
REST: Settings = (("initial", "rest"),)
MOVING: Settings = (("initial", "moving"),)
"""Initial states of [1] fig. 6.12 (REST) and fig. 6.11 (MOVING)."""
LITERAL: Settings = (*REST, ("autopilot.law.form", "literal"))
"""Settings of fig. 6.12 with the proportional law as published."""


@dataclasses.dataclass(frozen=True)
class TruthSignals:
    """True signals of many runs.  t: times (samples,) in s.  signals: log path -> values (runs, samples)."""

    t: Any
    signals: Mapping[str, Any]

    def __getitem__(self, signal: str) -> Any:
        """Return the true values of the named signal (runs, samples)."""
        return self.signals[f"truth.{signal}"]


def load_scenario(name: str, settings: Settings = ()) -> Scenario:
    """Load a hovercraft scenario with settings."""
    built, rest = catalogue.load_scenario(f"hovercraft/{name}", dict(settings))
    return with_settings(built, rest)


@lru_cache(maxsize=18)  # as many as one group of figures needs; each takes 20 MB
def fly_real(name: str, without: tuple[str, ...] = (), reading: str = "C", settings: Settings = ()) -> TruthSignals:
    """Fly a scenario with SEEDS and all faults except those in `without`, logged every 10 ms.

    reading: interpretation of the printed navigation noise, as in `NavigationErrors.reading`.
    """
    flown = load_scenario(name, settings)
    for fault in without:
        flown = flown.without(fault)
    if reading != "C":
        sensors = {"navigation": NavigationErrors.reading(reading)}
        flown = replace(flown, world=replace(flown.world, sensors=sensors))
    batch = simulate_batch(flown, seeds=SEEDS, signals=("truth",), log_period=ms(10), log=True)
    return TruthSignals(to_seconds(batch.ticks), batch.log)


@cache
def fly_ideal(name: str, settings: Settings = ()) -> Log:
    """Fly the scenario without faults, logged every millisecond."""
    return simulate(load_scenario(name, settings).ideal())


@cache
def fly_random_starts(form: str) -> Mapping[str, Any]:
    """Fly the ideal proportional law from 200 random starts. Return the last 10 of 60 s: path -> (200, samples)."""
    settings = (*REST, ("autopilot.law.form", form))
    flown = replace(load_scenario("heading-proportional", settings).ideal(), duration=seconds(60))
    draws = np.random.default_rng(0)
    u, v, r = draws.uniform(-1, 1, (3, 200)) * [[1.0], [1.0], [5.0]]
    start = {"surge_velocity": u, "sway_velocity": v, "yaw_rate": r, "heading": 1 + draws.uniform(-np.pi, np.pi, 200)}
    spread = {f"initial.{name}": values for name, values in start.items()}
    signals = ("law.heading_error", "law.mode", "truth.yaw_rate")
    batch = simulate_batch(flown, seeds=range(200), spread=spread, signals=signals, log_period=ms(10), log=True)
    late = to_seconds(batch.ticks) >= 50
    return {path: values[:, late] for path, values in batch.log.items()}


def slow_manifold_slope() -> float:
    """Return the slope (s) of 1/(2 r²) between 1000 and 2000 s under the ideal rest law, in steps of 10 ms."""
    slow = (("autopilot.period", "10 ms"), ("world.max_step", "10 ms"))
    flown = load_scenario("zero-velocity", slow).ideal()
    log = simulate(flown, duration=seconds(2000), log_period=seconds(1), signals=("truth.yaw_rate",))
    late = log.t > 1000
    return float(np.polyfit(log.t[late], 1 / (2 * log["truth.yaw_rate"][late] ** 2), 1)[0])


def first_time(t: Any, holds: Any) -> Any:
    """Return for each run the first time (s) at which a condition (runs, samples) holds, or infinity."""
    return np.where(holds.any(axis=-1), t[holds.argmax(axis=-1)], np.inf)


def settling_time(t: Any, holds: Any) -> Any:
    """Return for each run the time (s) from which a condition (runs, samples) holds to the end, or infinity."""
    last = holds.shape[-1] - 1 - (~holds)[..., ::-1].argmax(axis=-1)
    after = np.where(holds.all(axis=-1), 0, last + 1)
    return np.where(holds[..., -1], t[np.minimum(after, len(t) - 1)], np.inf)


SPEED, RATE, HEADING = "m/s", "rad/s", "rad"
UNITS = {"surge_velocity": SPEED, "sway_velocity": SPEED, "yaw_rate": RATE, "heading": HEADING}


def draw_flights(
    path: Path, title: str, flights: Mapping[str, tuple[Any, Any]], limits: Mapping[str, Mapping[str, Any]]
) -> Path:
    """Plot signals of flights, one column per flight.

    Args:
        path: path of the picture.
        title: title of the picture.
        flights: column title -> (t, true signals by log path).
        limits: signal -> column title -> limits of its axis, or None.
    """
    panels = [
        Panel(
            words, "t (s)", f"{signal.replace('_', ' ')} ({UNITS[signal]})", ((t, y[f"truth.{signal}"], "", "-"),), at
        )
        for signal, by_column in limits.items()
        for (words, (t, y)), at in zip(flights.items(), (by_column[w] for w in flights), strict=True)
    ]
    return draw_panels(path, title, panels, columns=len(flights))


def first_seed(flown: TruthSignals) -> tuple[Any, Any]:
    """Return the times and signals of the first run."""
    return flown.t, {path: values[0] for path, values in flown.signals.items()}
