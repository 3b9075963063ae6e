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
SEED = click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the random numbers.")
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
@LOCKSTEP
@SEED
@click.option("--duration", metavar="TIME", help="End this long after arming.  [default: until Ctrl-C]")
@KEY
@UNSIGNED
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
@click.option("--real-time/--no-real-time", default=True, show_default=True, help="Ask for real-time scheduling.")
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
