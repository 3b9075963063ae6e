"""The plan of a campaign, checked against its scenario, and what each run of it is.

A plan is plain data and decides every row, so that a later session or another machine makes the same rows.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.campaign.grammar import Condition, parse_condition
from trimtab.campaign.sampling.distributions import Amount, Distribution
from trimtab.campaign.sampling.points import DESIGNS, Points, check_factors, points
from trimtab.campaign.sampling.spread import Factor, Spread, parse_factors, resolve_spread, spread_arrays, spread_values
from trimtab.campaign.statistics.metrics import Metric, default_metrics, find_metric, short_name
from trimtab.core.errors import InputError
from trimtab.core.record import Option, Quantity, leaves, with_leaf, with_part_of
from trimtab.core.time import ms
from trimtab.logs.log import provenance
from trimtab.loop.scenario import Scenario
from trimtab.loop.settings import with_settings
from trimtab.loop.walk import logged_signals
from trimtab.run.inputs import run_inputs
from trimtab.run.program import check_seed, describe_scenario
from trimtab.run.walk_program import signal_structure
from trimtab.scenarios.build import build

MEMORY = 48 * 2**20
"""Bytes of logged rows that a block holds at once, about."""
FEWEST, MOST = 64, 2048
"""Runs of a block."""
VARIANTS = 64
"""Programs that choices of options may ask for."""


class CampaignPlan(NamedTuple):
    """The campaign. Settings, imperfections and faults as `trimtab run` takes them.

    spread: what differs and what it is drawn from.  correlate: pairs of what was written, with their correlation.
    runs: of the whole campaign; only a Latin hypercube's rows depend on it.  success: conditions, all of which hold.
    """

    scenario: str
    settings: tuple[tuple[str, str], ...] = ()
    without: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    seed: int = 0
    runs: int = 1000
    sampling: str = "random"
    spread: tuple[tuple[str, Distribution], ...] = ()
    correlate: tuple[tuple[str, str, float], ...] = ()
    metrics: tuple[str, ...] = ()
    success: tuple[str, ...] = ()
    log_period: int = ms(10)

    def as_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        return json.loads(json.dumps(self._asdict() | {"spread": [[p, d._asdict()] for p, d in self.spread]}))


def plan_campaign(
    part: str,
    scenario: str | Scenario,
    settings: Mapping[str, str] | None,
    without: Iterable[str],
    faults: Iterable[str],
    seed: int,
    **rest: Any,
) -> CampaignPlan:
    """The plan of a scenario, which is named or given itself; then settings, without and faults have no place.

    part: what a refusal names.  rest: fields of the plan.
    """
    check_seed(seed)
    changes = tuple(sorted((settings or {}).items())), tuple(without), tuple(faults)
    if isinstance(scenario, str):
        return CampaignPlan(scenario, *changes, seed=seed, **rest)
    if any(changes):
        raise InputError(part, "settings are for a scenario that is named", fix="change the scenario itself")
    return CampaignPlan(scenario.name, seed=seed, **rest)


def plan_from_dict(plain: Mapping[str, Any]) -> CampaignPlan:
    """The plan of what `CampaignPlan.as_dict` gave."""
    fields = {name: _as_tuples(value) for name, value in plain.items()}
    fields["spread"] = tuple((path, _distribution_from_dict(d)) for path, d in plain["spread"])
    return CampaignPlan(**fields)


def _distribution_from_dict(plain: Mapping[str, Any]) -> Distribution:
    distribution = Distribution(**{name: _as_tuples(value) for name, value in plain.items()})
    return distribution._replace(amounts=tuple(Amount(*a) for a in plain["amounts"]))


def _as_tuples(value: Any) -> Any:
    return tuple(_as_tuples(v) for v in value) if isinstance(value, list) else value


def identity(plan: CampaignPlan, scenario: Scenario, backend: str) -> dict[str, str]:
    """What must be equal for two rows of one number to be equal: the campaign, the scenario, what computes it."""
    of_plan = plan.as_dict()
    if plan.sampling != "latin":
        del of_plan["runs"]
    about = describe_scenario(scenario)
    of_scenario = {"parameters": about["parameters"], "parts": about["parts"]}
    digests = {"campaign": of_plan, "scenario": of_scenario, "files": _file_digests(plan)}
    return {**{name: _digest(plain) for name, plain in digests.items()}, "backend": backend, **provenance()}


def _file_digests(plan: CampaignPlan) -> dict[str, str]:
    """Name of each file of Python that the plan names -> digest of what it holds."""
    texts = (plan.scenario, *plan.metrics, *plan.success)
    names = {text.partition(".py:")[0].strip() + ".py" for text in texts if ".py:" in text}
    return {name: hashlib.sha256(Path(name).read_bytes()).hexdigest() for name in sorted(names)}


def _digest(plain: Any) -> str:
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()[:16]


class PreparedCampaign(NamedTuple):
    """A plan, checked against its scenario. block: runs that fly together, and are kept together."""

    plan: CampaignPlan
    scenario: Scenario
    spread: Spread
    metrics: tuple[Metric, ...]
    success: tuple[Condition, ...]
    logged_signals: tuple[str, ...]
    block: int


def prepare_campaign(
    plan: CampaignPlan, scenario: Scenario | None = None, own: Iterable[Metric] = ()
) -> PreparedCampaign:
    """Check everything that can be checked before anything flies.

    Args:
        plan: the campaign.
        scenario: where it is not to be built from the plan's name and settings.
        own: metrics that are functions.

    Raises: InputError with what to type instead.
    """
    if scenario is None:
        scenario = build(plan.scenario, dict(plan.settings), plan.without, plan.faults)
    factors = parse_factors(plan.spread)
    scenario = with_spread_parts(scenario, factors)
    scenario.check()
    shapes, units = signal_shapes(scenario)
    targets, own = tuple(scenario.targets), tuple(own)
    texts = plan.metrics or (() if own else default_metrics(targets))
    metrics = tuple(find_metric(text, shapes, targets, units) for text in dict.fromkeys(texts)) + own
    conditions = tuple(parse_condition(text) for text in plan.success)
    conditions = conditions or tuple(Condition(f"settling:{short_name(t.path)}", "<", np.inf) for t in targets)
    needed = [c.metric for c in conditions if c.metric not in [m.name for m in metrics]]
    metrics += tuple(find_metric(text, shapes, targets, units) for text in dict.fromkeys(needed))
    spread = resolve_spread(scenario, factors, plan.correlate)
    if plan.sampling in DESIGNS:
        check_factors([f.text for f in spread.factors], [pair[:2] for pair in plan.correlate])
    signals = tuple(sorted({s for m in metrics for s in m.signals})) or (next(iter(shapes)),)
    ready = PreparedCampaign(plan, scenario, spread, metrics, conditions, signals, 0)
    _check_values(ready)
    width = sum(int(np.prod(s)) for p, s in shapes.items() if any(p == w or p.startswith(w + ".") for w in signals))
    rows = max(scenario.duration // plan.log_period, 1)
    block = int(np.clip(MEMORY // (8 * rows * max(width, 1)), FEWEST, MOST)) // FEWEST * FEWEST
    return ready._replace(block=block)


def with_spread_parts(scenario: Scenario, factors: Iterable[Factor]) -> Scenario:
    """The scenario with the optional parts that what differs leads into, e.g. the hovercraft's friction."""
    for factor in factors:
        scenario = with_part_of(scenario, factor.path)
    return scenario


