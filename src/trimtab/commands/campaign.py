"""`trimtab campaign`: fly thousands of runs of one scenario, compute statistics, or repeat a single run."""

import importlib.util
import math
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import jax

from trimtab.analysis.campaign.campaign import Campaign, CampaignResult, Workers
from trimtab.analysis.campaign.grammar import parse_requirement, parse_stopping
from trimtab.analysis.campaign.sampling.points import DESIGNS
from trimtab.analysis.campaign.statistics.requirement import RequirementVerdict, evaluate_requirement
from trimtab.analysis.campaign.statistics.stopping import evaluate_stopping
from trimtab.analysis.campaign.store.store import count_missing_rows, estimate_store_size
from trimtab.commands.campaign_pictures import ANIMATED, check_plan_view, draw_animation, write_pictures
from trimtab.commands.campaign_tables import print_campaign, summarise_metrics
from trimtab.commands.options import (
    FILE,
    FLIGHT,
    JSON,
    OUT,
    RUNS,
    SCENARIO,
    SEED,
    SPREAD,
    STORE,
    SUCCESS,
    THREADS,
    WITHOUT,
    is_calibration,
)
from trimtab.commands.output import (
    check_animation,
    check_folder,
    draw_plot,
    new_table,
    print_files,
    print_json,
    print_table,
)
from trimtab.commands.progress import announce_size, show_count, warn_of_room
from trimtab.commands.written_files import check_new_in
from trimtab.core.cache_folder import enable_cache
from trimtab.core.errors import InputError, install_command
from trimtab.logs.mcap import write_mcap
from trimtab.loop.calibrated_spread import calibrated_spread
from trimtab.loop.calibration import read_calibration
from trimtab.scenarios.build import build

Correlations = dict[tuple[str, str], float]


