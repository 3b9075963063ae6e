"""A block of runs, from the plan to its rows: what differs is drawn, the runs are flown, the metrics are taken."""

import itertools
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.campaign.condition import Condition, parse_condition
from trimtab.campaign.metrics import Metric, Rows, default_metrics, parse_metric, short_name
from trimtab.campaign.plan import Plan
from trimtab.campaign.saltelli import check_factors
from trimtab.campaign.sampling import DESIGNS, Points, points
from trimtab.campaign.spread import Spread, arrays_of, parse_factors, resolve, values_of
from trimtab.core.errors import InputError
from trimtab.core.record import Option, Quantity, leaves, with_leaf
from trimtab.core.time import to_seconds
from trimtab.export.compiler import NoCompiler, search
from trimtab.logs.log import Log
from trimtab.loop.scenario import Scenario
from trimtab.loop.settings import with_settings
from trimtab.loop.walk import logged, signals, start
from trimtab.run import compiled
from trimtab.run.batch import Batch, simulate_batch
from trimtab.run.prepare import inputs, prepared, use_c
from trimtab.run.program import Column
from trimtab.scenarios.build import build

MEMORY = 48 * 2**20
"""Bytes of logged rows that a block holds at once, about."""
FEWEST, MOST = 64, 2048
VARIANTS = 64
"""Programs that choices of options may ask for."""


class Ready(NamedTuple):
    """A plan, checked against its scenario. block: runs that fly together, and are kept together."""

    plan: Plan
    scenario: Scenario
    spread: Spread
    metrics: tuple[Metric, ...]
    success: tuple[Condition, ...]
    wanted: tuple[str, ...]
    block: int


