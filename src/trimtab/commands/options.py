"""Options and arguments that several verbs take, and what turns their text into values."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from trimtab.commands.typed_names import keep_paths, read_paths
from trimtab.commands.written_files import with_overwrite
from trimtab.core.errors import InputError
from trimtab.logs.log_limit import DEFAULT_LIMIT, format_size, parse_size
from trimtab.scenarios import catalogue

FILE = click.Path(path_type=Path)
CALIBRATION = "trimtab.calibration"
"""Where a context keeps the file of ``--calibration``."""
REFERENCE = "trimtab.reference"
"""And the settings of ``--reference``."""
CHOICES = "trimtab.choices"
"""And those of options that are a setting each, by its name: ``--navigation``, ``--duration``."""


def parse_settings(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """path=value texts as a mapping, with the calibration of ``--calibration`` among them."""
    fix = "--set world.vehicle.mass=3.2; trimtab list SCENARIO shows paths"
    settings: dict[str, str] = {}
    for path, value in _split_pairs("--set", "path=value", fix, values):
        if path in settings:
            problem = f"is set twice, to {settings[path]} and to {value.strip()}"
            raise InputError(f"--set {path}", problem, fix=f"keep one of them, e.g. --set {path}={value.strip()}")
        settings[path] = value.strip()
    file = context.meta.get(CALIBRATION)
    settings = {**context.meta.get(REFERENCE, {}), **settings, **context.meta.get(CHOICES, {})}
    return settings if file is None else {"calibration": str(file), **settings}


def parse_parts(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """part=choice texts as a mapping."""
    pairs = _split_pairs("--with", "PART=CHOICE", "--with estimator=ins-coupled", values)
    return {part: choice.strip() for part, choice in pairs}


def keep_references(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> None:
    """Settings of ``--reference``: of a path "reference", of a law's number its own."""
    references: dict[str, str] = {}
    for text in values:
        path, equals, schedule = (word.strip() for word in text.partition("="))
        own = path if equals and "(" not in path else "reference"
        if own in references:
            raise InputError("--reference", f"there are two of {own}", fix="keep one of them")
        references[own] = schedule if own == path else text.strip()
    context.meta[REFERENCE] = references


