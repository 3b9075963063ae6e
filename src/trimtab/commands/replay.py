"""`trimtab replay`: run the recorded or a changed autopilot on the frames of a log, and compare the outputs."""

import importlib
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np

from trimtab.commands.foreign_logs import check_choice, read_any_log, scenario_estimator
from trimtab.commands.options import BACKEND, FILE, JSON, MAP, OUT, PLOT, parse_settings
from trimtab.commands.output import check_out, check_picture, draw_plot, print_files, print_json
from trimtab.commands.progress import show_spinner
from trimtab.core.cache_folder import enable_cache
from trimtab.core.errors import InputError
from trimtab.core.record import is_record, replace
from trimtab.logs.log import Log
from trimtab.logs.mcap import write_mcap
from trimtab.logs.navigation import assess_navigation
from trimtab.loop.scenario import Scenario
from trimtab.loop.settings import with_settings
from trimtab.plots.replay import interpolate_truth, plot_replay
from trimtab.run.replay import Replay, describe_replay
from trimtab.run.replay import replay as fly_again
from trimtab.run.replay_estimator import replay_estimator
from trimtab.scenarios import catalogue
from trimtab.scenarios.recorded import rebuild_scenario

PARTS = ("estimator", "law", "allocation")
"""Names of the autopilot's parts that --with can replace."""


@click.command()
@click.argument("file", type=FILE)
@MAP
@click.option(
    "--scenario",
    metavar="SCENARIO",
    help="Scenario of the log, if it is not in the catalogue. With --map: scenario whose estimator is run.",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="PATH=VALUE",
    callback=parse_settings,
    help="Change a setting of the scenario in --scenario. Only with --map. May be repeated.",
)
@click.option(
    "--with",
    "choices",
    multiple=True,
    metavar="PART=CHOICE",
    callback=parse_settings,
    help="Replace the estimator or the law of the recorded autopilot. May be repeated.",
)
@click.option(
    "--estimator",
    metavar="MODULE:FACTORY",
    help="Estimator to run on the samples of any log, without a scenario.",
)
@OUT("FILE", "Write the log with the estimates added to this MCAP file. Only with --estimator or --map.")
@BACKEND
@PLOT("Draw the recorded and the replayed signals to this picture.")
@JSON
def command(
    file: Path,
    mapping: Path | None,
    scenario: str | None,
    settings: dict[str, str],
    choices: dict[str, str],
    estimator: str | None,
    out: Path | None,
    backend: str,
    plot: Path | None,
    as_json: bool,
) -> None:
    """Replay a recorded flight through its autopilot.

    The command checks that the outputs are bit-identical to the recorded ones.

    If the outputs differ, the first difference is printed, and the exit code is 1. --with replays the frames with
    another part of the autopilot instead, and prints the errors of both autopilots if the log contains the true state.

    \b
    trimtab run hovercraft/forward --navigation ins --out forward
    trimtab replay forward/run.mcap
    trimtab replay forward/run.mcap --with estimator=ins-coupled --plot both.png
    trimtab replay mine.mcap --estimator my_filters:planar --out estimated.mcap

    For a log of another system (PX4's ULog, ArduPilot's BIN, MCAP, rosbag2, CSV) the topics are listed. With --map an
    estimator is run on the log.

    \b
    trimtab replay flight.ulg
    trimtab replay flight.ulg --map px4.toml --scenario navigation/platform-square-wave --out estimated.mcap
    """
    check_picture(plot, None)
    if out is not None:
        check_out("--out", out, "estimated.mcap")
    check_choice(mapping, scenario, estimator, settings, choices)
    log = read_any_log(file, mapping, quiet=as_json)
    if estimator is not None or mapping is not None:
        _step_estimator(log, scenario, settings, estimator, backend, out, as_json)
        return
    if out is not None:
        raise InputError(
            "--out", "applies only to the replay of an estimator", fix="add --estimator, or leave --out out"
        )
    recorded = rebuild_scenario(log, scenario)
    autopilot = replace_parts(recorded, choices) if choices else None
    enable_cache()
    with show_spinner(f"compiling the autopilot of {recorded.name}"):
        replay = fly_again(log, recorded, autopilot=autopilot, backend=backend)
    errors = rms_errors(log, replay)
    words = ", ".join(f"{k}={v}" for k, v in choices.items())
    title = f"{file.name} replayed" + (f" with {words}" if words else "")
    files = draw_plot(plot, plot_replay, log, replay.recorded_log, replay.replayed_log, title=title)
    if as_json:
        about = {"file": str(file), "scenario": recorded.name, "seed": log.metadata.get("seed")}
        print_json(about | replay_json(replay) | {"errors": errors, "files": [str(f) for f in files]})
    else:
        click.echo(describe_replay(replay) + (f"; {replay.end_reason}" if replay.end_reason else ""))
        if replay.changed:
            _print_errors(errors)
        print_files(files)
    sys.exit(0 if replay.equal else 1)


