"""`trimtab replay`: a log's autopilot once more over its frames, or another one, and what is different."""

import importlib
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click
import numpy as np

from trimtab.core.errors import InputError

if TYPE_CHECKING:
    from trimtab.logs.log import Log
    from trimtab.loop.scenario import Scenario
    from trimtab.run.replay import Replay

PARTS = ("estimator", "law", "allocation")
"""Of an autopilot: what can be replaced whole."""


class ReplayRequest(NamedTuple):
    """What was asked for on the command line."""

    file: Path
    scenario: str | None = None
    instead: Mapping[str, str] = {}
    backend: str = "auto"
    plot: Path | None = None
    as_json: bool = False


def replay(request: ReplayRequest) -> None:
    """Everything is checked before anything runs; exit code 1 where a replay is not what was recorded."""
    from trimtab.commands.cache import enable_cache
    from trimtab.commands.fly_scenario import check_picture
    from trimtab.commands.progress import show_spinner
    from trimtab.logs.mcap import read_mcap
    from trimtab.run.replay import describe_replay
    from trimtab.run.replay import replay as fly_again
    from trimtab.scenarios.recorded import rebuild_scenario

    check_picture(request.plot, None)
    log = read_mcap(request.file)
    scenario = rebuild_scenario(log, request.scenario)
    autopilot = replace_parts(scenario, log, request.instead) if request.instead else None
    enable_cache()
    with show_spinner(f"compiling the autopilot of {scenario.name}"):
        found = fly_again(log, scenario, autopilot=autopilot, backend=request.backend)
    errors = rms_errors(log, found)
    written = _draw_replay(request, log, found)
    if request.as_json:
        about = {"file": str(request.file), "scenario": scenario.name, "seed": log.metadata.get("seed")}
        click.echo(json.dumps(about | replay_json(found) | {"errors": errors, "files": written}))
    else:
        click.echo(describe_replay(found) + (f"; {found.end_reason}" if found.end_reason else ""))
        if found.changed:
            _print_errors(errors)
        for file in written:
            click.echo(f"wrote {file}")
    if not found.equal:
        raise SystemExit(1)


def replay_json(found: "Replay") -> dict[str, Any]:
    """The outcome as plain numbers and words, for JSON."""
    first = None if found.first is None else {k: _finite_or_none(v) for k, v in found.first._asdict().items()}
    steps = {"steps": len(found.recorded_log), "until_s": float(found.recorded_log.t[-1]), "rest": found.end_reason}
    flags = {name: getattr(found, name) for name in ("backend", "changed", "exact", "strict", "equal")}
    return steps | flags | {"first": first}


def replace_parts(scenario: "Scenario", log: "Log", instead: Mapping[str, str]) -> Any:
    """The recorded autopilot with some of it replaced.

    Args:
        scenario: as recorded.
        log: its metadata names the scenario that offers choices.
        instead: ``estimator``, ``law`` or ``allocation`` -> a choice of the scenario's function, e.g. ins-coupled, or
            ``module:factory``; or the path of a setting below them -> its value.
    """
    from trimtab.core.record import replace
    from trimtab.loop.settings import with_settings

    autopilot = scenario.autopilot
    for name in PARTS:
        if name in instead:
            autopilot = replace(autopilot, **{name: _load_part(name, instead[name], scenario.name)})
    settings = {f"autopilot.{p.removeprefix('autopilot.')}": v for p, v in instead.items() if p not in PARTS}
    return with_settings(replace(scenario, autopilot=autopilot), settings).autopilot


def _load_part(name: str, choice: str, scenario: str) -> Any:
    """A part by name: what a scenario flies by choice, or what a factory makes."""
    from trimtab.scenarios import catalogue

    if ":" in choice:
        return _build_part(name, choice)
    offered = catalogue.scenario_choices(scenario) if scenario in catalogue.scenario_names() else {}
    for argument, values in offered.items():
        if choice in values:
            return getattr(catalogue.load_scenario(scenario, {argument: choice})[0].autopilot, name)
    choices = [v for values in offered.values() for v in values]
    problem = f"{choice!r} is no choice of scenario {scenario!r}"
    raise InputError(f"--with {name}", problem, choices=choices, fix=f"--with {name}=module:factory")


def _build_part(name: str, choice: str) -> Any:
    from trimtab.core.record import is_record

    where, _, factory = choice.partition(":")
    if "" not in sys.path:
        sys.path.insert(0, "")
    try:
        made = getattr(importlib.import_module(where), factory)()
    except (ImportError, AttributeError, TypeError) as error:
        fix = f"define  def {factory or 'make'}():  in {where}, which gives the {name}"
        raise InputError(f"--with {name}", f"{choice!r} gives nothing: {error}", fix=fix) from None
    if not is_record(made):
        problem = f"{choice!r} gives {type(made).__name__}, which is no record"
        raise InputError(f"--with {name}", problem, fix="write @record above its class")
    return made


def rms_errors(log: "Log", found: "Replay") -> dict[str, dict[str, float | None]]:
    """State -> RMS of its error as recorded and as replayed, where the log has the truth."""
    from trimtab.plots.replay import interpolate_truth

    errors = {}
    for path in [p for p in found.recorded_log.paths if p in found.replayed_log]:
        truth = interpolate_truth(log, path, found.recorded_log.ticks)
        if truth is not None:
            pair = {"recorded": found.recorded_log[path], "replayed": found.replayed_log[path]}
            errors[path.rpartition(".")[2]] = {
                k: _finite_or_none(np.sqrt(np.nanmean((v - truth) ** 2))) for k, v in pair.items()
            }
    return errors


def _finite_or_none(value: Any) -> Any:
    if isinstance(value, str):
        return value
    return float(value) if np.isfinite(value) else None


def _print_errors(errors: Mapping[str, Mapping[str, float | None]]) -> None:
    for name, pair in errors.items():
        was, now = (f"{v:.4g}" if v is not None else "-" for v in (pair["recorded"], pair["replayed"]))
        click.echo(f"  {name}: rms of its error {was} as recorded, {now} as replayed")


def _draw_replay(request: ReplayRequest, log: "Log", found: "Replay") -> list[str]:
    if request.plot is None:
        return []
    from trimtab.plots.replay import plot_replay

    request.plot.parent.mkdir(parents=True, exist_ok=True)
    words = ", ".join(f"{k}={v}" for k, v in request.instead.items())
    title = f"{request.file.name} replayed" + (f" with {words}" if words else "")
    plot_replay(log, found.recorded_log, found.replayed_log, request.plot, title)
    return [str(request.plot)]
