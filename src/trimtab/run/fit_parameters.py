"""What is sought in flights: settings of the vehicle and of its actuators, with bounds, and a delay."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from trimtab.core.errors import InputError, argument, argument_name, closest
from trimtab.core.quantity import Quantity, first_number, has_index, leaves, split_index
from trimtab.core.record import with_part_of
from trimtab.loop.scenario import Scenario

DELAY = "delay"
"""What is sought besides settings: how much later than the log says a command acts (s); clocks that differ, too."""
LONGEST_DELAY = 0.5


class FitParameter(NamedTuple):
    """A number that is sought. path: setting, or "delay".  start: where the search begins.  low, high: bounds."""

    path: str
    unit: str
    start: float
    low: float
    high: float


def find_parameters(scenario: Scenario, paths: Sequence[str]) -> tuple[Scenario, tuple[FitParameter, ...]]:
    """The scenario with the parts that the paths lead into, and what is sought; refuses what can't be."""
    parameters = []
    for path in paths:
        if path == DELAY:
            parameters.append(FitParameter(DELAY, "s", 0.0, -LONGEST_DELAY, LONGEST_DELAY))
            continue
        base, at = split_index(path)
        scenario = with_part_of(scenario, base)
        known = {p: (v, d) for p, v, d in leaves(scenario) if p.startswith(("world.vehicle.", "world.actuators."))}
        real = {
            p: pair for p, pair in known.items() if isinstance(pair[1], Quantity) and pair[1].kind in ("real", "angle")
        }
        if base not in real:
            near = closest(base, [*real, DELAY], 6) or [DELAY, *list(real)[:6]]
            problem = "is no number of the vehicle or its actuators"
            raise InputError(argument_name("paths", path), problem, choices=near, fix=argument("paths", [near[0]]))
        value, declared = real[base]
        assert isinstance(declared, Quantity)
        if not has_index(np.shape(value), at):
            fix = f"{argument('paths', [first_number(base, np.shape(value))])}, one of them"
            raise InputError(argument_name("paths", path), f"has shape {np.shape(value)}", fix=fix)
        value = np.asarray(value, np.float64)[at or ()]
        low, high = _bounds(declared)
        parameters.append(FitParameter(path, declared.unit, float(value), low, high))
    if not parameters:
        raise InputError("identify", "nothing is to be fitted", fix=argument("paths", ["world.vehicle.mass", "delay"]))
    return scenario, tuple(parameters)


def _bounds(declared: Quantity) -> tuple[float, float]:
    low = declared.above if declared.above is not None else declared.low
    low = -math.inf if low is None else float(low) + (1e-6 if declared.above is not None else 0.0)
    return low, math.inf if declared.high is None else float(declared.high)


def find_scale(p: FitParameter) -> float:
    """What the search counts in: a tenth of the value, or a size that its unit suggests."""
    if p.path == DELAY:
        return 0.01
    return 0.1 * abs(p.start) if p.start else {"rad": 0.02, "m": 0.01}.get(p.unit, 0.003)
