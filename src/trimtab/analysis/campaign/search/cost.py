"""Cost that tuning minimises: a weighted sum of metrics, e.g. ``error_rms:yaw_rate + 2*error_rms:sway_velocity``.

Tuning by gradient needs a cost that is an integral over the run. These metrics are integrals:

    error_rms   sqrt(1/T int (x - target)^2 dt), over the second half        rms   sqrt(1/T int x^2 dt)
    mean        1/T int x dt

For tuning by gradient they are computed from every time step, while the metrics of a campaign use the log rows.

Source: docs page, Tune.
"""

import functools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.analysis.campaign.grammar import CostTerm, parse_metric
from trimtab.analysis.campaign.workers.prepare import PreparedCampaign
from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.quantity import component_paths, split_component
from trimtab.core.time import to_seconds
from trimtab.logs.metrics import full_path
from trimtab.logs.spatial import FLIGHT
from trimtab.loop.walk import Signals, logged_signals
from trimtab.run.inputs import run_inputs
from trimtab.run.walk_structure import signal_structure

INTEGRALS = ("error_rms", "rms", "mean")


def evaluate_cost(terms: tuple[CostTerm, ...], columns: Mapping[str, Any]) -> Any:
    """Return the costs (n,) of runs from a campaign's results. The cost of a diverged run is infinite."""
    total = np.sum([t.weight * columns[t.metric] for t in terms], axis=0)
    return np.where(columns["lost"] | np.isnan(total), np.inf, total)


class IntegralCost(NamedTuple):
    """Cost as a function of k integrals. cost: integrands, in the form that `run.gradient.gradients` needs.

    since: start time of each integral (100 ns).  finish: function from integrals (n, k) of n runs and the slopes of
    these integrals (n, k, d) along d gains to costs (n,) and slopes of the costs (n, d).
    """

    cost: Callable[[Signals], Any]
    since: tuple[int, ...]
    finish: Callable[[Any, Any], tuple[Any, Any]]


def integral_cost(terms: tuple[CostTerm, ...], ready: PreparedCampaign) -> IntegralCost:
    """Convert a cost to integrals. Raise InputError for a metric that is not an integral."""
    targets = {full_path(t.path): float(t.value) for t in ready.scenario.targets}
    declared = {path: d for path, _, d in logged_signals(signal_structure(run_inputs(ready.scenario)))}
    integrands, since = [], []
    for term in terms:
        kind, name = parse_metric(term.metric)
        path = full_path(name)
        if kind not in INTEGRALS:
            problem = f"a gradient needs metrics that are integrals over the run, but {term.metric} is not an integral"
            raise InputError(
                argument_name("cost"),
                problem,
                choices=INTEGRALS,
                fix=f"{argument('method', 'search')} accepts any metric",
            )
        if path.startswith(FLIGHT):
            problem = f"{name} is computed after the flight, so it has no gradient"
            fix = f"{argument('method', 'search')}, or use a signal truth.…"
            raise InputError(argument_name("cost"), problem, fix=fix)
        if kind == "error_rms" and declared[split_component(path)[0]].kind == "angle":
            problem = f"{name} is an angle, whose target is shifted by full turns depending on the end of the run"
            raise InputError(
                argument_name("cost"),
                problem,
                fix=f"{argument('method', 'search')}, or the rms of a signal that does not wrap",
            )
        integrands.append((path, targets[path] if kind == "error_rms" else 0.0, kind != "mean"))
        since.append(ready.scenario.duration // 2 if kind == "error_rms" else 0)
    length = np.array([to_seconds(ready.scenario.duration - first) for first in since])
    weights, squared = np.array([t.weight for t in terms]), np.array([squared for _, _, squared in integrands])
    finish = functools.partial(_combine_integrals, length, weights, squared)
    return IntegralCost(_integrand(tuple(integrands)), tuple(since), finish)


@functools.cache
def _integrand(terms: tuple[tuple[str, float, bool], ...]) -> Callable[[Signals], Any]:
    """Return the integrand of a cost. The integrand is cached, so that each cost is compiled only once."""

    def integrand(instant: Signals) -> Any:
        numbers = {
            one: number
            for path, value, _ in logged_signals(instant)
            for one, number in zip(component_paths(path, np.shape(value)), jax.numpy.ravel(value), strict=True)
        }
        reals = [jax.numpy.asarray(numbers[path], np.float64) - value for path, value, _ in terms]
        return jax.numpy.stack([x * x if squared else x for x, (_, _, squared) in zip(reals, terms, strict=True)])

    return integrand


def _combine_integrals(length: Any, weights: Any, squared: Any, integrals: Any, slopes: Any) -> tuple[Any, Any]:
    mean, change = integrals / length, slopes / length[:, None]
    root = np.sqrt(np.maximum(mean, 0.0))
    value = np.where(squared, root, mean)
    factor = np.where(squared, 0.5 / np.maximum(root, 1e-12), 1.0)
    return value @ weights, np.einsum("nk,nkd->nd", factor * weights, change)
