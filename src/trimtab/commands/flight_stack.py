"""`trimtab vehicle --ardupilot` and `--px4`: a scenario's vehicle as the simulator of another flight stack's SITL."""

import dataclasses
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import click
from click.core import ParameterSource

from trimtab.commands.flight_summary import print_truth, summarise_truth
from trimtab.commands.line import current_machine, is_local
from trimtab.commands.options import FiniteRange
from trimtab.commands.output import new_log, print_json, print_log_size
from trimtab.commands.progress import show_spinner
from trimtab.core.errors import InputError
from trimtab.core.time import to_seconds
from trimtab.flight.stacks.ardupilot import ArduPilotPhysics
from trimtab.flight.stacks.ardupilot_json import MOST_CHANNELS
from trimtab.flight.stacks.physics_log import PhysicsSummary
from trimtab.flight.stacks.pulsed_vehicle import PulsedVehicle
from trimtab.flight.stacks.px4 import Px4Simulator
from trimtab.flight.stacks.px4_simulator import CHANNELS as PX4_CHANNELS
from trimtab.flight.transports.open_link import parse_uri
from trimtab.flight.transports.tcp import open_tcp
from trimtab.flight.transports.udp import open_udp
from trimtab.loop.scenario import Scenario
from trimtab.run.command_pulses import describe_outputs


class FlightStack(NamedTuple):
    """Flight stack whose autopilot flies the simulated vehicle, e.g. ArduPilot.

    maker: name of the flight stack.  scheme, place: URI scheme and default address at which the flight stack expects
    the simulator.  begin: command that starts the autopilot.  channels: maximum number of output channels.
    open_line: function that opens the listening socket.  physics: class that simulates the vehicle for the autopilot.
    """

    maker: str
    scheme: str
    place: str
    begin: str
    channels: int
    open_line: Callable[..., Any]
    physics: Callable[..., Any]


STACKS: Mapping[str, FlightStack] = {
    "ardupilot": FlightStack(
        "ArduPilot",
        "udp",
        "127.0.0.1:9002",
        "sim_vehicle.py … --model JSON:127.0.0.1",
        MOST_CHANNELS,
        open_udp,
        ArduPilotPhysics,
    ),
    "px4": FlightStack("PX4", "tcp", "127.0.0.1:4560", "make px4_sitl none_iris", PX4_CHANNELS, open_tcp, Px4Simulator),
}
"""Name of an option of `trimtab vehicle`, without dashes -> flight stack."""
PLACE, PX4_PLACE = (stack.place for stack in STACKS.values())
SIGNED = (
    "listen",
    "lockstep",
    "key",
    "unsigned",
    "clock",
    "watchdog",
    "real_time",
    "origin",
    "parameters",
    "log_limit",
)
"""Options for signed MAVLink in real time, which do not apply to another flight stack."""


def _parse_channels(context: click.Context, option: click.Parameter, text: str | None) -> tuple[int, ...]:
    if text is None:
        return ()
    try:
        return tuple(int(word) for word in text.split(","))
    except ValueError:
        raise InputError("--channels", f"{text!r} is not a list of channels", fix="--channels 3,1,4,2") from None


ARDUPILOT = click.option(
    "--ardupilot",
    is_flag=False,
    flag_value=PLACE,
    metavar="[HOST:PORT]",
    help=f"Simulate the vehicle for ArduPilot's SITL (--model JSON), at this address or by default {PLACE}.",
)
CHANNELS = click.option(
    "--channels",
    metavar="N,N,…",
    callback=_parse_channels,
    help="ArduPilot channel or PX4 output for each element of the actuator command.  [default: 1,2,… in order]",
)
RELEASE = click.option(
    "--release",
    type=FiniteRange(),
    metavar="PULSE",
    help="Hold the vehicle until an output pulse reaches this width, in µs.  "
    "[default: until a pulse leaves its rest value]",
)


PX4 = click.option(
    "--px4",
    is_flag=False,
    flag_value=PX4_PLACE,
    metavar="[HOST:PORT]",
    help=f"Simulate the vehicle for PX4's SITL, at this address or by default {PX4_PLACE}.",
)


