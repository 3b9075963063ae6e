"""Tuning: search for gains that minimise the mean cost of many runs, and validation in runs not used for tuning.

A gain is a parameter with a search range, e.g. ``autopilot.law.k1=0.5:3``. Its position x within the range is scaled
to [0, 1], on a logarithmic scale for a range written as ``loguniform(LOW, HIGH)``. A limit that ends in % is
a percentage of the value in the scenario.

Two sets of gains are compared in runs with the same random numbers, so that common variation cancels in the difference:

    D_i = cost of the second set - cost of the first set, in run i        mean(D) ± t_{n-1} std(D)/sqrt(n)

If a cost is infinite, the mean does not exist. The comparison is then a sign test: the share of runs in which
the second set is better, among the runs in which the costs differ, with its exact interval.

Source: Law, "Simulation modeling and analysis", 5th ed. 2015, sections 10.2.1 (paired t) and 11.2 (common random
numbers); Dixon, Mood, "The statistical sign test", Journal of the ASA 41 (1946); docs page, Tune.
"""

import re
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.analysis.campaign.grammar import CostTerm, parse_cost
from trimtab.analysis.campaign.sampling.distributions import Distribution, parse_distribution
from trimtab.analysis.campaign.sampling.points import inside_cube
from trimtab.analysis.campaign.sampling.spread import (
    Factor,
    Spread,
    parse_factors,
    resolve_spread,
    spread_arrays,
    spread_values,
)
from trimtab.analysis.campaign.search.comparison import Comparison, compare
from trimtab.analysis.campaign.search.cost import evaluate_cost, integral_cost
from trimtab.analysis.campaign.search.tune_methods import Slope, TuningStep, descend_gradient, search_gains
from trimtab.analysis.campaign.statistics.metrics import name_option
from trimtab.analysis.campaign.workers.block import fly_points, open_memo
from trimtab.analysis.campaign.workers.prepare import (
    CampaignPlan,
    PreparedCampaign,
    build_scenario,
    check_bounds,
    draw_runs,
    parameters_at,
    plan_campaign,
    prepare_campaign,
    refuse_options,
    with_spread_parts,
)
from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.explain_call import explain_call
from trimtab.core.quantity import first_number
from trimtab.core.record import leaves
from trimtab.loop.scenario import Scenario
from trimtab.run.gradient import gradients

METHODS = ("search", "gradient")
RANGES = ("uniform", "loguniform")
UNSEEN = 2**31
"""Run number of the first validation run. Tuning flies only runs with smaller numbers."""
BOUND = 0.01
"""Largest distance of a gain from an end of the search range, as a fraction of the range, at which the gain counts as
being at the end."""


def _falls(low: str, high: str) -> bool:
    try:
        return float(low.rstrip("% ")) >= float(high.rstrip("% "))
    except ValueError:
        return False


def parse_gain(path: str, text: str) -> Distribution:
    """Read the search range of a gain from text. path: path of the gain, for errors."""
    part, fix = (
        argument_name("gains", path),
        f"{argument('gains', '0.5:3', path)}, or {argument('gains', 'loguniform(0.01, 10)', path)}",
    )
    low, colon, high = text.partition(":")
    if colon:
        try:
            return parse_distribution(f"uniform({low}, {high})", part)
        except InputError:
            fix = argument("gains", f"{high}:{low}", path) if _falls(low, high) else fix
            problem = f"LOW must be below HIGH, got {text!r}"
            raise InputError(part, problem, fix=fix) from None
    span = parse_distribution(text, part) if "(" in text else None
    if span is None or span.kind not in RANGES:
        raise InputError(part, f"{text!r} is not a valid range", choices=("LOW:HIGH", "loguniform(LOW, HIGH)"), fix=fix)
    return span


