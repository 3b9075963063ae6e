"""A campaign: one scenario flown thousands of times, each time a little otherwise, and what came of it.

Source: docs page, Campaigns.
"""

import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.campaign.sampling.distributions import Distribution, parse_distribution
from trimtab.campaign.statistics.intervals import Proportion, proportion
from trimtab.campaign.statistics.metrics import Rows, function_metric
from trimtab.campaign.store.store import CampaignStore, MemoryStore, missing_blocks, open_store, read_block_length
from trimtab.campaign.workers.block import Workers, WorkersLost, compute_log_metrics, uses_c
from trimtab.campaign.workers.local import RowCount, local_workers
from trimtab.campaign.workers.prepare import (
    CampaignPlan,
    draw_runs,
    identity,
    plan_campaign,
    plan_from_dict,
    prepare_campaign,
    scenario_of,
)
from trimtab.core.errors import InputError, argument, argument_name, install_command
from trimtab.core.html_table import html_table
from trimtab.core.time import ms
from trimtab.logs.log import Log
from trimtab.loop.scenario import Scenario
from trimtab.run.simulate import simulate


class CampaignResult(NamedTuple):
    """What came of it. columns: by name, (n,); `run` is the number of each row.

    success: the share of runs that did what they must, with its interval.  flown_runs, wall_s: of this session, and the
    time they took (s).  block: of how many runs the rows were made at once.  identity: what made them, `identity`.
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
        """Name, least, median and most of each column of numbers."""
        rows: list[tuple[str, str, str, str]] = []
        for name, column in self.columns.items():
            if name in ("run", "success", "lost") or column.dtype.kind not in "fiu" or column.ndim != 1:
                continue
            known = column[~np.isnan(column)] if column.dtype.kind == "f" else column
            three = (np.min(known), np.quantile(known, 0.5, method="lower"), np.max(known)) if known.size else ()
            rows.append((name, *(f"{v:>11.5g}" for v in three), *("",) * (3 - len(three))))  # pyright: ignore[reportArgumentType]
        return rows

    def to_dataframe(self) -> Any:
        """A ``pandas.DataFrame``: a row for each run, under its number."""
        try:
            import pandas
        except ImportError:
            fix = install_command("pandas")
            raise InputError("result.to_dataframe", "the package pandas is not installed", fix=fix) from None
        one = {name: column for name, column in self.columns.items() if column.ndim == 1}
        return pandas.DataFrame(one).set_index("run")


class Campaign:
    """One scenario in many worlds; a run's numbers depend on the campaign's seed and on the run's number alone.

    >>> from trimtab import Campaign
    >>> campaign = Campaign("hovercraft/spin", runs=8, spread={"world.vehicle.mass": "normal(100%, 5%)"})
    >>> campaign.run().success.trials
    8

    Args:
        scenario: its name in the catalogue, ``file.py:function``, or the scenario itself.
        runs: how many.
        seed: of the campaign.
        spread: path -> distribution or its text, e.g. {"world.vehicle.mass": "normal(100%, 5%)"}.
        correlate: pairs of paths -> correlation, e.g. {("world.vehicle.mass", "world.vehicle.inertia"): 0.8}.
        metrics: texts, e.g. "settling:yaw_rate", or functions of `Rows` to (n,); of each target when empty.
        success: conditions, e.g. "settling:yaw_rate <= 10"; each target reached for good when empty.
        sampling: "random", "sobol" or "latin".
        settings, without, faults: as `trimtab run` takes them; for a scenario that is named.
        log_period: between the rows that metrics see.

    Raises: InputError for what can't be flown, before anything is.
    """

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
        if runs < 1:
            raise InputError(argument_name("runs"), f"{runs} is no number of runs", fix=argument("runs", 1000))
        metrics = list(metrics)
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
        """The campaign of a plan as a store has it, `CampaignPlan.as_dict`."""
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
        """Fly what is missing.

        Args:
            store: folder of a Zarr store in which rows are kept as they are done, and looked for.
            backend: "auto", "c" or "jax", as `simulate`.
            threads: as many as there are cores when None.
            workers: who flies the blocks, where it is not this process.
            stop: asked after each block with the columns of all rows from run 0 on without a gap; True ends it.
            progress: called with the number of rows that are done.
            about: more attributes for the store.

        Raises: InputError where the store holds another campaign, is being written, or the disk is full.
        """
        began = time.perf_counter()
        if workers is not None and not self.by_name:
            problem = "other machines can't be given an object or a function of this program"
            fix = "name them, file.py:function, and put the file where the workers were started"
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
            n = int(np.searchsorted(columns["run"], self.plan.runs))  # a store may have more
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
            kept = f"{int(done.sum())} runs are kept" if stored else "no run is kept without a store"
            raise InputError(lost.part, f"{lost}: {kept}", fix=lost.fix) from None
        finally:
            results.close()
        return flown

    def _example_row(self) -> dict[str, Any]:
        """A value of each column's type."""
        _, values = draw_runs(self.ready, 0, 1)
        metrics = {m.name: np.empty(1) for m in self.ready.metrics}
        return {**values, **metrics, "success": np.empty(1, bool), "lost": np.empty(1, bool)}

    def row_size(self) -> int:
        """Bytes of a run's row, before a store compresses it."""
        return sum(column.itemsize for column in self._example_row().values()) + 1  # and whether it is done

    def scenario(self, run: int) -> Scenario:
        """The scenario of one run, with all that is its own."""
        if not 0 <= run < self.plan.runs:
            raise InputError(
                argument_name("rerun"), f"there is no run {run} among {self.plan.runs}", fix=argument("rerun", 0)
            )
        return scenario_of(self.ready, run)

    def rerun(self, run: int, *, log_period: int | None = None, signals: tuple[str, ...] = ()) -> Log:
        """One run once more, with its whole log; its numbers are those of its row."""
        drawn, _ = draw_runs(self.ready, run, run + 1)
        period = self.plan.log_period if log_period is None else log_period
        word = int(drawn.words[0])
        return simulate(self.scenario(run), seed=self.plan.seed, run=word, log_period=period, signals=signals)

    def row(self, run: int, log: Log) -> dict[str, Any]:
        """The row that a rerun's log makes, of one run: to be held against that of the campaign."""
        _, values = draw_runs(self.ready, run, run + 1)
        columns = {**values, **compute_log_metrics(self.ready, log)}
        return {name: column[0] for name, column in columns.items()}


def _gapless_rows(rows: "MemoryStore | CampaignStore", done: Any) -> dict[str, Any]:
    """Columns of the runs from 0 on without a gap."""
    n = len(done) if done.all() else int(np.argmin(done))
    return {name: column[:n] for name, column in rows.read().items()}


def _as_distribution(path: str, drawn_from: str | Distribution) -> Distribution:
    return (
        drawn_from
        if isinstance(drawn_from, Distribution)
        else parse_distribution(drawn_from, argument_name("spread", path))
    )
