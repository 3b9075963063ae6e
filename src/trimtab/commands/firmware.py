"""`trimtab firmware`: the vehicle's end of a scenario as C for a microcontroller, and its run on an emulated board."""

import shutil
import subprocess
import sys
from pathlib import Path

import click

from trimtab.commands.kept_programs import enable_cache
from trimtab.commands.line import find_key
from trimtab.commands.options import FILE, JSON, KEY, SCENARIO, SEED, SET
from trimtab.commands.output import print_json
from trimtab.core.errors import InputError
from trimtab.export.boards import require_tools
from trimtab.export.firmware_folder import write_firmware
from trimtab.scenarios.build import build


@click.command()
@SCENARIO
@click.option("--out", type=FILE, metavar="DIR", required=True, help="Folder for the C.")
@click.option("--board", default="cortex-m7", show_default=True, help="What it is built for.")
@click.option("--emulate", type=click.IntRange(1, 65535), metavar="PORT", help="Build it and run it emulated.")
@SET
@SEED
@KEY
@JSON
def command(
    scenario: str,
    out: Path,
    board: str,
    emulate: int | None,
    settings: dict[str, str],
    seed: int,
    key: Path | None,
    as_json: bool,
) -> None:
    """Write a scenario's vehicle as firmware for a microcontroller: world, failsafe, wire, in C.

    On the emulated board the exported world takes the place of the hardware; the rest is what a craft would run.

    \b
    trimtab firmware hovercraft/forward --out board --emulate 5760
    trimtab fly hovercraft/forward --link tcp://127.0.0.1:5760
    """
    if emulate is not None:
        require_tools(board)
        if not shutil.which("make"):
            raise InputError("--emulate", "needs make, not found here", fix="apt-get install make")
    built = build(scenario, settings)
    line = f"tcp://127.0.0.1:{emulate or 5760}"
    signing_key = find_key(scenario, key, False, line, create=True)
    assert signing_key is not None
    enable_cache()
    written = write_firmware(built, out, signing_key, board=board, seed=seed)
    if as_json:
        print_json({"scenario": built.name, "board": board, "files": [str(f) for f in written.files]})
    else:
        click.echo(f"wrote {len(written.files)} files in {out}, with the vehicle's key in key.bin")
        click.echo(f"build and run them: make -C {out} run      fly: trimtab fly {scenario} --link {line}")
    if emulate is not None and not _run_emulator(out, emulate):
        sys.exit(1)


def _run_emulator(folder: Path, port: int) -> bool:
    with subprocess.Popen(["make", "-s", "-C", str(folder), "run", f"PORT={port}"]) as emulator:
        try:
            return emulator.wait() == 0
        except KeyboardInterrupt:
            emulator.terminate()
            return True
