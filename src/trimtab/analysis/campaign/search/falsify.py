"""Falsification: a search for the worst run inside given bounds.

    minimise over x in [0, 1]^d:  m(x) = minimum (or mean) over w of margin(run with parameters Q(x), noise w)

Q(x) are the quantiles of the varied parameters. A distribution without bounds is searched within three standard
deviations. The random key w, called word, selects the random numbers of a run. Every candidate x flies with the same
few words w (common random numbers), so that m depends only on x. The first runs cover the whole box [0, 1]^d with Sobol
points. CMA-ES then starts from the worst point, and restarts from the worst points elsewhere. The last runs fly the
worst point with new words.

The margin of a run measures how far the run is from failing. It is negative for a failure. It varies gradually, also
among successes and among failures. Each condition has a room: the distance of the
metric to the bound, relative to the bound. The margin of a run is that of the worst condition:

    settling:s <= T      1 - max |e|/band, over the rows from the last one at or before T
    first_reach:s <= T   1 - min |e|/band, over the rows up to T
    any other <= b       (b - x)/|b|, or b - x if b = 0
    >= and >             the same with the opposite sign
    margin               min of room/(1 + |room|), in (-1, 1);  a diverged run: -2 + t/T, t: first non-finite time

The room of settling is negative, the distance outside the band, if the signal does not settle by T. Otherwise it is the
remaining distance to the edge of the band. A margin is negative if and only if a condition does not hold.

Source: Annapureddy, Liu, Fainekos, Sankaranarayanan, "S-TaLiRo: a tool for temporal logic falsification", TACAS 2011,
for the search by robustness; Fainekos, Pappas, "Robustness of temporal logic specifications for continuous-time
signals", Theoretical Computer Science 410 (2009), definition 13, for "always from T on in the band" and "once until T"
as least and largest room; docs page, Falsify.
"""

import time
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import special
from scipy.stats import qmc

from trimtab.analysis.campaign.grammar import Condition, parse_metric
from trimtab.analysis.campaign.sampling.points import inside_cube
from trimtab.analysis.campaign.search.evolution import evolve
from trimtab.analysis.campaign.statistics.metrics import Metric, Rows
from trimtab.analysis.campaign.workers.block import fly_points, open_memo, repeat_run
from trimtab.analysis.campaign.workers.prepare import (
    CampaignPlan,
    PreparedCampaign,
    check_bounds,
    parameters_at,
    plan_search,
    prepare_campaign,
    refuse_options,
    scenario_at,
)
from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.explain_call import explain_call
from trimtab.loop.scenario import Scenario

NAME = "margin"
SMALLEST_VIOLATION = 1e-12
"""Smallest absolute value of the margin of a violated condition."""
OVER: Mapping[str, Callable[[Any], Any]] = {"worst": lambda m: m.min(axis=1), "mean": lambda m: m.mean(axis=1)}
"""Functions that combine margins (n, k) of k runs at n points into one value for each point (n,), to be minimised."""
TAIL = float(special.ndtr(-3.0))
"""Probability that is cut off at each end of a distribution without bounds."""
BATCH_RUNS_MIN = 64
"""Minimum number of runs in a batch. Fewer runs would not use the processor's vector units fully."""
FIRST, LAST = 0.15, 0.1
"""Fraction of all runs that covers the whole box at first, and fraction that repeats the worst point at last."""
STEP = 0.2
"""Initial standard deviation of CMA-ES, as a fraction of the box's width."""
START_DISTANCE_MIN = 0.3
"""Minimum distance between two starting points of CMA-ES, measured as the largest difference of a coordinate."""


def prepare_search(part: str, scenario: str | Scenario, spread: Mapping[str, str], **plan: Any) -> PreparedCampaign:
    """Prepare a search that computes the margin of each run. The arguments are those of `plan_search`."""
    planned = plan_search(part, scenario, spread, **plan)
    return with_margin(prepare_campaign(planned, None if isinstance(scenario, str) else scenario))


def with_margin(ready: PreparedCampaign) -> PreparedCampaign:
    """Return the prepared campaign with an additional metric, `margin`."""
    of = {m.name: m for m in ready.metrics}
    signals = tuple(sorted({s for c in ready.success for s in of[c.metric].signals}))
    more = Metric(NAME, signals, lambda rows: margin(rows, ready.success, of))
    return ready._replace(metrics=(*(m for m in ready.metrics if m.name != NAME), more))


