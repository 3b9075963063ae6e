"""Runs of the rotating platform that several files of the study use. Each is simulated once.

An estimate is valid at the time of its newest inertial sample, so it is compared with the truth at that time.
"""

from collections.abc import Mapping
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from studies.hovercraft2006._pictures import Panel, draw_panels
from trimtab.core.record import replace
from trimtab.core.time import ms, to_seconds
from trimtab.estimators.ranging.multilateration import assisted_heading, two_unit_heading
from trimtab.estimators.ranging.position import RangingPosition
from trimtab.loop.scenario import Scenario
from trimtab.loop.settings import with_settings
from trimtab.run.simulate import Batch, simulate_batch
from trimtab.scenarios import catalogue
from trimtab.scenarios.navigation.platform_cricket import BASE
from trimtab.sensors.ultrasonic_ranging import UltrasonicRanging

SEEDS = range(20)
SETTLED = 10.0
"""Time (s) after which errors are evaluated."""
STATES = ("heading", "yaw_rate", "surge_velocity", "sway_velocity", "north", "east")
SIGNALS = ("truth", "estimate.age", *(f"estimate.state.{name}" for name in STATES))
UNITS = ("sensors.unit_a", "sensors.unit_b")
LITERAL = (("covariance", "literal"),)
"""Setting of the filter covariances as published."""


class Errors(NamedTuple):
    """Estimation errors: rms over the settled part of a run, median over runs.

    heading: deg.  yaw_rate: deg/s.  position: cm, both coordinates together.  velocity: cm/s, both components.
    """

    heading: float
    yaw_rate: float
    position: float
    velocity: float


def load_rig(name: str, settings: tuple[tuple[str, str], ...]) -> Scenario:
    """Load a scenario of the rotating platform with settings."""
    scenario, rest = catalogue.load_scenario(f"navigation/{name}", dict(settings))
    return with_settings(scenario, rest)


@lru_cache(maxsize=4)  # as many as one group of figures needs; each takes 50 to 100 MB
def fly_rig(name: str, settings: tuple[tuple[str, str], ...] = LITERAL) -> Batch:
    """Run a scenario of the rotating platform with SEEDS, logged every millisecond."""
    signals = SIGNALS + (UNITS if name == "platform-cricket" else ())
    return simulate_batch(load_rig(name, settings), seeds=SEEDS, signals=signals, log_period=ms(1), log=True)


@cache
def navigation_errors(name: str, settings: tuple[tuple[str, str], ...] = LITERAL) -> Errors:
    """Return the estimation errors in a scenario of the rotating platform."""
    batch = fly_rig(name, settings)
    t, errors = to_seconds(batch.ticks), []
    late = t > SETTLED
    for run in range(len(batch.seeds)):
        nav = {n: batch.log[f"estimate.state.{n}"][run][late] for n in STATES}
        at = (t - batch.log["estimate.age"][run])[late]
        true = {n: np.interp(at, t, batch.log[f"truth.{n}"][run]) for n in STATES}
        place = (nav["north"] - true["north"]) + 1j * (nav["east"] - true["east"])
        errors.append(
            (
                np.degrees(_rms(_wrap_angle(nav["heading"] - true["heading"]))),
                np.degrees(_rms(nav["yaw_rate"] - true["yaw_rate"])),
                100 * _rms(place),
                100 * _rms(_world_velocity(nav) - _world_velocity(true)),
            )
        )
    return Errors(*(float(x) for x in np.median(errors, axis=0)))


@cache
def two_unit_errors(settings: tuple[tuple[str, str], ...] = LITERAL) -> tuple[float, float]:
    """Return the rms error (deg) of the heading from two ultrasonic units, without and with inertial assistance.

    The heading is evaluated when unit B's fix arrives, 100 ms after unit A's. The motion in between is the integral of
    the estimated velocity. A difference of estimated positions would count the correction by a fix as motion.
    """
    batch = fly_rig("platform-cricket", settings)
    t, (a, b), errors = to_seconds(batch.ticks), UNITS, []
    levers = np.zeros(2), np.array([0.0, BASE])
    direct = jax.vmap(lambda p, q: two_unit_heading(p, q, *levers))
    assisted: Any = jax.vmap(lambda p, q, m: assisted_heading(p, q, m, *levers))
    for run in range(len(batch.seeds)):
        log = {path: values[run] for path, values in batch.log.items()}
        came = np.flatnonzero(log[f"{b}.fresh"] & (t > SETTLED))
        before = np.flatnonzero(log[f"{a}.fresh"])
        before = before[np.searchsorted(before, came) - 1]
        places = [np.stack([log[f"{u}.value.north"], log[f"{u}.value.east"]], 1)[came] for u in UNITS]
        v = _world_velocity({n: log[f"estimate.state.{n}"] for n in STATES})
        moved: Any = np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) / 2 * np.diff(t))])
        step = moved[came] - moved[before]
        both = direct(*places), assisted(*places, np.stack([step.real, step.imag], 1))
        errors.append([np.degrees(_rms(_wrap_angle(np.asarray(h) - log["truth.heading"][came]))) for h in both])
    raw, helped = np.median(errors, axis=0)
    return float(raw), float(helped)