def parse_spreads(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """path=distribution texts as a mapping; of a calibration file its name, with nothing."""
    fix = "--spread 'world.vehicle.mass=normal(100%, 5%)'; trimtab list SCENARIO shows every path"
    spread: dict[str, str] = {text: "" for text in values if is_calibration(text)}
    paths = tuple(text for text in values if not is_calibration(text))
    for path, distribution in _split_pairs("--spread", "PATH=DISTRIBUTION", fix, paths):
        if path in spread:
            raise InputError(f"--spread {path}", "is named twice", fix="keep one of them")
        spread[path] = distribution
    return spread


def is_calibration(text: str) -> bool:
    """Whether a spread is a calibration file, whose own errors are drawn."""
    return text.endswith(".toml") and "=" not in text


def _split_pairs(option: str, form: str, fix: str, values: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Path and text of each PATH=TEXT."""
    for text in values:
        path, equals, value = text.partition("=")
        if not equals or not path.strip():
            raise InputError(option, f"{text!r} is not {form}", fix=fix)
        yield path.strip(), value


def complete_scenarios(context: click.Context, parameter: click.Parameter, start: str) -> list[CompletionItem]:
    """Scenarios of the catalogue for a shell; without one, files."""
    names = [name for name in catalogue.scenario_files() if name.startswith(start)]
    return [CompletionItem(name) for name in names] or [CompletionItem(start, type="file")]


def complete_settings(context: click.Context, parameter: click.Parameter, start: str) -> list[CompletionItem]:
    """Paths of the scenario's settings for a shell; the first time that takes as long as a list of them."""
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
    help="Of a state, an input, an output or a rate, e.g. speed='150 m/s', throttle=free, throttle=0..1, \"yaw'=0.1\","
    ' "height\'=any"; repeatable.',
)
SCENARIO = click.argument("scenario", metavar="SCENARIO", shell_complete=complete_scenarios)
JSON = click.option("--json", "as_json", is_flag=True, help="One JSON object on standard output.")


def OUT(metavar: str, help: str, required: bool = False, name: str = "out") -> Callable[..., Any]:
    """``--out``: what the verb writes, a file or a folder, and with it ``--overwrite``."""

    def add_options(function: Callable[..., Any]) -> Callable[..., Any]:
        written = click.option("--out", name, type=FILE, metavar=metavar, required=required, help=help)
        return written(with_overwrite(function))

    return add_options


def PLOT(help: str, name: str = "plot") -> Callable[..., Any]:
    """``--plot``: a picture, and with it ``--overwrite``."""

    def add_options(function: Callable[..., Any]) -> Callable[..., Any]:
        return click.option("--plot", name, type=FILE, metavar="FILE", help=help)(with_overwrite(function))

    return add_options


SEED = click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the random numbers.")
MOST_RUNS = 10_000_000
"""Of one search or campaign: their numbers fit in memory."""


def RUNS(default: int, help: str, least: int = 1) -> Callable[..., Any]:
    """``--runs``: how many fly."""
    return click.option("--runs", type=click.IntRange(least, MOST_RUNS), default=default, show_default=True, help=help)


# what flies


def SET(function: Callable[..., Any]) -> Callable[..., Any]:
    """``--set``, and ``--calibration`` and ``--reference``, which are settings, too: all arrive as `settings`."""
    calibration = click.option(
        "--calibration",
        type=FILE,
        metavar="FILE",
        is_eager=True,  # before --set, whose callback takes it up
        expose_value=False,
        callback=lambda context, parameter, file: context.meta.update({CALIBRATION: file}),
        help="Numbers that trimtab calibrate found, for the world and for what the autopilot believes.",
    )
    reference = click.option(
        "--reference",
        multiple=True,
        metavar="TEXT",
        is_eager=True,
        expose_value=False,
        callback=keep_references,
        help="What to follow, e.g. 'circle(radius=1.5, period=20 s)', 'waypoints(0 0, 3 0, 3 3; speed=0.4)', path.csv,"
        " or 'autopilot.law.k1=steps(0 s: 1, 5 s: 2)'.",
    )
    change = click.option(
        "--set",
        "settings",
        multiple=True,
        metavar="PATH=VALUE",
        callback=parse_settings,
        shell_complete=complete_settings,
        help="Change a setting; repeatable.",
    )
    return change(reference(calibration(function)))


def keep_choice(context: click.Context, parameter: click.Parameter, value: str | None) -> None:
    """An option that is a setting of its own name."""
    if value is not None:
        context.meta.setdefault(CHOICES, {})[str(parameter.name)] = value


NAVIGATION = click.option(
    "--navigation",
    metavar="KIND",
    is_eager=True,  # before --set, whose callback takes it up
    expose_value=False,
    callback=keep_choice,
    help="What it finds its way with: errors, ins, ins-magnetometer, ins-coupled, ins-feedforward, ins-direct, tight or"
    " particle; `trimtab list SCENARIO` says what each is.",
)
DURATION = click.option(
    "--duration",
    metavar="TIME",
    is_eager=True,
    expose_value=False,
    callback=keep_choice,
    help="How long it flies, e.g. 20, '20 s', '500 ms'.  [default: the scenario's]",
)


def FLIGHT(function: Callable[..., Any]) -> Callable[..., Any]:
    """What flies in virtual time, and how: ``--set`` with its kin, ``--navigation``, ``--duration``, ``--fault``."""
    return SET(NAVIGATION(DURATION(FAULT(function))))


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
    help="E.g. 'world.vehicle.mass=normal(100%, 5%)', or of a campaign a calibration file; repeatable.",
)
FAULT_RANGE = click.option(
    "--fault-range",
    "fault_ranges",
    multiple=True,
    metavar="TEXT",
    help="E.g. 'downlink off @ 2..10 s for 0.1..2 s': a fault whose numbers differ; repeatable.",
)
VARY = click.option(
    "--vary", multiple=True, metavar="TEXT", help="E.g. 'stick.turn=pieces(5, -1:1)': an input in pieces; repeatable."
)
SUCCESS = click.option(
    "--success", multiple=True, metavar="TEXT", help="E.g. 'settling:yaw_rate <= 10'; repeatable, all must hold."
)
THREADS = click.option(
    "--threads", type=click.IntRange(1), metavar="N", help="How many threads fly.  [default: as many as cores]"
)
BACKEND = click.option(
    "--backend", type=click.Choice(("auto", "c", "jax")), default="auto", show_default=True, help="What flies it."
)

STORE = click.option(
    "--store", type=FILE, metavar="DIR", help="Keep what is flown here; started again, only what is missing flies."
)

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


def PLACE(function: Callable[..., Any]) -> Callable[..., Any]:
    """Where a console listens, ``--port``, ``--bind``, ``--certificate``, ``--private-key``; and ``--open``."""
    options = [
        click.option("--port", type=click.IntRange(0, 65535), default=0, help="Of the console.  [default: a free one]"),
        click.option("--bind", default="127.0.0.1", show_default=True, help="Address of the console; others need TLS."),
        click.option("--certificate", type=FILE, metavar="FILE", help="Of the console, for TLS."),
        click.option("--private-key", type=FILE, metavar="FILE", help="Of that certificate."),
        click.option("--open", "opens", is_flag=True, help="Open the console in a browser of this computer."),
    ]
    for option in reversed(options):
        function = option(function)
    return function


LOCKSTEP = click.option("--lockstep", is_flag=True, help="Virtual time: each end waits for the other.")
