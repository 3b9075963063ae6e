"""The verbs that fly: a vehicle, an autopilot, and the line between them."""

import sys
from pathlib import Path
from typing import Any

import click

from trimtab.core.errors import InputError

SCENARIO = click.argument("scenario", metavar="SCENARIO")
JSON = click.option("--json", "as_json", is_flag=True, help="One JSON object on standard output.")
FILE = click.Path(path_type=Path)
KEY = click.option("--key", type=FILE, metavar="FILE", help="Key that signs the line.  [default: the vehicle's]")
UNSIGNED = click.option("--unsigned", is_flag=True, help="No signatures; for lines within this machine.")
REAL_TIME = click.option(
    "--real-time/--no-real-time", default=True, show_default=True, help="Ask for real-time scheduling."
)
SEED = click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the random numbers.")
FAULT = click.option(
    "--fault", "faults", multiple=True, metavar="TEXT", help="E.g. 'sensor:imu off @ 3 s for 1 s'; repeatable."
)
LOCKSTEP = click.option("--lockstep", is_flag=True, help="Virtual time: each end waits for the other.")


def parse_pairs(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """path=value texts as a mapping."""
    settings = {}
    for text in values:
        path, equals, value = text.partition("=")
        if not equals or not path:
            problem = f"{text!r} is not path=value"
            raise InputError("--set", problem, fix="--set world.vehicle.mass=3.2; trimtab list SCENARIO shows paths")
        settings[path.strip()] = value.strip()
    return settings


SET = click.option(
    "--set", "settings", multiple=True, metavar="PATH=VALUE", callback=parse_pairs, help="Change a setting; repeatable."
)


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
def vehicle(as_json: bool, **asked: Any) -> None:
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
    from trimtab.commands.vehicle import VehicleRequest
    from trimtab.commands.vehicle import vehicle as carry_out

    carry_out(VehicleRequest(**asked, as_json=as_json))


@click.command()
@SCENARIO
@click.option("--link", required=True, metavar="URI", help="Line to the vehicle, e.g. udp://127.0.0.1:14550.")
@SET
@LOCKSTEP
@SEED
@click.option("--duration", metavar="TIME", help="End this long after arming.  [default: the scenario's]")
@KEY
@UNSIGNED
@REAL_TIME
@click.option("--out", type=FILE, metavar="DIR", help="Folder for the flight's log, flight.mcap.")
@JSON
def fly(as_json: bool, **asked: Any) -> None:
    """Fly a vehicle over a real line with a scenario's autopilot, compiled, at its control period.

    Waits for the vehicle, finds its clock, arms it as soon as there is an estimate, flies the scenario's duration and
    disarms. A supervisor watches speeds, the line and the estimate's age; --set supervisor=none does without. Exit code
    1 when it was never armed, or the log lost rows.

    \b
    trimtab fly hovercraft/forward --link udp://127.0.0.1:14550 --out here
    trimtab fly hovercraft/forward --link serial:///dev/ttyUSB1?baud=115200
    trimtab fly hovercraft/spin --link loopback://spin --lockstep
    """
    from trimtab.commands.fly import FlyRequest
    from trimtab.commands.fly import fly as carry_out

    if not carry_out(FlyRequest(**asked, as_json=as_json)):
        sys.exit(1)


@click.command()
@SCENARIO
@click.argument("fault", metavar="FAULT")
@click.option("--link", required=True, metavar="URI", help="Line to the vehicle, e.g. udp://127.0.0.1:14550.")
@SET
@KEY
@UNSIGNED
@JSON
def inject(as_json: bool, **asked: Any) -> None:
    """Put a fault into a virtual vehicle while it flies.

    FAULT is where, what, and how: WHERE WORD [by NUMBER] [@ TIME] [for TIME]; @ counts from now. The words: off, stuck,
    garbage, wrong, slow, delayed, intermittent; where: sensor:NAME, downlink, uplink, actuators.

    \b
    trimtab inject hovercraft/forward 'sensor:navigation off for 1 s' --link udp://127.0.0.1:14550
    trimtab inject hovercraft/forward 'actuators wrong by -2 @ 1 s for 500 ms' --link udp://127.0.0.1:14550
    """
    from trimtab.commands.inject import InjectRequest
    from trimtab.commands.inject import inject as carry_out

    carry_out(InjectRequest(**asked, as_json=as_json))


@click.command(name="link-test")
@click.argument("uri", metavar="URI")
@click.option("--echo", is_flag=True, help="Be the other end, until Ctrl-C.")
@click.option("--load", "loads", multiple=True, metavar="UP/DOWN", help="Load in kb/s; repeatable.")
@click.option("--requests", type=int, default=300, show_default=True, help="For each load.")
@click.option("--rate", type=float, default=10.0, show_default=True, help="Requests per second.")
@SEED
@click.option("--plot", type=FILE, metavar="FILE", help="Picture of the histograms.")
@click.option("--out", type=FILE, metavar="DIR", help="Folder for table, picture, recordings and settings.")
@JSON
def link_test(as_json: bool, **asked: Any) -> None:
    """Measure a line's one-way delays, up and down, under load.

    One end echoes, the other measures: a table, histograms, recordings that `run` repeats, and a model of the line to
    type after `trimtab run`. On one machine both have one clock; else the split of the round trip is estimated.

    \b
    trimtab link-test serial:///dev/ttyUSB0?baud=115200 --echo          on one end
    trimtab link-test serial:///dev/ttyUSB1?baud=115200 --out radio     on the other
    trimtab link-test udp://127.0.0.1:14555 --load 2.9/22.0 --plot delays.png
    """
    from trimtab.commands.link_test import LinkTestRequest
    from trimtab.commands.link_test import link_test as carry_out

    if not carry_out(LinkTestRequest(**asked, as_json=as_json)):
        sys.exit(1)


@click.command()
@click.argument("file", type=FILE)
@click.option("--scenario", metavar="SCENARIO", help="Your own, where the log's is not in the catalogue.")
@click.option(
    "--with",
    "instead",
    multiple=True,
    metavar="PART=CHOICE",
    callback=parse_pairs,
    help="Another estimator or law.",
)
@click.option("--backend", type=click.Choice(("auto", "c", "jax")), default="auto", show_default=True)
@click.option("--plot", type=FILE, metavar="FILE", help="Picture: recorded and replayed.")
@JSON
def replay(as_json: bool, **asked: Any) -> None:
    """Give a recorded flight's frames to its autopilot once more; the same must come out, to the bit.

    Exit code 1 with the first difference where it does not. --with flies the frames with another part instead, and
    says how far each was from the truth, where the log has it.

    \b
    trimtab run hovercraft/forward --navigation ins --out forward
    trimtab replay forward/run.mcap
    trimtab replay forward/run.mcap --with estimator=ins-coupled --plot both.png
    """
    from trimtab.commands.replay import ReplayRequest
    from trimtab.commands.replay import replay as carry_out

    carry_out(ReplayRequest(**asked, as_json=as_json))


@click.command()
@SCENARIO
@click.option("--out", type=FILE, metavar="DIR", required=True, help="Folder for the C.")
@click.option("--board", default="cortex-m7", show_default=True, help="What it is built for.")
@click.option("--emulate", type=click.IntRange(1, 65535), metavar="PORT", help="Build it and run it emulated.")
@SET
@SEED
@KEY
@JSON
def firmware(as_json: bool, **asked: Any) -> None:
    """Write a scenario's vehicle as firmware for a microcontroller: world, failsafe, wire, in C.

    On the emulated board the exported world takes the place of the hardware; the rest is what a craft would run.

    \b
    trimtab firmware hovercraft/forward --out board --emulate 5760
    trimtab fly hovercraft/forward --link tcp://127.0.0.1:5760
    """
    from trimtab.commands.firmware import FirmwareRequest
    from trimtab.commands.firmware import firmware as carry_out

    if not carry_out(FirmwareRequest(**asked, as_json=as_json)):
        sys.exit(1)


@click.command(name="live-faults")
@click.option("--only", multiple=True, metavar="CASE", help="Only this case; repeatable.  [default: all]")
@click.option("--jobs", type=click.IntRange(1, 16), default=2, show_default=True, help="How many at a time.")
@click.option("--out", type=FILE, metavar="DIR", help="Keep logs, and all that was said, in a folder a case.")
@click.option("--page", type=FILE, metavar="FILE", help="Write the docs page with the table; with --only, into it.")
@JSON
def live_faults(as_json: bool, **asked: Any) -> None:
    """Spoil the line, the processes and the machine of a vehicle and an autopilot that fly, in over sixty ways.

    Each case is a short flight of two processes. Exit code 1 where a vehicle was not safe, a process crashed, or a log
    doesn't say what happened. All of it takes some ten minutes; disks and clocks are spoilt for the processes alone.

    \b
    trimtab live-faults --only cut-1 --only autopilot-killed
    trimtab live-faults --jobs 3 --out campaign --json
    """
    from trimtab.commands.live_faults import LiveFaultsRequest
    from trimtab.commands.live_faults import live_faults as carry_out

    if not carry_out(LiveFaultsRequest(**asked, as_json=as_json)):
        sys.exit(1)
