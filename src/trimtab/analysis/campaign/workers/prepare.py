"""Plan of a campaign, with checks against the scenario, and computation of the parameters of each run.

A plan is JSON-compatible data that determines the results of every run. From the same plan, a later session or another
machine computes the same results.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.analysis.campaign.grammar import Condition, parse_condition
from trimtab.analysis.campaign.sampling.distributions import Amount, Distribution, parse_distribution
from trimtab.analysis.campaign.sampling.points import DESIGNS, Points, check_factors, points
from trimtab.analysis.campaign.sampling.spread import (
    Factor,
    Spread,
    parse_factors,
    resolve_spread,
    spread_arrays,
    spread_values,
)
from trimtab.analysis.campaign.sampling.varying import fault_spread, pieces_spread, with_pieces
from trimtab.analysis.campaign.statistics.metrics import Metric, default_metrics, find_metric, name_option, short_name
from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.record import Option, Quantity, leaves, with_leaf, with_part_of
from trimtab.core.time import ms
from trimtab.logs.log import provenance
from trimtab.loop.calibration import format_calibration, parse_calibration, read_calibration
from trimtab.loop.scenario import Scenario
from trimtab.loop.settings import with_settings
from trimtab.run.known_signals import find_signals
from trimtab.run.program import check_seed, describe_scenario
from trimtab.scenarios.build import CALIBRATION, build

MEMORY = 48 * 2**20
"""Approximate memory (bytes) for the logged rows of a block of runs."""
BLOCK_RUNS_MIN, BLOCK_RUNS_MAX = 64, 2048
"""Minimum and maximum number of runs in a block."""
VARIANTS = 64
"""Maximum number of compiled programs, one for each combination of varied options."""


class CampaignPlan(NamedTuple):
    """Plan of a campaign. settings, without, faults: as in `trimtab run`.

    spread: pairs (path, distribution) of the varied parameters.  correlate: pairs of these paths, each with the
    correlation.  runs: total number of runs. The parameters of a run depend on this number only for a Latin hypercube.
    success: conditions that must all hold.  log_period: time between log rows (100 ns).  calibration: content of the
    calibration file named in the settings, so that other machines do not need the file.  inputs: inputs held constant
    in pieces, as typed after `--vary`.
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
    calibration: str = ""
    inputs: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return the plan as JSON-compatible data."""
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
    """Create a plan. Settings, `without` and faults need a scenario given by name, not as an object.

    part: name of the caller, for error messages.  rest: other fields of the plan.
    """
    check_seed(seed)
    own = dict(settings or {})
    file = own.pop(CALIBRATION, "")
    changes = tuple(sorted(own.items())), tuple(without), tuple(faults)
    if isinstance(scenario, str):
        content = format_calibration(read_calibration(file)) if file else ""
        return CampaignPlan(scenario, *changes, seed=seed, calibration=content, **rest)
    if any(changes) or file:
        raise InputError(part, "settings need a scenario given by name", fix="change the scenario itself")
    return CampaignPlan(scenario.name, seed=seed, **rest)


def plan_search(
    part: str,
    scenario: str | Scenario,
    spread: Mapping[str, str],
    *,
    fault_ranges: Iterable[str] = (),
    vary: Iterable[str] = (),
    **rest: Any,
) -> CampaignPlan:
    """Create the plan of a search over parameters, faults with ranges, and inputs that are constant in pieces.

    fault_ranges, vary: faults and inputs as typed, see `sampling.varying`.  rest: as in `plan_campaign`.
    """
    ranges, inputs = tuple(fault_ranges), tuple(vary)
    if not ranges and not inputs:
        return plan_campaign(part, scenario, **rest, spread=_parse_spread(spread))
    if not isinstance(scenario, str):
        raise InputError(part, "varied faults and inputs need a scenario given by name", fix="file.py:function")
    bare = plan_campaign(part, scenario, **{**rest, "faults": ()})
    built = with_pieces(build_scenario(bare), inputs)
    rest["faults"], more = fault_spread(rest["faults"], built, ranges)
    plan = plan_campaign(part, scenario, **rest, inputs=inputs)
    more |= pieces_spread(build_scenario(plan), inputs)
    for path in spread:
        if path in more:
            raise InputError(
                argument_name("spread", path),
                "already varies",
                fix="leave out this spread, or the fault range or input that varies the same quantity",
            )
    return plan._replace(spread=_parse_spread({**spread, **more}))


def _parse_spread(spread: Mapping[str, str]) -> tuple[tuple[str, Distribution], ...]:
    return tuple(
        (path, parse_distribution(text, argument_name("spread", path))) for path, text in sorted(spread.items())
    )


def build_scenario(plan: CampaignPlan) -> Scenario:
    """Build the scenario that is named in a plan, with the plan's settings, faults, calibration and inputs."""
    calibration = parse_calibration("calibration", plan.calibration) if plan.calibration else None
    return with_pieces(build(plan.scenario, dict(plan.settings), plan.without, plan.faults, calibration), plan.inputs)