@cache
def network_errors(rate: str) -> tuple[float, float]:
    """Return latency and error of the simulated ultrasonic network on the platform, over eight runs at a rate (deg/s).

    No parameter is fitted. Two ultrasonic units of the vehicle ping in turn, in slots of 100 ms. The latency is the
    mean time (s) from a ping to its last reply. The error is that of the heading from both units (deg, rms), evaluated
    when the replies to unit B have arrived.
    """
    scenario = load_rig("platform-cricket", (("rate", rate),))
    units = np.array([[0.0, 0.0, 0.0], [0.0, BASE, 0.0]])
    ranging = UltrasonicRanging(units=units, clients=2)
    locate = RangingPosition(units=units, beacons=np.asarray(ranging.beacons.map))
    scenario = replace(
        scenario,
        world=replace(scenario.world, sensors={"ranging": ranging}),
        autopilot=replace(scenario.autopilot, estimator=locate),
    )
    path = "estimate.state"
    signals = ("truth.heading", "estimate.age", "estimate.fresh", f"{path}.heading", f"{path}.unit")
    batch = simulate_batch(scenario, seeds=range(8), signals=signals, log_period=ms(1), log=True)
    came = batch.log["estimate.fresh"].astype(bool) & (to_seconds(batch.ticks) > SETTLED)
    error = np.degrees(_wrap_angle(batch.log[f"{path}.heading"] - batch.log["truth.heading"]))
    late = float(batch.log["estimate.age"][came].mean())
    return late, float(_rms(error[came & (batch.log[f"{path}.unit"] == 1)]))


def draw_rig(path: Path, title: str, runs: Mapping[str, Batch]) -> Path:
    """Plot the first seed's errors in heading, yaw rate, north position and north velocity.

    runs: label -> batch of runs.
    """
    whats = "heading (deg)", "rate (deg/s)", "north (cm)", "velocity north (cm/s)"
    panels: dict[str, list[Any]] = {what: [] for what in whats}
    for words, batch in runs.items():
        t = to_seconds(batch.ticks)
        nav = {n: batch.log[f"estimate.state.{n}"][0] for n in STATES}
        at = t - batch.log["estimate.age"][0]
        true = {n: np.interp(at, t, batch.log[f"truth.{n}"][0]) for n in STATES}
        values = (
            np.degrees(_wrap_angle(nav["heading"] - true["heading"])),
            np.degrees(nav["yaw_rate"] - true["yaw_rate"]),
            100 * (nav["north"] - true["north"]),
            100 * (_world_velocity(nav) - _world_velocity(true)).real,
        )
        late = t > SETTLED
        for curves, value in zip(panels.values(), values, strict=True):
            curves.append((t[late][::10], value[late][::10], words, "-"))
    every = [Panel("", "t (s)", f"error of {what}", tuple(curves)) for what, curves in panels.items()]
    on_axis = all(np.ptp(b.log["truth.north"][0]) < 1e-9 for b in runs.values())
    return draw_panels(path, title, every[:2] if on_axis else every, columns=2)


def _world_velocity(state: dict[str, Any]) -> Any:
    """Return the velocity in frame W as the complex number north + i east."""
    return (state["surge_velocity"] + 1j * state["sway_velocity"]) * np.exp(1j * state["heading"])


def _wrap_angle(angle: Any) -> Any:
    return np.angle(np.exp(1j * angle))


def _rms(x: Any) -> Any:
    return np.sqrt(np.mean(np.abs(x) ** 2))
