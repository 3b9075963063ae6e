"""`trimtab vehicle`: a virtual vehicle behind a real transport."""

import dataclasses
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click

from trimtab.commands.flight_summary import metric_units, print_result, summarise_run
from trimtab.commands.kept_programs import enable_cache
from trimtab.commands.line import (
    VEHICLE,
    catch_interrupts,
    endpoint_factory,
    find_key,
    open_line,
    store_stamps_ahead,
    transfer_rate,
)
from trimtab.commands.options import (
    FAULT,
    FILE,
    JSON,
    KEY,
    LOCKSTEP,
    LOG_LIMIT,
    PARAMETERS,
    REAL_TIME,
    SCENARIO,
    SEED,
    SET,
    UNSIGNED,
)
from trimtab.commands.output import new_log, print_json, show_spinner
from trimtab.core.errors import InputError
from trimtab.core.interfaces import Link
from trimtab.core.record import replace
from trimtab.core.time import ms, parse_time, to_seconds
from trimtab.live.connection_problem import COMPUTER_CLOCK, STORED_CLOCK
from trimtab.live.globe import parse_origin
from trimtab.live.injector import add_idle_faults
from trimtab.live.lockstep import LockstepVehicle, NoAnswerError
from trimtab.live.parameter_store import ParameterStore, read_parameters
from trimtab.live.station_options import StationOptions
from trimtab.live.vehicle import LiveVehicle, VehicleSummary
from trimtab.logs.log import Log
from trimtab.logs.log_limit import list_files
from trimtab.logs.mcap import read_mcap
from trimtab.logs.metrics import full_path
from trimtab.loop.scenario import Scenario
from trimtab.run.identity import setting_path
from trimtab.scenarios.build import build
from trimtab.wire.dialect import Dialect
from trimtab.wire.mavlink import Endpoint

SHORTEST_WATCHDOG = ms(20)
"""Four heartbeats of the outputs' process."""
MOST_SUMMARISED = 200_000_000
"""Bytes of a log that is read whole for its metrics: a quarter of an hour."""


@click.command()
@SCENARIO
@click.option("--listen", required=True, metavar="URI", help="Line to be reached on, e.g. udp://:14550.")
@SET
@FAULT
@LOCKSTEP
@SEED
@click.option("--duration", metavar="TIME", help="End this long after arming.  [default: until Ctrl-C]")
@KEY
@UNSIGNED
@click.option(
    "--clock",
    type=click.Choice([STORED_CLOCK, COMPUTER_CLOCK]),
    default=STORED_CLOCK,
    show_default=True,
    help="What it signs by: on from what is stored; or this computer's clock, where a wrong one was stored.",
)
@click.option(
    "--watchdog",
    metavar="TIME",
    default="50 ms",
    show_default=True,
    help="Silence of this process after which its outputs, in a process of their own, go safe.",
)
@REAL_TIME
@click.option("--out", type=FILE, metavar="DIR", help="Folder for its log, with the truth.  [default: no log]")
@click.option(
    "--origin",
    metavar="LAT,LON,ALT",
    help="Where its world frame is on the globe, in degrees and metres, for maps.  [default: nowhere]",
)
@PARAMETERS
@LOG_LIMIT
@JSON
def command(
    scenario: str,
    listen: str,
    settings: dict[str, str],
    faults: tuple[str, ...],
    lockstep: bool,
    seed: int,
    duration: str | None,
    key: Path | None,
    unsigned: bool,
    clock: str,
    watchdog: str,
    real_time: bool,
    out: Path | None,
    origin: str | None,
    parameters: Path | None,
    log_limit: int,
    as_json: bool,
) -> None:
    """Be a scenario's vehicle, in wall-clock time, behind a real transport.

    Vehicle, sensors and actuators of the scenario, with the duties of a firmware: failsafe, arming, a safety pilot's
    takeover, parameters. The line takes the place of the scenario's simulated delays. The vehicle is held until it is
    armed. It speaks MAVLink 2, signed, so ground stations can join. Exit code 1: a failsafe acted, its outputs
    went safe by themselves, or its log is lost or lacks rows; 2: refused input.

    \b
    trimtab vehicle hovercraft/forward --listen udp://:14550
    trimtab vehicle hovercraft/forward --listen serial:///dev/ttyUSB0?baud=115200 --out there
    trimtab vehicle hovercraft/forward --listen udp://:14550 --fault 'sensor:navigation stuck @ 8 s for 2 s'
    trimtab vehicle hovercraft/spin --listen loopback://spin --lockstep
    """
    built = build(scenario, read_parameters(parameters, scenario) | settings, faults=faults)
    signing_key = find_key(scenario, key, unsigned, listen, create=True)
    limit = None if duration is None else parse_time(duration)
    silence = _parse_watchdog(watchdog)
    place = None if origin is None else parse_origin(origin)
    enable_cache()

    def tell(text: str) -> None:
        click.echo(text, err=as_json)

    with open_line(listen, listen=True) as line:
        log = None if out is None else new_log(out, "vehicle.mcap")
        endpoint = endpoint_factory(listen, VEHICLE, signing_key, clock)
        if lockstep:
            built = built if limit is None else replace(built, duration=limit)
            other = f"trimtab fly {scenario} --lockstep --link …"
            ready = f"{built.name} waits on {listen} for  {other}"
            _lead_lockstep(built, line, endpoint, seed, log, lambda: tell(ready), other)
            flown, release, service_facts = built.duration, 0, {}
        else:
            with show_spinner(f"compiling {built.name}"):
                options = StationOptions(
                    out, transfer_rate(listen), place, ParameterStore(parameters, scenario, setting_path)
                )
                live = LiveVehicle(add_idle_faults(built), line, endpoint, seed=seed, station_options=options)
            tell(f"{built.name} listens on {listen}; held until it is armed. Ctrl-C ends it.")
            with catch_interrupts() as stop, store_stamps_ahead(live.endpoint):
                service = live.serve(
                    duration=limit,
                    log=log,
                    log_limit=log_limit,
                    watchdog=silence,
                    outputs_folder=out,
                    wanted_real_time=real_time,
                    stop=stop,
                    tell=tell,
                )
            flown, release = service.t - (service.release_time or 0), service.release_time
            service_facts = _describe_service(service, live, line)
        result = {"scenario": built.name, "seed": seed, "duration_s": to_seconds(flown), "ideal": None}
        result |= service_facts | _summarise_flight(log, release, built)
    if as_json:
        print_json(result)
    else:
        _print_service(result, out)
    sys.exit(1 if result.get("problems") else 0)