def plan_from_dict(plain: Mapping[str, Any]) -> CampaignPlan:
    """Create a plan from the result of `CampaignPlan.as_dict`."""
    fields = {name: _as_tuples(value) for name, value in plain.items()}
    fields["spread"] = tuple((path, _distribution_from_dict(d)) for path, d in plain["spread"])
    return CampaignPlan(**fields)


def _distribution_from_dict(plain: Mapping[str, Any]) -> Distribution:
    distribution = Distribution(**{name: _as_tuples(value) for name, value in plain.items()})
    return distribution._replace(amounts=tuple(Amount(*a) for a in plain["amounts"]))


def _as_tuples(value: Any) -> Any:
    return tuple(_as_tuples(v) for v in value) if isinstance(value, list) else value


def identity(plan: CampaignPlan, scenario: Scenario, backend: str) -> dict[str, str]:
    """Return the data that determine a campaign's results: digests of plan, scenario and files, backend, versions."""
    of_plan = plan.as_dict()
    if plan.sampling != "latin":
        del of_plan["runs"]
    for name in ("calibration", "inputs"):
        if not of_plan[name]:
            del of_plan[name]  # this field is absent in older plans
    about = describe_scenario(scenario)
    of_scenario = {"parameters": about["parameters"], "parts": about["parts"]}
    digests = {"campaign": of_plan, "scenario": of_scenario, "files": _file_digests(plan)}
    return {**{name: _digest(plain) for name, plain in digests.items()}, "backend": backend, **provenance()}


def _file_digests(plan: CampaignPlan) -> dict[str, str]:
    """Return name -> digest of each Python file that the plan names."""
    texts = (plan.scenario, *plan.metrics, *plan.success)
    names = {text.partition(".py:")[0].strip() + ".py" for text in texts if ".py:" in text}
    return {name: hashlib.sha256(Path(name).read_bytes()).hexdigest() for name in sorted(names)}


def _digest(plain: Any) -> str:
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()[:16]