class Gains(NamedTuple):
    """Gains that are tuned.

    ready: prepared campaign.  at: indices of the gains among the campaign's varied parameters.
    own: values of the gains in the scenario.  start: (d,), positions of these values in the search ranges, scaled to
    [0, 1].
    """

    ready: PreparedCampaign
    at: Any
    own: tuple[float, ...]
    start: Any

    @property
    def factors(self) -> tuple[Factor, ...]:
        """Return the campaign's varied parameters that are gains."""
        return tuple(self.ready.spread.factors[i] for i in self.at)

    def spread_points(self, x: Any, first: int) -> Any:
        """Return sampling points u (n, number of varied parameters) for runs first … first + n - 1.

        The gains are at scaled positions x (n, d) in their ranges. The other parameters are drawn as in a campaign.
        """
        u = draw_runs(self.ready, first, first + len(x))[0].u.copy()
        u[:, self.at] = inside_cube(x)
        return u

    def slope(self, x: Any) -> Any:
        """Return the derivative (n, d) of each gain with respect to its scaled position x (n, d) in the range."""
        columns = []
        for factor, place, own in zip(self.factors, np.asarray(x).T, self.own, strict=True):
            low, high = (a.of(own) for a in factor.distribution.amounts)
            if factor.distribution.kind == "loguniform":
                columns.append(np.log(high / low) * low * (high / low) ** place)
            else:
                columns.append(np.full(len(place), high - low))
        return np.stack(columns, axis=1)

    def gain_values(self, x: Any) -> dict[str, float]:
        """Return path of a gain -> value, for scaled positions x (d,)."""
        each = zip(self.factors, inside_cube(x), self.own, strict=True)
        return {f.text: float(f.distribution.quantile(np.array([u]), own)[0]) for f, u, own in each}

    def at_bounds(self, x: Any) -> tuple[str, ...]:
        """Return the paths of gains whose scaled position in x (d,) is within BOUND of an end of the range."""
        return tuple(f.text for f, place in zip(self.factors, x, strict=True) if abs(place - 0.5) > 0.5 - BOUND)

    def values(self, x: Any) -> dict[str, Any]:
        """Return path -> parameter value, for gains at scaled positions x (d,).

        Array elements that are not gains keep the scenario's values.
        """
        alone = self.ready._replace(spread=Spread(self.factors))
        return parameters_at(alone, inside_cube(x))


def campaign_gains(ready: PreparedCampaign, names: tuple[str, ...]) -> Gains:
    """Return the gains of a campaign.

    Raise InputError if a search range does not include the gain's value in the scenario.
    """
    texts = [f.text for f in ready.spread.factors]
    at = np.array([i for i, text in enumerate(texts) if text in names])
    known = {path: value for path, value, _ in leaves(ready.scenario)}
    values, start = [], []
    for i in at:
        factor = ready.spread.factors[i]
        part, value = argument_name("gains", factor.text), np.asarray(known[factor.path])
        if value.ndim and factor.at is None:
            fix = argument("gains", "LOW:HIGH", first_number(factor.path, value.shape))
            raise InputError(part, f"has shape {value.shape}, but a gain must be one number", fix=fix)
        own = float(value[factor.at or ()])
        low, high = (
            a.of(own) for a in factor.distribution.amounts
        )  # percentages of a negative number are in falling order
        if not min(low, high) <= own <= max(low, high):
            problem = f"the scenario's own value, {own:g}, must lie within {min(low, high):g} … {max(low, high):g}"
            raise InputError(
                part,
                problem,
                fix=f"use a wider range, or another start value: {argument('settings', f'{low:g}', factor.text)}",
            )
        log = factor.distribution.kind == "loguniform"
        values.append(own)
        start.append(np.log(own / low) / np.log(high / low) if log else (own - low) / (high - low))
    return Gains(ready, at, tuple(values), np.array(start))


class TuningResult(NamedTuple):
    """Result of tuning.

    values: path -> exact parameter value with the tuned gains.  before, after: path of a gain -> value in the scenario,
    and tuned value.  steps: steps of the method.  slopes: slope of the cost at each step of the gradient method.
    seen_comparison: comparison with the scenario's own gains, in the runs used for tuning.
    held_out_comparison: the same comparison in the validation runs. It decides if the tuned gains are better.
    flown_runs: total number of runs. A run with derivatives along d gains counts d times.  wall_s: duration (s).
    at_bounds: gains within BOUND of an end of the range. A wider range may lead to a better result.
    """

    plan: CampaignPlan
    method: str
    values: dict[str, Any]
    before: dict[str, float]
    after: dict[str, float]
    steps: list[TuningStep]
    slopes: list[Slope]
    seen_comparison: Comparison
    held_out_comparison: Comparison
    flown_runs: int
    wall_s: float
    at_bounds: tuple[str, ...] = ()

    @property
    def is_improvement(self) -> bool:
        """Return True if the comparison in the validation runs shows a significant improvement."""
        return self.held_out_comparison.improves


