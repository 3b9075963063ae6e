"""`trimtab firmware`: the vehicle's end of a scenario as C for a microcontroller, and its run on an emulated board."""

import json
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import click

from trimtab.commands.cache import enable_cache
from trimtab.commands.fly_scenario import RunRequest as Asked
from trimtab.commands.fly_scenario import build_from_request
from trimtab.commands.line import find_key
from trimtab.core.errors import InputError


class FirmwareRequest(NamedTuple):
    """What was asked for on the command line. emulate: port at which the emulated board is to listen, or None."""

    scenario: str
    out: Path
    board: str = "cortex-m7"
    settings: Mapping[str, str] = {}
    seed: int = 0
    key: Path | None = None
    emulate: int | None = None
    as_json: bool = False


def firmware(request: FirmwareRequest) -> bool:
    """Write the folder; with `emulate` build it and run it until Ctrl-C. Whether that went well."""
    from trimtab.export.firmware_folder import write_firmware

    if request.emulate is not None:
        _require_tools(request)
    scenario = build_from_request(Asked(request.scenario, request.settings, seed=request.seed))
    line = f"tcp://127.0.0.1:{request.emulate or 5760}"
    key = find_key(request.scenario, request.key, False, line, create=True)
    assert key is not None
    enable_cache()
    written = write_firmware(scenario, request.out, key, board=request.board, seed=request.seed)
    if request.as_json:
        files = [str(f) for f in written.files]
        click.echo(json.dumps({"scenario": scenario.name, "board": request.board, "files": files}))
    else:
        click.echo(f"wrote {len(written.files)} files in {request.out}, with the vehicle's key in key.h")
        click.echo(
            f"build and run them: make -C {request.out} run      fly: trimtab fly {request.scenario} --link {line}"
        )
    return request.emulate is None or _run_emulator(request.out, request.emulate)


def _require_tools(request: FirmwareRequest) -> None:
    from trimtab.export.boards import require_tools

    require_tools(request.board)
    if not shutil.which("make"):
        raise InputError("--emulate", "needs make, not found here", fix="apt-get install make")


def _run_emulator(folder: Path, port: int) -> bool:
    with subprocess.Popen(["make", "-s", "-C", str(folder), "run", f"PORT={port}"]) as running:
        try:
            return running.wait() == 0
        except KeyboardInterrupt:
            running.terminate()
            return True
