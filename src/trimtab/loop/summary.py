"""Summary of a scenario in a few lines: the class and the first parameters of each part."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from trimtab.core.quantity import Option, Quantity, children, is_record
from trimtab.core.time import format_time

FEW = 4
"""Maximum number of parameters that the summary shows for each part."""
NOTE = "every setting: trimtab.settings(scenario); change some: trimtab.with_settings(scenario, {path: value})"


def summarise_scenario(scenario: Any) -> list[tuple[str, str]]:
    """Return the name and a one-line description of each part of a scenario."""
    world, autopilot = scenario.world, scenario.autopilot
    rows = [("vehicle", describe_part(world.vehicle))]
    rows += [(f"sensor {name}", describe_part(sensor)) for name, sensor in world.sensors.items()]
    rows += [(name, describe_part(getattr(world, name))) for name in ("downlink", "uplink", "actuators")]
    rows += [(name, describe_part(getattr(autopilot, name))) for name in ("estimator", "law", "allocation")]
    for owner in (world, autopilot):
        optional = ("integration", "turbulence", "supervisor", "predictor", "monitor")
        rows += [(n, describe_part(getattr(owner, n))) for n in optional if getattr(owner, n, None) is not None]
    rows.append(("initial", describe_part(scenario.initial, skips_zero=True)))
    targets = [f"{t.path.removeprefix('truth.')} {t.value:.4g} ± {t.band:.3g}" for t in scenario.targets]
    return [*rows, ("targets", _join(targets, "none"))][:17]


def describe_part(part: Any, *, skips_zero: bool = False) -> str:
    """Return a one-line description of a part: its class and its first parameters.

    skips_zero: True to leave out parameters that are zero.
    """
    if not is_record(part):
        return "none" if part is None else type(part).__name__
    numbers = [(name, value, declared) for name, value, declared in children(part)]
    words = [_describe_number(n, v, d) for n, v, d in numbers if not (skips_zero and not np.any(v))]
    known = [word for word in words if word]
    return f"{type(part).__name__}: {_join(known, '')}" if known else type(part).__name__


def _join(words: list[str], none: str) -> str:
    return ", ".join(words[:FEW]) + (" …" if len(words) > FEW else "") if words else none


def _describe_number(name: str, value: Any, declared: Any) -> str:
    if isinstance(declared, Option):
        return f"{name} {format_time(value)}" if declared.kind == "period" else ""
    if not isinstance(declared, Quantity) or isinstance(value, Mapping):
        return ""
    unit = "" if declared.unit == "1" else f" {declared.unit}"
    if np.ndim(value):
        few = np.ndim(value) == 1 and np.size(value) <= FEW
        return f"{name} [{', '.join(f'{v:.4g}' for v in np.asarray(value))}]{unit}" if few else ""
    return f"{name} {float(value):.6g}{unit}"
