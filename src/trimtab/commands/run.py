"""`trimtab run`: simulate a scenario, ideal and real, and show the results.

Nothing that needs JAX is imported at the top of this file, so that an invalid option is reported without delay.
"""

import sys
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from trimtab.commands.flight_summary import closest_approach, metric_units, print_result, summarise_run
from trimtab.commands.options import ANIMATE, BACKEND, FLIGHT, JSON, OUT, PLOT, SCENARIO, WITHOUT
from trimtab.commands.output import (
    check_animation,
    check_picture,
    draw_plot,
    new_table,
    print_files,
    print_json,
    print_table,
)
from trimtab.commands.progress import announce_size, show_spinner, warn_of_room
from trimtab.commands.typed_names import keep_paths, read_paths
from trimtab.commands.written_files import check_new_in
from trimtab.core.cache_folder import enable_cache
from trimtab.core.errors import InputError
from trimtab.core.formula import is_temporal, parse_formula
from trimtab.core.formula_units import fit_formula
from trimtab.core.time import parse_time
from trimtab.logs.log import Log
from trimtab.logs.metrics import Target, full_path
from trimtab.logs.robustness import assess_formula, check_length
from trimtab.logs.spatial import with_flight
from trimtab.run.program import check_log_period, check_seed

if TYPE_CHECKING:
    from trimtab.logs.navigation import Navigation
    from trimtab.loop.scenario import Scenario
    from trimtab.run.program import Program


PICTURES = ("tracking", "swarm", "navigation")
"""Name suffixes of additional pictures. They are drawn next to the picture of --plot if the run has data for them."""


class RunReport(NamedTuple):
    """Result of `trimtab run`: logs of the real and the ideal run, targets, and computing time (s)."""

    name: str
    real: Log
    ideal: Log | None
    targets: tuple[Target, ...]
    wall_s: float


@click.command()
@SCENARIO
@FLIGHT
@WITHOUT
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of the random numbers.")
@click.option(
    "--run",
    "number",
    type=int,
    default=0,
    show_default=True,
    help="Number of the run within a campaign of the same seed.",
)
@click.option(
    "--ideal/--no-ideal",
    default=True,
    show_default=True,
    help="Also simulate the ideal twin: true state known, no delay, no limits.",
)
@BACKEND
@PLOT("Draw all signals to this picture file.")
@ANIMATE
@OUT("DIR", "Write the log (MCAP) and the picture of the run to this folder.")
@click.option("--log-period", metavar="TIME", default="1 ms", show_default=True, help="Time between two log rows.")
@click.option(
    "--require",
    multiple=True,
    metavar="FORMULA",
    help="Requirement, e.g. 'always[5 s, 15 s](abs(truth.yaw_rate) < 3 deg/s)'. Exit code 1 if violated. Repeatable.",
)
@JSON
def command(
    scenario: str,
    settings: dict[str, str],
    without: tuple[str, ...],
    faults: tuple[str, ...],
    seed: int,
    number: int,
    ideal: bool,
    backend: str,
    plot: Path | None,
    animate: Path | None,
    out: Path | None,
    log_period: str,
    require: tuple[str, ...],
    as_json: bool,
) -> None:
    """Simulate a scenario, ideal and real, in virtual time.

    SCENARIO is a name from `trimtab list`, or your own: my_boat.py:scenario.

    \b
    trimtab run hovercraft/zero-velocity --plot rest.png --animate rest.gif
    trimtab run hovercraft/heading-bang-bang --set initial=moving --seed 3
    trimtab run hovercraft/forward --without navigation-error --out forward/
    trimtab run hovercraft/spin --set autopilot.law.spinning.k2=5 --duration '30 s' --json
    trimtab run hovercraft/zero-velocity --navigation ins --plot ins.png
    trimtab run hovercraft/forward --fault 'uplink off @ 5 s for 2 s' --plot cut.png
    trimtab run hovercraft/zero-velocity --require 'eventually[0, 8 s](always(abs(truth.yaw_rate) < 9 deg/s))'
    """
    flight: dict[str, Any] = {"seed": seed, "run": number, "log_period": parse_time(log_period)}
    check_seed(seed)
    check_seed(number, "run")
    for formula in require:
        parse_formula(formula)
        if not is_temporal(formula):
            problem = f"{formula!r} is checked only at the first instant"
            raise InputError("--require", problem, fix=f"--require 'always({formula})'")
    plot = out / "run.png" if plot is None and out is not None else plot
    check_new_in("--out", out, "run.mcap", "ideal.mcap")
    if plot is not None:
        check_new_in("--plot", plot.parent, *(f"{plot.stem}-{more}{plot.suffix}" for more in PICTURES))
    from trimtab.loop.settings import setting_paths
    from trimtab.run.known_signals import find_signals
    from trimtab.scenarios.build import build

    built = build(scenario, settings, without, faults)
    if not (settings or without or faults or read_paths(scenario)):
        keep_paths(scenario, setting_paths(built))
    built = _estimate_steps(built)
    known = find_signals(built)
    for formula in require:
        check_length(fit_formula(formula, known.shapes, known.units, full_path), built.duration)
    check_log_period(flight["log_period"], built.duration)
    check_picture(plot, out)
    check_animation(animate)
    report = _compile_and_fly(built, ideal, backend, flight)
    seen = with_flight(report.real)
    result, assessed = _summarise_report(scenario, report), [assess_formula(seen, text) for text in require]
    if assessed:
        result["requirements"] = [a._asdict() | {"holds": a.holds} for a in assessed]
    navigated = _summarise_navigation(report.real)
    if navigated is not None:
        result["navigation"] = navigated.plain()
    files = [*_write_logs(report, out), *_draw_run(report, plot, animate, navigated is not None)]
    failed = not all(a.holds for a in assessed) or result["real"]["lost_s"] is not None
    failed |= "not_finite" in result["real"]
    if as_json:
        print_json(result, files)
        sys.exit(failed)
    print_result(result, metric_units(report.real, result["real"]["metrics"]))
    if "ended_s" in report.real.metadata:
        click.echo(f"the FMU requested the end of the simulation at {report.real.metadata['ended_s']:g} s")
    if navigated is not None:
        units = {name: report.real.unit(f"{navigated.where}.{name}") for name in navigated.learned}
        print_navigation(navigated, units)
    for line in assessed:
        click.echo(f"require: {line}")
    print_files(files)
    sys.exit(failed)


