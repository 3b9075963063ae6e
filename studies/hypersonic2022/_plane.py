"""Flights with a truth model that is harsher than the paper's: one parameter at a time worsens until flights fail.

The command is a climb by 3000 ft and 500 ft/s in 100 s. Both modal frequencies of the plant are 10 % above or below
those of law and filter, so that a flight needs the estimate. All other settings are those of `--set truth=plane`.
"""

from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.record import replace
from trimtab.core.rotation import DEG
from trimtab.core.time import ms, seconds
from trimtab.loop.scenario import Scenario
from trimtab.run.simulate import simulate_batch
from trimtab.scenarios.hypersonic.modal_mismatch import scenario

FREQUENCIES: tuple[Any, ...] = ("1.10", "0.90")
SEEDS = 16
LENGTH = 100.0
LATE = 20.0
"""Duration (s) at the end of a flight over which errors and saturation are evaluated."""
OFF = 30.0, 5.0
"""Largest accepted errors of h (ft) and V (ft/s) at the end of a flight: 1 % of the command."""
ROUGHNESS = (0.0, 1.0, 10.0)
"""Factors of the intensity of turbulence."""
INSTRUMENT = "world.sensors.angular-accelerometer."
SIGNALS = ("law.h_error", "law.V_error", "law.saturated", "truth.h", "truth.V", "truth.alpha")


class Axis(NamedTuple):
    """Parameter of the truth model, with values from mild to severe.

    name, unit: texts to display.  path: path of the setting.  values: values in `unit`.
    scale: factor from `unit` to the unit of the setting.
    """

    name: str
    unit: str
    path: str
    values: tuple[float, ...]
    scale: float = 1.0


SERVO = "world.actuators.stages."
PER_MODE, SLOPES = "1e-4/(slug ft)^1/2", (0.5, 1.0, 2.0, 3.0, 5.0)
AXES = (
    Axis("noise a sample", "rad/s²", INSTRUMENT + "noise", (0.01, 0.05, 0.1, 0.2, 0.3)),
    Axis("bias", "rad/s²", INSTRUMENT + "bias", (0.1, 0.3, 1.0, 3.0, 10.0)),
    Axis("scale factor", "%", INSTRUMENT + "scale_factor", (1.0, 5.0, 10.0, 20.0, 40.0), scale=0.01),
    Axis("bandwidth", "Hz", INSTRUMENT + "bandwidth", (60.0, 20.0, 15.0, 10.0, 6.0)),
    Axis("delay", "ms", INSTRUMENT + "delay", (1.0, 10.0, 15.0, 20.0, 30.0), scale=1e-3),
    Axis("slope of mode 1", PER_MODE, INSTRUMENT + "slope1", SLOPES, scale=1e-4),
    Axis(
        "slope of mode 1, other sign",
        "1e-4/(slug ft)^1/2",
        INSTRUMENT + "slope1",
        (0.5, 1.0, 2.0, 3.0, 5.0),
        scale=-1e-4,
    ),
    Axis("slope of mode 2", PER_MODE, INSTRUMENT + "slope2", SLOPES, scale=1e-4),
    Axis(
        "slope of mode 2, other sign",
        "1e-4/(slug ft)^1/2",
        INSTRUMENT + "slope2",
        (0.5, 1.0, 2.0, 3.0, 5.0),
        scale=-1e-4,
    ),
    Axis("elevator's servo", "rad/s", SERVO + "delta_e.0.frequency", (100.0, 60.0, 40.0, 30.0, 20.0)),
    Axis("elevator's rate", "deg/s", SERVO + "delta_e.0.rate_limit", (100.0, 20.0, 10.0, 5.0, 2.0), DEG),
    Axis("engine's servo", "rad/s", SERVO + "Phi.0.frequency", (20.0, 5.0, 2.0, 1.0, 0.5)),
)


@cache
def build_plane(frequency: Any, filter: Any = "tuned") -> Scenario:
    """Return the scenario before one of its parameters is made worse."""
    return replace(scenario(frequency=frequency, filter=filter, truth="plane"), duration=seconds(LENGTH))


def fly_until_late(flown: Scenario, spread: dict[str, Any], runs: int) -> tuple[Any, Any]:
    """Return True for flights (runs,) that succeed, and the rms errors of h (ft) at the end.

    SEEDS seeds are used in turn.
    """
    seeds = np.arange(runs) % SEEDS
    batch = simulate_batch(flown, seeds=seeds, spread=spread, signals=SIGNALS, log=True, log_period=ms(50))
    log, late = batch.log, batch.ticks * 1e-7 > LENGTH - LATE
    h, V, alpha = log["truth.h"], log["truth.V"], log["truth.alpha"] / DEG
    is_kept = ((h > 80e3) & (h < 95e3) & (V > 7e3) & (V < 9e3) & (alpha > 0) & (alpha < 4)).all(1)
    errors = [np.abs(log[f"law.{name}_error"][:, late]) for name in ("h", "V")]
    is_near = (errors[0].max(1) < OFF[0]) & (errors[1].max(1) < OFF[1])
    is_free = ~log["law.saturated"][:, late].astype(bool).any(1)
    return is_kept & is_near & is_free, np.sqrt(np.mean(errors[0] ** 2, axis=1))


def axis_settings(axis: Axis) -> Any:
    """Return the setting's value of each run: SEEDS runs for each value of the axis."""
    return np.repeat(axis.scale * np.asarray(axis.values), SEEDS)


@cache
def axis_shares() -> dict[str, Any]:
    """Return for each axis, by its name, the shares of flights that succeed, (frequencies, values)."""
    shares: dict[str, list[Any]] = {axis.name: [] for axis in AXES}
    for frequency in FREQUENCIES:
        flown = build_plane(frequency)
        for axis in AXES:
            settings = axis_settings(axis)
            success, _ = fly_until_late(flown, {axis.path: settings}, len(settings))
            shares[axis.name].append(success.reshape(-1, SEEDS).mean(1))
    return {name: np.array(found) for name, found in shares.items()}


def worst_values() -> Iterator[tuple[Axis, float]]:
    """Yield each axis with the worst value up to which all flights succeed, NaN if some fail at its first value."""
    for axis in AXES:
        succeeds = (axis_shares()[axis.name] == 1).all(0)
        reach = int(np.argmin(succeeds)) if not succeeds.all() else len(succeeds)
        yield axis, axis.values[reach - 1] if reach else float("nan")


@cache
def without_measurement() -> tuple[int, int]:
    """Return the number of successful flights without measurements in the filter, and the number of all flights."""
    found = [fly_until_late(build_plane(f, "none"), {}, SEEDS)[0] for f in FREQUENCIES]
    return int(np.concatenate(found).sum()), len(FREQUENCIES) * SEEDS


@cache
def rough_flights() -> dict[float, tuple[int, float]]:
    """Return for each factor of turbulence the number of successful flights and the median rms error of h (ft)."""
    times = np.repeat(ROUGHNESS, SEEDS)
    both = [fly_until_late(build_plane(f), {"world.turbulence.intensity": times}, len(times)) for f in FREQUENCIES]
    success, errors = (np.stack([b[i].reshape(-1, SEEDS) for b in both]) for i in (0, 1))
    return {x: (int(success[:, i].sum()), float(np.median(errors[:, i]))) for i, x in enumerate(ROUGHNESS)}
