"""Falsification: the worst case inside given bounds, searched for instead of waited for.

    least over x in [0, 1]^d of  m(x) = least (or mean) over the run words of margin(run at Q(x), word)

Q are the quantile functions of the spread, so that bounds and units are its own; a distribution without bounds is
searched within three standard deviations. A candidate flies with the same few words of random numbers as every other
(common random numbers), so that m has one value at a point. One part of the runs goes into Sobol points over the whole
box; CMA-ES starts from the worst of them, then from the worst that lie elsewhere. The last runs fly the worst point
with words that no candidate had.

Source: Annapureddy, Liu, Fainekos, Sankaranarayanan, "S-TaLiRo: a tool for temporal logic falsification", TACAS 2011,
for the search by robustness; docs page, Falsify.
"""

import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.campaign.sampling.distributions import parse_distribution
from trimtab.campaign.search.box_search import TOGETHER, Search, levels
from trimtab.campaign.search.ends import check_ends, refuse_options
from trimtab.campaign.search.evolution import evolve
from trimtab.campaign.search.margin import margins, with_margin
from trimtab.campaign.statistics.measure import measured_log
from trimtab.campaign.workers.plan import Plan
from trimtab.campaign.workers.ready import Ready, parameters_at, prepare, scenario_at
from trimtab.core.errors import InputError
from trimtab.core.time import ms
from trimtab.loop.scenario import Scenario
from trimtab.run.program import check_seed
from trimtab.run.simulate import simulate

OVER: Mapping[str, Callable[[Any], Any]] = {"worst": lambda m: m.min(axis=1), "mean": lambda m: m.mean(axis=1)}
FIRST, LAST = 0.15, 0.1
"""Shares of the runs: points over the whole box, and more random numbers at the worst point."""
STEP = 0.2


class Falsified(NamedTuple):
    """What was found.

    margin: of the worst run, as it flew again by itself; the run failed where it is negative.  values: path -> what the
    parameters have there, to the bit.  point: (d,), where in the box.  word: its run word.  columns: the metrics of
    that run.  flown: runs in all.  first: after how many the first failure, or None.  tried: margins of all
    candidates (n, words), in the order flown.  points: (n, d).  stages: (n,), -1 for the Sobol points, then the
    restarts, and last the worst point with other words.
    """

    plan: Plan
    margin: float
    values: dict[str, Any]
    point: Any
    word: int
    columns: dict[str, Any]
    flown: int
    first: int | None
    tried: Any
    points: Any
    stages: Any
    names: tuple[str, ...]
    wall_s: float

    @property
    def fails(self) -> bool:
        """Whether a failure was found."""
        return self.margin < 0


def falsify(
    scenario: str | Scenario,
    *,
    spread: Mapping[str, str],
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
) -> Falsified:
    """Search for the run that fails worst.

    Args:
        scenario: its name in the catalogue, ``file.py:function``, or the scenario itself.
        spread: path -> distribution as text, whose bounds are those of the search, e.g. "uniform(80%, 120%)".
        success: what a run must do, e.g. "settling:yaw_rate <= 10"; each target reached for good when empty.
        runs: how many may fly.
        words: with how many words of random numbers each candidate flies.
        over: "worst" or "mean" of their margins is what is searched.
        seed: of the runs' random numbers, and of the search.
        until_first: end with the first failure.
        settings, without, faults: as `trimtab run` takes them; for a scenario that is named.
        backend, threads: as `simulate_batch`.
        progress: called with the number of runs flown since.

    Raises: InputError for what can't be flown, before anything is.
    """
    began = time.perf_counter()
    ready = _ready(scenario, spread, success, runs, seed, settings, without, faults)
    _check_search(ready, runs, words, over)
    search = Search(ready, words, OVER[over], {"backend": backend, "threads": threads, "progress": progress})
    last = max(int(LAST * runs) // words, 1)
    search.cover(max(int(FIRST * runs) // words, TOGETHER // words, 1), until_first)
    if not (search.failed and until_first):
        at_least, budget = -(-TOGETHER // words), search.left(runs) - last
        for _ in evolve(search, search.start, step=STEP, population=at_least, budget=budget, seed=seed):
            if search.failed and until_first:
                break
    if not (search.failed and until_first):
        search.harden(last)
    return _result(ready, search, backend, began)


def _ready(
    scenario: str | Scenario,
    spread: Mapping[str, str],
    success: Iterable[str],
    runs: int,
    seed: int,
    settings: Mapping[str, str] | None,
    without: Iterable[str],
    faults: Iterable[str],
) -> Ready:
    check_seed(seed)
    if not spread:
        raise InputError("--spread", "nothing may differ", fix="--spread 'world.vehicle.mass=uniform(80%, 120%)'")
    named = isinstance(scenario, str)
    if not named and (settings or tuple(without) or tuple(faults)):
        raise InputError("falsify", "settings are for a scenario that is named", fix="change the scenario itself")
    plan = Plan(
        scenario=scenario if named else scenario.name,
        settings=tuple(sorted((settings or {}).items())),
        without=tuple(without),
        faults=tuple(faults),
        seed=seed,
        runs=max(min(runs, 256), 1),
        spread=tuple((p, parse_distribution(d, f"--spread {p}")) for p, d in sorted(spread.items())),
        success=tuple(success),
        log_period=ms(10),
    )
    return with_margin(prepare(plan, None if named else scenario))


def _check_search(ready: Ready, runs: int, words: int, over: str) -> None:
    if over not in OVER:
        raise InputError("--over", f"{over!r} is no way to take the runs of a candidate", choices=OVER, fix="worst")
    if not 1 <= words <= TOGETHER:
        raise InputError("--words", f"{words} is not in 1 … {TOGETHER}", fix="--words 4")
    if runs < 4 * TOGETHER:
        raise InputError("--runs", f"{runs} runs are no search", fix="--runs 5000")
    refuse_options(ready, "--spread")
    check_ends(ready, np.stack([levels(ready, np.full(len(ready.spread.factors), e)) for e in (0.0, 1.0)]), "--spread")


def _result(ready: Ready, search: Search, backend: str, began: float) -> Falsified:
    """The worst run, flown once more by itself."""
    x, m = np.concatenate(search.points), np.concatenate(search.margins)
    i, at = np.unravel_index(int(np.argmin(m)), m.shape)
    word = int(np.concatenate(search.firsts)[i] + at)
    u, plan = levels(ready, x[i]), ready.plan
    log = simulate(
        scenario_at(ready, u),
        seed=plan.seed,
        run=word,
        log_period=plan.log_period,
        signals=ready.wanted,
        backend=backend,
    )
    columns = measured_log(ready, log)
    fails = np.flatnonzero((m < 0).ravel())
    return Falsified(
        plan=plan,
        margin=float(margins(columns)[0]),
        values=parameters_at(ready, u),
        point=x[i],
        word=word,
        columns={name: column[0] for name, column in columns.items()},
        flown=m.size,
        first=int(fails[0]) + 1 if len(fails) else None,
        tried=m,
        points=x,
        stages=np.concatenate(search.restarts),
        names=tuple(f.text for f in ready.spread.factors),
        wall_s=time.perf_counter() - began,
    )
