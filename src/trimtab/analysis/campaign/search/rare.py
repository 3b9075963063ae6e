"""Probability of rare failures, estimated by multilevel splitting over a campaign's parameters and noise. The failures
found can be repeated.

The margin of a run is that of `falsify`. Parameters are drawn as in a campaign. The noise of a run is selected by
GROUPS random keys, called words. Each word is the seed of one part of the run's random numbers, so that one part can be
drawn again without a change of the others.

Independent starting points (roots) fly in rounds of BATCHES batches. A round depends only on the seed and the number of
the round. An estimation that is resumed from the folder therefore has the same result as an uninterrupted one.

Source: docs page, Rare failures; `campaign.statistics.splitting`.
"""

import json
import math
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from trimtab.analysis.campaign.sampling.points import inside_cube
from trimtab.analysis.campaign.search.falsify import margins, prepare_search
from trimtab.analysis.campaign.statistics import splitting
from trimtab.analysis.campaign.statistics.intervals import Mean
from trimtab.analysis.campaign.statistics.splitting import Descent, Ladder
from trimtab.analysis.campaign.workers.block import fly_points, repeat_run, uses_c
from trimtab.analysis.campaign.workers.prepare import (
    CampaignPlan,
    PreparedCampaign,
    check_bounds,
    identity,
    parameters_at,
    refuse_options,
    scenario_at,
)
from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.record import replace
from trimtab.logs.mcap import replace_file
from trimtab.loop.scenario import Scenario

GROUPS = 32
"""Number of random keys that together select the noise of a run."""
ROUNDS, BATCHES = 4, 10
"""Number of rounds, and number of batches in a round. The confidence interval is computed from the batches' means."""
LEAST_RUNS = 5000
SPREAD_MAX = 6.0
"""Largest distance of a parameter from its median, in standard deviations, at which the scenario must be valid."""
STATE = "rare.json"
PILOT_STREAM, ROUND_STREAM = 0, 1


class Failure(NamedTuple):
    """Run that fails. z: standard normal numbers that determine the parameters.  words: random keys of the noise.

    margin: margin found in the search.  values: path -> exact value of the parameter.
    columns: metrics, from a repetition of the run alone.
    """

    z: Any
    words: tuple[int, ...]
    margin: float
    values: dict[str, Any]
    columns: dict[str, Any]


class PilotReport(NamedTuple):
    """Forecast after the pilot runs. ladder: result of the pilot runs.  runs: number of runs still to fly.

    wall_s: expected duration of these flights (s).  width: expected half-width of the interval, as a fraction of the
    probability.
    """

    ladder: Ladder
    runs: int
    wall_s: float
    width: float


class Round(NamedTuple):
    """Result of one round of splitting, as stored in the folder.

    sums: (BATCHES,), number of failing descendants in each batch.  failing_roots: number of roots with a failing
    descendant.  survivors, taken: as in `RareResult`.  flown: number of runs.  worst, likeliest: normal numbers z,
    words and margin of the worst and of the likeliest failure, or an empty list without a failure.
    """

    sums: list[int]
    failing_roots: int
    survivors: list[int]
    taken: list[float]
    flown: int
    worst: list[Any]
    likeliest: list[Any]


class RareResult(NamedTuple):
    """Probability of a failure with its confidence interval, the worst failure and the likeliest failure.

    ladder: levels and step sizes of the splitting.  roots: total number of roots.  failing_roots: number of roots with
    a failing descendant.  survivors: (K,), number of points below each level.  taken: (K - 1,), share of accepted steps
    below each level.  flown_runs: total number of runs, including the pilot.  new_runs: number of runs flown in this
    session.  has_noise: True if runs draw random numbers.  worst: failure with the smallest margin.
    likeliest: failure with the most probable parameters.  wall_s: duration of this session (s).
    """

    plan: CampaignPlan
    probability: Mean
    ladder: Ladder
    roots: int
    failing_roots: int
    survivors: Any
    taken: Any
    flown_runs: int
    new_runs: int
    has_noise: bool
    worst: Failure | None
    likeliest: Failure | None
    wall_s: float


