"""Error budget: effect of each imperfection on errors, from flights without and flights only with this imperfection.

Source: docs page, Error budget.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.explain_call import explain_call
from trimtab.core.quantity import leaves, split_component
from trimtab.core.time import to_seconds
from trimtab.logs.log import Log
from trimtab.logs.metrics import full_path
from trimtab.logs.navigation import state_series
from trimtab.loop.scenario import Scenario
from trimtab.run.inputs import run_inputs
from trimtab.run.known_signals import find_signals
from trimtab.run.simulate import simulate_many
from trimtab.scenarios.build import find_scenario

ALL, NONE = "all imperfections", "no imperfections"
"""Names of the set of flights with all imperfections, and of the set without imperfections."""
NAVIGATION_FIELDS = {
    "position": ("north", "east"),
    "velocity": ("surge_velocity", "sway_velocity"),
    "heading": ("heading",),
}
"""Name of a navigation error -> fields of the estimate that are compared with the true state."""
UNITS = {"position error": "m", "velocity error": "m/s", "heading error": "rad"}


class Cost(NamedTuple):
    """Effect of one imperfection on the measures. A measure is the RMS of an error over runs and instants.

    without: measure -> value and standard error, from flights with all imperfections except this one.  alone: measure
    -> value and standard error, from flights with this imperfection only. If a run has no valid estimate, the measures
    of the estimate's errors are infinite.
    """

    name: str
    without: Mapping[str, tuple[float, float]]
    alone: Mapping[str, tuple[float, float]]


class ErrorBudget(NamedTuple):
    """Effects of all imperfections. Their sum may differ from the total, because imperfections interact.

    units: name of a measure -> unit.  whole: name of a measure -> value and standard error, with all imperfections.
    least: name of a measure -> value and standard error, without imperfections.  costs: effects of the imperfections,
    the largest first.
    """

    units: Mapping[str, str]
    whole: Mapping[str, tuple[float, float]]
    least: Mapping[str, tuple[float, float]]
    costs: tuple[Cost, ...]


@explain_call()
def error_budget(
    scenario: Scenario | str,
    *,
    seeds: Iterable[int] = range(20),
    names: Iterable[str] = (),
    tell: Callable[[str], None] = lambda done: None,
    backend: str = "auto",
) -> ErrorBudget:
    """Return the effect of each imperfection of a scenario on its errors.

    The scenario is flown with all imperfections, with none, and, for each imperfection, with all except this one and
    with this one only.

    >>> from trimtab import build, error_budget
    >>> budget = error_budget(build("hovercraft/spin", {"duration": "1 s"}), seeds=range(2), names=["dead-zone"])
    >>> [cost.name for cost in budget.costs]
    ['dead-zone']

    The measures are RMS errors in the second half of each run: the deviations of signals from the scenario's targets,
    and the deviations of a navigation estimate from the true state at the same time.

    Args:
        scenario: scenario, or name of a scenario.
        seeds: seeds of the runs. Every set of flights has the same seeds, so that only the imperfections differ.
        names: names of imperfections. Empty: all imperfections of the scenario.
        tell: function that is called after each set of flights, with the name of the set.
        backend: backend, as in `simulate`.

    Raises: InputError if the scenario does not have a named imperfection, or has neither targets nor an estimate.
    """
    scenario = find_scenario(scenario)
    chosen, known = list(seeds), scenario.imperfections()
    if not chosen:
        raise InputError("error_budget", "at least one seed is needed", fix="use e.g. seeds=range(20)")
    names = list(names) or sorted(known)
    for name in names:
        scenario.without(name)  # raises InputError for an unknown name
    if not _is_measurable(scenario):
        _refuse_scenario(scenario)

    signal_units = find_signals(scenario).units
    aimed = [full_path(t.path) for t in scenario.targets]
    others = [split_component(path)[0] for path in aimed if not path.startswith(("truth.", "estimate."))]
    needed = ("truth", "estimate", *dict.fromkeys(others))

    def fly_without(label: str, switched_off: Iterable[str]) -> dict[str, tuple[float, float]]:
        changed = scenario
        for name in switched_off:
            changed = changed.without(name)
        logs = simulate_many(changed, seeds=chosen, signals=needed, backend=backend)
        measures = _compute_measures(logs, scenario)
        tell(label)
        return measures

    whole = fly_without(ALL, ())
    if not whole:
        _refuse_scenario(scenario)
    least = fly_without(NONE, known)
    costs = [
        Cost(
            name, fly_without(f"without {name}", [name]), fly_without(f"{name} alone", [n for n in known if n != name])
        )
        for name in names
    ]
    rows = [least, *(row for cost in costs for row in (cost.without, cost.alone))]
    measures = [measure for measure in whole if all(measure in row for row in rows)]
    costs.sort(key=lambda cost: [cost.without[m][0] for m in measures[:1]])
    own = {path.removeprefix("truth."): signal_units[split_component(path)[0]] for path in aimed}
    units = {m: UNITS.get(m) or own[m] for m in measures}
    return ErrorBudget(units, whole, least, tuple(costs))


def flight_set_count(scenario: Scenario, names: Iterable[str] = ()) -> int:
    """Return the number of sets of flights in an error budget. `error_budget` calls `tell` once for each set."""
    return 2 + 2 * len(list(names) or scenario.imperfections())


def cost_share(budget: ErrorBudget, cost: Cost, measure: str) -> float:
    """Return the share of an imperfection in the total mean square error.

    The share is negative if the imperfection reduces the error, and NaN if a measure is infinite.
    """
    whole, without = budget.whole[measure][0], cost.without[measure][0]
    if not (np.isfinite(whole) and np.isfinite(without)):
        return float("nan")
    return (whole**2 - without**2) / whole**2 if whole > 0 else 0.0


def _is_measurable(scenario: Scenario) -> bool:
    """Return True if a scenario has targets, or an estimate with standard deviations to compare with the true state."""
    if scenario.targets:
        return True
    _, autopilot = jax.eval_shape(run_inputs(scenario).initial_states)
    known = {path.rpartition(".")[2] for path, _, _ in leaves(autopilot.estimate)}
    true = {path for path, _, _ in leaves(scenario.initial)}
    return any(all(s in true and {s, f"sigma_{s}"} <= known for s in signals) for signals in NAVIGATION_FIELDS.values())


def _refuse_scenario(scenario: Scenario) -> None:
    problem = "has neither targets nor an estimate with standard deviations (sigma_…), so no error can be measured"
    fix = "add targets=(Target(…),) to the scenario, or use another scenario: trimtab budget hovercraft/forward"
    raise InputError(f"scenario {scenario.name!r}", problem, fix=fix)


def _compute_measures(logs: list[Log], scenario: Scenario) -> dict[str, tuple[float, float]]:
    half = to_seconds(scenario.duration) / 2
    squares: dict[str, list[float]] = {}
    for log in logs:
        rows = log.t >= half
        for target in scenario.targets:
            path = full_path(target.path)
            away = log[path][rows] - target.value
            squares.setdefault(path.removeprefix("truth."), []).append(float(np.mean(away**2)))
        states = state_series(log)
        for measure, signals in NAVIGATION_FIELDS.items():
            series = [states[s] for s in signals if s in states and states[s].error is not None]
            if len(series) == len(signals):
                late = [one.error[one.t >= half] for one in series]
                square = sum(float(np.mean(e**2)) if len(e) else np.inf for e in late)
                squares.setdefault(f"{measure} error", []).append(square)
    return {measure: _root_mean_square(np.array(values)) for measure, values in squares.items()}


def _root_mean_square(squares: Any) -> tuple[float, float]:
    """Return the RMS error over all runs, and the standard error of this RMS. squares: mean square of each run (n,)."""
    mean, n = float(squares.mean()), len(squares)
    root = float(np.sqrt(mean))
    if n < 2 or root == 0.0 or not np.isfinite(root):
        return root, 0.0
    return root, float(squares.std(ddof=1)) / np.sqrt(n) / (2 * root)
