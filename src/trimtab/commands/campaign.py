"""`trimtab campaign`: one scenario in thousands of worlds, what they say, and one of them once more.

One run of a campaign once more: with its whole log, held against the row that the campaign has of it.
"""

import importlib.util
import json
import math
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from trimtab.core.errors import InputError

if TYPE_CHECKING:
    from trimtab.campaign.campaign import Campaign
    from trimtab.commands.campaign import CampaignRequest
if TYPE_CHECKING:
    from trimtab.campaign.campaign import Campaign, CampaignResult, Workers
    from trimtab.campaign.statistics.requirement import RequirementVerdict


def rerun_row(request: "CampaignRequest", made: "Campaign", run: int) -> bool:
    """Fly a run again; whether it is equal to its row, where the store has it."""
    from trimtab.logs.mcap import write_mcap
    from trimtab.plots.run import plot_run

    scenario = made.scenario(run)
    log = made.rerun(run)
    row = made.row(run, log)
    apart = _differing_columns(request, run, row)
    files = []
    if request.out is not None:
        request.out.mkdir(parents=True, exist_ok=True)
        files = [request.out / f"run-{run}.mcap", request.out / f"run-{run}.png"]
        write_mcap(log, files[0])
        plot_run(log, None, files[1], title=f"{scenario.name}, run {run}", targets=tuple(scenario.targets))
    if request.as_json:
        plain = {name: value.item() if value == value else None for name, value in row.items()}
        plain = {name: None if value in (float("inf"), float("-inf")) else value for name, value in plain.items()}
        told = {"run": run, "row": plain, "differs": apart, "files": [str(f) for f in files]}
        click.echo(json.dumps(told, allow_nan=False))
        return not apart
    _show_rerun(run, row, made)
    for file in files:
        click.echo(f"wrote {file}")
    if apart is None:
        click.echo("no row to hold it against: name the campaign's store with --store")
    elif apart:
        click.echo(f"DIFFERS from its row in {', '.join(apart)}")
    else:
        click.echo("equal to its row, to the bit")
    return not apart


def _differing_columns(request: "CampaignRequest", run: int, row: dict[str, Any]) -> list[str] | None:
    """Names of the columns that differ from the store's row; None where there is no such row."""
    if request.store is None:
        return None
    from trimtab.campaign.store.store import read_store

    _, columns = read_store(request.store)
    at = (columns["run"] == run).nonzero()[0]
    if not len(at):
        return None
    there = {name: columns[name][at[0]] for name in row}
    return [name for name, value in row.items() if not (value == there[name] or value != value)]


def _show_rerun(run: int, row: dict[str, Any], made: "Campaign") -> None:
    from trimtab.commands.tables import console, new_table

    table = new_table(title=f"{made.plan.scenario}, run {run} of seed {made.plan.seed}", title_justify="left")
    table.add_column("", no_wrap=True)
    table.add_column("value", justify="right")
    for name, value in row.items():
        table.add_row(name, f"{value:.6g}" if value.dtype.kind == "f" else str(value))
    console().print(table)


class CampaignRequest(NamedTuple):
    """What was asked for on the command line."""

    scenario: str
    runs: int = 1000
    seed: int = 0
    spread: Mapping[str, str] = {}
    correlate: tuple[str, ...] = ()
    metrics: tuple[str, ...] = ()
    success: tuple[str, ...] = ()
    require: tuple[str, ...] = ()
    stop: str | None = None
    sampling: str = "random"
    settings: Mapping[str, str] = {}
    without: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    store: Path | None = None
    device: str = "auto"
    threads: int | None = None
    cluster: str | None = None
    tls: tuple[Path | None, Path | None, Path | None] = (None, None, None)
    rerun: int | None = None
    out: Path | None = None
    as_json: bool = False

    @property
    def command(self) -> str:
        """How to type it again."""
        return shlex.join(["trimtab", *sys.argv[1:]])


def campaign(request: CampaignRequest) -> bool:
    """Fly it, or one of its runs; whether every requirement is met."""
    from trimtab.campaign.campaign import Campaign
    from trimtab.commands.cache import enable_cache
    from trimtab.commands.fly_scenario import check_folder

    _check_device(request)
    if request.out is not None:
        check_folder("--out", request.out)
    enable_cache()
    made = Campaign(
        request.scenario,
        runs=request.runs,
        seed=request.seed,
        spread=request.spread,
        correlate=_parse_correlations(request.correlate),
        metrics=request.metrics,
        success=request.success,
        sampling=request.sampling,
        settings=request.settings,
        without=request.without,
        faults=request.faults,
    )
    if request.rerun is not None:
        from trimtab.commands.campaign import rerun_row

        return rerun_row(request, made, request.rerun)
    return _fly_and_report(request, made)