def signal_shapes(scenario: Scenario) -> tuple[dict[str, tuple[int, ...]], dict[str, str]]:
    """Shape and unit of each signal by path; nothing flies."""
    signals = list(logged_signals(signal_structure(run_inputs(scenario))))
    return {path: tuple(np.shape(value)) for path, value, _ in signals}, {path: d.unit for path, _, d in signals}


def draw_runs(ready: PreparedCampaign, first: int, last: int) -> tuple[Points, dict[str, Any]]:
    """Points of the runs first … last - 1, and what each has where it differs."""
    names = tuple(f.text for f in ready.spread.factors)
    drawn = points(ready.plan.sampling, ready.plan.seed, names, ready.plan.runs, first, last)
    return drawn, spread_values(ready.spread, ready.scenario, drawn.u)


def _check_values(ready: PreparedCampaign) -> None:
    """Refuse a spread that leaves a parameter's range, naming the run; parts check themselves at each extreme."""
    extremes: dict[str, list[tuple[float, int]]] = {}
    for first in range(0, ready.plan.runs, 2**16):
        _, values = draw_runs(ready, first, min(first + 2**16, ready.plan.runs))
        for text, column in values.items():
            for at in (int(np.argmin(column)), int(np.argmax(column))):
                extremes.setdefault(text, []).append((float(column[at]), first + at))
    ends = {run for values in extremes.values() for run in (min(values)[1], max(values)[1])}
    for run in sorted(ends):
        try:
            scenario_of(ready, run).check()
        except InputError as error:
            problem = f"run {run} of the campaign can't be flown: {error.problem}"
            fix = "narrow the spread, e.g. --spread 'PATH=truncated(MEAN, STD, LOW, HIGH)'"
            fix += f"; or {error.fix}" if error.fix else ""
            raise InputError(f"--spread {error.part}", problem, choices=error.choices, fix=fix) from None
    options = program_options(ready).values()
    count = int(np.prod([len(set(f.distribution.choices)) for f in options] or [1]))
    if count > VARIANTS:
        problem = f"the choices of {', '.join(f.path for f in options)} make {count} programs"
        raise InputError("--spread", problem, fix=f"at most {VARIANTS} together: offer fewer choices")


