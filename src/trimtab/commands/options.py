"""Options and arguments shared by several subcommands, with the functions that parse them."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from trimtab.commands.typed_names import keep_paths, read_paths
from trimtab.commands.written_files import PICTURES, with_overwrite
from trimtab.core.errors import InputError
from trimtab.logs.log_limit import DEFAULT_LIMIT, format_size, parse_size
from trimtab.scenarios import catalogue

FILE = click.Path(path_type=Path)
CALIBRATION = "trimtab.calibration"
"""Key under which the click context stores the file of ``--calibration``."""
REFERENCE = "trimtab.reference"
"""Key under which the click context stores the settings of ``--reference``."""
CHOICES = "trimtab.choices"
"""Key under which the click context stores options that change one setting, e.g. ``--duration``."""


class FiniteRange(click.FloatRange):
    """Type of an option for a finite number in a range. click's own type accepts nan."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number. Report an error of the command line if the number is nan or infinite."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        return number


def parse_settings(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """Parse the texts PATH=VALUE of ``--set`` into a mapping from path to value. Add the file of ``--calibration``."""
    fix = "--set world.vehicle.mass=3.2; trimtab list SCENARIO shows paths"
    settings: dict[str, str] = {}
    for path, value in _split_pairs("--set", "path=value", fix, values):
        if path in settings:
            problem = f"set twice: to {settings[path]} and to {value.strip()}"
            raise InputError(f"--set {path}", problem, fix=f"keep one of the two, e.g. --set {path}={value.strip()}")
        settings[path] = value.strip()
    file = context.meta.get(CALIBRATION)
    settings = {**context.meta.get(REFERENCE, {}), **settings, **context.meta.get(CHOICES, {})}
    return settings if file is None else {"calibration": str(file), **settings}


def parse_parts(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """Parse the texts PART=CHOICE of ``--with`` into a mapping."""
    pairs = _split_pairs("--with", "PART=CHOICE", "--with estimator=ins-coupled", values)
    return {part: choice.strip() for part, choice in pairs}


def keep_references(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> None:
    """Store the texts of ``--reference``: a path as the setting "reference", a gain's schedule as the gain's value."""
    references: dict[str, str] = {}
    for text in values:
        path, equals, schedule = (word.strip() for word in text.partition("="))
        own = path if equals and "(" not in path else "reference"
        if own in references:
            raise InputError("--reference", f"{own} is given twice", fix=f"keep only one --reference for {own}")
        references[own] = schedule if own == path else text.strip()
    context.meta[REFERENCE] = references


def parse_spreads(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """Parse the texts PATH=DISTRIBUTION of ``--spread`` into a mapping; a calibration file maps to an empty text."""
    fix = "--spread 'world.vehicle.mass=normal(100%, 5%)'; trimtab list SCENARIO shows every path"
    spread: dict[str, str] = {text: "" for text in values if is_calibration(text)}
    paths = tuple(text for text in values if not is_calibration(text))
    for path, distribution in _split_pairs("--spread", "PATH=DISTRIBUTION", fix, paths):
        if path in spread:
            raise InputError(f"--spread {path}", "is named twice", fix="keep only one distribution for each path")
        spread[path] = distribution
    return spread


def is_calibration(text: str) -> bool:
    """Return True if a value of ``--spread`` is a calibration file, from whose uncertainties the runs are drawn."""
    return text.endswith(".toml") and "=" not in text


def _split_pairs(option: str, form: str, fix: str, values: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Split each value PATH=TEXT of an option, and yield path and text."""
    for text in values:
        path, equals, value = text.partition("=")
        if not equals or not path.strip():
            raise InputError(option, f"{text!r} is not of the form {form}", fix=fix)
        yield path.strip(), value


def complete_scenarios(context: click.Context, parameter: click.Parameter, start: str) -> list[CompletionItem]:
    """Return shell completions: scenarios of the catalogue, or files if no scenario matches."""
    names = [name for name in catalogue.scenario_files() if name.startswith(start)]
    return [CompletionItem(name) for name in names] or [CompletionItem(start, type="file")]


def complete_settings(context: click.Context, parameter: click.Parameter, start: str) -> list[CompletionItem]:
    """Return shell completions: paths of settings. The first call takes as long as `trimtab list SCENARIO`."""
    typed = (str(context.params.get("scenario")), *context.args)
    scenario = next((word for word in typed if word in catalogue.scenario_files()), None)
    if scenario is None:
        return []
    paths = read_paths(scenario)
    if not paths:
        from trimtab.loop.settings import setting_paths

        paths = setting_paths(catalogue.load_scenario(scenario)[0])
        keep_paths(scenario, paths)
    return [CompletionItem(f"{path}=") for path in paths if path.startswith(start)]


VEHICLE = click.argument("vehicle", metavar="VEHICLE")
AT = click.option(
    "--at",
    "at",
    multiple=True,
    metavar="NAME=VALUE",
    help="Condition on a state, input, output or rate, e.g. speed='150 m/s', throttle=free, throttle=0..1,"
    ' "yaw\'=0.1", "height\'=any". May be repeated.',
)
SCENARIO = click.argument("scenario", metavar="SCENARIO", shell_complete=complete_scenarios)
MAP = click.option(
    "--map",
    "mapping",
    type=FILE,
    metavar="MAP.toml",
    help="Mapping of another system's log: TOML file that names the column of each signal.",
)
JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON object to standard output.")


def OUT(metavar: str, help: str, required: bool = False, name: str = "out") -> Callable[..., Any]:
    """Return a decorator that adds ``--out``, the file or folder that the subcommand writes, and ``--overwrite``."""

    def add_options(function: Callable[..., Any]) -> Callable[..., Any]:
        check = _refuse_picture if metavar == "DIR" else None
        written = click.option("--out", name, type=FILE, metavar=metavar, required=required, help=help, callback=check)
        return written(with_overwrite(function))

    return add_options


def _refuse_picture(context: click.Context, parameter: click.Parameter, folder: Path | None) -> Path | None:
    """Return the folder of ``--out``. Raise InputError if the name is that of a picture."""
    if folder is not None and folder.suffix.lower() in PICTURES:
        raise InputError("--out", f"must name a folder, got {str(folder)!r}", fix=f"--out {folder.with_suffix('')}")
    return folder


def PLOT(help: str, name: str = "plot") -> Callable[..., Any]:
    """Return a decorator that adds ``--plot``, the picture that the subcommand writes, and ``--overwrite``."""

    def add_options(function: Callable[..., Any]) -> Callable[..., Any]:
        return click.option("--plot", name, type=FILE, metavar="FILE", help=help)(with_overwrite(function))

    return add_options


ANIMATE = click.option("--animate", type=FILE, metavar="FILE", help="Draw an animation of the run to this file (.gif).")
SEED = click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the random numbers.")
MOST_RUNS = 10_000_000
"""Maximum number of runs of a search or a campaign, so that the results fit in memory."""


class Count(click.IntRange):
    """Option type for a whole number of runs. The number may be written as 1e4 for 10000."""

    def __init__(self, least: int, most: int) -> None:
        super().__init__(least, most)
        self.least, self.most = least, most

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Return the number of runs. Raise InputError if the number is not whole or out of range."""
        try:
            number = float(value)
        except ValueError:
            number = float("nan")
        if number.is_integer() and self.least <= number <= self.most:
            return int(number)
        option = param.opts[0] if param is not None else "value"
        limits = f"must be a whole number from {self.least} to {self.most}"
        raise InputError(option, f"{limits}, got {value}", fix=f"{option} {max(self.least, 1000)}")


def RUNS(default: int, help: str, least: int = 1) -> Callable[..., Any]:
    """Return a decorator that adds ``--runs``, the number of runs."""
    return click.option("--runs", type=Count(least, MOST_RUNS), default=default, show_default=True, help=help)


# options that change the simulated loop and its settings


def SET(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--set``, ``--calibration`` and ``--reference``. The argument `settings` gets the values of all three."""
    calibration = click.option(
        "--calibration",
        type=FILE,
        metavar="FILE",
        is_eager=True,  # before --set, whose callback reads it
        expose_value=False,
        callback=lambda context, parameter, file: context.meta.update({CALIBRATION: file}),
        help="File of trimtab calibrate. Its values are used in the simulated world and in the autopilot's model.",
    )
    reference = click.option(
        "--reference",
        multiple=True,
        metavar="TEXT",
        is_eager=True,
        expose_value=False,
        callback=keep_references,
        help="Reference to follow, e.g. 'circle(radius=1.5, period=20 s)', 'waypoints(0 0, 3 0, 3 3; speed=0.4)',"
        " path.csv, or 'autopilot.law.k1=steps(0 s: 1, 5 s: 2)'. May be repeated.",
    )
    change = click.option(
        "--set",
        "settings",
        multiple=True,
        metavar="PATH=VALUE",
        callback=parse_settings,
        shell_complete=complete_settings,
        help="Change a setting of the scenario. May be repeated.",
    )
    return change(reference(calibration(function)))


def keep_choice(context: click.Context, parameter: click.Parameter, value: str | None) -> None:
    """Store the value of an option that changes the setting of the same name."""
    if value is not None:
        context.meta.setdefault(CHOICES, {})[str(parameter.name)] = value


NAVIGATION = click.option(
    "--navigation",
    metavar="KIND",
    is_eager=True,  # before --set, whose callback reads it
    expose_value=False,
    callback=keep_choice,
    help="Navigation system: errors, ins, ins-magnetometer, ins-coupled, ins-feedforward, ins-direct, tight or"
    " particle. `trimtab list SCENARIO` describes each.",
)
DURATION = click.option(
    "--duration",
    metavar="TIME",
    is_eager=True,
    expose_value=False,
    callback=keep_choice,
    help="Duration of the flight, e.g. 20, '20 s', '500 ms'.  [default: the scenario's]",
)


def FLIGHT(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a flight in virtual time: ``SET``, ``--navigation``, ``--duration`` and ``--fault``."""
    return SET(NAVIGATION(DURATION(FAULT(function))))


WITHOUT = click.option(
    "--without",
    multiple=True,
    metavar="IMPERFECTION",
    help="Switch one imperfection off. `trimtab list SCENARIO` names the imperfections. May be repeated.",
)
FAULT = click.option(
    "--fault",
    "faults",
    multiple=True,
    metavar="TEXT",
    help="Fault to inject, e.g. 'sensor:imu off @ 3 s for 1 s'. May be repeated.",
)

# options for many runs
SPREAD = click.option(
    "--spread",
    multiple=True,
    callback=parse_spreads,
    metavar="PATH=DISTRIBUTION",
    help="Distribution of a setting, e.g. 'world.vehicle.mass=normal(100%, 5%)', or for `campaign` a calibration file."
    " May be repeated.",
)
FAULT_RANGE = click.option(
    "--fault-range",
    "fault_ranges",
    multiple=True,
    metavar="TEXT",
    help="Fault whose times or sizes vary within ranges, e.g. 'downlink off @ 2..10 s for 0.1..2 s'. May be repeated.",
)
VARY = click.option(
    "--vary",
    multiple=True,
    metavar="TEXT",
    help="Piecewise constant input to vary, e.g. 'stick.turn=pieces(5, -1:1)'. May be repeated.",
)
SUCCESS = click.option(
    "--success",
    multiple=True,
    metavar="TEXT",
    help="Condition for success, e.g. 'settling:yaw_rate <= 10'. May be repeated; all conditions must hold.",
)
THREADS = click.option(
    "--threads", type=click.IntRange(1), metavar="N", help="Number of threads.  [default: number of cores]"
)
BACKEND = click.option(
    "--backend",
    type=click.Choice(("auto", "c", "jax")),
    default="auto",
    show_default=True,
    help="Simulation backend: c (compiled), or jax (slower).",
)

STORE = click.option(
    "--store",
    type=FILE,
    metavar="DIR",
    help="Store the runs in this folder. The same command, started again, flies only the missing runs.",
)

# options for links
LINK = click.option("--link", required=True, metavar="URI", help="Link to the vehicle, e.g. udp://127.0.0.1:14550.")
KEY = click.option("--key", type=FILE, metavar="FILE", help="Signing key of the link.  [default: key of the vehicle]")
UNSIGNED = click.option(
    "--unsigned", is_flag=True, help="Disable signatures. Allowed only on links within this computer."
)
REAL_TIME = click.option(
    "--real-time/--no-real-time",
    default=True,
    show_default=True,
    help="Ask the operating system for real-time scheduling.",
)
PARAMETERS = click.option(
    "--parameters",
    type=FILE,
    metavar="FILE",
    help="File with settings stored by a ground station, read at the start. --set takes precedence.  [default: none]",
)
LOG_LIMIT = click.option(
    "--log-limit",
    default=format_size(DEFAULT_LIMIT),
    show_default=True,
    metavar="SIZE",
    callback=lambda context, parameter, text: parse_size(text),
    help="Maximum size of the log. At this size, `vehicle` deletes the oldest part, and `fly` stops logging.",
)


def PLACE(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a console: ``--port``, ``--bind``, ``--certificate``, ``--private-key`` and ``--open``."""
    options = [
        click.option(
            "--port", type=click.IntRange(0, 65535), default=0, help="Port of the console.  [default: a free port]"
        ),
        click.option(
            "--bind",
            default="127.0.0.1",
            show_default=True,
            help="Address at which the console is served. Addresses beyond this computer need TLS.",
        ),
        click.option("--certificate", type=FILE, metavar="FILE", help="TLS certificate of the console."),
        click.option("--private-key", type=FILE, metavar="FILE", help="Private key of the console's TLS certificate."),
        click.option("--open", "opens", is_flag=True, help="Open the console in a browser on this computer."),
    ]
    for option in reversed(options):
        function = option(function)
    return function


LOCKSTEP = click.option(
    "--lockstep", is_flag=True, help="Run in virtual time. Each end of the link waits for the other end."
)
