"""`trimtab console`: web page to fly a simulated craft, or to view a recorded flight or a campaign."""

import asyncio
import contextlib
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, NoReturn

import click

from trimtab.commands import fly
from trimtab.commands.foreign_logs import read_own_log
from trimtab.commands.line import live_settings
from trimtab.commands.options import FAULT, NAVIGATION, OUT, PLACE, SEED, SET, parse_parts
from trimtab.commands.progress import show_spinner
from trimtab.commands.replay import replace_parts
from trimtab.console.address import ConsoleAddress
from trimtab.core.cache_folder import enable_cache
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import parse_time
from trimtab.run.replay import replay
from trimtab.scenarios import catalogue
from trimtab.scenarios.build import build
from trimtab.scenarios.recorded import rebuild_scenario

if TYPE_CHECKING:  # the packages of the extra "console" may not be installed
    from trimtab.console.recordings import Recording

START_S = 180.0
"""Longest time (s) to wait until the simulated vehicle is compiled and started."""
LONGEST = "28800 s"
"""Maximum duration of a flight that the pilot ends. If the law follows a table, the flight ends with the table."""
POSITION = {"navigation": "ins"}
"""Name of a navigation system that estimates the position, so that the page can draw the craft on a map."""


@click.command()
@click.argument("subjects", nargs=-1, required=True, metavar="SCENARIO|FILE.mcap…|STORE")
@SET
@NAVIGATION
@FAULT
@SEED
@OUT("DIR", "Write the flight's logs to this folder.  [default: none]")
@click.option(
    "--with",
    "parts",
    multiple=True,
    metavar="PART=CHOICE",
    callback=parse_parts,
    help="Replace estimator or law of a recorded autopilot, as in trimtab replay. Shows log and replay together.",
)
@PLACE
@click.pass_context
def command(
    context: click.Context,
    subjects: tuple[str, ...],
    settings: dict[str, str],
    faults: tuple[str, ...],
    seed: int,
    out: Path | None,
    parts: dict[str, str],
    port: int,
    bind: str,
    certificate: Path | None,
    private_key: Path | None,
    opens: bool,
) -> None:
    """Fly a simulated craft from a page in a browser.

    The page also shows recorded flights and campaigns.

    Starts the simulated vehicle, its autopilot and the page's server, and prints the page's address. Ctrl-C stops all
    three. Steer with the arrow keys, a gamepad, or the pad on the page; the space bar stops the flight. For a real
    vehicle use trimtab fly --console.

    \b
    trimtab console hovercraft/pilot
    trimtab console hovercraft/pilot --fault 'link:down off @ 30 s for 2 s' --out flight
    trimtab console hovercraft/forward --set navigation=ins
    trimtab console flight/flight.mcap flight/vehicle.mcap
    trimtab console flight/flight.mcap --with estimator=ins-coupled
    trimtab console mass.zarr
    """
    address = ConsoleAddress(bind, port, certificate, private_key, opens)
    address.check()
    if _show_recorded(subjects, parts, address):
        return
    signal.signal(signal.SIGTERM, _end)
    scenario, *others = subjects
    if others:
        raise InputError("trimtab console", f"needs exactly one scenario, got {len(subjects)}", fix="name one scenario")
    chosen = _choose(scenario, settings)
    duration = _duration(scenario, chosen)
    with _vehicle(scenario, chosen, faults, seed, out) as link:
        click.echo(f"vehicle link for ground stations and trimtab inject: --link {link}")
        words = [scenario, "--link", link, "--seed", str(seed), "--console", *duration]
        words += ["--port", str(port), "--bind", bind, *(["--open"] if opens else [])]
        words += [word for path, value in chosen.items() for word in ("--set", f"{path}={value}")]
        files = {"--out": out, "--certificate": certificate, "--private-key": private_key}
        words += [word for option, file in files.items() if file is not None for word in (option, str(file))]
        with fly.command.make_context("fly", words, parent=context) as flown:
            fly.command.invoke(flown)


def _end(number: int, _: object) -> NoReturn:
    """Handle SIGTERM like Ctrl-C, so that the process of the simulated vehicle ends too."""
    sys.exit(128 + number)


