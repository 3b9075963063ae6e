"""Options and arguments that several verbs take, and what turns their text into values."""

from pathlib import Path

import click

from trimtab.core.errors import InputError

FILE = click.Path(path_type=Path)


def parse_settings(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """path=value texts as a mapping."""
    settings = {}
    for text in values:
        path, equals, value = text.partition("=")
        if not equals or not path:
            problem = f"{text!r} is not path=value"
            raise InputError("--set", problem, fix="--set world.vehicle.mass=3.2; trimtab list SCENARIO shows paths")
        settings[path.strip()] = value.strip()
    return settings


def parse_spreads(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """path=distribution texts as a mapping."""
    spread: dict[str, str] = {}
    for text in values:
        path, equals, distribution = text.partition("=")
        if not equals or not path.strip():
            fix = "--spread 'world.vehicle.mass=normal(100%, 5%)'; trimtab list SCENARIO shows every path"
            raise InputError("--spread", f"{text!r} is not PATH=DISTRIBUTION", fix=fix)
        if path.strip() in spread:
            raise InputError(f"--spread {path.strip()}", "is named twice", fix="keep one of them")
        spread[path.strip()] = distribution
    return spread


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
    help="What it finds its way with, e.g. ins; `trimtab list SCENARIO` has the choices.",
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
KEY = click.option("--key", type=FILE, metavar="FILE", help="Key that signs the line.  [default: the vehicle's]")
UNSIGNED = click.option("--unsigned", is_flag=True, help="No signatures; for lines within this machine.")
REAL_TIME = click.option(
    "--real-time/--no-real-time", default=True, show_default=True, help="Ask for real-time scheduling."
)
LOCKSTEP = click.option("--lockstep", is_flag=True, help="Virtual time: each end waits for the other.")
