"""`trimtab firmware`: export a scenario's vehicle as C for a microcontroller, and run the code on an emulated board."""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import click

from trimtab.commands.line import find_key
from trimtab.commands.options import JSON, KEY, LOCKSTEP, NAVIGATION, OUT, SCENARIO, SEED, SET
from trimtab.commands.output import check_folder, print_json, quote
from trimtab.commands.written_files import place_files
from trimtab.core.cache_folder import enable_cache
from trimtab.core.errors import InputError
from trimtab.flight.boards.firmware_folder import firmware_outputs, write_firmware
from trimtab.flight.boards.microcontrollers import require_tools
from trimtab.scenarios.build import build


@click.command()
@SCENARIO
@OUT("DIR", "Write the C code to this folder.", required=True)
@click.option("--board", default="cortex-m7", show_default=True, help="Target board.")
@click.option(
    "--emulate",
    type=click.IntRange(1, 65535),
    metavar="PORT",
    help="Build the firmware and run it on an emulated board, at this TCP port.",
)
@LOCKSTEP
@SET
@NAVIGATION
@SEED
@KEY
@JSON
def command(
    scenario: str,
    out: Path,
    board: str,
    emulate: int | None,
    lockstep: bool,
    settings: dict[str, str],
    seed: int,
    key: Path | None,
    as_json: bool,
) -> None:
    """Write a vehicle as C firmware for a microcontroller.

    The firmware holds the simulated world, the failsafe and the radio protocol.

    On the emulated board the exported world replaces the hardware. All other code is that of a real craft.

    \b
    trimtab firmware hovercraft/forward --out board --emulate 5760
    trimtab fly hovercraft/forward --link tcp://127.0.0.1:5760
    trimtab firmware f16/gcas --out board --emulate 5760 --lockstep
    trimtab fly f16/gcas --link tcp://127.0.0.1:5760 --lockstep
    """
    if lockstep and (emulate is None or board == "stm32f405"):
        problem = "needs an emulated board whose clock can be stopped: cortex-m4 or cortex-m7"
        raise InputError("--lockstep", problem, fix="--board cortex-m7 --emulate 5760 --lockstep")
    if emulate is not None:
        require_tools(board)
        if not shutil.which("make"):
            raise InputError("--emulate", "needs make, which was not found", fix="apt-get install make")
    built = build(scenario, settings)
    firmware_outputs(built, board)  # raises for outputs that the firmware cannot drive, before a key is created
    check_folder("--out", out)
    line = f"tcp://127.0.0.1:{emulate or 5760}"
    signing_key = find_key(scenario, key, False, line, create=True)
    assert signing_key is not None
    enable_cache()
    with tempfile.TemporaryDirectory() as scratch:
        written = write_firmware(built, Path(scratch), signing_key, board=board, seed=seed)
        files = place_files("--out", Path(scratch), written.files, out)
    if as_json:
        print_json({"scenario": built.name, "board": board, "outputs": written.outputs}, files)
    else:
        click.echo(f"wrote {len(files)} files in {out}, with the vehicle's key in key.bin")
        click.echo("\n".join(written.outputs))
        run, fly = (" LOCKSTEP=1", " --lockstep") if lockstep else ("", "")
        fly = f"trimtab fly {quote(scenario)} --link {line}{fly}"
        click.echo(f"build and run them: make -C {quote(out)} run{run}      fly: {fly}")
    if emulate is not None and not _run_emulator(out, emulate, lockstep):
        sys.exit(1)


def _run_emulator(folder: Path, port: int, lockstep: bool) -> bool:
    make = ["make", "-s", "-C", str(folder), "run", f"PORT={port}", *(["LOCKSTEP=1"] if lockstep else [])]
    with subprocess.Popen(make) as emulator:
        try:
            return emulator.wait() == 0
        except KeyboardInterrupt:
            emulator.terminate()
            return True