def parse_correlations(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> Correlations:
    """Parse the texts PATH,PATH=NUMBER of --correlate into a mapping."""
    correlations = {}
    for text in values:
        names, _, number = text.rpartition("=")
        one, comma, other = names.partition(",")
        try:
            rho = float(number)
        except ValueError:
            rho = math.nan
        if not comma or math.isnan(rho):
            fix = "--correlate world.vehicle.mass,world.vehicle.inertia=0.8"
            raise InputError("--correlate", f"{text!r} is not PATH,PATH=NUMBER", fix=fix)
        correlations[one.strip(), other.strip()] = rho
    return correlations


@click.command()
@SCENARIO
@RUNS(1000, "Number of runs.")
@SPREAD
@click.option(
    "--correlate",
    multiple=True,
    metavar="PATH,PATH=RHO",
    callback=parse_correlations,
    help="Correlate two parameters. May be repeated.",
)
@click.option(
    "--metric", "metrics", multiple=True, metavar="KIND:SIGNAL", help="Metric to store for each run. May be repeated."
)
@SUCCESS
@click.option(
    "--require",
    multiple=True,
    metavar="TEXT",
    help="Requirement, e.g. 'success >= 0.99 @ 95%'. Exit code 1 if not met. May be repeated.",
)
@click.option(
    "--stop", metavar="TEXT", help="Stop early when this condition holds, e.g. 'width(success) <= 0.01 @ 95%'."
)
@click.option(
    "--sampling",
    default="random",
    show_default=True,
    help="Sampling of the parameters: random, sobol or latin; saltelli or morris for a sensitivity analysis.",
)
@STORE
@click.option(
    "--rerun",
    type=click.IntRange(0),
    metavar="RUN",
    help="Repeat the run with this number, and compare the results with those in the store.",
)
@FLIGHT
@WITHOUT
@SEED
@click.option(
    "--device",
    type=click.Choice(("auto", "cpu", "gpu")),
    default="auto",
    show_default=True,
    help="Device that computes the runs.",
)
@THREADS
@click.option(
    "--cluster", metavar="URI", help="Fly the runs on the workers of this Dask scheduler, e.g. tls://HOST:8786."
)
@click.option("--tls-ca", type=FILE, metavar="FILE", help="CA certificate for the Dask scheduler.")
@click.option("--tls-cert", type=FILE, metavar="FILE", help="TLS certificate of this client.")
@click.option("--tls-key", type=FILE, metavar="FILE", help="TLS key of this client.")
@OUT("DIR", "Write pictures and the table of runs (Parquet) to this folder.")
@click.option(
    "--animate", type=FILE, metavar="FILE", help=f"Draw an animation of the first {ANIMATED} runs to this file (.gif)."
)
@JSON
def command(
    scenario: str,
    require: tuple[str, ...],
    stop: str | None,
    store: Path | None,
    rerun: int | None,
    device: str,
    threads: int | None,
    cluster: str | None,
    tls_ca: Path | None,
    tls_cert: Path | None,
    tls_key: Path | None,
    out: Path | None,
    animate: Path | None,
    as_json: bool,
    **plan: Any,
) -> None:
    """Estimate the success rate of a scenario over many runs.

    The rate comes with confidence bounds.

    The parameters of a run depend only on the seed and on the run's number. Distributions: normal(MEAN, STD),
    truncated(MEAN, STD, LOW, HIGH), lognormal(MEDIAN, STD_OF_LOG), uniform(LOW, HIGH), loguniform(LOW, HIGH),
    choice(A, B, …), file(NAME.csv:COLUMN), along(V1, V2, …) for an array. A number with % is relative to the scenario's
    value.

    Metrics of a signal with a target: settling, first_reach, overshoot, error_rms. Metrics of any signal: final, least,
    most, peak, mean, rms, tail_mean, tail_rms, sustained (remaining oscillation at the end), changes (number of mode
    changes).

    \b
    trimtab campaign hovercraft/zero-velocity --spread 'world.vehicle.mass=normal(100%, 5%)' --store mass.zarr
    trimtab campaign hovercraft/zero-velocity --spread 'world.vehicle.mass=normal(100%, 5%)' --store mass.zarr \\
        --rerun 12 --out run-12
    trimtab campaign hovercraft/zero-velocity --sampling saltelli --runs 4096 --out matters \\
        --spread 'world.vehicle.mass=normal(100%, 5%)' --spread 'autopilot.law.k2=uniform(80%, 120%)'
    trimtab campaign hovercraft/spin --runs 4000 --require 'success >= 0.99 @ 95%' --out spin
    """
    _check_device(device)
    _check_files(out, animate)
    enable_cache()
    notes = _expand_calibrations(scenario, plan)
    campaign = Campaign(scenario, **plan)
    if rerun is not None:
        sys.exit(0 if _rerun_row(campaign, rerun, store, out, animate, as_json) else 1)
    check_plan_view(campaign, animate)
    requirements = [parse_requirement(text) for text in require]
    if campaign.plan.sampling in DESIGNS and (requirements or stop):
        problem = f"the runs of a {campaign.plan.sampling} design are not independent"
        problem += ": they are for sensitivities, not for a success rate"
        raise InputError("--require, --stop", problem, fix="--sampling random")
    stops_at = _stopping_function(stop, campaign)
    for one in requirements:
        one.check(_column_names(campaign), anytime=stops_at is not None)
    workers = _connect_workers(cluster, tls_ca, tls_cert, tls_key)
    flight = {"backend": "jax" if device == "gpu" else "auto", "threads": threads, "workers": workers}
    result = _fly_campaign(campaign, store, stop=stops_at, **flight)
    verdicts = [evaluate_requirement(one, result.columns, anytime=stops_at is not None) for one in requirements]
    files = [*_write_files(campaign, result, out), *draw_animation(campaign, result, animate)]
    if as_json:
        print_json(_result_json(scenario, result, verdicts, store) | {"notes": notes, "files": files})
    else:
        print_campaign(campaign, result, verdicts, drop_option(drop_option(_typed_command(), "--out"), "--animate"))
        for note in notes:
            click.echo(f"note: {note}")
        print_files(files)
    sys.exit(0 if all(v.is_met for v in verdicts) else 1)


def _expand_calibrations(scenario: str, plan: dict[str, Any]) -> list[str]:
    """Replace calibration files in `plan` by distributions of their parameters; return notes on constant parameters."""
    notes: list[str] = []
    for file in [text for text in plan["spread"] if is_calibration(text)]:
        calibration, other = read_calibration(file), plan["settings"].get("calibration", file)
        if other != file:
            problem = f"a campaign must use one calibration, got {other} and {file}"
            raise InputError("--spread", problem, fix="calibrate into one file: trimtab calibrate … --out FILE.toml")
        built = build(scenario, {"calibration": file, **plan["settings"]})
        drawn, correlate, said = calibrated_spread(built, calibration)
        notes += said
        plan["spread"] = drawn | {path: text for path, text in plan["spread"].items() if path != file}
        plan["correlate"] = {(a, b): rho for a, b, rho in correlate} | plan["correlate"]
        plan["settings"] = {"calibration": file, **plan["settings"]}
    return notes


def _typed_command() -> str:
    """Return the command line as typed."""
    return shlex.join(["trimtab", *sys.argv[1:]])


def drop_option(command: str, option: str) -> str:
    """Return a command line with one option and the option's value removed."""
    words = shlex.split(command)
    kept = [
        w for k, w in enumerate(words) if not w.startswith(f"{option}=") and option not in words[max(k - 1, 0) : k + 1]
    ]
    return shlex.join(kept)


def _check_device(device: str) -> None:
    if device == "gpu" and jax.default_backend() != "gpu":
        problem = f"JAX finds no GPU, only {jax.default_backend()}"
        fix = f"leave --device out, or on a machine with a GPU: {install_command('cuda12', 'jax')}"
        raise InputError("--device gpu", problem, fix=fix)


def _check_files(out: Path | None, animation: Path | None) -> None:
    """Raise InputError if the folder of --out or the file of --animate cannot be written."""
    check_animation(animation)
    if out is not None:
        check_folder("--out", out)
        check_new_in("--out", out, "*.png", "campaign.parquet", "run-*.mcap")


def _stopping_function(text: str | None, campaign: Campaign) -> Callable[[Any], bool] | None:
    if text is None:
        return None
    stopping = parse_stopping(text)
    stopping.check(_column_names(campaign))
    return lambda columns: evaluate_stopping(stopping, columns).is_met


def _column_names(campaign: Campaign) -> list[str]:
    return [*(m.name for m in campaign.ready.metrics), "success", "lost"]


def _connect_workers(cluster: str | None, *tls: Path | None) -> Workers | None:
    if cluster is None:
        return None
    from trimtab.analysis.campaign.workers.cluster import cluster_workers

    ca, cert, key = (file or "" for file in tls)
    return cluster_workers(cluster, ca=ca, cert=cert, key=key)


def _fly_campaign(campaign: Campaign, store: Path | None, **flight: Any) -> CampaignResult:
    if store is not None:
        warn_of_room("store", campaign.row_size() * count_missing_rows(store, campaign.plan.runs), store)
    with show_count(campaign.plan.runs, f"compiling {campaign.plan.scenario}") as tell:
        try:
            progress = tell if store is None else _announcing(store, campaign.plan.runs, tell)
            return campaign.run(store, **flight, progress=progress, about={"command": _typed_command()})
        except KeyboardInterrupt:
            kept = f"completed runs are in {store}; the same command continues from there"
            click.echo(f"stopped; {kept if store else 'runs are not stored without --store NAME.zarr'}", err=True)
            sys.exit(130)


def _announcing(store: Path, runs: int, tell: Callable[[int], None]) -> Callable[[int], None]:
    """Return a progress function that calls `tell`, and that once prints the expected size of a large store."""
    is_known = False

    def tell_size(done: int) -> None:
        nonlocal is_known
        size = None if is_known else estimate_store_size(store, runs)
        if size is not None:
            is_known = True
            announce_size("store", size)
        tell(done)

    return tell_size


def _write_files(campaign: Campaign, result: CampaignResult, out: Path | None) -> list[str]:
    if out is None:
        return []
    out.mkdir(parents=True, exist_ok=True)
    files = write_pictures(campaign, result, out)
    if importlib.util.find_spec("pyarrow") is None:
        click.echo(f"campaign.parquet needs pyarrow: {install_command('parquet')}", err=True)
        return [str(f) for f in files]
    from trimtab.analysis.campaign.store.parquet import write_parquet

    table = out / "campaign.parquet"
    write_parquet(result, table)
    return [str(f) for f in (table, *files)]


def _result_json(
    scenario: str, result: CampaignResult, verdicts: list[RequirementVerdict], store: Path | None
) -> dict[str, Any]:
    success = result.success
    return {
        "scenario": scenario,
        "seed": result.plan.seed,
        "runs": len(result.columns["run"]),
        "flown": result.flown_runs,
        "wall_s": result.wall_s,
        "success": {"share": success.share, "low": success.low, "high": success.high, "level": success.level},
        "lost": int(result.columns["lost"].sum()),
        "metrics": summarise_metrics(result),
        "requirements": [{"text": v.requirement.text, "outcome": v.outcome, "note": v.note} for v in verdicts],
        "failed": [int(run) for run in result.columns["run"][~result.columns["success"]][:100]],
        "store": str(store) if store else None,
    }


def _rerun_row(
    campaign: Campaign, run: int, store: Path | None, out: Path | None, animation: Path | None, as_json: bool
) -> bool:
    """Repeat a run and record all signals. Return False if the results differ from those in the store."""
    scenario = campaign.scenario(run)
    log, title = campaign.rerun(run), f"{scenario.name}, run {run}"
    row = campaign.row(run, log)
    differs = _differing_columns(store, run, row)
    files: list[Path] = []
    if out is not None:
        from trimtab.plots.run import plot_run

        out.mkdir(parents=True, exist_ok=True)
        files = [out / f"run-{run}.mcap", out / f"run-{run}.png"]
        write_mcap(log, files[0])
        plot_run(log, None, files[1], title=title, targets=tuple(scenario.targets))
    if animation is not None:
        from trimtab.plots.animation import animate_run

        files += draw_plot(animation, animate_run, log, None, title=title, targets=tuple(scenario.targets))
    if as_json:
        numbers = {name: value.item() for name, value in row.items()}
        print_json({"run": run, "row": numbers, "differs": differs, "files": [str(f) for f in files]})
        return not differs
    _print_row(campaign, run, row)
    print_files(files)
    if differs is None:
        click.echo("no stored run to compare with; name the campaign's store with --store")
    elif differs:
        click.echo(f"DIFFERS from the stored run in {', '.join(differs)}")
    else:
        click.echo("equal to the stored run, bit for bit")
    return not differs


def _differing_columns(store: Path | None, run: int, row: dict[str, Any]) -> list[str] | None:
    """Return the names of the results that differ from the stored results of a run; None if the run is not stored."""
    if store is None:
        return None
    from trimtab.analysis.campaign.store.store import read_store

    _, columns = read_store(store)
    at = (columns["run"] == run).nonzero()[0]
    if not len(at):
        return None
    there = {name: columns[name][at[0]] for name in row}
    return [name for name, value in row.items() if not (value == there[name] or value != value)]


def _print_row(campaign: Campaign, run: int, row: dict[str, Any]) -> None:
    title = f"{campaign.plan.scenario}, run {run} of seed {campaign.plan.seed}"
    table = new_table("", ">value", title=title, unwrapped=("",))
    for name, value in row.items():
        table.add_row(name, f"{value:.6g}" if value.dtype.kind == "f" else str(value))
    print_table(table)