def _estimate_steps(scenario: "Scenario") -> "Scenario":
    """Return the scenario with integration error estimates added. They do not change the results of the simulation."""
    from trimtab.core.record import replace
    from trimtab.loop.integration import PLAIN_STEP
    from trimtab.run.blocks import has_stepped_vehicle

    if scenario.world.integration is not None or has_stepped_vehicle(scenario):
        return scenario
    return replace(scenario, world=replace(scenario.world, integration=PLAIN_STEP))


def _compile_and_fly(scenario: "Scenario", ideal: bool, backend: str, flight: dict[str, Any]) -> RunReport:
    from trimtab.run.blocks import has_stepped_vehicle, hold_vehicle
    from trimtab.run.runner import choose_c
    from trimtab.run.simulate import compile_scenario, simulate

    enable_cache()
    name, targets = scenario.name, tuple(scenario.targets)
    started = time.perf_counter()
    if has_stepped_vehicle(scenario):
        real = simulate(scenario, **flight)
        twin = simulate(hold_vehicle(scenario).ideal(), **flight) if ideal else None
        return RunReport(name, real, twin, targets, time.perf_counter() - started)

    def compile_both() -> "tuple[Program, Program | None]":
        other = ThreadPoolExecutor(1)  # JAX traces one program while the C compiler works on the other program
        try:
            real = other.submit(compile_scenario, scenario)
            twin = compile_scenario(scenario.ideal()) if ideal else None
            return real.result(), twin
        finally:
            other.shutdown(wait=False)  # after Ctrl-C the command ends without waiting for the trace

    with show_spinner(f"compiling {name}"):
        programs = choose_c(backend, compile_both)
    if programs is not None:
        real = programs[0].fly(**flight)
        twin = None if programs[1] is None else programs[1].fly(**flight)
    else:
        real = simulate(scenario, **flight, backend="jax")
        twin = simulate(scenario.ideal(), **flight, backend="jax") if ideal else None
    return RunReport(name, real, twin, targets, time.perf_counter() - started)


def _summarise_report(scenario: str, report: RunReport) -> dict[str, Any]:
    about = report.real.metadata
    return {
        "scenario": scenario,
        "seed": about["seed"],
        "run": about["run"],
        "backend": about["backend"],
        "duration_s": about["duration_s"],
        "mismatch": about.get("mismatch", []),
        "wall_s": round(report.wall_s, 4),
        "real": summarise_run(report.real, report.targets),
        "ideal": None if report.ideal is None else summarise_run(report.ideal, report.targets),
    }


