"""`trimtab vehicle`: a virtual vehicle behind a real transport."""

import dataclasses
import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import click

from trimtab.commands.cache import use_cache
from trimtab.commands.fly_scenario import Request as Asked
from trimtab.commands.fly_scenario import build, check_folder, summary
from trimtab.commands.line import VEHICLE, end_of, find_key, opened, stamps_kept, until_interrupted
from trimtab.commands.progress import waiting
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import parse, to_seconds
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap
from trimtab.logs.metrics import full_path


class Request(NamedTuple):
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


def vehicle(request: Request) -> None:
    """Compile it, open the line, run until told to stop."""
    scenario = build(Asked(request.scenario, request.settings, seed=request.seed, faults=request.faults))
    key = find_key(request.scenario, request.key, request.unsigned, request.listen, create=True)
    if request.out is not None:
        check_folder("--out", request.out)
        request.out.mkdir(parents=True, exist_ok=True)
    duration = None if request.duration is None else parse(request.duration)
    use_cache()
    with tempfile.TemporaryDirectory() as scratch, opened(request.listen, listen=True) as link:
        log = (request.out or Path(scratch)) / "vehicle.mcap"
        _free(log)
        run = _lockstep if request.lockstep else _real_time
        result = run(request, scenario, link, end_of(request.listen, VEHICLE, key), duration, log)
    _show(request, result)


def _free(log: Path) -> None:
    if log.exists():
        raise InputError("--out", f"there is a log already: {log}", fix="--out with a new folder")


def _real_time(request: Request, scenario: Any, link: Any, end: Any, duration: int | None, log: Path) -> dict[str, Any]:
    from trimtab.live.injector import ready_for_faults
    from trimtab.live.vehicle import Vehicle

    with waiting(f"compiling {scenario.name}"):
        one = Vehicle(ready_for_faults(scenario), link, end, seed=request.seed)
    _say(request, f"{scenario.name} listens on {request.listen}; held until it is armed. Ctrl-C ends it.")
    with until_interrupted() as stop, stamps_kept(one.endpoint):
        served = one.serve(
            duration=duration,
            log=log,
            wanted_real_time=request.real_time,
            stop=stop,
            tell=lambda text: _say(request, text),
        )
    found = _facts(request, scenario, served.t - (served.released or 0)) | {
        "released_s": None if served.released is None else to_seconds(served.released),
        "mode": served.mode,
        "cause": served.cause,
        "late": served.late.summary()._asdict(),
        "wire": dataclasses.asdict(one.endpoint.counts),
        "line": link.statistics._asdict(),
        "log": None if served.log is None else served.log._asdict(),
    }
    return found | _flown(log, served.released, scenario)


def _lockstep(request: Request, scenario: Any, link: Any, end: Any, duration: int | None, log: Path) -> dict[str, Any]:
    from trimtab.live.lockstep import LockstepVehicle, Silence

    if duration is not None:
        scenario = replace(scenario, duration=duration)
    with waiting(f"compiling {scenario.name}"):
        one = LockstepVehicle(scenario, end, seed=request.seed)
    other = f"trimtab fly {request.scenario} --lockstep --link …"
    _say(request, f"{scenario.name} waits on {request.listen} for  {other}")
    try:
        one.run(link, log)
    except Silence as error:
        raise InputError("--lockstep", str(error), fix=other) from None
    return _facts(request, scenario, scenario.duration) | _flown(log, 0, scenario)


def _facts(request: Request, scenario: Any, ran: int) -> dict[str, Any]:
    return {"scenario": scenario.name, "seed": request.seed, "duration_s": to_seconds(ran), "ideal": None}


def _flown(file: Path, released: int | None, scenario: Any) -> dict[str, Any]:
    """Metrics of the truth since the release."""
    if released is None:
        return {"real": None}
    whole = read_mcap(file)
    after = whole.ticks >= released
    if not after.any():
        return {"real": None}
    ticks = whole.ticks[after] - released
    signals = {p: v[after] for p, v in whole.signals.items()}
    log = Log(to_seconds(ticks), ticks, signals, whole.declared, whole.metadata, whole.final)
    real = summary(log, [t for t in scenario.targets if full_path(t.path) in log])
    units = {name: log.unit(name if name in log else f"truth.{name}") for name in real["metrics"]}
    return {"real": real, "units": units}


def _refused(counts: Mapping[str, int]) -> str:
    kinds = ("checksum", "unknown", "unsigned", "downgraded", "wrong_signature", "replayed")
    return ", ".join(f"{k.replace('_', ' ')} {counts[k]}" for k in kinds if counts[k]) or "none"


def _say(request: Request, text: str) -> None:
    click.echo(text, err=request.as_json)


def _show(request: Request, result: dict[str, Any]) -> None:
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
        click.echo(f"at the end: {result['mode']}, {result['cause']}; refused frames: {_refused(result['wire'])}")
    if request.out is not None:
        click.echo(f"wrote {request.out / 'vehicle.mcap'}")