def choose_line(
    context: click.Context,
    listen: str | None,
    ardupilot: str | None,
    px4: str | None,
    channels: Sequence[int],
    release: float | None,
) -> str:
    """Return the URI to listen on; raise InputError for conflicting options or an address outside this machine."""
    if ardupilot is None and px4 is None:
        for option, value in (("--channels", channels), ("--release", release)):
            if value not in ((), None):
                raise InputError(option, "needs --ardupilot or --px4", fix="add --ardupilot or --px4, or leave it out")
        if listen is None:
            raise click.MissingParameter(ctx=context, param_hint="'--listen'", param_type="option")
        return listen
    if ardupilot is not None and px4 is not None:
        raise InputError("--px4", "cannot be combined with --ardupilot", fix="leave one of the two out")
    option, place = ("px4", px4) if ardupilot is None else ("ardupilot", ardupilot)
    stack, door = STACKS[option], f"--{option}"
    for name in SIGNED:
        if context.get_parameter_source(name) is ParameterSource.COMMANDLINE:
            refused = f"--{name.replace('_', '-')}"
            problem = f"does not apply to {stack.maker}, whose frames carry the time and are not signed"
            raise InputError(refused, problem, fix=f"leave it out, or leave {door} out")
    line = f"{stack.scheme}://{place}"
    if not is_local(line):
        problem = f"anyone who reaches {place} could fly the vehicle: {stack.maker}'s frames cannot be signed"
        raise InputError(door, problem, fix=f"{door} {stack.place}, and run {stack.maker} on this machine")
    return line


def serve_stack(
    option: str,
    scenario: Scenario,
    line: str,
    channels: Sequence[int],
    release: float | None,
    seed: int,
    duration: int | None,
    out: Path | None,
    tell: Callable[[str], None],
    as_json: bool,
) -> None:
    """Simulate the vehicle for a flight stack until the duration ends or Ctrl-C, print the result, and exit."""
    stack = STACKS[option]
    link = stack.open_line(parse_uri(line), listen=True)
    try:
        log = None if out is None else new_log(out, "vehicle.mcap")
        vehicle = _compile_vehicle(scenario, seed, channels, release, option, stack.channels, tell)
        physics = stack.physics(scenario, vehicle, link, seed=seed)
        tell(f"{scenario.name} waits on {line} for  {stack.begin}   Ctrl-C stops the simulation.")
        machine = current_machine()
        with machine.write_lines(tell) as lines, machine.catch_interrupts() as stop:
            summary = physics.serve(duration=duration, log=log, stop=stop, tell=lines.put, lost_lines=lines.settle)
    finally:
        link.close()
    _end(scenario, seed, summary, stack.maker, out, as_json)


def _compile_vehicle(
    scenario: Scenario,
    seed: int,
    channels: Sequence[int],
    release: float | None,
    door: str,
    most_channels: int,
    tell: Callable[[str], None],
) -> PulsedVehicle:
    """Compile the vehicle for a flight stack, and print the meaning of each channel."""
    width = None if release is None else release * 1e-6
    with show_spinner(f"compiling {scenario.name}"):
        vehicle = PulsedVehicle(
            scenario, seed=seed, channels=channels, release=width, door=door, most_channels=most_channels
        )
    for text in _describe_vehicle(vehicle):
        tell(text)
    return vehicle


def _end(scenario: Scenario, seed: int, summary: PhysicsSummary, maker: str, out: Path | None, as_json: bool) -> None:
    """Print the result of the flights, and exit."""
    result = _describe_result(scenario, seed, summary)
    result |= summarise_truth(summary.file, summary.release_time, scenario.targets)
    if as_json:
        print_json(result)
    else:
        _print_physics(result, maker, out)
    sys.exit(1 if summary.problems else 0)


def _describe_vehicle(vehicle: PulsedVehicle) -> list[str]:
    """Return one text for each channel, and one that names the source of the gyro and accelerometer data."""
    lines = [text.partition(": ")[2] for text in describe_outputs(vehicle.outputs)]
    told = [f"channel {c}: {text}" for c, text in zip(vehicle.channels, lines, strict=True)]
    return [*told, f"gyro and accelerometer: {f'sensor {vehicle.imu}' if vehicle.imu else 'true motion'}"]


def _describe_result(scenario: Scenario, seed: int, summary: PhysicsSummary) -> dict[str, Any]:
    release = summary.release_time
    return {
        "scenario": scenario.name,
        "seed": seed,
        "duration_s": to_seconds(summary.t - (release or 0)),
        "ideal": None,
        "released_s": None if release is None else to_seconds(release),
        "flights": summary.flights,
        "frames": dataclasses.asdict(summary.tally),
        "problems": summary.problems,
        "log": None if summary.log is None else summary.log._asdict(),
        "files": [] if summary.file is None else [str(summary.file)],
    }


def _print_physics(result: dict[str, Any], maker: str, out: Path | None) -> None:
    never = f"no frame received from {maker}" if not result["flights"] else "no pulse ever left its rest value"
    print_truth(result, out, never)
    for problem in result["problems"]:
        click.echo(f"problem: {problem}")
    frames = ", ".join(f"{name} {count}" for name, count in result["frames"].items())
    click.echo(f"flights: {result['flights']}; {frames}")
    print_log_size(result["log"])
    for file in result["files"]:
        click.echo(f"wrote {file}")
