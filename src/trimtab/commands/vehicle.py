"""`trimtab vehicle`: a virtual vehicle behind a real transport."""

import dataclasses
import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import click

from trimtab.commands.cache import enable_cache
from trimtab.commands.fly_scenario import RunRequest as Asked
from trimtab.commands.fly_scenario import build_from_request, check_folder, summarise_run
from trimtab.commands.line import VEHICLE, catch_interrupts, endpoint_factory, find_key, open_line, store_stamps_ahead
from trimtab.commands.progress import show_spinner
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import parse_time, to_seconds
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap
from trimtab.logs.metrics import full_path


class VehicleRequest(NamedTuple):
    """What was asked for on the command line."""

    scenario: str
    listen: str
    settings: Mapping[str, str] = {}
    faults: tuple[str, ...] = ()
    lockstep: bool = False
    seed: int = 0
    duration: str | None = None
    key: Path | None = None
    unsigned: bool = False
    real_time: bool = True
    out: Path | None = None
    as_json: bool = False


def vehicle(request: VehicleRequest) -> None:
    """Compile it, open the line, run until told to stop."""
    scenario = build_from_request(Asked(request.scenario, request.settings, seed=request.seed, faults=request.faults))
    key = find_key(request.scenario, request.key, request.unsigned, request.listen, create=True)
    if request.out is not None:
        check_folder("--out", request.out)
        request.out.mkdir(parents=True, exist_ok=True)
    duration = None if request.duration is None else parse_time(request.duration)
    enable_cache()
    with tempfile.TemporaryDirectory() as scratch, open_line(request.listen, listen=True) as link:
        log = (request.out or Path(scratch)) / "vehicle.mcap"
        _refuse_existing_log(log)
        run = _serve_lockstep if request.lockstep else _serve_real_time
        result = run(request, scenario, link, endpoint_factory(request.listen, VEHICLE, key), duration, log)
    _show_result(request, result)


def _refuse_existing_log(log: Path) -> None:
    if log.exists():
        raise InputError("--out", f"there is a log already: {log}", fix="--out with a new folder")


def _serve_real_time(
    request: VehicleRequest, scenario: Any, link: Any, end: Any, duration: int | None, log: Path
) -> dict[str, Any]:
    from trimtab.live.injector import add_idle_faults
    from trimtab.live.vehicle import LiveVehicle

    with show_spinner(f"compiling {scenario.name}"):
        one = LiveVehicle(add_idle_faults(scenario), link, end, seed=request.seed)
    _print_message(request, f"{scenario.name} listens on {request.listen}; held until it is armed. Ctrl-C ends it.")
    with catch_interrupts() as stop, store_stamps_ahead(one.endpoint):
        served = one.serve(
            duration=duration,
            log=log,
            wanted_real_time=request.real_time,
            stop=stop,
            tell=lambda text: _print_message(request, text),
        )
    found = _run_facts(request, scenario, served.t - (served.release_time or 0)) | {
        "released_s": None if served.release_time is None else to_seconds(served.release_time),
        "mode": served.mode,
        "cause": served.cause,
        "late": served.lateness.summary()._asdict(),
        "wire": dataclasses.asdict(one.endpoint.counts),
        "line": link.statistics._asdict(),
        "log": None if served.log is None else served.log._asdict(),
    }
    return found | _summarise_flight(log, served.release_time, scenario)


def _serve_lockstep(
    request: VehicleRequest, scenario: Any, link: Any, end: Any, duration: int | None, log: Path
) -> dict[str, Any]:
    from trimtab.live.lockstep import LockstepVehicle, NoAnswerError

    if duration is not None:
        scenario = replace(scenario, duration=duration)
    with show_spinner(f"compiling {scenario.name}"):
        one = LockstepVehicle(scenario, end, seed=request.seed)
    other = f"trimtab fly {request.scenario} --lockstep --link …"
    _print_message(request, f"{scenario.name} waits on {request.listen} for  {other}")
    try:
        one.run(link, log)
    except NoAnswerError as error:
        raise InputError("--lockstep", str(error), fix=other) from None
    return _run_facts(request, scenario, scenario.duration) | _summarise_flight(log, 0, scenario)


def _run_facts(request: VehicleRequest, scenario: Any, ran: int) -> dict[str, Any]:
    return {"scenario": scenario.name, "seed": request.seed, "duration_s": to_seconds(ran), "ideal": None}


def _summarise_flight(file: Path, released: int | None, scenario: Any) -> dict[str, Any]:
    """Metrics of the truth since the release."""
    if released is None:
        return {"real": None}
    whole = read_mcap(file)
    after = whole.ticks >= released
    if not after.any():
        return {"real": None}
    ticks = whole.ticks[after] - released
    signals = {p: v[after] for p, v in whole.signals.items()}
    log = Log(to_seconds(ticks), ticks, signals, whole.declarations, whole.metadata, whole.final)
    real = summarise_run(log, [t for t in scenario.targets if full_path(t.path) in log])
    units = {name: log.unit(name if name in log else f"truth.{name}") for name in real["metrics"]}
    return {"real": real, "units": units}


def _format_refused_frames(counts: Mapping[str, int]) -> str:
    kinds = ("checksum", "unknown", "unsigned", "downgraded", "wrong_signature", "replayed")
    return ", ".join(f"{k.replace('_', ' ')} {counts[k]}" for k in kinds if counts[k]) or "none"


def _print_message(request: VehicleRequest, text: str) -> None:
    click.echo(text, err=request.as_json)


def _show_result(request: VehicleRequest, result: dict[str, Any]) -> None:
    if request.as_json:
        click.echo(json.dumps(result))
        return
    from trimtab.commands.tables import print_result

    real = result["real"]
    if real is None:
        click.echo("it was never armed, so it never moved")
    else:
        units = {name: unit for name, unit in result["units"].items() if name in real["metrics"]}
        print_result(result, units)
    if "mode" in result:
        click.echo(
            f"at the end: {result['mode']}, {result['cause']}; refused frames: {_format_refused_frames(result['wire'])}"
        )
    if request.out is not None:
        click.echo(f"wrote {request.out / 'vehicle.mcap'}")