def _lead_lockstep(
    scenario: Scenario,
    line: Link,
    endpoint: Callable[[Dialect], Endpoint],
    seed: int,
    log: Path | None,
    tell_ready: Callable[[], None],
    other: str,
) -> None:
    """other: what is typed at the other end."""
    with show_spinner(f"compiling {scenario.name}"):
        virtual = LockstepVehicle(scenario, endpoint, seed=seed)
    tell_ready()
    try:
        virtual.run(line, log)
    except NoAnswerError as error:
        raise InputError("--lockstep", str(error), fix=other) from None


def _parse_watchdog(text: str) -> int:
    """The watchdog's time (100 ns)."""
    silence = parse_time(text)
    if silence < SHORTEST_WATCHDOG:
        raise InputError("--watchdog", f"{text} is shorter than four heartbeats", fix="--watchdog '50 ms'")
    return silence


def _describe_service(service: VehicleSummary, live: LiveVehicle, line: Link) -> dict[str, Any]:
    """What became of the vehicle, for the result."""
    return {
        "released_s": None if service.release_time is None else to_seconds(service.release_time),
        "mode": service.mode,
        "cause": service.cause,
        "problems": service.problems,
        "late": service.lateness.summary()._asdict(),
        "wire": dataclasses.asdict(live.endpoint.counts),
        "line": line.statistics._asdict(),
        "log": None if service.log is None else service.log._asdict(),
    }


def _summarise_flight(file: Path | None, release: int | None, scenario: Scenario) -> dict[str, Any]:
    """Metrics of the truth since the release, where there is a log that fits into memory with ease."""
    if release is None or file is None or list_files(file) != [file] or file.stat().st_size > MOST_SUMMARISED:
        return {"real": None}
    whole = read_mcap(file)
    after = whole.ticks >= release
    if not after.any():
        return {"real": None}
    ticks = whole.ticks[after] - release
    signals = {p: v[after] for p, v in whole.signals.items()}
    log = Log(to_seconds(ticks), ticks, signals, whole.declarations, whole.metadata, whole.final)
    real = summarise_run(log, [t for t in scenario.targets if full_path(t.path) in log])
    return {"real": real, "units": metric_units(log, real["metrics"])}


def _print_service(result: dict[str, Any], out: Path | None) -> None:
    if result["real"] is None and result.get("released_s", 0) is None:
        click.echo("it was never armed, so it never moved")
    elif result["real"] is None:
        click.echo("no metrics: there is no log" if out is None else "no metrics: the log is too long to be read whole")
    else:
        print_result(result, result["units"])
    if "mode" in result:
        refused = _format_refused_frames(result["wire"])
        for problem in result["problems"]:
            click.echo(f"problem: {problem}")
        click.echo(f"at the end: {result['mode']}, {result['cause']}; refused frames: {refused}")
    if out is not None:
        for file in list_files(out / "vehicle.mcap"):
            click.echo(f"wrote {file}")


def _format_refused_frames(counts: Mapping[str, int]) -> str:
    kinds = ("checksum", "unknown", "unsigned", "downgraded", "wrong_signature", "replayed", "stale", "leading")
    return ", ".join(f"{k.replace('_', ' ')} {counts[k]}" for k in kinds if counts[k]) or "none"