def margins(columns: Mapping[str, Any]) -> Any:
    """Return the margins (n,) from the results of n runs.

    A run that diverged counts as a failure, whatever its metrics.
    """
    return np.where(columns["lost"], np.minimum(columns[NAME], -1.0), columns[NAME])


def margin(rows: Rows, conditions: tuple[Condition, ...], metrics: Mapping[str, Metric]) -> Any:
    """Compute the margins (n,) of n runs.

    Args:
        rows: logged rows of the runs.
        conditions: conditions that must all hold.
        metrics: metrics of the conditions, by name.
    """
    worst = np.min([_condition_margin(rows, c, metrics[c.metric]) for c in conditions], axis=0)
    wrong = [~np.isfinite(v).reshape(*v.shape[:2], -1).all(axis=2) for v in rows.signals.values()]
    bad = np.any(wrong, axis=0)
    late = rows.t[np.argmax(bad, axis=1)] / max(rows.t[-1], 1e-9)
    return np.where(bad.any(axis=1), -2.0 + late, worst)


def _condition_margin(rows: Rows, condition: Condition, metric: Metric) -> Any:
    """Compute the margins (n,) of one condition in n runs.

    A margin is negative if and only if the condition does not hold.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        value = np.asarray(metric.of(rows), np.float64)
        room = _distance_to_bound(rows, condition, value)
        squashed = np.where(np.isinf(room), np.sign(room), room / (1 + np.abs(room)))
    holds = condition.holds(value)
    squashed = np.where(np.isnan(squashed), np.where(holds, 1.0, -1.0), squashed)
    return np.where(holds, np.maximum(squashed, 0.0), np.minimum(squashed, -SMALLEST_VIOLATION))


def _distance_to_bound(rows: Rows, condition: Condition, value: Any) -> Any:
    kind, path = parse_metric(condition.metric)
    sign = 1.0 if condition.compare in ("<", "<=") else -1.0
    if kind in ("settling", "first_reach"):
        side = "right" if condition.compare in ("<=", ">") else "left"
        last = max(int(np.searchsorted(rows.t - rows.t[0], condition.bound, side)) - 1, 0)
        share = np.abs(rows.error(path)) / rows.band(path)
        return sign * (1 - (share[:, last:].max(axis=1) if kind == "settling" else share[:, : last + 1].min(axis=1)))
    return sign * (condition.bound - value) / (abs(condition.bound) or 1.0)


def spread_levels(ready: PreparedCampaign, x: Any) -> Any:
    """Map points x in [0, 1]^d to probabilities u of the varied parameters. Unbounded tails are cut off."""
    tail = np.array([TAIL if f.distribution.kind in ("normal", "lognormal") else 0.0 for f in ready.spread.factors])
    return inside_cube(tail + (1 - 2 * tail) * x)


class BoxSearch:
    """Search of the box [0, 1]^d, with the results of all runs flown.

    A call flies the points x (n, d) and returns the values to minimise (n,).
    """

    def __init__(
        self, ready: PreparedCampaign, words: int, over: Callable[[Any], Any], options: Mapping[str, Any]
    ) -> None:
        self.ready, self.words, self.over, self.options = ready, words, over, options
        self.restart, self.has_failed = -1, False
        self.flights: list[tuple[Any, Any, Any, Any]] = []
        self.starts: list[Any] = []

    def __call__(self, x: Any) -> Any:
        """Return the values to minimise at points x (n, d), all flown with the same random keys."""
        return self.over(self.fly_candidates(x, np.zeros(len(x), np.uint32)))

    def fly_candidates(self, x: Any, first: Any) -> Any:
        """Return margins (n, words) at points x (n, d). first (n,): first of the consecutive random keys."""
        u = np.repeat(spread_levels(self.ready, x), self.words, axis=0)
        words = first[:, None] + np.arange(self.words, dtype=np.uint32)
        m = margins(fly_points(self.ready, u, words.ravel(), **self.options)).reshape(words.shape)
        self.flights.append((x, m, first, np.full(len(x), self.restart)))
        self.has_failed |= bool((m < 0).any())
        return m

    def refly_worst(self, n: int) -> None:
        """Fly the worst candidate n more times, each time with new random keys."""
        x, m, *_ = self.candidates()
        first = self.words * np.arange(1, n + 1, dtype=np.uint32)
        self.restart += 1
        self.fly_candidates(np.repeat(x[[np.argmin(self.over(m))]], n, axis=0), first)

    def candidates(self) -> tuple[Any, ...]:
        """Return all candidates: points (n, d), margins (n, words), first random keys (n,), restart numbers (n,)."""
        return tuple(np.concatenate(parts) for parts in zip(*self.flights, strict=True))

    def remaining_candidates(self, runs: int) -> int:
        """Return the number of candidates that can still be flown. runs: total number of runs."""
        return runs // self.words - sum(len(x) for x, *_ in self.flights)

    def cover_box(self, n: int, until_first: bool) -> None:
        """Fly n Sobol points that cover the whole box, in batches."""
        d = len(self.ready.spread.factors)
        with warnings.catch_warnings(
            action="ignore", category=UserWarning
        ):  # the warning about balance does not matter here
            points = qmc.Sobol(d, rng=np.random.default_rng(self.ready.plan.seed)).random(n)
        for part in np.array_split(points, max(n * self.words // 512, 1)):
            self(part)
            if self.has_failed and until_first:
                return

    def start(self, restart: int) -> Any:
        """Return the point at which CMA-ES restarts: the worst candidate that is not near an earlier starting point."""
        self.restart = restart
        x, m, *_ = self.candidates()
        for i in np.argsort(self.over(m), kind="stable"):
            if all(np.abs(x[i] - s).max() > START_DISTANCE_MIN for s in self.starts):
                self.starts.append(x[i])
                return x[i]
        rng = np.random.default_rng(self.ready.plan.seed + len(self.starts))
        self.starts.append(rng.random(x.shape[1]))
        return self.starts[-1]


class FalsificationResult(NamedTuple):
    """Worst run that a search found, and all candidates of the search.

    margin: margin of the worst run, from a repetition of this run; negative if the run failed.  values: path -> exact
    value of the parameter.  point: (d,), point of the run in the box.  word: random key that selects the run's random
    numbers.  columns: metrics of the run.  flown_runs: total number of runs.  first: number of runs until the first
    failure, or None.  candidate_margins: (n, words), margins of all candidates in the order flown.  points: (n, d),
    points of the candidates in the box.  stages: (n,), -1 for a Sobol point, otherwise the number of the restart of
    CMA-ES. The largest number marks the repetitions of the worst point with new noise.  names: names of the varied
    parameters.
    """

    plan: CampaignPlan
    margin: float
    values: dict[str, Any]
    point: Any
    word: int
    columns: dict[str, Any]
    flown_runs: int
    first: int | None
    candidate_margins: Any
    points: Any
    stages: Any
    names: tuple[str, ...]
    wall_s: float

    @property
    def fails(self) -> bool:
        """Return True if a failure was found."""
        return self.margin < 0


@explain_call()
def falsify(
    scenario: str | Scenario,
    *,
    spread: Mapping[str, str] | None = None,
    fault_ranges: Iterable[str] = (),
    vary: Iterable[str] = (),
    success: Iterable[str] = (),
    runs: int = 5000,
    words: int = 4,
    over: str = "worst",
    seed: int = 0,
    until_first: bool = False,
    settings: Mapping[str, str] | None = None,
    without: Iterable[str] = (),
    faults: Iterable[str] = (),
    backend: str = "auto",
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
    store: Path | None = None,
) -> FalsificationResult:
    """Search for the worst run within the bounds of varied parameters.

    >>> from trimtab import falsify
    >>> brief, spread = {"duration": "1 s"}, {"world.vehicle.mass": "uniform(80%, 120%)"}
    >>> falsify("hovercraft/spin", spread=spread, success=["peak:yaw_rate <= 9"], settings=brief, runs=512).fails
    False

    Args:
        scenario: name in the catalogue, ``file.py:function``, or a `Scenario`.
        spread: path -> distribution as text, whose bounds limit the search, e.g. "uniform(80%, 120%)".
        fault_ranges: faults with ranges, e.g. "downlink off @ 2..10 s for 0.1..2 s".
        vary: inputs held constant in pieces, e.g. "stick.turn=pieces(5, -1:1)".
        success: conditions of a success, e.g. "settling:yaw_rate <= 10". Default: each target is reached and held.
        runs: maximum number of runs.
        words: number of runs for each candidate. The runs have different random numbers.
        over: "worst" or "mean": the margin of a candidate is the worst or the mean margin of its runs.
        seed: seed of the runs' random numbers and of the search.
        until_first: True to stop at the first failure.
        settings, without, faults: as in `trimtab run`, only for a scenario given by name.
        backend, threads: as in `simulate_batch`.
        progress: function called with the number of runs flown since the last call.
        store: folder in which finished runs are stored. The same search resumes from this folder.

    Raises: InputError for a search that can't be flown, before any run starts.
    """
    began = time.perf_counter()
    fault_ranges, vary = tuple(fault_ranges), tuple(vary)
    if not (spread or fault_ranges or vary):
        fix = argument("spread", "uniform(80%, 120%)", "world.vehicle.mass")
        raise InputError(argument_name("spread"), "no parameter varies", fix=fix)
    ready = prepare_search(
        "falsify",
        scenario,
        spread or {},
        fault_ranges=fault_ranges,
        vary=vary,
        settings=settings,
        without=without,
        faults=faults,
        seed=seed,
        runs=max(min(runs, 256), 1),
        success=tuple(success),
    )
    _check_search(ready, runs, words, over)
    options = {"backend": backend, "threads": threads, "progress": progress, "memo": open_memo(store, ready, backend)}
    search = BoxSearch(ready, words, OVER[over], options)
    last = max(int(LAST * runs) // words, 1)
    search.cover_box(max(int(FIRST * runs) // words, BATCH_RUNS_MIN // words, 1), until_first)
    if not (search.has_failed and until_first):
        at_least, budget = -(-BATCH_RUNS_MIN // words), search.remaining_candidates(runs) - last
        for _ in evolve(search, search.start, step=STEP, population=at_least, budget=budget, seed=seed):
            if search.has_failed and until_first:
                break
    if not (search.has_failed and until_first):
        search.refly_worst(last)
    return _summarise_search(ready, search, backend, began)


def _check_search(ready: PreparedCampaign, runs: int, words: int, over: str) -> None:
    if over not in OVER:
        raise InputError(
            argument_name("over"), f"must be worst or mean, got {over!r}", choices=OVER, fix=argument("over", "worst")
        )
    if not 1 <= words <= BATCH_RUNS_MIN:
        raise InputError(
            argument_name("words"),
            f"the number of runs for each point must be from 1 to {BATCH_RUNS_MIN}, got {words}",
            fix=argument("words", 4),
        )
    if runs < 4 * BATCH_RUNS_MIN:
        problem = f"a search needs at least {4 * BATCH_RUNS_MIN} runs, got {runs}"
        raise InputError(argument_name("runs"), problem, fix=argument("runs", 5000))
    refuse_options(ready)
    ends = [spread_levels(ready, np.full(len(ready.spread.factors), end)) for end in (0.0, 1.0)]
    check_bounds(ready, np.stack(ends))


def _summarise_search(ready: PreparedCampaign, search: BoxSearch, backend: str, began: float) -> FalsificationResult:
    """Repeat the worst run alone, and summarise the search."""
    x, m, first, stages = search.candidates()
    i, at = np.unravel_index(int(np.argmin(m)), m.shape)
    word = int(first[i] + at)
    u = spread_levels(ready, x[i])
    columns = repeat_run(ready, scenario_at(ready, u), backend, word)
    fails = np.flatnonzero((m < 0).ravel())
    return FalsificationResult(
        plan=ready.plan,
        margin=float(margins(columns)),
        values=parameters_at(ready, u),
        point=x[i],
        word=word,
        columns=columns,
        flown_runs=m.size,
        first=int(fails[0]) + 1 if len(fails) else None,
        candidate_margins=m,
        points=x,
        stages=stages,
        names=tuple(f.text for f in ready.spread.factors),
        wall_s=time.perf_counter() - began,
    )
