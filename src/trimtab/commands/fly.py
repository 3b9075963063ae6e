"""`trimtab fly`: run an autopilot in real time that flies a vehicle at the other end of a link."""

import dataclasses
import shlex
import sys
import webbrowser
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import click

from trimtab.commands.flight_summary import assess_estimate
from trimtab.commands.line import (
    AUTOPILOT,
    current_machine,
    endpoint_factory,
    find_key,
    live_settings,
    open_line,
)
from trimtab.commands.options import (
    JSON,
    KEY,
    LINK,
    LOCKSTEP,
    LOG_LIMIT,
    NAVIGATION,
    OUT,
    PARAMETERS,
    PLACE,
    REAL_TIME,
    SCENARIO,
    SEED,
    SET,
    UNSIGNED,
)
from trimtab.commands.output import new_log, new_table, print_json, print_log_size, print_table, quote
from trimtab.commands.progress import show_spinner
from trimtab.console.address import ConsoleAddress
from trimtab.console.hello import describe_flight
from trimtab.console.process import open_console
from trimtab.core.cache_folder import enable_cache
from trimtab.core.control_characters import KEPT, show_controls
from trimtab.core.errors import InputError
from trimtab.core.interfaces import Link
from trimtab.core.record import replace
from trimtab.core.time import parse_time, to_seconds
from trimtab.flight.autopilot import COUNT, OVERRUN_POLICIES, LiveAutopilot
from trimtab.flight.autopilot_parts import AutopilotOptions
from trimtab.flight.connection_problem import COMPUTER_CLOCK, STORED_CLOCK, VEHICLE_CLOCK
from trimtab.flight.lockstep import LockstepAutopilot, NoAnswerError
from trimtab.flight.mavlink.dialect import Dialect
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.parameter_store import ParameterStore, read_parameters
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import refuse_swarm
from trimtab.scenarios.build import build


