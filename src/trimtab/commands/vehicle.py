"""`trimtab vehicle`: simulate a vehicle that an autopilot or a flight stack controls over a link."""

import dataclasses
import sys
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import click

from trimtab.commands.flight_stack import ARDUPILOT, CHANNELS, PX4, RELEASE, choose_line, serve_stack
from trimtab.commands.flight_summary import print_truth, summarise_truth
from trimtab.commands.line import (
    VEHICLE,
    current_machine,
    endpoint_factory,
    find_key,
    live_settings,
    open_line,
    transfer_rate,
)
from trimtab.commands.options import (
    FAULT,
    JSON,
    KEY,
    LOCKSTEP,
    LOG_LIMIT,
    NAVIGATION,
    OUT,
    PARAMETERS,
    REAL_TIME,
    SCENARIO,
    SEED,
    SET,
    UNSIGNED,
)
from trimtab.commands.output import new_log, print_json, print_log_size, quote
from trimtab.commands.progress import show_spinner
from trimtab.core.cache_folder import enable_cache
from trimtab.core.control_characters import KEPT, show_controls
from trimtab.core.errors import InputError
from trimtab.core.interfaces import Link
from trimtab.core.record import replace
from trimtab.core.time import ms, parse_time, to_seconds
from trimtab.flight.connection_problem import COMPUTER_CLOCK, STORED_CLOCK
from trimtab.flight.globe import parse_origin
from trimtab.flight.injector import add_idle_faults
from trimtab.flight.lockstep import LockstepVehicle, NoAnswerError
from trimtab.flight.mavlink.dialect import Dialect
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.parameter_store import ParameterStore, read_parameters
from trimtab.flight.safety_settings import check_confirmations
from trimtab.flight.scenario_identity import setting_path
from trimtab.flight.station_options import StationOptions
from trimtab.flight.vehicle import LiveVehicle, VehicleSummary
from trimtab.logs.log_limit import list_files
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import refuse_swarm
from trimtab.scenarios.build import build

SHORTEST_WATCHDOG = ms(20)
"""Minimum time of the watchdog (100 ns): four heartbeats of the process that drives the outputs."""


@click.command()
@SCENARIO
@click.option("--listen", metavar="URI", help="Link to listen on, e.g. udp://:14550.")
@ARDUPILOT
@PX4
@CHANNELS
@RELEASE
@SET
@NAVIGATION
@FAULT
@LOCKSTEP
@SEED
@click.option("--duration", metavar="TIME", help="Duration of the flight after arming.  [default: until Ctrl-C]")
@KEY
@UNSIGNED
@click.option(
    "--clock",
    type=click.Choice([STORED_CLOCK, COMPUTER_CLOCK]),
    default=STORED_CLOCK,
    show_default=True,
    help="Clock for signatures: continue the stored clock, or use this computer's clock.",
)
@click.option(
    "--watchdog",
    metavar="TIME",
    default="50 ms",
    show_default=True,
    help="Time without data from the simulation after which the outputs switch to safe values.",
)
@click.option(
    "--confirm",
    multiple=True,
    metavar="SETTING",
    callback=lambda _context, _option, names: check_confirmations(names),
    help="Accept a setting that weakens a safety function, e.g. failsafe.timeout. May be repeated.",
)
@REAL_TIME
@OUT("DIR", "Write the vehicle's log, with the truth, to this folder.  [default: no log]")
@click.option(
    "--origin",
    metavar="LAT,LON,ALT",
    help="Geographic position of the world frame's origin, in degrees and metres, for maps.  [default: none]",
)
@PARAMETERS
@LOG_LIMIT
@JSON
def command(
    scenario: str,
    listen: str | None,
    ardupilot: str | None,
    px4: str | None,
    channels: tuple[int, ...],
    release: float | None,
    settings: dict[str, str],
    faults: tuple[str, ...],
    lockstep: bool,
    seed: int,
    duration: str | None,
    key: Path | None,
    unsigned: bool,
    clock: str,
    watchdog: str,
    confirm: frozenset[str],
    real_time: bool,
    out: Path | None,
    origin: str | None,
    parameters: Path | None,
    log_limit: int,
    as_json: bool,
) -> None:
    """Run a scenario's vehicle in real time behind a real link.

    Simulates the scenario's vehicle, sensors and actuators, and acts as its firmware: failsafe, arming, takeover by a
    safety pilot, parameters. The real link replaces the scenario's simulated delays. The vehicle is held until it is
    armed. It speaks signed MAVLink 2, so ground stations can connect. Exit code 1: a failsafe acted, the watchdog
    switched the outputs to safe values, or the log is lost or incomplete; 2: invalid input. With --ardupilot or --px4
    the command is the physics simulator of ArduPilot's or PX4's SITL instead, in virtual time (PX4: in lockstep) and
    with the protocol of that flight stack.

    \b
    trimtab vehicle hovercraft/forward --listen udp://:14550 --out there
    trimtab vehicle hovercraft/forward --listen 'serial:///dev/ttyUSB0?baud=115200' --fault 'uplink off @ 8 s for 2 s'
    trimtab vehicle hovercraft/spin --listen loopback://spin --lockstep
    trimtab vehicle quadrotor/track --release 1590 --out there --ardupilot
    """
    line_uri = choose_line(click.get_current_context(), listen, ardupilot, px4, channels, release)
    world = ({} if lockstep else live_settings(scenario, ("stick",))) | read_parameters(parameters, scenario) | settings
    built = _build_one(scenario, world, faults)
    limit, silence = None if duration is None else parse_time(duration), _parse_watchdog(watchdog)
    place, tell = None if origin is None else parse_origin(origin), partial(click.echo, err=as_json)
    enable_cache()
    if stack := "ardupilot" if ardupilot is not None else "px4" if px4 is not None else None:
        return serve_stack(stack, built, line_uri, channels, release, seed, limit, out, tell, as_json)
    signing_key = find_key(scenario, key, unsigned, line_uri, create=True)
    with open_line(line_uri, listen=True) as line:
        log = None if out is None else new_log(out, "vehicle.mcap")
        endpoint = endpoint_factory(line_uri, VEHICLE, signing_key, clock)
        if lockstep:
            built = built if limit is None else replace(built, duration=limit)
            _lead_lockstep(built, line, endpoint, seed, log, tell, f"trimtab fly {quote(scenario)} --lockstep --link …")
            release_time, end, service_facts = 0, built.duration, {}
        else:
            store = ParameterStore(parameters, scenario, setting_path)
            with show_spinner(f"compiling {built.name}"):
                options = StationOptions(out, transfer_rate(line_uri), place, store)
                live = _build_vehicle(built, line, endpoint, seed, options)
            tell(f"{built.name} listens on {line_uri}; the vehicle is held until armed. Ctrl-C stops the simulation.")
            limits = {"duration": limit, "log_limit": log_limit, "watchdog": silence, "confirmed": confirm}
            service = _serve(live, tell, log=log, outputs_folder=out, wanted_real_time=real_time, **limits)
            release_time, end = service.release_time, service.disarm_time or service.t
            service_facts = _describe_service(service, live, line)
    result = {"scenario": built.name, "seed": seed, "duration_s": to_seconds(end - (release_time or 0)), "ideal": None}
    result |= service_facts | summarise_truth(log, release_time, built.targets, end)
    if as_json:
        print_json(result)
    else:
        _print_service(result, out)
    sys.exit(1 if result.get("problems") else 0)


