"""`trimtab map`: find the region in the plane of two parameters where a scenario succeeds."""

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np

from trimtab.analysis.campaign.search.axes import KINDS, LINKS, Axis, axis_of_link, axis_of_path, axis_of_scale
from trimtab.analysis.campaign.search.map_theory import StabilityCriterion, stability_criteria
from trimtab.analysis.campaign.search.stability_map import SWING, StabilityMap, parse_success, stability_map
from trimtab.analysis.campaign.store.memo import FlightMemo
from trimtab.commands.kept_flights import keep_flights
from trimtab.commands.options import (
    FLIGHT,
    JSON,
    PLOT,
    RUNS,
    SCENARIO,
    SEED,
    STORE,
    SUCCESS,
    THREADS,
    WITHOUT,
    FiniteRange,
)
from trimtab.commands.output import check_picture, draw_plot, print_files, print_json
from trimtab.commands.progress import show_progress
from trimtab.core.cache_folder import enable_cache
from trimtab.core.errors import InputError
from trimtab.run.program import check_seed, describe_scenario
from trimtab.scenarios.build import build

COARSE = 5
"""Default number of values on an axis of the coarse grid."""
EXAMPLE = "delay=0:0.6"
KNOWS_NO = "the theory holds for the linear loop without packet loss"
"""Text about the limits of the theory, printed with a map."""

Criteria = tuple[StabilityCriterion, ...]


@click.command()
@SCENARIO
@click.option(
    "--x", required=True, metavar="AXIS=LOW:HIGH[:N]", help="Horizontal axis, e.g. delay=0:0.6, or any PATH=LOW:HIGH."
)
@click.option("--y", required=True, metavar="AXIS=LOW:HIGH[:N]", help="Vertical axis, e.g. jitter=0:0.3.")
@SUCCESS
@FLIGHT
@WITHOUT
@THREADS
@STORE
@RUNS(8, "Number of runs at each point.")
@click.option(
    "--depth",
    type=click.IntRange(0, 8),
    default=4,
    show_default=True,
    help="Number of times that each cell on the boundary is halved.",
)
@click.option(
    "--threshold", type=FiniteRange(0, 1), default=0.5, show_default=True, help="Success rate on the boundary."
)
@click.option(
    "--swing",
    type=FiniteRange(0),
    default=SWING,
    show_default=True,
    help="Without --success: largest accepted oscillation at the end of a run, as a fraction of the target band.",
)
@SEED
@click.option(
    "--theory/--no-theory",
    default=True,
    show_default=True,
    help="Draw the stability boundary of linear theory, if the theory applies.",
)
@PLOT("Draw the map to this picture.")
@JSON
def command(
    scenario: str,
    x: str,
    y: str,
    success: tuple[str, ...],
    settings: dict[str, str],
    without: tuple[str, ...],
    faults: tuple[str, ...],
    seed: int,
    theory: bool,
    store: Path | None,
    plot: Path | None,
    as_json: bool,
    **grid: Any,
) -> None:
    """Map where a scenario succeeds in the plane of two parameters.

    Flies a coarse grid, then halves only the cells that contain the boundary. An axis is delay, jitter or loss of the
    link, or any parameter by its path. Without --success, every target must stay in its band for the last third of the
    flight, and its oscillation must be below a tenth of the band (--swing) or decrease. A limit cycle is a failure.

    \b
    trimtab map hovercraft/zero-velocity --x delay=0:0.6 --y loss=0:0.9 --success 'error_rms:yaw_rate <= 0.6'
    trimtab map hovercraft/zero-velocity --x world.vehicle.mass=1:5 --y autopilot.law.k2=50%:400% \\
        --success 'error_rms:yaw_rate <= 0.4'
    trimtab map hypersonic/noise --x world.vehicle.modes.w1=70%:130%:7 --y world.vehicle.modes.zeta1=0.001:0.021:5 \\
        --set duration=60 --success 'tail_rms:law.h_error <= 1'
    trimtab map hovercraft/forward --x delay=0:0.4 --y jitter=0:0.4 --without navigation-error \\
        --set initial.sway_velocity=0.05 --set initial.yaw_rate=0.15 --set duration=30
    """
    check_seed(seed)
    horizontal, vertical = parse_axis("--x", x), parse_axis("--y", y)
    if horizontal.name == vertical.name:
        problem = f"must differ from --x, got {vertical.name!r} for both"
        raise InputError("--y", problem, fix="choose another parameter for --y, e.g. --y jitter=0:0.3")
    built = build(scenario, settings, without, faults)
    check_picture(plot, None)
    enable_cache()
    about = {"scenario": describe_scenario(built), "success": success, "swing": grid["swing"]}
    if success:
        grid["success"], grid["signals"] = parse_success(built, success)
    points = _estimate_points(horizontal, vertical, grid["depth"])
    with show_progress(points) as tell, keep_flights(scenario, store) as folder:
        tell("compiling", 0)
        memo = FlightMemo(folder, about, scenario)
        with _name_axis({"--x": horizontal, "--y": vertical}):
            diagram = stability_map(
                built, horizontal, vertical, seed=seed, memo=memo, progress=lambda n: tell("points", n), **grid
            )
        criteria, why = _find_criteria(diagram) if theory else ((), "")
    files = []
    if plot is not None:
        from trimtab.plots.stability_map import plot_stability_map

        files = draw_plot(plot, plot_stability_map, diagram, title=diagram.scenario.name, theory=criteria)
    if as_json:
        print_json({"scenario": scenario, "seed": seed} | _map_json(diagram, criteria), files)
        return
    _print_map(scenario, diagram, criteria, why)
    print_files(files)


