"""Flights as a motion capture sees them: pose at 50 Hz with gaps, noise, and another clock than the commands'."""

import numpy as np

from trimtab.core.quantity import Quantity
from trimtab.core.time import UNITS_PER_SECOND, ms
from trimtab.logs.log import Log
from trimtab.run.simulate import simulate
from trimtab.scenarios.build import build

NAME = "hovercraft/spin"
NOISE = {"north": (0.002, "m"), "east": (0.002, "m"), "heading": (0.005, "rad")}
CLOCK = 0.03
"""s by which the capture's stamps are late."""


def capture_flight(settings: dict[str, str], seed: int, duration: float = 60.0, rate: float = 50.0) -> Log:
    """A log of commands as they arrived, and of the pose; half a second is lost each nine, headings are wrapped."""
    scenario = build(NAME, {**settings, "duration": f"{duration:g} s"})
    flown, g = simulate(scenario, seed=seed, log_period=ms(5)), np.random.default_rng([seed, 3])
    step = round(UNITS_PER_SECOND / rate)
    at = np.arange(step, int(flown.ticks[-1]) - step, step)
    at = np.sort(at + g.integers(-2000, 2000, len(at)))
    at = at[(at / UNITS_PER_SECOND) % 9.0 < 8.5]
    late = at + round(CLOCK * UNITS_PER_SECOND)
    row = np.searchsorted(late, flown.ticks, side="right") - 1
    seen, held = row >= 0, np.maximum(row, 0)
    signals = {p: np.asarray(flown[p]) for p in flown.paths if p.startswith("uplink.value.")}
    declared = {p: flown.declarations[p] for p in signals}
    for name, (sigma, unit) in NOISE.items():
        pose = np.interp(at, flown.ticks, flown[f"truth.{name}"]) + sigma * g.standard_normal(len(at))
        pose = (pose + np.pi) % (2 * np.pi) - np.pi if unit == "rad" else pose
        signals[f"sensors.mocap.value.{name}"] = pose[held]
        declared[f"sensors.mocap.value.{name}"] = Quantity(unit, "Measured.")
    signals |= {"sensors.mocap.t": late[held], "sensors.mocap.valid": seen}
    declared |= {"sensors.mocap.t": Quantity("100 ns", "When."), "sensors.mocap.valid": Quantity("1", "Whether.")}
    return Log(flown.t, flown.ticks, signals, declared, {"scenario": NAME})