def _build_vehicle(
    scenario: Scenario, line: Link, endpoint: Callable[[Dialect], Endpoint], seed: int, options: StationOptions
) -> LiveVehicle:
    """Return the real-time vehicle of a scenario. Every part has an inactive fault, which can be injected in flight."""
    idle, machine = add_idle_faults(scenario), current_machine()
    return LiveVehicle(idle, line, endpoint, seed=seed, station_options=options, machine=machine)


def _serve(live: LiveVehicle, tell: Callable[[str], None], **options: Any) -> VehicleSummary:
    """Run the vehicle until Ctrl-C. A separate thread prints the vehicle's messages."""
    machine = current_machine()
    lines, stamps = machine.write_lines(tell), machine.store_stamps_ahead(live.endpoint)
    with lines as sink, machine.catch_interrupts() as stop, stamps:
        return live.serve(stop=stop, tell=sink.put, lost_lines=sink.settle, **options)


def _build_one(name: str, settings: Mapping[str, str], faults: Iterable[str]) -> Scenario:
    """Build a scenario for real time. Faults may begin after the scenario's duration. Raise InputError for a swarm."""
    built = build(name, settings, faults=faults, in_virtual_time=False)
    refuse_swarm(built, "a link")
    return built


def _lead_lockstep(
    scenario: Scenario,
    line: Link,
    endpoint: Callable[[Dialect], Endpoint],
    seed: int,
    log: Path | None,
    tell: Callable[[str], None],
    other: str,
) -> None:
    """Run the vehicle in lockstep with the other end of the link. other: command to type at that end."""
    with show_spinner(f"compiling {scenario.name}"):
        virtual = LockstepVehicle(scenario, endpoint, seed=seed)
    tell(f"{scenario.name} waits on the link for  {other}")
    try:
        virtual.run(line, log)
    except NoAnswerError as error:
        raise InputError("--lockstep", str(error), fix=other) from None


def _parse_watchdog(text: str) -> int:
    """Parse the watchdog's time, and return the time in units of 100 ns."""
    silence = parse_time(text)
    if silence < SHORTEST_WATCHDOG:
        raise InputError("--watchdog", f"must be at least 20 ms, four heartbeats, got {text}", fix="--watchdog '50 ms'")
    return silence


def _describe_service(service: VehicleSummary, live: LiveVehicle, line: Link) -> dict[str, Any]:
    """Return the part of the result about the vehicle: last mode, cause, frames, problems, link and log."""
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


def _print_service(result: dict[str, Any], out: Path | None) -> None:
    print_truth(result, out, "the vehicle was never armed, so it never moved")
    if "mode" in result:
        refused = _format_refused_frames(result["wire"])
        for problem in result["problems"]:
            click.echo(show_controls(f"problem: {problem}", KEPT))
        click.echo(f"at the end: {result['mode']}, {result['cause']}; rejected frames: {refused}")
    if out is not None:
        print_log_size(result.get("log"))
        for file in list_files(out / "vehicle.mcap"):
            click.echo(f"wrote {file}")


def _format_refused_frames(counts: Mapping[str, int]) -> str:
    kinds = ("checksum", "unknown", "unsigned", "downgraded", "wrong_signature", "replayed", "stale", "leading")
    return ", ".join(f"{k.replace('_', ' ')} {counts[k]}" for k in kinds if counts[k]) or "none"
