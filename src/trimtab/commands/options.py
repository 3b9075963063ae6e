"""Options and arguments that several verbs take, and what turns their text into values."""

from collections.abc import Iterator
from pathlib import Path

import click

from trimtab.core.errors import InputError
from trimtab.logs.log_limit import DEFAULT_LIMIT, format_size, parse_size

FILE = click.Path(path_type=Path)


def parse_settings(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """path=value texts as a mapping."""
    fix = "--set world.vehicle.mass=3.2; trimtab list SCENARIO shows paths"
    return {path: value.strip() for path, value in _split_pairs("--set", "path=value", fix, values)}


def parse_spreads(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """path=distribution texts as a mapping."""
    fix = "--spread 'world.vehicle.mass=normal(100%, 5%)'; trimtab list SCENARIO shows every path"
    spread: dict[str, str] = {}
    for path, distribution in _split_pairs("--spread", "PATH=DISTRIBUTION", fix, values):
        if path in spread:
            raise InputError(f"--spread {path}", "is named twice", fix="keep one of them")
        spread[path] = distribution
    return spread


def _split_pairs(option: str, form: str, fix: str, values: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Path and text of each PATH=TEXT."""
    for text in values:
        path, equals, value = text.partition("=")
        if not equals or not path.strip():
            raise InputError(option, f"{text!r} is not {form}", fix=fix)
        yield path.strip(), value


SCENARIO = click.argument("scenario", metavar="SCENARIO")
JSON = click.option("--json", "as_json", is_flag=True, help="One JSON object on standard output.")
SEED = click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the random numbers.")

# what flies
SET = click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="PATH=VALUE",
    callback=parse_settings,
    help="Change a setting; repeatable.",
)
NAVIGATION = click.option(
    "--navigation",
    metavar="KIND",
    help="What it finds its way with: errors, ins, ins-magnetometer, ins-coupled, ins-feedforward, ins-direct, tight or"
    " particle; `trimtab list SCENARIO` says what each is.",
)
WITHOUT = click.option("--without", multiple=True, metavar="FAULT", help="Switch one imperfection off; repeatable.")
FAULT = click.option(
    "--fault", "faults", multiple=True, metavar="TEXT", help="E.g. 'sensor:imu off @ 3 s for 1 s'; repeatable."
)

# thousands of runs
SPREAD = click.option(
    "--spread",
    multiple=True,
    callback=parse_spreads,
    metavar="PATH=DISTRIBUTION",
    help="E.g. 'world.vehicle.mass=normal(100%, 5%)'; repeatable.",
)
SUCCESS = click.option(
    "--success", multiple=True, metavar="TEXT", help="E.g. 'settling:yaw_rate <= 10'; repeatable, all must hold."
)
THREADS = click.option("--threads", type=click.IntRange(1), metavar="N", help="[default: as many as cores]")

# lines
LINK = click.option("--link", required=True, metavar="URI", help="Line to the vehicle, e.g. udp://127.0.0.1:14550.")
KEY = click.option("--key", type=FILE, metavar="FILE", help="Key that signs the line.  [default: the vehicle's]")
UNSIGNED = click.option("--unsigned", is_flag=True, help="No signatures; for lines within this machine.")
REAL_TIME = click.option(
    "--real-time/--no-real-time", default=True, show_default=True, help="Ask for real-time scheduling."
)
PARAMETERS = click.option(
    "--parameters",
    type=FILE,
    metavar="FILE",
    help="Settings that a ground station has stored, read at the start; --set goes before.  [default: none are kept]",
)
LOG_LIMIT = click.option(
    "--log-limit",
    default=format_size(DEFAULT_LIMIT),
    show_default=True,
    metavar="SIZE",
    callback=lambda context, parameter, text: parse_size(text),
    help="Most that its log may take on the disk: a vehicle's goes on without its oldest part, an autopilot's ends.",
)
LOCKSTEP = click.option("--lockstep", is_flag=True, help="Virtual time: each end waits for the other.")