def _show_recorded(subjects: Sequence[str], parts: Mapping[str, str], address: ConsoleAddress) -> bool:
    """Serve a page for a campaign's store or for logs until interrupted. Return False if the subjects are neither."""
    from trimtab.console.campaigns import CampaignFeed
    from trimtab.console.recordings import RecordingFeed, describe_recordings, load_recording
    from trimtab.console.server import serve_here

    files = [Path(text) for text in subjects]
    missing = [file for file in files if file.suffix in (".mcap", ".zarr") and not file.exists()]
    if missing:
        raise InputError("trimtab console", f"not found: '{missing[0]}'", fix="trimtab fly … --out DIR writes logs")
    is_store = (files[0] / "zarr.json").exists()
    if not is_store and not all(file.suffix == ".mcap" for file in files):
        return False
    if len(files) > (1 if is_store else 2):
        raise InputError(
            "trimtab console",
            f"needs one store, or one or two logs, got {len(files)} files",
            fix="name one store, or one or two logs",
        )
    if is_store:
        campaign = CampaignFeed(files[0])
        asyncio.run(serve_here(address, campaign.feed, campaign.routes(), click.echo))
        return True
    if parts:
        flights = _replay(files[0], parts)
    else:
        with show_spinner(f"reading {' and '.join(map(str, files))}"):
            flights = [*map(load_recording, files)]
    feed = RecordingFeed(describe_recordings(flights), flights)
    asyncio.run(serve_here(address, feed, feed.routes(), click.echo))
    return True


def _replay(file: Path, parts: Mapping[str, str]) -> "list[Recording]":
    """Return two recordings: the log, and a replay of the log with some parts of the autopilot replaced."""
    from trimtab.console.recordings import load_recording, record_flight

    log = read_own_log(file)
    recorded = rebuild_scenario(log)
    enable_cache()
    with show_spinner(f"compiling the autopilot of {recorded.name}"):
        again = replay(log, recorded, autopilot=replace_parts(recorded, parts))
    words = ", ".join(f"{part}={choice}" for part, choice in parts.items())
    return [load_recording(file), record_flight(again.replayed_log, f"replayed with {words}", scenario=recorded)]


def _choose(scenario: str, settings: Mapping[str, str]) -> dict[str, str]:
    """Return the settings, plus a supervisor, a stick and a position estimate if the scenario offers these choices."""
    offered = catalogue.scenario_choices(scenario)
    position = {name: value for name, value in POSITION.items() if value in offered.get(name, ())}
    return position | live_settings(scenario) | dict(settings)


def _duration(scenario: str, settings: Mapping[str, str]) -> list[str]:
    """Return the option --duration for `trimtab fly`, or no option if the scenario cannot run for LONGEST."""
    built = build(scenario, settings)
    try:
        replace(built, duration=parse_time(LONGEST)).check()
    except InputError:
        return []
    return ["--duration", LONGEST]


@contextlib.contextmanager
def _vehicle(
    scenario: str, settings: Mapping[str, str], faults: Sequence[str], seed: int, out: Path | None
) -> Iterator[str]:
    """Run a simulated vehicle in a separate process, and yield the URI of the vehicle's link."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        link = f"udp://127.0.0.1:{free.getsockname()[1]}"
    words = [sys.executable, "-m", "trimtab", "vehicle", scenario, "--listen", link, "--seed", str(seed)]
    words += [word for path, value in settings.items() for word in ("--set", f"{path}={value}")]
    words += [word for text in faults for word in ("--fault", text)]
    words += [] if out is None else ["--out", str(out)]
    with tempfile.TemporaryFile("w+") as said:
        process = subprocess.Popen(words, stdout=said, stderr=subprocess.STDOUT, start_new_session=True)
        try:
            with show_spinner(f"compiling the vehicle of {scenario}"):
                _await_vehicle(process, said)
            yield link
        finally:
            process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(10.0)
            process.kill()


def _await_vehicle(process: "subprocess.Popen[bytes]", said: IO[str]) -> None:
    """Wait until the vehicle listens on its link. If the vehicle's process ends, raise InputError with the output."""
    end = time.monotonic() + START_S
    while True:
        said.seek(0)
        text = said.read()
        if "listens on" in text:
            return
        if process.poll() is not None or time.monotonic() > end:
            raise _refuse_start(text)
        time.sleep(0.05)


def _refuse_start(said: str) -> InputError:
    """Return an InputError with the problem and the fix that the vehicle's process printed."""
    problem, _, fix = said.strip().partition("\nFix: ")
    problem = problem.rpartition("error: ")[2] or "no output"
    return InputError(
        "the vehicle", f"did not start: {problem}", fix=fix or "trimtab vehicle SCENARIO --listen udp://:14550"
    )