class PreparedCampaign(NamedTuple):
    """Plan, checked against the scenario. block: number of runs that are flown and stored together."""

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
    """Prepare a campaign, and check everything that can be checked before any run starts.

    Args:
        plan: plan of the campaign.
        scenario: scenario of the campaign. None: the scenario is built from the name and settings in the plan.
        own: the user's metrics that are defined by functions.

    Raises: InputError with a fix, for an invalid campaign.
    """
    if scenario is None:
        scenario = build_scenario(plan)
    factors = parse_factors(plan.spread)
    scenario = with_spread_parts(scenario, factors)
    scenario.check()
    known = find_signals(scenario)
    targets, own = tuple(scenario.targets), tuple(own)
    texts = plan.metrics or (() if own else default_metrics(targets))
    length = scenario.duration
    metrics = (
        tuple(find_metric(text, known.shapes, targets, known.units, length) for text in dict.fromkeys(texts)) + own
    )
    conditions = tuple(parse_condition(text) for text in plan.success)
    conditions = conditions or tuple(Condition(f"settling:{short_name(t.path)}", "<", np.inf) for t in targets)
    needed = [c.metric for c in conditions if c.metric not in [m.name for m in metrics]]
    for text, condition in {c.metric: c for c in reversed(conditions) if c.metric in needed}.items():
        with name_option("success", f" {condition.compare} {condition.bound:g}"):
            metrics += (find_metric(text, known.shapes, targets, known.units, length),)
    spread = resolve_spread(scenario, factors, plan.correlate)
    if plan.sampling in DESIGNS:
        check_factors([f.text for f in spread.factors], [pair[:2] for pair in plan.correlate])
    signals = known.source_signals(s for m in metrics for s in m.signals) or (next(iter(known.shapes)),)
    ready = PreparedCampaign(plan, scenario, spread, metrics, conditions, signals, 0)
    _check_values(ready)
    width = sum(
        int(np.prod(s)) for p, s in known.shapes.items() if any(p == w or p.startswith(w + ".") for w in signals)
    )
    rows = max(scenario.duration // plan.log_period, 1)
    block = (
        int(np.clip(MEMORY // (8 * rows * max(width, 1)), BLOCK_RUNS_MIN, BLOCK_RUNS_MAX))
        // BLOCK_RUNS_MIN
        * BLOCK_RUNS_MIN
    )
    return ready._replace(block=block)


def with_spread_parts(scenario: Scenario, factors: Iterable[Factor]) -> Scenario:
    """Add the optional parts of the vehicle whose parameters vary, e.g. the hovercraft's friction."""
    for factor in factors:
        scenario = with_part_of(scenario, factor.path)
    return scenario


def draw_runs(ready: PreparedCampaign, first: int, last: int) -> tuple[Points, dict[str, Any]]:
    """Return the sampling points of runs first … last - 1, and the values of the varied parameters in these runs."""
    names = tuple(f.text for f in ready.spread.factors)
    drawn = points(ready.plan.sampling, ready.plan.seed, names, ready.plan.runs, first, last)
    return drawn, spread_values(ready.spread, ready.scenario, drawn.u)


def _check_values(ready: PreparedCampaign) -> None:
    """Raise InputError, with the run's number, if a varied parameter leaves the valid range.

    For each parameter, only the runs with its smallest and its largest value are checked.
    """
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
            fix = f"narrow the spread, e.g. {argument('spread', 'truncated(MEAN, STD, LOW, HIGH)', 'PATH')}"
            fix += f"; or {error.fix}" if error.fix else ""
            raise InputError(argument_name("spread", error.part), problem, choices=error.choices, fix=fix) from None
    options = program_options(ready).values()
    count = int(np.prod([len(set(f.distribution.choices)) for f in options] or [1]))
    if count > VARIANTS:
        problem = f"the choices of {', '.join(f.path for f in options)} need {count} compiled programs"
        raise InputError(
            argument_name("spread"), problem, fix=f"vary fewer choices, so that at most {VARIANTS} programs are needed"
        )


def parameters_at(ready: PreparedCampaign, u: Any) -> dict[str, Any]:
    """Return path -> exact value of each varied parameter, at the quantiles u (d,). Options are not included."""
    dtypes = {path: d.dtype() for path, _, d in leaves(ready.scenario) if isinstance(d, Quantity)}
    arrays = spread_arrays(ready.spread, ready.scenario, spread_values(ready.spread, ready.scenario, u[None]))
    return {path: np.asarray(array[0]).astype(dtypes[path])[()] for path, array in arrays.items()}


def scenario_at(ready: PreparedCampaign, u: Any) -> Scenario:
    """Return the scenario with all varied parameters and options at the quantiles u (d,)."""
    values = spread_values(ready.spread, ready.scenario, u[None])
    scenario = scenario_variant(ready, {text: int(values[text][0]) for text in program_options(ready)})
    for path, value in parameters_at(ready, u).items():
        scenario = with_leaf(scenario, path, lambda _old, _declared, value=value: value)
    return scenario


def scenario_of(ready: PreparedCampaign, run: int) -> Scenario:
    """Return the scenario of one run, with the parameters of this run."""
    return scenario_at(ready, draw_runs(ready, run, run + 1)[0].u[0])


def program_options(ready: PreparedCampaign) -> dict[str, Factor]:
    """Return the options that vary, by the text of the spread.

    Each choice of an option needs a separate compiled program.
    """
    declared = {path: d for path, _, d in leaves(ready.scenario)}
    return {f.text: f for f in ready.spread.factors if isinstance(declared[f.path], Option)}


def scenario_variant(ready: PreparedCampaign, picks: Mapping[str, int]) -> Scenario:
    """Return the scenario with some options changed. picks: text of an option in the spread -> number of the choice."""
    texts = {f.path: f.distribution.choices[picks[text]] for text, f in program_options(ready).items()}
    return with_settings(ready.scenario, texts) if texts else ready.scenario


def refuse_options(ready: PreparedCampaign) -> None:
    """Raise InputError if an option varies, because a search can vary only numbers."""
    for text, factor in program_options(ready).items():
        problem = f"{factor.path} changes the program, but a search can vary only numbers"
        fix = (
            f"one search for each choice, e.g. with {argument('settings', factor.distribution.choices[0], factor.path)}"
        )
        raise InputError(argument_name("spread", text), problem, fix=fix)


def check_bounds(ready: PreparedCampaign, ends: Any) -> None:
    """Raise InputError if a bound of a varied parameter is not valid.

    Each parameter is tested alone at both ends of its range, and all parameters together.
    ends: (2, d), lower and upper ends of the ranges, as probabilities.
    """
    middle, names = ends.mean(axis=0), [f.text for f in ready.spread.factors]
    corners = [(ends[side], "all parameters at one end") for side in (0, 1)]
    for i, name in enumerate(names):
        for side in (0, 1):
            point = middle.copy()
            point[i] = ends[side, i]
            corners.insert(0, (point, name))
    for point, name in corners:
        try:
            scenario_at(ready, point).check()
        except InputError as error:
            problem = f"can't be flown at an end of its range: {error.part}: {error.problem}"
            raise InputError(
                argument_name("spread", name), problem, choices=error.choices, fix="choose narrower bounds"
            ) from None
