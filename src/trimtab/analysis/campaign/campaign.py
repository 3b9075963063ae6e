"""Campaigns: many runs of one scenario, each with different parameters and noise, and the results of the runs.

Source: docs page, Campaigns.
"""

import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.analysis.campaign.sampling.distributions import Distribution, parse_distribution
from trimtab.analysis.campaign.statistics.intervals import Proportion, proportion
from trimtab.analysis.campaign.statistics.metrics import Rows, function_metric
from trimtab.analysis.campaign.store.store import (
    CampaignStore,
    MemoryStore,
    missing_blocks,
    open_store,
    read_block_length,
)
from trimtab.analysis.campaign.workers.block import Workers, WorkersLost, compute_log_metrics, uses_c
from trimtab.analysis.campaign.workers.local import RowCount, local_workers
from trimtab.analysis.campaign.workers.prepare import (
    CampaignPlan,
    draw_runs,
    identity,
    plan_campaign,
    plan_from_dict,
    prepare_campaign,
    scenario_of,
)
from trimtab.core.errors import InputError, argument, argument_name, install_command
from trimtab.core.explain_call import explain_call
from trimtab.core.html_table import html_table
from trimtab.core.time import ms
from trimtab.logs.log import Log
from trimtab.loop.scenario import Scenario
from trimtab.run.simulate import simulate


class CampaignResult(NamedTuple):
    """Result of a campaign. columns: name -> values (n,) in n runs. The column `run` contains the run numbers.

    success: share of successful runs, with a confidence interval.  flown_runs, wall_s: number of runs flown in this
    session, and computing time for these runs (s).  block: number of runs simulated together.  identity: digests and
    versions that determine the results, see the function `identity`.
    """

    plan: CampaignPlan
    columns: dict[str, Any]
    success: Proportion
    flown_runs: int
    wall_s: float
    block: int
    identity: dict[str, str]

    def __repr__(self) -> str:
        rows = [f"  {name:<28}{least}  {median}  {most}" for name, least, median, most in self._rows()]
        head = f"  {'':<28}{'least':>11}  {'median':>11}  {'most':>11}"
        return "\n".join([self._title(), head, *rows, "each run: result.columns, or result.to_dataframe()"])

    def _repr_html_(self) -> str:
        note = "each run: result.columns, or result.to_dataframe()"
        return html_table(self._title(), ("", "least", "median", "most"), self._rows(), note)

    def _title(self) -> str:
        lost = int(self.columns["lost"].sum())
        return f"Campaign of {self.plan.scenario}: {self.success.trials} runs, success {self.success}, {lost} lost"

    def _rows(self) -> list[tuple[str, str, str, str]]:
        """Return name, minimum, median and maximum of each numeric result."""
        rows: list[tuple[str, str, str, str]] = []
        for name, column in self.columns.items():
            if name in ("run", "success", "lost") or column.dtype.kind not in "fiu" or column.ndim != 1:
                continue
            known = column[~np.isnan(column)] if column.dtype.kind == "f" else column
            three = (np.min(known), np.quantile(known, 0.5, method="lower"), np.max(known)) if known.size else ()
            rows.append((name, *(f"{v:>11.5g}" for v in three), *("",) * (3 - len(three))))  # pyright: ignore[reportArgumentType]
        return rows

    def to_dataframe(self) -> Any:
        """Return a ``pandas.DataFrame`` with one row for each run, indexed by the run's number."""
        try:
            import pandas
        except ImportError:
            fix = install_command("pandas")
            raise InputError("result.to_dataframe", "the package pandas is not installed", fix=fix) from None
        one = {name: column for name, column in self.columns.items() if column.ndim == 1}
        return pandas.DataFrame(one).set_index("run")