@contextlib.contextmanager
def _name_axis(axes: Mapping[str, Axis]) -> Iterator[None]:
    """Change an error about a value of an axis so that the error names the option of this axis."""
    try:
        yield
    except InputError as error:
        for option, axis in axes.items():
            if error.part == axis.name:
                fix = f"{option} {axis.name}=LOW:HIGH, with both ends in the valid range"
                raise InputError(f"{option} {axis.name}", error.problem, choices=error.choices, fix=fix) from None
        raise


def _estimate_points(x: Axis, y: Axis, depth: int) -> int:
    """Estimate the number of points to fly: the coarse grid, and the cells along a boundary that crosses the map."""
    return len(x.values) * len(y.values) + 4 * max(len(x.values), len(y.values)) * (2**depth - 1)


def parse_axis(option: str, text: str) -> Axis:
    """Parse an axis `name=low:high[:count]`. name: delay, jitter, loss (of the uplink), downlink-delay, …, or a path.

    Values with a percent sign are relative to the scenario's own value.
    """
    name, equals, span = text.partition("=")
    ends = span.split(":")
    if not equals or len(ends) not in (2, 3):
        raise InputError(
            option, f"{text!r} is not of the form NAME=LOW:HIGH", fix=f"{option} {EXAMPLE}, or {option} {EXAMPLE}:7"
        )
    percent = all(e.endswith("%") for e in ends[:2])
    try:
        low, high = (float(e.removesuffix("%")) / (100 if percent else 1) for e in ends[:2])
        count = int(ends[2]) if len(ends) == 3 else COARSE
    except ValueError:
        fix = f"{option} {name}=0:0.6 in SI units, or {option} {name}=50%:200%"
        raise InputError(option, f"{span!r} is not a range of numbers", fix=fix) from None
    if not (np.isfinite([low, high]).all() and low < high and 2 <= count <= 1000):
        fix = f"{option} {EXAMPLE}, with LOW below HIGH, and 2 to 1000 values in the coarse grid"
        problem = f"needs finite numbers, LOW below HIGH, and 2 to 1000 values, got {span!r}"
        raise InputError(option, problem, fix=fix)
    values = np.linspace(low, high, count)
    link, _, kind = name.rpartition("-")
    if kind in KINDS and link in ("", *LINKS):
        if low < 0 or (kind == "loss" and high > 1):
            must = "between 0 and 1" if kind == "loss" else "at least 0 s"
            raise InputError(option, f"{name} must be {must}, got {span}", fix=f"{option} {name}=0:0.6")
        if percent:
            raise InputError(option, f"{name!r} cannot be given in per cent", fix=f"{option} {EXAMPLE}")
        return axis_of_link(kind, values, link or "uplink")
    if "." not in name:
        choices = [*KINDS, *(f"{one}-{kind}" for one in LINKS for kind in KINDS)]
        fix = f"{option} {EXAMPLE}, or the path of a quantity, which  trimtab list SCENARIO  shows"
        raise InputError(option, f"unknown axis {name!r}", choices=choices, fix=fix)
    return axis_of_scale(name, values) if percent else axis_of_path(name, values)


