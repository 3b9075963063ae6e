"""`trimtab map`: where in the plane of two parameters a scenario succeeds."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click
import numpy as np

from trimtab.core.errors import InputError

if TYPE_CHECKING:
    from trimtab.campaign.search.axes import Axis
    from trimtab.campaign.search.map_theory import StabilityCriterion
    from trimtab.campaign.search.stability_map import StabilityMap
    from trimtab.loop.scenario import Scenario

COARSE = 5
"""Values of the coarse grid where an axis does not say how many."""
EXAMPLE = "delay=0:0.6"


class MapRequest(NamedTuple):
    """What was asked for on the command line."""

    scenario: str
    x: str
    y: str
    settings: Mapping[str, str] = {}
    without: tuple[str, ...] = ()
    success: tuple[str, ...] = ()
    runs: int = 8
    depth: int = 4
    threshold: float = 0.5
    seed: int = 0
    theory: bool = True
    plot: Path | None = None
    as_json: bool = False


def stability_map(request: MapRequest) -> None:
    """Everything is checked before anything runs."""
    from trimtab.campaign.search import stability_map as maps
    from trimtab.commands.cache import enable_cache
    from trimtab.commands.fly_scenario import RunRequest as Flight
    from trimtab.commands.fly_scenario import build_from_request, check_picture
    from trimtab.commands.progress import show_spinner
    from trimtab.run.program import check_seed

    check_seed(request.seed)
    x, y = parse_axis("--x", request.x), parse_axis("--y", request.y)
    if x.name == y.name:
        raise InputError("--y", f"it is {y.name!r} like --x", fix="give it another parameter, e.g. --y jitter=0:0.3")
    scenario = build_from_request(Flight(request.scenario, request.settings, request.without))
    check_picture(request.plot, None)
    enable_cache()
    wanted: dict[str, Any] = {"runs": request.runs, "depth": request.depth, "threshold": request.threshold}
    if request.success:
        from trimtab.campaign.search.stability_map import parse_success

        wanted["success"], wanted["signals"] = parse_success(scenario, request.success)
    with show_spinner(f"flying {scenario.name}"):
        found = maps.stability_map(scenario, x, y, seed=request.seed, **wanted)
        criteria, why = _find_criteria(found) if request.theory else ((), "")
    written = _draw_map(found, criteria, scenario, request.plot)
    if request.as_json:
        plain = _map_json(request, found, criteria) | ({"files": written} if written else {})
        click.echo(json.dumps(plain, allow_nan=False))
        return
    _print_map(found, criteria, why)
    for file in written:
        click.echo(f"wrote {file}")


def parse_axis(option: str, text: str) -> "Axis":
    """An axis from `name=low:high[:count]`: delay, jitter, loss (of the uplink), downlink-delay, …, or a path.

    With percent signs the scenario's own value is multiplied.
    """
    from trimtab.campaign.search.axes import KINDS, LINKS, axis_of_link, axis_of_path, axis_of_scale

    name, given, span = text.partition("=")
    ends = span.split(":")
    if not given or len(ends) not in (2, 3):
        raise InputError(option, f"{text!r} is no name and range", fix=f"{option} {EXAMPLE}, or {option} {EXAMPLE}:7")
    percent = all(e.endswith("%") for e in ends[:2])
    try:
        low, high = (float(e.removesuffix("%")) / (100 if percent else 1) for e in ends[:2])
        count = int(ends[2]) if len(ends) == 3 else COARSE
    except ValueError:
        fix = f"{option} {name}=0:0.6 in SI units, or {option} {name}=50%:200%"
        raise InputError(option, f"{span!r} is no range of numbers", fix=fix) from None
    if not (np.isfinite([low, high]).all() and low < high and 2 <= count <= 1000):
        fix = f"{option} {EXAMPLE}, low before high, with 2 to 1000 values in the coarse grid"
        raise InputError(option, f"{span!r} is no rising range", fix=fix)
    values = np.linspace(low, high, count)
    link, _, kind = name.rpartition("-")
    if kind in KINDS and link in ("", *LINKS):
        if percent:
            raise InputError(option, f"{name!r} takes no percent", fix=f"{option} {EXAMPLE}")
        return axis_of_link(kind, values, link or "uplink")
    if "." not in name:
        choices = [*KINDS, *(f"{one}-{kind}" for one in LINKS for kind in KINDS)]
        fix = f"{option} {EXAMPLE}, or the path of a quantity, which  trimtab list SCENARIO  shows"
        raise InputError(option, f"there is no {name!r}", choices=choices, fix=fix)
    return axis_of_scale(name, values) if percent else axis_of_path(name, values)


def _find_criteria(found: "StabilityMap") -> tuple[tuple["StabilityCriterion", ...], str]:
    """The criteria that apply, or why there are none."""
    from trimtab.campaign.search.map_theory import stability_criteria

    try:
        return stability_criteria(found), ""
    except InputError as error:
        return (), error.problem


def _map_json(request: MapRequest, found: "StabilityMap", criteria: tuple["StabilityCriterion", ...]) -> dict[str, Any]:
    traced = found.traced_boundary
    boundary = [
        [[float(found.at_x[i]), float(found.at_y[j])], [float(found.at_x[i + s]), float(found.at_y[j + s])]]
        for i, j, s in traced.boundary_cells().tolist()
    ]
    return {
        "scenario": request.scenario,
        "seed": request.seed,
        "runs": found.runs,
        "threshold": traced.threshold,
        "backend": found.backend,
        "x": {"name": found.x.name, "unit": found.x.unit, "values": found.at_x.tolist()},
        "y": {"name": found.y.name, "unit": found.y.unit, "values": found.at_y.tolist()},
        "flown": traced.evaluated_points,
        "full_grid": traced.of,
        "points": np.column_stack([found.flown_points, found.share]).tolist(),
        "boundary_cells": boundary,
        "theory": {one.name: [line.tolist() for line in one.zero_lines()] for one in criteria},
    }


def _print_map(found: "StabilityMap", criteria: tuple["StabilityCriterion", ...], why: str) -> None:
    traced = found.traced_boundary
    click.echo(
        f"{found.scenario.name}: {traced.evaluated_points} points flown of {traced.of}, {found.runs} runs each,"
        f" {len(traced.boundary_cells())} cells on the boundary"
    )
    for value in found.y.values:
        line = int(np.abs(found.at_y - value).argmin())
        (first,) = traced.value[(traced.index == [0, line]).all(axis=1)]
        side = "succeeds" if first >= traced.threshold else "fails"
        unit, along = (f" {axis.unit}" if axis.unit not in ("", "1") else "" for axis in (found.y, found.x))
        passes = [f"{a:.4g} to {b:.4g}" for a, b in found.crossings(float(value))]
        turns = f", turns at {found.x.name} {', '.join(passes)}{along}" if passes else " all along"
        click.echo(f"  {found.y.name} {value:.4g}{unit}: {side} at {found.x.values[0]:.4g}{turns}")
    if len(traced.boundary_cells()) == 0:
        click.echo(_boundary_hint(found))
    if criteria:
        click.echo(f"theory beside it: {', '.join(one.name for one in criteria)}")
    elif why:
        click.echo(f"no theory beside it: {why}")


def _boundary_hint(found: "StabilityMap") -> str:
    """What to type where a map is all of one colour."""
    if (found.share >= found.traced_boundary.threshold).all():
        return "no boundary: it succeeds everywhere. Wider --x or --y, or a stricter --success"
    target = found.scenario.targets[0].path.removeprefix("truth.") if found.scenario.targets else "SIGNAL"
    what = f"--success 'error_rms:{target} <= 0.5', --without navigation-error, or other --x and --y"
    return f"no boundary: it fails everywhere. Errors of navigation alone can keep it from a target's band: {what}"


def _draw_map(
    found: "StabilityMap", criteria: tuple["StabilityCriterion", ...], scenario: "Scenario", file: Path | None
) -> list[str]:
    if file is None:
        return []
    from trimtab.plots.stability_map import plot_stability_map

    file.parent.mkdir(parents=True, exist_ok=True)
    plot_stability_map(found, file, title=scenario.name, theory=criteria)
    return [str(file)]