def estimate_rare(
    scenario: str | Scenario,
    *,
    spread: Mapping[str, str] | None = None,
    fault_ranges: Iterable[str] = (),
    vary: Iterable[str] = (),
    success: Iterable[str] = (),
    runs: int = 100_000,
    seed: int = 0,
    settings: Mapping[str, str] | None = None,
    without: Iterable[str] = (),
    faults: Iterable[str] = (),
    folder: Path | None = None,
    backend: str = "auto",
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
    report: Callable[[PilotReport], None] | None = None,
) -> RareResult:
    """Estimate the probability that a run fails, if failures are rare.

    Args:
        scenario: name in the catalogue, ``file.py:function``, or a `Scenario`.
        spread: path -> distribution as text. Without a spread only the noise varies.
        fault_ranges, vary: as in `falsify`. Values within the bounds are equally probable.
        success: conditions of a success, e.g. "peak:yaw_rate <= 4". Default: each target is reached and held.
        runs: approximate number of runs.
        seed: seed of all random numbers.
        settings, without, faults: as in `trimtab run`, only for a scenario given by name.
        folder: folder in which finished rounds are stored. The same estimation resumes from this folder.
        backend, threads: as in `simulate_batch`.
        progress: function called with the number of runs flown since the last call.
        report: function called once after the pilot runs, with the forecast.

    Raises: InputError if the scenario can't be flown (before any run starts), if the margin does not approach a
    failure, or if the folder contains a different study.
    """
    began = time.perf_counter()
    if runs < LEAST_RUNS:
        problem = f"at least {LEAST_RUNS} runs are needed to reach a rare failure, got {runs}"
        raise InputError(argument_name("runs"), problem, fix=argument("runs", 100000))
    ready = prepare_search(
        "rare",
        scenario,
        spread or {},
        fault_ranges=fault_ranges,
        vary=vary,
        settings=settings,
        without=without,
        faults=faults,
        seed=seed,
        runs=256,
        success=tuple(success),
    )
    ready = ready._replace(scenario=replace(ready.scenario, words=(0,) * GROUPS))
    _check_differences(ready)
    options = {"backend": backend, "threads": threads, "progress": progress}
    study = _Study(ready, options, folder, "c" if backend == "c" or uses_c(ready, backend) else "jax")
    study.read_or_pilot(runs)
    roots = BATCHES * study.roots
    wanted = max(ROUNDS, round((runs - study.ladder.flown) / (study.ladder.roots_cost * roots)))
    more = max(wanted - len(study.rounds), 0)
    if report is not None and more:
        cost = more * roots * study.ladder.roots_cost
        width = splitting.expected_width(study.ladder, max(wanted, len(study.rounds)) * roots)
        report(PilotReport(study.ladder, round(cost), cost / study.rate, width))
    study.fly_rounds(wanted)
    return study.summarise(time.perf_counter() - began)


def _check_differences(ready: PreparedCampaign) -> None:
    """Raise InputError if a varied parameter is an option of the program, or takes values that are not valid."""
    refuse_options(ready)
    if ready.spread.factors:
        ends = np.array([[-SPREAD_MAX], [SPREAD_MAX]]) * np.ones(len(ready.spread.factors))
        check_bounds(ready, inside_cube(special.ndtr(ends)))


