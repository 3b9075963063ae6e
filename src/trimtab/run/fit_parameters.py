"""Parameters that can be fitted to logs of flights: settings of vehicle and actuators, and a delay, with bounds."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.quantity import Quantity, first_number, has_index, leaves, split_index
from trimtab.core.record import with_part_of
from trimtab.core.suggestions import closest
from trimtab.loop.scenario import Scenario

DELAY = "delay"
"""Name of the fit parameter for the time (s) from a logged command to its effect, including differences of clocks."""
LONGEST_DELAY = 0.5


class FitParameter(NamedTuple):
    """Parameter to fit.

    path: path of a setting, or "delay".  start: initial value of the fit.  low, high: bounds of the fitted value.
    """

    path: str
    unit: str
    start: float
    low: float
    high: float


def find_parameters(scenario: Scenario, paths: Sequence[str]) -> tuple[Scenario, tuple[FitParameter, ...]]:
    """Return the parameters at the given paths, and the scenario with all optional parts that these parameters need.

    Raise InputError if a path is not a numeric parameter of the vehicle or its actuators.
    """
    parameters = []
    for path in paths:
        if list(paths).count(path) > 1:
            raise InputError(argument_name("paths", path), "is given twice", fix="name each parameter once")
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
            problem = "is not a numeric parameter of the vehicle or its actuators"
            raise InputError(argument_name("paths", path), problem, choices=near, fix=argument("paths", [near[0]]))
        value, declared = real[base]
        assert isinstance(declared, Quantity)
        if not has_index(np.shape(value), at):
            fix = argument("paths", [first_number(base, np.shape(value))])
            problem = f"has shape {np.shape(value)}, so the index of one of its elements is needed"
            if not np.shape(value):
                problem = "is one number, so its path must not have an index"
            raise InputError(argument_name("paths", path), problem, fix=fix)
        value = np.asarray(value, np.float64)[at or ()]
        low, high = _bounds(declared)
        parameters.append(FitParameter(path, declared.unit, float(value), low, high))
    if not parameters:
        raise InputError(
            "identify", "at least one parameter is needed", fix=argument("paths", ["world.vehicle.mass", "delay"])
        )
    table = getattr(scenario.world.actuators, "table", None)
    is_computed = getattr(table, "origin", "") == "formula" or any(".actuators.thruster." in p for p in paths)
    for path in [p for p in paths if is_computed and p.startswith("world.actuators.table.")]:
        problem = "cannot be fitted, because this table is computed from the parameters of the thruster"
        fix = argument("paths", ["world.actuators.thruster.coefficient"])
        raise InputError(argument_name("paths", path), problem, fix=fix)
    return scenario, tuple(parameters)


def _bounds(declared: Quantity) -> tuple[float, float]:
    low = declared.above if declared.above is not None else declared.low
    low = -math.inf if low is None else float(low) + (1e-6 if declared.above is not None else 0.0)
    return low, math.inf if declared.high is None else float(declared.high)


def find_scale(p: FitParameter) -> float:
    """Return the step size of a parameter in the fit: a tenth of its initial value or, for zero, a value by unit."""
    if p.path == DELAY:
        return 0.01
    return 0.1 * abs(p.start) if p.start else {"rad": 0.02, "m": 0.01}.get(p.unit, 0.003)