def _find_criteria(diagram: StabilityMap) -> tuple[Criteria, str]:
    """Return the stability criteria of linear theory that apply to a map, or the reason why no criterion applies."""
    try:
        return stability_criteria(diagram), ""
    except InputError as error:
        return (), error.problem


def _map_json(diagram: StabilityMap, criteria: Criteria) -> dict[str, Any]:
    traced = diagram.traced_boundary
    boundary = [
        [[float(diagram.at_x[i]), float(diagram.at_y[j])], [float(diagram.at_x[i + s]), float(diagram.at_y[j + s])]]
        for i, j, s in traced.boundary_cells().tolist()
    ]
    return {
        "runs": diagram.runs,
        "threshold": traced.threshold,
        "backend": diagram.backend,
        "x": {"name": diagram.x.name, "unit": diagram.x.unit, "values": diagram.at_x.tolist()},
        "y": {"name": diagram.y.name, "unit": diagram.y.unit, "values": diagram.at_y.tolist()},
        "flown": traced.evaluated_points,
        "full_grid": traced.of,
        "points": np.column_stack([diagram.sample_points, diagram.share]).tolist(),
        "boundary_cells": boundary,
        "theory": {one.name: [line.tolist() for line in one.zero_lines()] for one in criteria},
    }


def _print_map(scenario: str, diagram: StabilityMap, criteria: Criteria, why: str) -> None:
    traced, cells = diagram.traced_boundary, len(diagram.traced_boundary.boundary_cells())
    click.echo(
        f"{scenario}: {traced.evaluated_points} of {traced.of} points flown, "
        f"{diagram.runs} run{'s' * (diagram.runs != 1)} each, {cells} cell{'s' * (cells != 1)} on the boundary"
    )
    for value in diagram.y.values:
        line = int(np.abs(diagram.at_y - value).argmin())
        (first,) = traced.value[(traced.index == [0, line]).all(axis=1)]
        side = "succeeds" if first >= traced.threshold else "fails"
        unit, along = (f" {axis.unit}" if axis.unit not in ("", "1") else "" for axis in (diagram.y, diagram.x))
        passes = [f"{a:.4g} to {b:.4g}" for a, b in diagram.crossings(float(value))]
        turns = f", boundary at {diagram.x.name} {', '.join(passes)}{along}" if passes else ", no boundary on this line"
        click.echo(f"  {diagram.y.name} {value:.4g}{unit}: {side} at {diagram.x.values[0]:.4g}{turns}")
    if cells == 0:
        click.echo(_boundary_hint(diagram))
    if criteria:
        click.echo(f"criteria of linear theory: {', '.join(one.name for one in criteria)}; {KNOWS_NO}")
    elif why:
        click.echo(f"no criterion of linear theory: {why}")


def _boundary_hint(diagram: StabilityMap) -> str:
    """Return a hint for a map without a boundary."""
    if (diagram.share >= diagram.traced_boundary.threshold).all():
        return "no boundary: the scenario succeeds everywhere. Try a wider --x or --y, or a stricter --success"
    target = diagram.scenario.targets[0].path.removeprefix("truth.") if diagram.scenario.targets else "SIGNAL"
    what = f"--success 'error_rms:{target} <= 0.5', --swing 1, --without navigation-error, or other --x and --y"
    return f"no boundary: the scenario fails everywhere. Navigation errors can exceed a target's band. Try {what}"