def parameters_at(ready: PreparedCampaign, u: Any) -> dict[str, Any]:
    """Path -> value of each parameter at the point u (d,) of the spread, to the bit as it flies there; no options."""
    dtypes = {path: d.dtype() for path, _, d in leaves(ready.scenario) if isinstance(d, Quantity)}
    arrays = spread_arrays(ready.spread, ready.scenario, spread_values(ready.spread, ready.scenario, u[None]))
    return {path: np.asarray(array[0]).astype(dtypes[path])[()] for path, array in arrays.items()}


def scenario_at(ready: PreparedCampaign, u: Any) -> Scenario:
    """The scenario at the point u (d,) of the spread, options too."""
    values = spread_values(ready.spread, ready.scenario, u[None])
    scenario = scenario_variant(ready, {text: int(values[text][0]) for text in program_options(ready)})
    for path, value in parameters_at(ready, u).items():
        scenario = with_leaf(scenario, path, lambda _old, _declared, value=value: value)
    return scenario


def scenario_of(ready: PreparedCampaign, run: int) -> Scenario:
    """The scenario of one run, with all that is its own."""
    return scenario_at(ready, draw_runs(ready, run, run + 1)[0].u[0])


def program_options(ready: PreparedCampaign) -> dict[str, Factor]:
    """What differs and shapes the program, by what was written."""
    declared = {path: d for path, _, d in leaves(ready.scenario)}
    return {f.text: f for f in ready.spread.factors if isinstance(declared[f.path], Option)}


def scenario_variant(ready: PreparedCampaign, picks: Mapping[str, int]) -> Scenario:
    """The scenario with the choices of these numbers, by what was written."""
    texts = {f.path: f.distribution.choices[picks[text]] for text, f in program_options(ready).items()}
    return with_settings(ready.scenario, texts) if texts else ready.scenario


def refuse_options(ready: PreparedCampaign) -> None:
    """Refuse a spread of what shapes the program: a search moves numbers."""
    for text, factor in program_options(ready).items():
        problem = f"{factor.path} shapes the program, and a search moves numbers"
        fix = f"one search each, e.g. --set '{factor.path}={factor.distribution.choices[0]}'"
        raise InputError(f"--spread {text}", problem, fix=fix)


def check_bounds(ready: PreparedCampaign, ends: Any) -> None:
    """Refuse bounds beyond what a part can be flown with: each parameter at its ends, and all at once.

    ends: (2, d), the least and the largest point.
    """
    middle, names = ends.mean(axis=0), [f.text for f in ready.spread.factors]
    corners = [(ends[side], "all at one end") for side in (0, 1)]
    for i, name in enumerate(names):
        for side in (0, 1):
            point = middle.copy()
            point[i] = ends[side, i]
            corners.insert(0, (point, name))
    for point, name in corners:
        try:
            scenario_at(ready, point).check()
        except InputError as error:
            problem = f"can't be flown at its end: {error.part}: {error.problem}"
            raise InputError(f"--spread {name}", problem, choices=error.choices, fix="narrower bounds") from None