def _fly_and_report(request: CampaignRequest, made: "Campaign") -> bool:
    from trimtab.campaign.grammar import parse_requirement
    from trimtab.campaign.sampling.points import DESIGNS
    from trimtab.campaign.statistics.requirement import evaluate_requirement

    wanted = [parse_requirement(text) for text in request.require]
    if request.sampling in DESIGNS and (wanted or request.stop):
        problem = f"rows of a {request.sampling} design are no independent worlds: they say what matters, not how often"
        raise InputError("--require, --stop", problem, fix="--sampling random")
    stop = _stopping_function(request.stop, made)
    for one in wanted:
        one.check(_column_names(made), anytime=stop is not None)
    found = _run_campaign(request, made, stop)
    verdicts = [evaluate_requirement(one, found.columns, anytime=stop is not None) for one in wanted]
    files = _write_files(request, made, found)
    if request.as_json:
        click.echo(json.dumps(_result_json(request, found, verdicts) | {"files": files}, allow_nan=False))
    else:
        from trimtab.commands.campaign_tables import print_campaign

        print_campaign(made, found, verdicts, request.command)
        for file in files:
            click.echo(f"wrote {file}")
    return all(v.is_met for v in verdicts)


def _run_campaign(request: CampaignRequest, made: "Campaign", stop: Any) -> "CampaignResult":
    from trimtab.commands.progress import show_count

    with show_count(made.plan.runs, f"compiling {made.plan.scenario}") as tell:
        try:
            return made.run(
                request.store,
                backend="jax" if request.device == "gpu" else "auto",
                threads=request.threads,
                workers=_choose_workers(request),
                stop=stop,
                progress=tell,
                about={"command": request.command},
            )
        except KeyboardInterrupt:
            kept = f"what was done is in {request.store}; the same command goes on from there"
            click.echo(f"stopped; {kept if request.store else 'nothing is kept without --store NAME.zarr'}", err=True)
            sys.exit(130)


def _stopping_function(text: str | None, made: "Campaign") -> Any:
    if text is None:
        return None
    from trimtab.campaign.grammar import parse_stopping
    from trimtab.campaign.statistics.stopping import evaluate_stopping

    wanted = parse_stopping(text)
    wanted.check(_column_names(made))
    return lambda columns: evaluate_stopping(wanted, columns).is_met


def _column_names(made: "Campaign") -> list[str]:
    return [*(m.name for m in made.ready.metrics), "success", "lost"]


def _choose_workers(request: CampaignRequest) -> "Workers | None":
    if request.cluster is None:
        return None
    from trimtab.campaign.workers.cluster import cluster_workers

    ca, cert, key = (file or "" for file in request.tls)
    return cluster_workers(request.cluster, ca=ca, cert=cert, key=key)


def _check_device(request: CampaignRequest) -> None:
    if request.device != "gpu":
        return
    import jax

    if jax.default_backend() != "gpu":
        problem = f"JAX sees no GPU here, only {jax.default_backend()}"
        fix = 'leave --device out; for a GPU: pip install "jax[cuda12]" on a machine that has one'
        raise InputError("--device gpu", problem, fix=fix)


def _parse_correlations(texts: tuple[str, ...]) -> dict[tuple[str, str], float]:
    found = {}
    for text in texts:
        names, _, number = text.rpartition("=")
        one, comma, other = names.partition(",")
        try:
            rho = float(number)
        except ValueError:
            rho = math.nan
        if not comma or math.isnan(rho):
            fix = "--correlate world.vehicle.mass,world.vehicle.inertia=0.8"
            raise InputError("--correlate", f"{text!r} is not PATH,PATH=NUMBER", fix=fix)
        found[one.strip(), other.strip()] = rho
    return found


def _write_files(request: CampaignRequest, made: "Campaign", found: "CampaignResult") -> list[str]:
    if request.out is None:
        return []
    from trimtab.commands.campaign_tables import write_pictures

    request.out.mkdir(parents=True, exist_ok=True)
    files = write_pictures(made, found, request.out)
    if importlib.util.find_spec("pyarrow") is None:
        click.echo('no campaign.parquet without pyarrow: pip install "trimtab[parquet]"', err=True)
        return [str(f) for f in files]
    from trimtab.campaign.store.parquet import write_parquet

    table = request.out / "campaign.store.parquet"
    write_parquet(found, table)
    return [str(f) for f in (table, *files)]


def _result_json(
    request: CampaignRequest, found: "CampaignResult", verdicts: "list[RequirementVerdict]"
) -> dict[str, Any]:
    from trimtab.commands.campaign_tables import summarise_metrics

    success = found.success
    return {
        "scenario": request.scenario,
        "seed": request.seed,
        "runs": len(found.columns["run"]),
        "flown": found.flown_runs,
        "wall_s": found.wall_s,
        "success": {"share": success.share, "low": success.low, "high": success.high, "level": success.level},
        "lost": int(found.columns["lost"].sum()),
        "metrics": {name: _finite_values(numbers) for name, numbers in summarise_metrics(found).items()},
        "requirements": [{"text": v.requirement.text, "outcome": v.outcome, "note": v.note} for v in verdicts],
        "failed": [int(run) for run in found.columns["run"][~found.columns["success"]][:100]],
        "store": str(request.store) if request.store else None,
    }


def _finite_values(numbers: Mapping[str, float]) -> dict[str, float | None]:
    return {name: value if math.isfinite(value) else None for name, value in numbers.items()}