@click.command()
@SCENARIO
@LINK
@SET
@NAVIGATION
@LOCKSTEP
@SEED
@click.option("--duration", metavar="TIME", help="Duration of the flight after arming.  [default: the scenario's]")
@KEY
@UNSIGNED
@click.option(
    "--clock",
    type=click.Choice([STORED_CLOCK, COMPUTER_CLOCK, VEHICLE_CLOCK]),
    default=STORED_CLOCK,
    show_default=True,
    help="Clock for signatures: continue the stored clock, use this computer's clock, or follow the vehicle's clock.",
)
@click.option(
    "--accept",
    "accepts",
    multiple=True,
    metavar="PATH",
    help="Fly although this setting or group of settings differs between vehicle and scenario. May be repeated.",
)
@click.option("--take-over", is_flag=True, help="Take over the vehicle if another autopilot flies it.")
@click.option("--rearm", is_flag=True, help="Allow arming after a failsafe. The vehicle must be at rest.")
@click.option(
    "--overrun",
    type=click.Choice(OVERRUN_POLICIES),
    default=COUNT,
    show_default=True,
    help="Action when a control period overruns: count it and continue, or halt the flight.",
)
@REAL_TIME
@OUT("DIR", "Write the flight's log, flight.mcap, to this folder.")
@PARAMETERS
@LOG_LIMIT
@click.option(
    "--console", "with_console", is_flag=True, help="Serve a web page for the pilot, and print the page's address."
)
@PLACE
@JSON
def command(
    scenario: str,
    link: str,
    settings: dict[str, str],
    lockstep: bool,
    seed: int,
    duration: str | None,
    key: Path | None,
    unsigned: bool,
    clock: str,
    accepts: tuple[str, ...],
    take_over: bool,
    rearm: bool,
    overrun: str,
    real_time: bool,
    out: Path | None,
    parameters: Path | None,
    log_limit: int,
    with_console: bool,
    port: int,
    bind: str,
    certificate: Path | None,
    private_key: Path | None,
    opens: bool,
    as_json: bool,
) -> None:
    """Fly a vehicle over a real link with a scenario's autopilot.

    The compiled autopilot runs in real time.

    Waits for the vehicle, synchronises with its clock, arms it when the estimate is valid, flies for the scenario's
    duration and disarms. A supervisor monitors speeds, the link and the estimate's age; --set supervisor=none disables
    it. Exit code 0: the flight was completed; 1: never armed, aborted, halted by an overrun, taken over, in failsafe,
    link lost, or log rows lost; 2: invalid input, or no answer.

    \b
    trimtab fly hovercraft/forward --link udp://127.0.0.1:14550 --out here
    trimtab fly hovercraft/forward --link 'serial:///dev/ttyUSB1?baud=115200'
    trimtab fly hovercraft/pilot --link udp://127.0.0.1:14550 --console
    trimtab fly hovercraft/spin --link loopback://spin --lockstep
    """
    settings = read_parameters(parameters, scenario) | settings
    built = build(scenario, settings if lockstep else live_settings(scenario) | settings)
    refuse_swarm(built, "a link")
    signing_key = find_key(scenario, key, unsigned, link, create=False)
    if duration is not None:
        built = replace(built, duration=parse_time(duration))
    enable_cache()
    log = None if out is None else new_log(out, "flight.mcap")
    with open_line(link, listen=False) as line:
        endpoint = endpoint_factory(link, AUTOPILOT, signing_key, clock)
        if lockstep:
            result = _fly_lockstep(built, line, endpoint, seed, log, other=f"trimtab vehicle {quote(scenario)}")
            if not as_json:
                click.echo(f"flew {to_seconds(built.duration):g} s of {built.name} in lockstep")
                _print_verdict(result)
        else:
            typed = f"trimtab {shlex.join(current_machine().typed_words())}"
            with show_spinner(f"compiling {built.name}"):
                autopilot = LiveAutopilot(
                    built,
                    line,
                    endpoint,
                    seed=seed,
                    options=AutopilotOptions(typed, take_over, rearm, accepts, ParameterStore(parameters, scenario)),
                    machine=current_machine(),
                )
            follows = clock == VEHICLE_CLOCK
            address = ConsoleAddress(bind, port, certificate, private_key, opens) if with_console else None
            result, granted = _fly_real_time(autopilot, log, log_limit, real_time, overrun, as_json, follows, address)
            if not as_json:
                _print_flight(result, granted)
    if as_json:
        print_json(result)
    elif out is not None:
        print_log_size(result["log"])
        click.echo(f"wrote {out / 'flight.mcap'}")
    sys.exit(1 if result["problems"] else 0)


def _fly_lockstep(
    scenario: Scenario, line: Link, endpoint: Callable[[Dialect], Endpoint], seed: int, log: Path | None, *, other: str
) -> dict[str, Any]:
    with show_spinner(f"compiling {scenario.name}"):
        autopilot = LockstepAutopilot(scenario, endpoint, seed=seed)
    try:
        written = autopilot.run(line, log)
    except NoAnswerError as error:
        fix = f"start the other end again: {other} --lockstep --listen …, or, for firmware, make -C DIR run LOCKSTEP=1"
        raise InputError("--lockstep", str(error), fix=fix) from None
    is_whole = log is None or (written is not None and not written.dropped and not written.unwritten)
    problems = [] if is_whole else ["the log lacks rows"]
    log_facts = None if written is None else written._asdict()
    facts = {"scenario": scenario.name, "armed": True, "log": log_facts, "problems": problems}
    return facts | _assess(log, 0, scenario)