class _Study:
    """State of one estimation: the levels with their step sizes, and the rounds already flown."""

    ladder: Ladder
    roots: int
    """Number of roots (independent starting points) in a batch."""
    words: int

    def __init__(self, ready: PreparedCampaign, options: Mapping[str, Any], folder: Path | None, used: str) -> None:
        self.ready, self.options, self.folder = ready, options, folder
        self.identity = identity(ready.plan, ready.scenario, used)
        self.rounds: list[Round] = []
        self.new_runs, self.rate, self.d = 0, math.inf, len(ready.spread.factors)

    def margins(self, z: Any, words: Any) -> Any:
        """Compute the margins (n,) of n runs. z (n, d): normal numbers of the parameters.

        words (n, m): random keys of the noise.
        """
        if not words.shape[1]:
            words = np.zeros((len(z), GROUPS), np.uint32)
        self.new_runs += len(z)
        return margins(fly_points(self.ready, inside_cube(special.ndtr(z)), words, **self.options))

    def read_or_pilot(self, runs: int) -> None:
        """Read levels and rounds from the folder. Without stored levels, fly the pilot runs.

        runs: total number of runs.
        """
        file = None if self.folder is None else self.folder / STATE
        if file is not None and file.exists():
            self._read(file)
            return
        rng = np.random.default_rng([self.ready.plan.seed, PILOT_STREAM])
        self.words = GROUPS if self._find_noise(rng) else 0
        if not (self.d or self.words):
            problem = "nothing varies: no parameter has a spread, and no part of the scenario draws random numbers"
            raise InputError(
                argument_name("spread"), problem, fix=argument("spread", "normal(100%, 5%)", "world.vehicle.mass")
            )
        began, before = time.perf_counter(), self.new_runs
        size = int(np.clip(runs // 60, 700, 2000))
        try:
            self.ladder = splitting.set_ladder(self.margins, rng, size, self.d, self.words)
        except splitting.Stalled as stalled:
            problem = (
                f"after {stalled.flown} runs the margin stays at {stalled.level:.4g} and does not approach 0, "
                "where a failure begins"
            )
            fix = "use a condition with a metric that approaches the bound gradually, e.g. the peak of an error"
            raise InputError(argument_name("success"), problem, fix=fix) from None
        self.rate = (self.new_runs - before) / (time.perf_counter() - began)
        rest = max(runs - self.ladder.flown, 0)
        self.roots = max(math.ceil(rest / self.ladder.roots_cost / (ROUNDS * BATCHES)), 10)
        self._write()

    def _find_noise(self, rng: np.random.Generator) -> bool:
        """Return True if the runs draw random numbers, i.e. if the margin depends on the random keys."""
        n = 64
        z, words = rng.standard_normal((n, self.d)), rng.integers(0, 2**32, (2, n, GROUPS), dtype=np.uint32)
        first, second = self.margins(z, words[0]), self.margins(z, words[1])
        self.new_runs = 0  # these runs are not part of the estimate
        return not np.array_equal(first, second)

    def fly_rounds(self, wanted: int) -> None:
        """Fly the missing rounds, and store each round when it is finished."""
        for number in range(len(self.rounds), wanted):
            rng = np.random.default_rng([self.ready.plan.seed, ROUND_STREAM, number])
            roots = BATCHES * self.roots
            found = splitting.descend(self.margins, rng, self.ladder, roots, self.d, self.words)
            self.rounds.append(_round_of(found))
            self._write()

    def summarise(self, wall_s: float) -> RareResult:
        """Combine all rounds into the result of the estimation."""
        sums = [n for r in self.rounds for n in r.sums]
        survivors = np.sum([r.survivors for r in self.rounds], axis=0)
        worst = min((r.worst for r in self.rounds if r.worst), key=lambda f: f[2], default=None)
        likeliest = min((r.likeliest for r in self.rounds if r.likeliest), key=_distance, default=None)
        return RareResult(
            plan=self.ready.plan,
            probability=splitting.probability(sums, self.roots, self.ladder),
            ladder=self.ladder,
            roots=self.roots * len(sums),
            failing_roots=sum(r.failing_roots for r in self.rounds),
            survivors=survivors,
            taken=np.mean([r.taken for r in self.rounds], axis=0),
            flown_runs=self.ladder.flown + sum(r.flown for r in self.rounds),
            new_runs=self.new_runs,
            has_noise=bool(self.words),
            worst=None if worst is None else self._fly_again(worst),
            likeliest=None if likeliest is None else self._fly_again(likeliest),
            wall_s=wall_s,
        )

    def _fly_again(self, kept: list[Any]) -> Failure:
        z, words, margin = np.array(kept[0], np.float64), tuple(kept[1]) or (0,) * GROUPS, kept[2]
        u = inside_cube(special.ndtr(z))
        columns = repeat_run(self.ready, replace(scenario_at(self.ready, u), words=words), self.options["backend"])
        return Failure(z, words, margin, parameters_at(self.ready, u) if self.d else {}, columns)

    def _write(self) -> None:
        if self.folder is None:
            return
        ladder = {name: np.asarray(value).tolist() for name, value in self.ladder._asdict().items()}
        plain = {
            "identity": self.identity,
            "ladder": ladder,
            "roots": self.roots,
            "words": self.words,
            "rounds": [r._asdict() for r in self.rounds],
        }
        self.folder.mkdir(parents=True, exist_ok=True)
        with replace_file(self.folder / STATE) as stream:
            stream.write(json.dumps(plain).encode())

    def _read(self, file: Path) -> None:
        try:
            plain = json.loads(file.read_text(encoding="utf-8"))
            same = plain["identity"] == self.identity
            of = plain["ladder"]
            steps = np.reshape(of["steps"], (len(of["refresh"]), self.d)) if same else ()
            self.ladder = Ladder(np.array(of["levels"]), steps, np.array(of["refresh"]), of["estimate"], of["flown"])
            self.roots, self.words = plain["roots"], plain["words"]
            self.rounds = [Round(**r) for r in plain["rounds"]]
        except (OSError, ValueError, KeyError, TypeError) as error:
            fix = f"{argument_name('out')} with a new folder"
            raise InputError(argument_name("out"), f"{str(file)!r} can't be read: {error}", fix=fix) from None
        if not same:
            problem = f"{str(file.parent)!r} contains another study, or a study from another version or backend"
            raise InputError(
                argument_name("out"),
                problem,
                fix=f"{argument_name('out')} with a new folder, or repeat the settings of the stored study",
            )


def _distance(kept: list[Any]) -> float:
    return math.hypot(*kept[0])


def _round_of(found: Descent) -> Round:
    failures, kept = found.failures, list[list[Any]]()
    if len(failures.margin):
        for i in (int(np.argmin(failures.margin)), int(np.argmin((failures.z**2).sum(axis=1)))):
            kept.append([failures.z[i].tolist(), failures.words[i].tolist(), float(failures.margin[i])])
    return Round(
        sums=found.counts.reshape(BATCHES, -1).sum(axis=1).tolist(),
        failing_roots=int((found.counts > 0).sum()),
        survivors=found.survivors.tolist(),
        taken=found.taken.tolist(),
        flown=found.flown,
        worst=kept[0] if kept else [],
        likeliest=kept[1] if kept else [],
    )