def _summarise_navigation(log: Log) -> "Navigation | None":
    """Assess the aided INS of a run. Return None if the run has no aided INS. scipy is imported only if needed."""
    if not any(p.startswith("estimate.") and p.endswith("_fix.nis") for p in log.paths):
        return None
    from trimtab.logs.navigation import assess_navigation

    return assess_navigation(log)


def _write_logs(report: RunReport, out: Path | None) -> list[Path]:
    if out is None:
        return []
    from trimtab.logs.mcap import estimate_size, write_mcap

    out.mkdir(parents=True, exist_ok=True)
    logs = {
        out / name: log for name, log in (("run.mcap", report.real), ("ideal.mcap", report.ideal)) if log is not None
    }
    size = sum(map(estimate_size, logs.values()))
    announce_size("log", size)
    warn_of_room("log", size, out)
    return [write_mcap(log, file) for file, log in logs.items()]


def _draw_run(report: RunReport, file: Path | None, animation: Path | None, with_navigation: bool) -> list[Path]:
    """Draw the pictures and the animation of a run, where a file is named. Return the files written."""
    moving: list[Path] = []
    if animation is not None:
        from trimtab.plots.animation import animate_run

        options = {"title": report.name, "targets": report.targets}
        moving = draw_plot(animation, animate_run, report.real, report.ideal, **options)
    if file is None:
        return moving
    from trimtab.plots.run import plot_run
    from trimtab.plots.tracking import plot_tracking, tracking_rows

    pictures = draw_plot(file, plot_run, report.real, report.ideal, title=report.name, targets=report.targets)
    if tracking_rows(report.real):
        pictures.append(file.with_stem(f"{file.stem}-tracking"))
        plot_tracking(report.real, pictures[-1], title=f"{report.name}: tracking")
    if closest_approach(report.real) is not None:
        from trimtab.plots.swarm import plot_swarm

        pictures.append(file.with_stem(f"{file.stem}-swarm"))
        plot_swarm(report.real, report.ideal, pictures[-1], title=report.name)
    if with_navigation:
        from trimtab.plots.navigation import plot_navigation

        pictures.append(file.with_stem(f"{file.stem}-navigation"))
        plot_navigation(report.real, pictures[-1], title=f"{report.name}: navigation")
    return pictures + moving


def print_navigation(navigation: "Navigation", units: Mapping[str, str]) -> None:
    """Print how well the navigation filter's sigmas match the actual errors, and how the filter's states converge."""
    from trimtab.logs.consistency import MEANINGS

    headings = ("quantity", ">of", ">draws", ">mean", ">bounds", ">error / sigma", "white", "verdict")
    table = new_table(*headings, title="Navigation: actual errors compared with the filter's sigmas")
    rows: list[tuple[str, str, Any, str]] = []
    for name, aid in navigation.aiding.items():
        rejections = f", {aid.refused} rejected" if aid.refused else ""
        white = "-" if aid.white is None else f"{'yes' if aid.white else 'no'}, p {aid.p:.2g}"
        rows.append((f"{name} innovations", f"{aid.updates}{rejections}", aid.nis, white))
    rows += [(f"{name} error", "truth", error, "") for name, error in navigation.errors.items()]
    for name, of, j, white in rows:
        bounds = f"{j.low:.3g} … {j.high:.3g}"
        factor = f"{j.factor:.2f}  ({_format_short(j.factor_low)} … {_format_short(j.factor_high)})"
        table.add_row(name, of, f"{j.draws:.0f}", f"{j.mean:.3g}", bounds, factor, white, j.verdict)
    print_table(table)
    verdicts = {j.verdict for _, _, j, _ in rows}
    if verdicts:
        click.echo("; ".join(f"{verdict}: {meaning}" for verdict, meaning in MEANINGS.items() if verdict in verdicts))
    table = new_table("state", ">first sigma", ">last sigma", ">settled (s)", "trend")
    for name, state in navigation.learned.items():
        cells = (f"{state.first:.3g}", f"{state.last:.3g}", f"{state.settled_s:.2f}", state.trend)
        table.add_row(f"{name} ({units[name]})", *cells)
    print_table(table)
    sure = f"{100 * navigation.probability:g} % of a consistent filter's runs stay within all bounds"
    verdict = f"{navigation.verdict}; judged from {navigation.since_s:.2f} s on"
    click.echo(f"navigation: {verdict}; {sure} (docs, Navigation of a run)")


def _format_short(value: float) -> str:
    return f"{value:.2f}" if value < 100 else "∞"