class Campaign:
    """Many runs of one scenario. A run depends only on the campaign's seed and the run's number.

    >>> from trimtab import Campaign
    >>> campaign = Campaign("hovercraft/spin", runs=8, spread={"world.vehicle.mass": "normal(100%, 5%)"})
    >>> campaign.run().success.trials
    8

    Args:
        scenario: name in the catalogue, ``file.py:function``, or a `Scenario`.
        runs: number of runs.
        seed: seed of the random numbers.
        spread: path -> distribution, as text or object, e.g. {"world.vehicle.mass": "normal(100%, 5%)"}.
        correlate: pairs of paths -> correlation, e.g. {("world.vehicle.mass", "world.vehicle.inertia"): 0.8}.
        metrics: metrics of each run: names, e.g. "settling:yaw_rate", or functions from `Rows` to values (n,).
            Default: settling and error_rms of each target.
        success: conditions of a successful run, e.g. "settling:yaw_rate <= 10". Default: each target is reached and
            held.
        sampling: sampling of the varied parameters: "random", "sobol" or "latin".
        settings, without, faults: as in `trimtab run`, only for a scenario given by name.
        log_period: time between the log rows from which metrics are computed (100 ns).

    Raises: InputError for a campaign that can't be flown, before any run starts.
    """

    @explain_call()
    def __init__(
        self,
        scenario: str | Scenario,
        *,
        runs: int = 1000,
        seed: int = 0,
        spread: Mapping[str, str | Distribution] | None = None,
        correlate: Mapping[tuple[str, str], float] | None = None,
        metrics: Iterable[str | Callable[[Rows], Any]] = (),
        success: Iterable[str] = (),
        sampling: str = "random",
        settings: Mapping[str, str] | None = None,
        without: Iterable[str] = (),
        faults: Iterable[str] = (),
        log_period: int = ms(10),
    ) -> None:
        if not isinstance(runs, int) or runs < 1:  # pyright: ignore[reportUnnecessaryIsInstance]
            problem = f"must be a whole number of at least 1, got {runs!r}"
            raise InputError(argument_name("runs"), problem, fix=argument("runs", 1000))
        metrics = [metrics] if isinstance(metrics, str) else list(metrics)
        success = [success] if isinstance(success, str) else list(success)
        if isinstance(spread, str):  # pyright: ignore[reportUnnecessaryIsInstance]
            fix = 'spread={"world.vehicle.mass": "normal(100%, 5%)"}'
            raise InputError("spread", f"must be a dictionary of distributions, got {spread!r}", fix=fix)
        self.plan = plan_campaign(
            "Campaign",
            scenario,
            settings,
            without,
            faults,
            seed,
            runs=runs,
            sampling=sampling,
            spread=tuple(sorted((p, _as_distribution(p, d)) for p, d in (spread or {}).items())),
            correlate=tuple((a, b, float(rho)) for (a, b), rho in sorted((correlate or {}).items())),
            metrics=tuple(m for m in metrics if isinstance(m, str)),
            success=tuple(success),
            log_period=log_period,
        )
        own = [function_metric(getattr(m, "__name__", "metric"), m) for m in metrics if not isinstance(m, str)]
        named = isinstance(scenario, str)
        self.by_name = named and not own
        self.ready = prepare_campaign(self.plan, None if named else scenario, own)

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> "Campaign":
        """Create a campaign from a stored plan, see `CampaignPlan.as_dict`."""
        campaign = cls.__new__(cls)
        campaign.plan, campaign.by_name = plan_from_dict(plain), True
        campaign.ready = prepare_campaign(campaign.plan)
        return campaign

    def run(
        self,
        store: str | Path | None = None,
        *,
        backend: str = "auto",
        threads: int | None = None,
        workers: Workers | None = None,
        stop: Callable[[dict[str, Any]], bool] | None = None,
        progress: Callable[[int], None] | None = None,
        about: Mapping[str, Any] | None = None,
    ) -> CampaignResult:
        """Fly the runs of the campaign that are not stored yet, and return the results of all runs.

        Args:
            store: folder of a Zarr store. Finished runs are saved there and reused. None: nothing is saved.
            backend: simulation backend "auto", "c" or "jax", as in `simulate`.
            threads: number of threads. None: one for each core.
            workers: function that flies blocks of runs. None: this process flies the runs.
            stop: function that is called after each block of runs with the results of all runs before the first
                unfinished run. The campaign ends when the function returns True.
            progress: function that is called with the number of finished runs.
            about: additional attributes to write to the store.

        Raises: InputError if the store belongs to a different campaign, if another process is writing to it, or if the
        disk is full.
        """
        began = time.perf_counter()
        if workers is not None and not self.by_name:
            problem = "an object or a function of this program can't be sent to other machines"
            fix = "write file.py:function, and put this file in the folder in which the workers were started"
            raise InputError("workers", problem, fix=fix)
        used = "c" if backend == "c" or uses_c(self.ready, backend) else "jax"
        count = RowCount(progress)
        fly, who = workers or local_workers(threads, count), identity(self.plan, self.ready.scenario, used)
        if store is None:
            rows = MemoryStore(self.plan.runs)
            block = self.ready.block
            flown = self._fly_blocks(fly, used, rows, block, stop, count)
            columns = rows.read()
        else:
            folder = Path(store)
            block = read_block_length(folder) or self.ready.block
            attributes = {"identity": who, "plan": self.plan.as_dict(), **(about or {})}
            with open_store(folder, attributes, self._example_row(), self.plan.runs, block) as rows:
                flown = self._fly_blocks(fly, used, rows, block, stop, count)
                columns = rows.read()
            n = int(np.searchsorted(columns["run"], self.plan.runs))  # the store may contain more runs
            columns = {name: column[:n] for name, column in columns.items()}
        good = proportion(int(columns["success"].sum()), len(columns["run"]))
        return CampaignResult(self.plan, columns, good, flown, time.perf_counter() - began, block, who)

    def _fly_blocks(self, fly: Workers, used: str, rows: Any, block: int, stop: Any, count: RowCount) -> int:
        done = rows.finished_rows()[: self.plan.runs]
        flown, blocks = 0, list(missing_blocks(done, self.plan.runs, block))
        if stop is not None and done[:1].all() and stop(_gapless_rows(rows, done)):
            return 0
        results = fly(self.ready, blocks, used)
        try:
            for first, columns in results:
                n = len(columns["success"])
                rows.write(first, columns)
                flown += int((~done[first : first + n]).sum())
                done[first : first + n] = True
                count.keep(int(done.sum()))
                if stop is not None and done[0] and stop(_gapless_rows(rows, done)):
                    break
        except WorkersLost as lost:
            stored = isinstance(rows, CampaignStore)
            kept = f"{int(done.sum())} finished runs are stored" if stored else "runs are not saved without a store"
            raise InputError(lost.part, f"{lost}: {kept}", fix=lost.fix) from None
        finally:
            results.close()
        return flown

    def _example_row(self) -> dict[str, Any]:
        """Return name of a result -> array of length 1, with the data type of the result."""
        _, values = draw_runs(self.ready, 0, 1)
        metrics = {m.name: np.empty(1) for m in self.ready.metrics}
        return {**values, **metrics, "success": np.empty(1, bool), "lost": np.empty(1, bool)}

    def row_size(self) -> int:
        """Return the uncompressed size of one run's results in the store, in bytes."""
        return (
            sum(column.itemsize for column in self._example_row().values()) + 1
        )  # plus one byte for the flag of a finished row

    def scenario(self, run: int) -> Scenario:
        """Return the scenario of one run, with the parameters of this run."""
        if not 0 <= run < self.plan.runs:
            raise InputError(
                argument_name("rerun"),
                f"run {run} does not exist; the campaign has {self.plan.runs} runs, numbered from 0",
                fix=argument("rerun", 0),
            )
        return scenario_of(self.ready, run)

    def rerun(self, run: int, *, log_period: int | None = None, signals: tuple[str, ...] = ()) -> Log:
        """Repeat one run and return the complete log.

        The metrics of the repetition equal the stored metrics.
        """
        drawn, _ = draw_runs(self.ready, run, run + 1)
        period = self.plan.log_period if log_period is None else log_period
        word = int(drawn.words[0])
        return simulate(self.scenario(run), seed=self.plan.seed, run=word, log_period=period, signals=signals)

    def row(self, run: int, log: Log) -> dict[str, Any]:
        """Compute the results of one run from the log of its rerun, to compare them with the stored results."""
        _, values = draw_runs(self.ready, run, run + 1)
        columns = {**values, **compute_log_metrics(self.ready, log)}
        return {name: column[0] for name, column in columns.items()}


def _gapless_rows(rows: "MemoryStore | CampaignStore", done: Any) -> dict[str, Any]:
    """Return the results of all runs before the first unfinished run."""
    n = len(done) if done.all() else int(np.argmin(done))
    return {name: column[:n] for name, column in rows.read().items()}


def _as_distribution(path: str, drawn_from: Any) -> Distribution:
    if isinstance(drawn_from, Distribution):
        return drawn_from
    if not isinstance(drawn_from, str):
        part = argument_name("spread", path)
        raise InputError(part, f"must be a distribution as text, got {drawn_from!r}", fix='"uniform(80%, 120%)"')
    return parse_distribution(drawn_from, argument_name("spread", path))