@explain_call()
def tune(
    scenario: str | Scenario,
    *,
    gains: Mapping[str, str],
    cost: str,
    method: str = "search",
    runs: int = 64,
    held_out: int = 256,
    iterations: int = 30,
    width: float = 0.05,
    spread: Mapping[str, str] | None = None,
    seed: int = 0,
    settings: Mapping[str, str] | None = None,
    without: Iterable[str] = (),
    faults: Iterable[str] = (),
    backend: str = "auto",
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
    store: Path | None = None,
) -> TuningResult:
    """Tune gains on many runs, then compare them with the scenario's own gains on other runs.

    >>> from trimtab import tune
    >>> few = {"runs": 8, "held_out": 16, "iterations": 2, "settings": {"duration": "1 s"}, "cost": "rms:yaw_rate"}
    >>> list(tune("hovercraft/zero-velocity", gains={"autopilot.law.k1": "0.5:3"}, **few).before)
    ['autopilot.law.k1']

    Args:
        scenario: name in the catalogue, ``file.py:function``, or a `Scenario`.
        gains: path -> range, e.g. "0.5:3" or "loguniform(0.01, 10)". The search starts at the scenario's own value.
        cost: metrics with weights, e.g. "error_rms:yaw_rate + 2*error_rms:sway_velocity".
        method: "search" (CMA-ES, any metric) or "gradient" (costs that are integrals, with a C compiler).
        runs: number of runs of each candidate, or of each gradient step.  held_out: number of validation runs.
        iterations: number of generations, or of gradient steps.
        width: width over which the gradient is smoothed, as a fraction of each range.
        spread: other parameters that vary from run to run, as in a campaign.
        seed: seed of the runs' random numbers and of the method.
        settings, without, faults: as in `trimtab run`, only for a scenario given by name.
        backend, threads: as in `simulate_batch`.  progress: called with the number of runs flown since the last call.
        store: folder in which finished runs are stored. The same tuning resumes from this folder.
    Raises: InputError for a scenario that can't be flown or tuned, before any run starts.
    """
    began = time.perf_counter()
    _check_tuning(gains, method, runs, held_out, iterations, width)
    terms = parse_cost(cost)
    differ = [(p, parse_gain(p, text)) for p, text in gains.items()]
    differ += [(p, parse_distribution(text, argument_name("spread", p))) for p, text in (spread or {}).items()]
    plan = plan_campaign(
        "tune",
        scenario,
        settings,
        without,
        faults,
        seed,
        runs=runs,
        spread=tuple(sorted(differ)),
        metrics=tuple(t.metric for t in terms),
    )
    chosen = _prepare_gains(plan, scenario, tuple(gains))
    options = {"backend": backend, "threads": threads, "progress": progress}
    fly = _GainFlights(chosen, terms, runs, options | {"memo": open_memo(store, chosen.ready, backend)})
    if method == "search":
        (x, steps), slopes = search_gains(fly.costs, chosen.start, runs, iterations, seed), list[Slope]()
    else:
        x, steps, slopes = descend_gradient(fly.slope_function(), chosen.start, runs, iterations, width, seed)
    return TuningResult(
        plan=chosen.ready.plan,
        method=method,
        values=chosen.values(x),
        before=chosen.gain_values(chosen.start),
        after=chosen.gain_values(x),
        steps=steps,
        slopes=slopes,
        seen_comparison=fly.compare_gains(x, 0, runs),
        held_out_comparison=fly.compare_gains(x, UNSEEN, held_out),
        flown_runs=fly.flown_runs,
        wall_s=time.perf_counter() - began,
        at_bounds=chosen.at_bounds(x),
    )


def _check_tuning(
    gains: Mapping[str, str], method: str, runs: int, held_out: int, iterations: int, width: float
) -> None:
    if not gains:
        raise InputError(argument_name("gains"), "no gain given", fix=argument("gains", "0.5:3", "autopilot.law.k1"))
    if method not in METHODS:
        raise InputError(
            argument_name("method"), f"unknown method {method!r}", choices=METHODS, fix=argument("method", "search")
        )
    for name, number, least in (("runs", runs, 4), ("held_out", held_out, 16), ("iterations", iterations, 1)):
        if number < least:
            raise InputError(
                argument_name(name), f"must be at least {least}, got {number}", fix=argument(name, max(least, 64))
            )
    if not 0 < width <= 0.5:
        problem = f"must be above 0 and at most 0.5, got {width}"
        raise InputError(argument_name("width"), problem, fix=argument("width", 0.05))


