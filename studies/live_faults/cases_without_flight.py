"""Cases of the campaign without a flight of a pair: files, logs, exported C and links, tried by real processes."""

import dataclasses
import os
import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from time import monotonic, sleep
from typing import NamedTuple

from studies.live_faults.case import CaseOutcome
from studies.live_faults.flight import NAME
from studies.live_faults.plain_station import explain_no_station, join_as_station
from studies.live_faults.process import NotReady, Process
from trimtab.core.errors import InputError
from trimtab.flight.mavlink.keys import create_key, load_key
from trimtab.logs.mcap import read_mcap, write_mcap

LONGEST_S = 600
HELD_S = 4.0
RUN_S = 1.0
INT64_MIN = """
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include "autopilot.h"

static autopilot_in in;
static autopilot_out out;
static autopilot_state state;
static autopilot_params params;

int main(void)
{
    autopilot_defaults(&params);
    autopilot_init(&params, &state);
    for (int k = 0; k < 3; ++k) {
        in.t = k % 2 ? INT64_MAX : INT64_MIN;
        SAMPLES
        autopilot_step(&params, &state, &in, &out);
    }
    puts("stepped");
    return 0;
}
"""


class ProcessCase(NamedTuple):
    """Case without a flight. run: function of an empty folder that returns observations and problems."""

    name: str
    does: str
    run: Callable[[Path], tuple[list[str], list[str]]]
    missing_requirement: Callable[[], str] = lambda: ""


def try_process_case(case: ProcessCase, folder: Path) -> CaseOutcome:
    """Try a case. Errors become problems."""
    why = case.missing_requirement()
    if why:
        return CaseOutcome(case.name, case.does, "", (), (), why)
    folder.mkdir(parents=True)
    try:
        seen, problems = case.run(folder)
    except (NotReady, InputError, OSError, subprocess.SubprocessError) as error:
        seen, problems = [], [f"{type(error).__name__}: {error}"]
    return CaseOutcome(case.name, case.does, "", tuple(seen), tuple(problems))