def prepare(plan: Plan, scenario: Scenario | None = None, own: Iterable[Metric] = ()) -> Ready:
    """Check everything that can be checked before anything flies.

    Args:
        plan: the campaign.
        scenario: where it is not to be built from the plan's name and settings.
        own: metrics that are functions.

    Raises: InputError with what to type instead.
    """
    if scenario is None:
        scenario = build(plan.scenario, dict(plan.settings), plan.without, plan.faults)
    scenario.check()
    shapes, units = signals_of(scenario)
    targets = tuple(scenario.targets)
    texts = plan.metrics or (() if tuple(own) else default_metrics(targets))
    metrics = tuple(parse_metric(text, shapes, targets, units) for text in dict.fromkeys(texts)) + tuple(own)
    conditions = tuple(parse_condition(text) for text in plan.success)
    needed = [c.metric for c in conditions if c.metric not in [m.name for m in metrics]]
    if not conditions:
        settled = [f"settling:{short_name(t.path)}" for t in targets]
        needed = [name for name in settled if name not in [m.name for m in metrics]]
        conditions = tuple(Condition(name, "<", np.inf) for name in settled)
    metrics += tuple(parse_metric(text, shapes, targets, units) for text in dict.fromkeys(needed))
    spread = resolve(scenario, parse_factors(plan.spread), plan.correlate)
    if plan.sampling in DESIGNS:
        check_factors([f.text for f in spread.factors], [pair[:2] for pair in plan.correlate])
    wanted = tuple(sorted({s for m in metrics for s in m.signals})) or (next(iter(shapes)),)
    ready = Ready(plan, scenario, spread, metrics, conditions, wanted, 0)
    _check_values(ready)
    width = sum(int(np.prod(s)) for p, s in shapes.items() if any(p == w or p.startswith(w + ".") for w in wanted))
    rows = max(scenario.duration // plan.log_period, 1)
    block = int(np.clip(MEMORY // (8 * rows * max(width, 1)), FEWEST, MOST)) // FEWEST * FEWEST
    return ready._replace(block=block)


def signals_of(scenario: Scenario) -> tuple[dict[str, tuple[int, ...]], dict[str, str]]:
    """Shape and unit of each signal by path; nothing flies."""
    seen = jax.eval_shape(lambda *fly: signals(*start(*fly)), *inputs(scenario, 0, 0))
    found = list(logged(seen))
    return {path: tuple(np.shape(value)) for path, value, _ in found}, {path: d.unit for path, _, d in found}


def drawn(ready: Ready, first: int, last: int) -> tuple[Points, dict[str, Any]]:
    """Points of the runs first … last - 1, and what each has where it differs."""
    names = tuple(f.text for f in ready.spread.factors)
    of = points(ready.plan.sampling, ready.plan.seed, names, ready.plan.runs, first, last)
    return of, values_of(ready.spread, ready.scenario, of.u)


def _check_values(ready: Ready) -> None:
    """Refuse a spread that leaves a parameter's range, naming the run; parts check themselves at each extreme."""
    declared = {path: d for path, _, d in leaves(ready.scenario)}
    options = {f.text: f.path for f in ready.spread.factors if isinstance(declared[f.path], Option)}
    extremes: dict[str, list[tuple[float, int]]] = {}
    for first in range(0, ready.plan.runs, 2**16):
        _, values = drawn(ready, first, min(first + 2**16, ready.plan.runs))
        for text, column in values.items():
            for at in (int(np.argmin(column)), int(np.argmax(column))):
                extremes.setdefault(text, []).append((float(column[at]), first + at))
    ends = {run for found in extremes.values() for run in (min(found)[1], max(found)[1])}
    for run in sorted(ends):
        try:
            scenario_of(ready, run).check()
        except InputError as error:
            problem = f"run {run} of the campaign can't be flown: {error.problem}"
            fix = "narrow the spread, e.g. --spread 'PATH=truncated(MEAN, STD, LOW, HIGH)'" + (
                f"; or {error.fix}" if error.fix else ""
            )
            raise InputError(f"--spread {error.part}", problem, choices=error.choices, fix=fix) from None
    count = int(np.prod([len(set(f.distribution.choices)) for f in ready.spread.factors if f.text in options] or [1]))
    if count > VARIANTS:
        problem = f"the choices of {', '.join(options)} make {count} programs"
        raise InputError("--spread", problem, fix=f"at most {VARIANTS} together: offer fewer choices")


def scenario_of(ready: Ready, run: int) -> Scenario:
    """The scenario of one run, with all that is its own."""
    _, values = drawn(ready, run, run + 1)
    scenario = _variant(ready, {text: int(column[0]) for text, column in values.items() if text in _options(ready)})
    for path, array in arrays_of(ready.spread, ready.scenario, values).items():
        scenario = with_leaf(scenario, path, lambda old, declared, array=array: _like(array[0], declared))
    return scenario


def _like(value: Any, declared: Quantity | Option) -> Any:
    if isinstance(declared, Quantity) and declared.kind not in ("real", "angle"):
        return np.asarray(value, declared.dtype())
    return np.asarray(value)[()]


def _options(ready: Ready) -> dict[str, Any]:
    declared = {path: d for path, _, d in leaves(ready.scenario)}
    return {f.text: f for f in ready.spread.factors if isinstance(declared[f.path], Option)}


def _variant(ready: Ready, picks: Mapping[str, int]) -> Scenario:
    texts = {f.path: f.distribution.choices[picks[text]] for text, f in _options(ready).items()}
    return with_settings(ready.scenario, texts) if texts else ready.scenario


def fly_block(
    ready: Ready,
    first: int,
    last: int,
    *,
    backend: str = "auto",
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> dict[str, Any]:
    """Rows first … last - 1: by name what differs, then each metric, `success` and `lost`, each (n,)."""
    of, values = drawn(ready, first, last)
    options = _options(ready)
    arrays = arrays_of(ready.spread, ready.scenario, values)
    kept: dict[str, Any] = {m.name: np.empty(last - first) for m in ready.metrics}
    kept |= {"success": np.empty(last - first, bool), "lost": np.empty(last - first, bool)}
    for picks, chosen in _groups(values, list(options), last - first):
        batch = simulate_batch(
            _variant(ready, picks),
            seeds=[ready.plan.seed] * len(chosen),
            runs=of.words[chosen],
            spread={path: array[chosen] for path, array in arrays.items()},
            signals=ready.wanted,
            log_period=ready.plan.log_period,
            log=True,
            backend=backend,
            threads=threads,
            progress=progress,
        )
        for name, column in measured(ready, batch).items():
            kept[name][chosen] = column
    return {**values, **kept}


def flies_c(ready: Ready, backend: str) -> bool:
    """Whether C flies the runs: where it is asked for, or a compiler is here and the loop can be written in C."""

    def can() -> None:
        found = search("c")
        if found.compiler is None:
            raise NoCompiler("compiler", found.problem, fix=found.fix)
        _, table, _ = prepared(ready.scenario, [], None, ready.plan.log_period)
        compiled.lowered(compiled.structure(inputs(ready.scenario, 0, 0), table.always, ready.wanted))

    return use_c(backend, can)


def _groups(values: Mapping[str, Any], options: list[str], n: int) -> list[tuple[dict[str, int], Any]]:
    """Runs of one program: what was picked for each option, and their places in the block."""
    if not options:
        return [({}, np.arange(n))]
    found = []
    for picks in itertools.product(*(np.unique(values[o]) for o in options)):
        inside = np.all([values[o] == p for o, p in zip(options, picks, strict=True)], axis=0)
        if inside.any():
            found.append(({o: int(p) for o, p in zip(options, picks, strict=True)}, np.flatnonzero(inside)))
    return found


class Flights(NamedTuple):
    """Of some runs: ticks of the rows, signals (n, rows, …), last values of the truth (n, …), what the columns are."""

    ticks: Any
    log: Mapping[str, Any]
    final: Mapping[str, Any]
    columns: list[Column]


def rows_of(scenario: Scenario, batch: Flights | Batch) -> Rows:
    """What metrics see of some runs."""
    angles = frozenset(c.path for c in batch.columns if c.declared is not None and c.declared.kind == "angle")
    return Rows(to_seconds(batch.ticks), batch.log, tuple(scenario.targets), angles)


def measured(ready: Ready, batch: Flights | Batch) -> dict[str, Any]:
    """Metrics, success and lost of some runs, each (n,)."""
    n = len(next(iter(batch.final.values())))
    rows = rows_of(ready.scenario, batch)
    with np.errstate(over="ignore", invalid="ignore"):  # a run that ran away is counted, not warned of
        found = {m.name: _column(m, rows, n) for m in ready.metrics}
    ends = np.stack([np.asarray(v, np.float64).reshape(n, -1).sum(axis=1) for v in batch.final.values()])
    lost = ~np.isfinite(ends).all(axis=0)
    success = ~lost
    for condition in ready.success:
        success &= condition.holds(found[condition.metric])
    return {**found, "success": success, "lost": lost}


def measured_log(ready: Ready, log: Log) -> dict[str, Any]:
    """The same of the log of one run."""
    columns = [Column(path, (), "float64", declared) for path, declared in log.declared.items()]
    one = {path: signal[None] for path, signal in log.signals.items()}
    final = {path: np.asarray(value)[None] for path, value in log.final.items()}
    return measured(ready, Flights(log.ticks, one, final, columns))


def _column(metric: Metric, rows: Rows, n: int) -> Any:
    column = np.asarray(metric.of(rows), np.float64)
    if column.shape != (n,):
        raise InputError(
            f"--metric {metric.name}", f"gave shape {column.shape}, wanted is {(n,)}", fix="one number a run"
        )
    return column
