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


def pairs(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
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
    "--set", "settings", multiple=True, metavar="PATH=VALUE", callback=pairs, help="Change a setting; repeatable."
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
    from trimtab.commands.vehicle import Request
    from trimtab.commands.vehicle import vehicle as carry_out

    carry_out(Request(**asked, as_json=as_json))


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
    disarms. Exit code 1 when it was never armed, or the log lost rows.

    \b
    trimtab fly hovercraft/forward --link udp://127.0.0.1:14550 --out here
    trimtab fly hovercraft/forward --link serial:///dev/ttyUSB1?baud=115200
    trimtab fly hovercraft/spin --link loopback://spin --lockstep
    """
    from trimtab.commands.fly import Request
    from trimtab.commands.fly import fly as carry_out

    if not carry_out(Request(**asked, as_json=as_json)):
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
    from trimtab.commands.inject import Request
    from trimtab.commands.inject import inject as carry_out

    carry_out(Request(**asked, as_json=as_json))


@click.command(name="live-faults")
@click.option("--only", multiple=True, metavar="CASE", help="Only this case; repeatable.  [default: all]")
@click.option("--jobs", type=click.IntRange(1, 16), default=2, show_default=True, help="How many at a time.")
@click.option("--out", type=FILE, metavar="DIR", help="Keep logs, and all that was said, in a folder a case.")
@click.option("--page", type=FILE, metavar="FILE", help="Write the docs page with the table.")
@JSON
def live_faults(as_json: bool, **asked: Any) -> None:
    """Spoil the line, the processes and the machine of a vehicle and an autopilot that fly, in over sixty ways.

    Each case is a short flight of two processes. Exit code 1 where a vehicle was not safe, a process crashed, or a log
    doesn't say what happened. All of it takes some ten minutes; disks and clocks are spoilt for the processes alone.

    \b
    trimtab live-faults --only cut-1 --only autopilot-killed
    trimtab live-faults --jobs 3 --out campaign --json
    """
    from trimtab.commands.live_faults import Request
    from trimtab.commands.live_faults import live_faults as carry_out

    if not carry_out(Request(**asked, as_json=as_json)):
        sys.exit(1)
