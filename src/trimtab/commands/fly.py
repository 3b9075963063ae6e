"""`trimtab fly`: an autopilot in real time against the vehicle at the far end of a line."""

import dataclasses
import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import click

from trimtab.commands.cache import enable_cache
from trimtab.commands.fly_scenario import RunRequest as Asked
from trimtab.commands.fly_scenario import build_from_request, check_folder
from trimtab.commands.line import AUTOPILOT, catch_interrupts, endpoint_factory, find_key, open_line, store_stamps_ahead
from trimtab.commands.progress import show_spinner
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import parse_time, to_seconds
from trimtab.scenarios import catalogue


class FlyRequest(NamedTuple):
    """What was asked for on the command line."""

    scenario: str
    link: str
    settings: Mapping[str, str] = {}
    lockstep: bool = False
    seed: int = 0
    duration: str | None = None
    key: Path | None = None
    unsigned: bool = False
    real_time: bool = True
    out: Path | None = None
    as_json: bool = False


def fly(request: FlyRequest) -> bool:
    """Compile it, open the line, fly; whether the vehicle was armed and no log row was lost."""
    scenario = build_from_request(Asked(request.scenario, _with_supervisor(request), seed=request.seed))
    key = find_key(request.scenario, request.key, request.unsigned, request.link, create=False)
    if request.out is not None:
        check_folder("--out", request.out)
        request.out.mkdir(parents=True, exist_ok=True)
    if request.duration is not None:
        scenario = replace(scenario, duration=parse_time(request.duration))
    enable_cache()
    with tempfile.TemporaryDirectory() as scratch, open_line(request.link, listen=False) as link:
        log = (request.out or Path(scratch)) / "flight.mcap"
        if log.exists():
            raise InputError("--out", f"there is a log already: {log}", fix="--out with a new folder")
        run = _fly_lockstep if request.lockstep else _fly_real_time
        result = run(request, scenario, link, endpoint_factory(request.link, AUTOPILOT, key), log)
    if request.as_json:
        click.echo(json.dumps(result))
    elif request.out is not None:
        click.echo(f"wrote {request.out / 'flight.mcap'}")
    written = result["log"]
    return bool(result["armed"]) and bool(written) and not written["dropped"] and not written["unwritten"]


def _with_supervisor(request: FlyRequest) -> Mapping[str, str]:
    """The settings; in real time a supervisor watches, where the scenario offers one and nothing else is asked for."""
    offered = catalogue.scenario_choices(request.scenario).get("supervisor", ())
    watched = {"supervisor": "automatic"} if "automatic" in offered and not request.lockstep else {}
    return watched | dict(request.settings)


def _fly_lockstep(request: FlyRequest, scenario: Any, link: Any, end: Any, log: Path) -> dict[str, Any]:
    from trimtab.live.lockstep import LockstepAutopilot, NoAnswerError

    with show_spinner(f"compiling {scenario.name}"):
        one = LockstepAutopilot(scenario, end, seed=request.seed)
    try:
        written = one.run(link, log)
    except NoAnswerError as error:
        fix = f"trimtab vehicle {request.scenario} --lockstep --listen …"
        raise InputError("--lockstep", str(error), fix=fix) from None
    if not request.as_json:
        click.echo(f"flew {to_seconds(scenario.duration):g} s of {scenario.name} in lockstep")
    return {"scenario": scenario.name, "armed": True, "log": None if written is None else written._asdict()}


def _fly_real_time(request: FlyRequest, scenario: Any, link: Any, end: Any, log: Path) -> dict[str, Any]:
    from trimtab.live.fly import LiveAutopilot

    with show_spinner(f"compiling {scenario.name}"):
        one = LiveAutopilot(scenario, link, end, seed=request.seed)

    def tell(text: str) -> None:
        click.echo(text, err=request.as_json)

    with catch_interrupts() as stop, store_stamps_ahead(one.endpoint):
        one.connect(stop=stop)
        flight = one.fly(log=log, wanted_real_time=request.real_time, stop=stop, tell=tell)
    result = {
        "scenario": scenario.name,
        "duration_s": to_seconds(flight.t),
        "armed": flight.arming_time is not None,
        "armed_s": None if flight.arming_time is None else to_seconds(flight.arming_time),
        "real_time": flight.grant._asdict(),
        "deadlines": flight.deadlines.summary() | {"skipped": one.skipped},
        "samples": flight.autopilot_end.received_samples,
        "overflowed": flight.autopilot_end.dropped_samples,
        "overtaken": flight.autopilot_end.overtaken_samples,
        "wire": dataclasses.asdict(one.endpoint.counts),
        "line": link.statistics._asdict(),
        "log": None if flight.log is None else flight.log._asdict(),
    }
    if not request.as_json:
        _print_flight(result, str(flight.grant))
    return result


def _print_flight(result: Mapping[str, Any], granted: str) -> None:
    from trimtab.commands.tables import print_deadlines

    print_deadlines(result["deadlines"], granted)
    counts, log = result["wire"], result["log"]
    click.echo(f"frames: {counts['sent']} sent, {counts['accepted']} taken, {counts['lost']} lost on the way")
    if not result["armed"]:
        click.echo("the vehicle was never armed")
    if log is not None and (log["dropped"] or log["unwritten"]):
        click.echo(f"log: {log['dropped']} rows had no room in memory, {log['unwritten']} none on the disk")