def _step_estimator(
    log: Log,
    scenario: str | None,
    settings: Mapping[str, str],
    name: str | None,
    backend: str,
    out: Path | None,
    as_json: bool,
) -> None:
    """Run an estimator alone, named by a factory or by a scenario. Print its errors and their consistency."""
    enable_cache()
    with show_spinner(f"compiling {name or scenario}"):
        if name is None:
            part = scenario_estimator(str(scenario), settings, log)
        elif ":" in name:
            part = _build_part("estimator", name)
        else:
            raise InputError(
                "--estimator", f"{name!r} is not a factory; must be MODULE:FACTORY", fix="--estimator module:factory"
            )
        estimated = replay_estimator(log, part, backend=backend)
    valid = estimated["estimate.valid"]
    states = [p for p in estimated.paths if p.startswith("estimate.state.") and p.count(".") == 2]
    truths = {p.rpartition(".")[2]: interpolate_truth(log, p, estimated.ticks) for p in states}
    off = {n: _state_error(estimated, n, v)[valid] for n, v in truths.items() if v is not None}
    errors = {n: float(np.sqrt(np.mean(v * v))) for n, v in off.items() if len(v)}
    navigation = assess_navigation(estimated)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
    files = [] if out is None else [write_mcap(estimated, out)]
    if as_json:
        verdict = None if navigation is None else navigation.plain()
        about = {"steps": len(estimated), "valid": int(valid.sum()), "errors": errors, "navigation": verdict}
        print_json(about | {"backend": estimated.metadata["backend"]}, files)
        return
    click.echo(f"{len(estimated)} steps, {int(valid.sum())} with a valid estimate, on {estimated.metadata['backend']}")
    for state, rms in errors.items():
        click.echo(f"  {state}: rms error {rms:.4g}")
    if navigation is not None:
        click.echo(f"  consistency of the errors: {navigation.verdict}")
    print_files(files)


def _state_error(estimated: Log, name: str, truth: Any) -> Any:
    """Return estimate minus true value. The error of an angle is wrapped to ±pi."""
    path = f"estimate.state.{name}"
    error = estimated[path] - truth
    is_angle = path in estimated.declarations and estimated.declarations[path].kind == "angle"
    return (error + np.pi) % (2 * np.pi) - np.pi if is_angle else error


def replay_json(replay: Replay) -> dict[str, Any]:
    """Return the result of a replay as plain data for JSON."""
    first = None
    if replay.first is not None:
        first = {name: v if isinstance(v, str) else float(v) for name, v in replay.first._asdict().items()}
    return {
        "steps": len(replay.recorded_log),
        "until_s": float(replay.recorded_log.t[-1]),
        "rest": replay.end_reason,
        "backend": replay.backend,
        "changed": replay.changed,
        "exact": replay.exact,
        "strict": replay.strict,
        "equal": replay.equal,
        "first": first,
    }


def replace_parts(scenario: Scenario, choices: Mapping[str, str]) -> Any:
    """Return the recorded autopilot with some parts replaced.

    Args:
        scenario: scenario of the log.
        choices: ``estimator``, ``law`` or ``allocation`` -> a choice of the scenario's function, e.g. ins-coupled, or
            ``module:factory``. Also path of a setting of these parts -> value.
    """
    autopilot = scenario.autopilot
    for name in PARTS:
        if name in choices:
            autopilot = replace(autopilot, **{name: _load_part(name, choices[name], scenario.name)})
    settings = {f"autopilot.{p.removeprefix('autopilot.')}": v for p, v in choices.items() if p not in PARTS}
    return with_settings(replace(scenario, autopilot=autopilot), settings).autopilot


def _load_part(name: str, choice: str, scenario: str) -> Any:
    """Return a part of an autopilot that is named by a choice of the scenario or by a factory."""
    if ":" in choice:
        return _build_part(name, choice)
    offered = catalogue.scenario_choices(scenario) if scenario in catalogue.scenario_names() else {}
    for argument, values in offered.items():
        if choice in values:
            return getattr(catalogue.load_scenario(scenario, {argument: choice})[0].autopilot, name)
    choices = [v for values in offered.values() for v in values]
    problem = f"{choice!r} is not a choice of scenario {scenario!r}"
    raise InputError(f"--with {name}", problem, choices=choices, fix=f"--with {name}=module:factory")


def _build_part(name: str, choice: str) -> Any:
    where, _, factory = choice.partition(":")
    if "" not in sys.path:
        sys.path.insert(0, "")
    try:
        part = getattr(importlib.import_module(where), factory)()
    except (ImportError, AttributeError, TypeError) as error:
        fix = f"define  def {factory or 'make'}():  in {where}, and return the {name} from it"
        if where.endswith(".py"):
            fix = f"name the module, from the folder that contains it: {Path(where).stem}:{factory or 'make'}"
        raise InputError(f"--with {name}", f"cannot load {choice!r}: {error}", fix=fix) from None
    if not is_record(part):
        problem = f"{choice!r} returns an object of type {type(part).__name__}, which is not a record"
        raise InputError(f"--with {name}", problem, fix="decorate the object's class with @record")
    return part


def rms_errors(log: Log, replay: Replay) -> dict[str, dict[str, float]]:
    """Return rms errors of the recorded and the replayed estimate, for each state whose true value is in the log."""
    errors = {}
    for path in [p for p in replay.recorded_log.paths if p in replay.replayed_log]:
        truth = interpolate_truth(log, path, replay.recorded_log.ticks)
        if truth is not None:
            pair = {"recorded": replay.recorded_log[path], "replayed": replay.replayed_log[path]}
            rms = {name: float(np.sqrt(np.nanmean((v - truth) ** 2))) for name, v in pair.items()}
            errors[path.rpartition(".")[2]] = rms
    return errors


def _print_errors(errors: Mapping[str, Mapping[str, float]]) -> None:
    for name, pair in errors.items():
        was, now = (f"{v:.4g}" if np.isfinite(v) else "-" for v in (pair["recorded"], pair["replayed"]))
        click.echo(f"  {name}: rms error {was} as recorded, {now} as replayed")
