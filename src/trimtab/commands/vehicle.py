"""`trimtab vehicle`: a virtual vehicle behind a real transport."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from trimtab.commands.flight_summary import metric_units, print_result, summarise_run
from trimtab.commands.kept_programs import enable_cache
from trimtab.commands.line import VEHICLE, catch_interrupts, endpoint_factory, find_key, open_line, store_stamps_ahead
from trimtab.commands.options import FAULT, FILE, JSON, KEY, LOCKSTEP, REAL_TIME, SCENARIO, SEED, SET, UNSIGNED
from trimtab.commands.output import new_log, print_json, show_spinner
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import parse_time, to_seconds
from trimtab.live.injector import add_idle_faults
from trimtab.live.lockstep import LockstepVehicle, NoAnswerError
from trimtab.live.vehicle import LiveVehicle
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap
from trimtab.logs.metrics import full_path
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.build import build


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
@REAL_TIME
@click.option("--out", type=FILE, metavar="DIR", help="Folder for its log, vehicle.mcap, with the truth.")
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
    real_time: bool,
    out: Path | None,
    as_json: bool,
) -> None:
    """Be a scenario's vehicle, in wall-clock time, behind a real transport.

    Vehicle, sensors and actuators of the scenario, with the duties of a firmware: failsafe, arming, a safety pilot's
    takeover, parameters. The line takes the place of the scenario's simulated delays. The vehicle is held until it is
    armed. It speaks MAVLink 2, signed, so ground stations can join.

    \b
    trimtab vehicle hovercraft/forward --listen udp://:14550
    trimtab vehicle hovercraft/forward --listen serial:///dev/ttyUSB0?baud=115200 --out there
    trimtab vehicle hovercraft/forward --listen udp://:14550 --fault 'sensor:navigation stuck @ 8 s for 2 s'
    trimtab vehicle hovercraft/spin --listen loopback://spin --lockstep
    """
    built = build(scenario, settings, faults=faults)
    signing_key = find_key(scenario, key, unsigned, listen, create=True)
    limit = None if duration is None else parse_time(duration)
    enable_cache()

    def tell(text: str) -> None:
        click.echo(text, err=as_json)

    with new_log(out, "vehicle.mcap") as log, open_line(listen, listen=True) as line:
        endpoint = endpoint_factory(listen, VEHICLE, signing_key)
        if lockstep:
            built = built if limit is None else replace(built, duration=limit)
            with show_spinner(f"compiling {built.name}"):
                virtual = LockstepVehicle(built, endpoint, seed=seed)
            other = f"trimtab fly {scenario} --lockstep --link …"
            tell(f"{built.name} waits on {listen} for  {other}")
            try:
                virtual.run(line, log)
            except NoAnswerError as error:
                raise InputError("--lockstep", str(error), fix=other) from None
            flown, release, service_facts = built.duration, 0, {}
        else:
            with show_spinner(f"compiling {built.name}"):
                live = LiveVehicle(add_idle_faults(built), line, endpoint, seed=seed)
            tell(f"{built.name} listens on {listen}; held until it is armed. Ctrl-C ends it.")
            with catch_interrupts() as stop, store_stamps_ahead(live.endpoint):
                service = live.serve(duration=limit, log=log, wanted_real_time=real_time, stop=stop, tell=tell)
            flown, release = service.t - (service.release_time or 0), service.release_time
            service_facts = {
                "released_s": None if release is None else to_seconds(release),
                "mode": service.mode,
                "cause": service.cause,
                "late": service.lateness.summary()._asdict(),
                "wire": dataclasses.asdict(live.endpoint.counts),
                "line": line.statistics._asdict(),
                "log": None if service.log is None else service.log._asdict(),
            }
        result = {"scenario": built.name, "seed": seed, "duration_s": to_seconds(flown), "ideal": None}
        result |= service_facts | _summarise_flight(log, release, built)
    if as_json:
        print_json(result)
    else:
        _print_service(result, out)


def _summarise_flight(file: Path, release: int | None, scenario: Scenario) -> dict[str, Any]:
    """Metrics of the truth since the release."""
    if release is None:
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
    if result["real"] is None:
        click.echo("it was never armed, so it never moved")
    else:
        print_result(result, result["units"])
    if "mode" in result:
        refused = _format_refused_frames(result["wire"])
        click.echo(f"at the end: {result['mode']}, {result['cause']}; refused frames: {refused}")
    if out is not None:
        click.echo(f"wrote {out / 'vehicle.mcap'}")


def _format_refused_frames(counts: Mapping[str, int]) -> str:
    kinds = ("checksum", "unknown", "unsigned", "downgraded", "wrong_signature", "replayed")
    return ", ".join(f"{k.replace('_', ' ')} {counts[k]}" for k in kinds if counts[k]) or "none"