def _prepare_gains(plan: CampaignPlan, scenario: str | Scenario, gains: tuple[str, ...]) -> Gains:
    """Return the gains to tune, after a check of the search ranges.

    Errors name the gain, not the spread that represents the gain.
    """
    try:
        if isinstance(scenario, str):
            scenario = build_scenario(plan)
        factors = parse_factors(plan.spread)
        scenario = with_spread_parts(scenario, factors)
        spread = resolve_spread(scenario, factors)
        bare = PreparedCampaign(plan, scenario, spread, (), (), (), 0)
        refuse_options(bare)
        chosen = campaign_gains(bare, gains)
        ends = np.stack([np.full(len(spread.factors), level) for level in (1e-3, 0.999)])
        ends[:, chosen.at] = inside_cube([[0.0], [1.0]])
        check_bounds(bare, ends)
        with name_option("cost"):
            return chosen._replace(ready=prepare_campaign(plan, scenario))
    except InputError as error:
        path = next((path for path in gains if error.part == argument_name("spread", path)), None)
        if path is None:
            raise
        fix, element = error.fix, re.search(rf"{re.escape(path)}\[[\d,]+\]", error.fix)
        if element or (fix.startswith(argument_name("spread")) and error.choices):
            fix = argument("gains", "LOW:HIGH", element[0] if element else error.choices[0])
        elif fix.startswith(argument_name("spread")):
            fix = f"{argument('settings', '…', path)}: gains are real numbers"
        raise InputError(argument_name("gains", path), error.problem, choices=error.choices, fix=fix) from None


class _GainFlights:
    """Function that flies runs with gains at given positions in their search ranges, and counts the runs."""

    def __init__(self, gains: Gains, terms: tuple[CostTerm, ...], runs: int, options: Mapping[str, Any]) -> None:
        self.gains, self.terms, self.runs, self.options = gains, terms, runs, options
        self.flown_runs = 0

    def costs(self, x: Any, first: int = 0, runs: int | None = None) -> Any:
        """Return costs (n, runs) of n sets of gains at scaled positions x (n, d).

        All sets are flown in the same runs. first: number of the first run.
        """
        n = runs or self.runs
        u = np.concatenate([self.gains.spread_points(np.repeat(place[None], n, axis=0), first) for place in x])
        words = np.tile(np.arange(first, first + n, dtype=np.uint32), len(x))
        self.flown_runs += len(words)
        return evaluate_cost(self.terms, fly_points(self.gains.ready, u, words, **self.options)).reshape(len(x), n)

    def compare_gains(self, x: Any, first: int, runs: int) -> Comparison:
        """Compare the gains at scaled positions x with the scenario's own gains, in runs first … first + runs - 1."""
        before, after = self.costs(np.stack([self.gains.start, x]), first, runs)
        return compare(before, after)

    def slope_function(self) -> Callable[[Any, int], tuple[Any, Any]]:
        """Return a function that flies pairs of runs, and returns costs and derivatives with respect to the gains."""
        ready, gains = self.gains.ready, self.gains
        of = integral_cost(self.terms, ready)
        along = [(f.path, f.at or ()) for f in gains.factors]

        def differentiate(u: Any, first: int, pairs: int) -> dict[str, Any]:
            integrals = gradients(
                ready.scenario,
                of.cost,
                along,
                seeds=[ready.plan.seed] * len(u),
                runs=np.repeat(np.arange(first, first + pairs), 2),
                spread=spread_arrays(ready.spread, ready.scenario, spread_values(ready.spread, ready.scenario, u)),
                since=of.since,
                threads=self.options["threads"],
            )
            return {"costs": integrals.costs, "slopes": integrals.slopes}

        def flights(x: Any, first: int) -> tuple[Any, Any]:
            pairs = len(x) // 2
            u = np.repeat(draw_runs(ready, first, first + pairs)[0].u, 2, axis=0)
            u[:, gains.at] = inside_cube(x)
            flown = self.options["memo"].recall((u, np.int64(first)), lambda: differentiate(u, first, pairs))
            self.flown_runs += len(x) * len(along)
            if self.options["progress"] is not None:
                self.options["progress"](len(x) * len(along))
            costs, slopes = of.finish(flown["costs"], flown["slopes"])
            return costs, slopes * gains.slope(x)

        return flights