def _run_verb(*words: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run `trimtab …` in a folder until it ends."""
    path = os.pathsep.join(p for p in sys.path if p)
    given = {**os.environ, "PYTHONPATH": path, "TRIMTAB_CONFIG": str(folder / "config"), **environment}
    command = [sys.executable, "-m", "trimtab", *words]
    return subprocess.run(command, capture_output=True, text=True, env=given, cwd=folder, timeout=LONGEST_S)


def _last_line(done: subprocess.CompletedProcess[str]) -> str:
    lines = (done.stderr + done.stdout).strip().splitlines()
    return next((line for line in lines if line.startswith("error")), lines[-1] if lines else "nothing")


def replay_hostile_log(folder: Path) -> tuple[list[str], list[str]]:
    """Replay logs whose metadata name a file, a module and `os:abort` as their scenario."""
    done = _run_verb("run", NAME, "--set", f"duration={RUN_S} s", "--out", "run", folder=folder)
    if done.returncode:
        return [], [f"no log to begin with: {_last_line(done)}"]
    log, seen, problems = read_mcap(folder / "run" / "run.mcap"), [], []
    mark = folder / "was-imported"
    (folder / "evil.py").write_text(f"open({str(mark)!r}, 'w')\ndef craft():\n    return None\n", "ascii")
    for k, name in enumerate((f"{folder / 'evil.py'}:craft", "evil:craft", "os:abort")):
        choices = {"scenario": name, "arguments": {}, "settings": {}, "without": [], "faults": []}
        hostile = dataclasses.replace(log, metadata={**log.metadata, "scenario": name, "choices": choices})
        file = write_mcap(hostile, folder / f"hostile-{k}.mcap")
        done = _run_verb("replay", str(file), folder=folder, PYTHONPATH=os.pathsep.join([str(folder), *sys.path]))
        seen.append(f"`{name.rpartition('/')[2]}`: exit code {done.returncode}")
        if done.returncode != 2 or mark.exists():
            problems.append(f"{name}: exit code {done.returncode}, imported: {mark.exists()}")
    return [*seen, "nothing imported" if not mark.exists() else "imported"], problems


def connect_mute_client(folder: Path) -> tuple[list[str], list[str]]:
    """Connect to a vehicle by TCP without sending anything, then start an autopilot."""
    create_key(folder / "config" / "keys" / "hovercraft.key")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    environment, uri = {"TRIMTAB_CONFIG": str(folder / "config")}, f"tcp://127.0.0.1:{port}"
    words = ("vehicle", NAME, "--listen", uri, "--duration", "4 s")
    vehicle = Process(*words, folder=folder, name="vehicle", environment=environment)
    autopilot = None
    try:
        vehicle.wait_for("listens on")
        with socket.create_connection(("127.0.0.1", port)):
            sleep(0.5)
            words = ("fly", NAME, "--link", uri, "--duration", "2 s")
            autopilot = Process(*words, folder=folder, name="autopilot", environment=environment)
            autopilot.finish()
        vehicle.finish()
    finally:
        for one in (vehicle, *([autopilot] if autopilot else [])):
            if one.status is None:
                one.kill()
    assert autopilot is not None
    ends = autopilot.status, vehicle.status
    seen = [f"autopilot: exit code {ends[0]}", f"vehicle: exit code {ends[1]}"]
    return seen, [] if ends == (0, 0) else [f"{seen}: {autopilot.output_text[-300:]}"]


def hold_without_log(folder: Path) -> tuple[list[str], list[str]]:
    """Hold a vehicle without --out for some seconds, and measure what it writes into the temporary folder."""
    create_key(folder / "config" / "keys" / "hovercraft.key")
    scratch = folder / "scratch"
    scratch.mkdir()
    environment = {"TRIMTAB_CONFIG": str(folder / "config"), "TMPDIR": str(scratch)}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        uri = f"udp://127.0.0.1:{free.getsockname()[1]}"
    vehicle = Process("vehicle", NAME, "--listen", uri, folder=folder, name="vehicle", environment=environment)
    try:
        vehicle.wait_for("listens on")
        before, began = _size_below(scratch), monotonic()
        sleep(HELD_S)
        rate = (_size_below(scratch) - before) / (monotonic() - began)
        vehicle.send(2)
        vehicle.finish()
    finally:
        if vehicle.status is None:
            vehicle.kill()
    logs = [str(f.name) for f in scratch.rglob("*.mcap")]
    seen = [f"{rate:.0f} bytes/s into the temporary folder, {len(logs)} logs there"]
    return seen, [f"it writes {rate:.0f} bytes/s: {logs}"] if rate > 0 or logs else []


def _size_below(folder: Path) -> int:
    return sum(f.stat().st_size for f in folder.rglob("*") if f.is_file())


def read_key_from_firmware(folder: Path) -> tuple[list[str], list[str]]:
    """Build the firmware, and check that no file readable by others contains the vehicle's key."""
    key = folder / "config" / "keys" / "hovercraft.key"
    create_key(key)
    done = _run_verb("firmware", NAME, "--out", "board", folder=folder)
    if done.returncode:
        return [], [_last_line(done)]
    made = subprocess.run(["make", "-s", "-C", folder / "board"], capture_output=True, text=True, timeout=LONGEST_S)
    if made.returncode:
        return [], [made.stderr[-300:]]
    secret, problems = load_key(key).secret, []
    holders = [f for f in (folder / "board").rglob("*") if f.is_file() and secret in f.read_bytes()]
    open_files = [f.name for f in holders if f.stat().st_mode & 0o077]
    problems = [f"readable by others, with the key: {', '.join(open_files)}"] if open_files else []
    modes = ", ".join(f"{f.name} {f.stat().st_mode & 0o777:o}" for f in holders)
    elf = folder / "board" / "firmware.elf"
    if elf in holders or not elf.exists():
        problems.append("firmware.elf is missing, or contains the key")
    return [f"the key is in {modes or 'no file'}", f"firmware.elf: {elf.stat().st_size} bytes, without it"], problems


def step_at_least_time(folder: Path) -> tuple[list[str], list[str]]:
    """Step exported C, without -fwrapv, at the smallest and largest times under the sanitizer."""
    done = _run_verb("export", NAME, "--out", "c", "--steps", "10", folder=folder)
    if done.returncode:
        return [], [_last_line(done)]
    where = folder / "c"
    header = (where / "autopilot.h").read_text("utf-8")
    inputs = header[header.index("typedef struct") : header.index("} autopilot_in;")]
    times = re.findall(r"int64_t t;[^}]*} (\w+);", inputs[inputs.index("samples") - 400 :])
    text = INT64_MIN.replace("SAMPLES", " ".join(f"in.samples.{n}.t = k % 2 ? INT64_MIN : INT64_MAX;" for n in times))
    (where / "least.c").write_text(text, "ascii")
    strict = ["-std=c99", "-O1", "-g", "-fno-wrapv", "-fsanitize=undefined", "-fno-sanitize-recover=all"]
    sources = [str(f) for f in where.glob("*.c") if f.name not in ("replay.c", "vectors.c")]
    built = subprocess.run(["cc", *strict, *sources, "-o", where / "least", "-lm"], capture_output=True, text=True)
    if built.returncode:
        return [], [built.stderr[-300:]]
    ran = subprocess.run([where / "least"], capture_output=True, text=True, timeout=LONGEST_S)
    seen = [f"{len(times) + 1} times at INT64_MIN and INT64_MAX: exit code {ran.returncode}"]
    return seen, [] if ran.returncode == 0 else [ran.stderr[-300:]]


def list_boards(folder: Path) -> tuple[list[str], list[str]]:
    """Check that firmware for a real board builds, and that its page names the functions of the board."""
    create_key(folder / "config" / "keys" / "hovercraft.key")
    words = ("--set", "navigation=ins", "--board", "stm32f405", "--out", "board")
    done = _run_verb("firmware", NAME, *words, folder=folder)
    if done.returncode:
        return [], [_last_line(done)]
    made = subprocess.run(["make", "-s", "-C", folder / "board"], capture_output=True, text=True, timeout=LONGEST_S)
    if made.returncode:
        return [], [made.stderr[-300:]]
    functions = re.findall(r"(board_\w+)\(", (folder / "board" / "portable" / "port.h").read_text("utf-8"))
    size = (folder / "board" / "firmware.elf").stat().st_size
    return [f"stm32f405: firmware.elf of {size} bytes, with {len(functions)} functions of the board"], []


def _explain_no_tools(*tools: str) -> Callable[[], str]:
    return lambda: ", ".join(f"{tool} is not installed" for tool in tools if not shutil.which(tool))


ARM_TOOLS = _explain_no_tools("arm-none-eabi-gcc", "make")
NOT_FLOWN: list[ProcessCase] = [
    ProcessCase("hostile-log", "replay of logs that name code as their scenario", replay_hostile_log),
    ProcessCase("mute-client", "a client connects by TCP, says nothing, stays; then an autopilot", connect_mute_client),
    ProcessCase("no-log-asked", "vehicle without --out, held", hold_without_log),
    ProcessCase("key-in-firmware", "firmware built; its files searched for the key", read_key_from_firmware, ARM_TOOLS),
    ProcessCase(
        "least-times", "exported C at INT64_MIN, UBSan, no -fwrapv", step_at_least_time, _explain_no_tools("cc")
    ),
    ProcessCase("ground-station", "a station of MAVLink's own library joins", join_as_station, explain_no_station),
    ProcessCase("board", "firmware for the STM32F405 built", list_boards, ARM_TOOLS),
]