def _fly_real_time(
    autopilot: LiveAutopilot,
    log: Path | None,
    log_limit: int,
    real_time: bool,
    overrun: str,
    quiet: bool,
    follows_clock: bool,
    address: ConsoleAddress | None,
) -> tuple[dict[str, Any], str]:
    """Fly a vehicle in real time; return the result, and the scheduling that the operating system granted.

    address: address of the console's server; None: no console.
    """

    def echo(text: str) -> None:
        click.echo(show_controls(text, KEPT), err=quiet)

    machine = current_machine()
    lines, stamps = machine.write_lines(echo), machine.store_stamps_ahead(autopilot.endpoint)
    with lines as sink, machine.catch_interrupts() as stop, stamps:
        autopilot.connect(stop=stop, follows_clock=follows_clock, tell=sink.put)
        fly = partial(
            autopilot.fly,
            log=log,
            log_limit=log_limit,
            wanted_real_time=real_time,
            overrun=overrun,
            stop=stop,
            tell=sink.put,
            lost_lines=sink.settle,
        )
        if address is None:
            flight = fly()
        else:
            with open_console(address, lambda line: describe_flight(autopilot, line)) as console:
                sink.put(f"console: {console.url}\nfor observers: {console.observer}")
                sink.put("open one of these addresses in a browser; Ctrl-C ends the flight")
                if address.opens:
                    webbrowser.open(console.url)
                flight = fly(console=console.line)
    stored = autopilot.parameters.store()
    if stored:
        echo(stored)
    result = {
        "scenario": autopilot.scenario.name,
        "duration_s": to_seconds(flight.t),
        "cause": flight.cause,
        "problems": flight.problems,
        "checks": autopilot.preflight.describe_checks(),
        "armed": flight.arming_time is not None,
        "armed_s": None if flight.arming_time is None else to_seconds(flight.arming_time),
        **_assess(log, flight.arming_time, autopilot.scenario),
        "real_time": flight.grant._asdict(),
        "deadlines": flight.deadlines.summary() | {"skipped": flight.skipped},
        "samples": autopilot.autopilot_end.counts.received,
        "overflowed": autopilot.autopilot_end.counts.dropped,
        "backwards": autopilot.autopilot_end.counts.backward,
        "overtaken": autopilot.autopilot_end.counts.overtaken,
        "wire": dataclasses.asdict(autopilot.endpoint.counts),
        "line": autopilot.link.statistics._asdict(),
        "log": None if flight.log is None else flight.log._asdict(),
    }
    return result, str(flight.grant)


def _assess(log: Path | None, release: int | None, scenario: Scenario) -> dict[str, Any]:
    """Return the verdict on the targets by the autopilot's estimates, or else None and the reason."""
    found = assess_estimate(log, release, scenario.targets)
    return {"verdict": None, "no_verdict": found} if isinstance(found, str) else {"verdict": found, "no_verdict": None}


def _print_verdict(result: Mapping[str, Any]) -> None:
    if result["verdict"] is not None:
        click.echo(f"by the autopilot's estimate: {result['verdict']['says']}")
    elif result["armed"]:
        click.echo(f"no verdict on the targets: {result['no_verdict']}")


def _print_flight(result: Mapping[str, Any], granted: str) -> None:
    _print_verdict(result)
    _print_deadlines(result["deadlines"], granted)
    counts, log = result["wire"], result["log"]
    click.echo(f"frames: {counts['sent']} sent, {counts['accepted']} accepted, {counts['lost']} lost in transit")
    if counts["disordered"]:
        click.echo(f"{counts['disordered']} frames had sequence numbers out of order, so losses among them are unknown")
    for problem in result["problems"]:
        click.echo(show_controls(f"problem: {problem}", KEPT))
    if log is not None and (log["dropped"] or log["unwritten"]):
        click.echo(f"log: {log['dropped']} rows lost for lack of memory, {log['unwritten']} rows for lack of disk")


def _print_deadlines(deadlines: Mapping[str, Any], granted: str) -> None:
    """Print the timing of the control periods and the number of overruns."""
    n = deadlines["work"]["n"]
    title, first = f"{n} periods of {deadlines['period']}, {granted}", "time (us)"
    table = new_table(first, ">median", ">99 %", ">99.9 %", ">longest", title=title, unwrapped=(first,))
    names = {"late": "deadline to wake-up", "step": "compiled step", "work": "work of a period"}
    for key, name in names.items():
        cells = [f"{deadlines[key][q] * 1e6:.1f}" for q in ("p50", "p99", "p999", "longest")]
        table.add_row(name, *cells)
    print_table(table)
    over, skipped = deadlines["overruns"], deadlines["skipped"]
    click.echo(
        f"overruns: {over['own_work']} caused by trimtab, {over['scheduler']} caused by the operating system; "
        f"skipped periods: {skipped}"
    )
