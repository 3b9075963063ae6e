"""Writer of firmware: the vehicle's end of a link as C for a microcontroller, with a simulated vehicle in place of the
hardware.

The portable C is in the folder `firmware` of this package. It has two output drivers (drives): one controls the speed
of a fan, the other converts the command to servo pulses by tables. The files written here depend on the scenario: the
exported world and failsafe, the tables or the fan's regulator and motor, the MAVLink messages, and the signing key.
"""

import json
import os
import shutil
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.actuators.drive import FanDrive
from trimtab.actuators.motor import MotorOutput
from trimtab.actuators.regulated_fan import RegulatedFan
from trimtab.actuators.servo_frame import SERVO_FRAME
from trimtab.actuators.speed_regulator import SpeedRegulatorInput
from trimtab.compiler.block import BlockDefinition, BlockText, block_text
from trimtab.compiler.elementary import LICENCE_NOTE
from trimtab.core.clock import SYSTEM_CLOCK, Clock
from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.imperfections import imperfections, without
from trimtab.core.record import replace, to_arrays
from trimtab.core.signals import Command
from trimtab.core.time import to_seconds
from trimtab.flight.boards.black_box import FAN_DRIVE
from trimtab.flight.boards.microcontrollers import FIRMWARE as START
from trimtab.flight.boards.microcontrollers import TARGETS
from trimtab.flight.boards.pulse_outputs import (
    COMMAND_HEADER,
    command_source,
    frame_of,
    outputs_header,
    outputs_source,
    world_source,
)
from trimtab.flight.boards.sample_sources import rest_header, samples_header, samples_source
from trimtab.flight.mavlink.dialect import Dialect, derive_dialect
from trimtab.flight.mavlink.generated import load_generator, write_c_headers
from trimtab.flight.mavlink.keys import SigningKey
from trimtab.flight.mavlink.stamps import EPOCH, PER_SECOND
from trimtab.flight.scenario_identity import scenario_identity
from trimtab.flight.station.identity import cut_line, identity_digest
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import (
    StepInput,
    carried_structures,
    choose_failsafe,
    failsafe_block,
    refuse_stepped_vehicle,
    refuse_swarm,
    replace_links,
    timed_block,
    world_block,
)
from trimtab.run.command_pulses import MOST_OUTPUTS, describe_outputs, find_outputs
from trimtab.vehicles.vehicle_type import mav_type

PACKAGED_FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
CHECKOUT_FIRMWARE = Path(__file__).resolve().parents[4] / "firmware"
"""Folder of the portable C in a checkout of the repository, beside `src`. An installed package uses
PACKAGED_FIRMWARE."""
START_UP_FILES = {"start.c": "boards/mps2/start.c", "link.ld": "boards/mps2/link.ld", "board.h": "boards/mps2/board.h"}
REALS = {"single": "f32", "double": "f64"}
FIRMWARE_BOARDS = {name: REALS[target.real] for name, target in TARGETS.items()} | {"stm32f405": REALS["single"]}
"""Floating-point type of the FPU of each board on which the firmware runs, by the board's name."""
MOST_OUTPUTS_OF = {"stm32f405": 4}
"""Maximum number of outputs of each board that has fewer outputs than MAVLink's message SERVO_OUTPUT_RAW, by the
board's name."""
FAN_OUTPUTS = [
    "output 1: rudder servo, the command's pulse, safe 1.500 ms",
    "output 2: thrust fan's speed controller, duty -1 to 1 by 1.000 to 2.000 ms, safe 1.500 ms",
    "output 3: lift fan's speed controller, off and on by 1.000 and 2.000 ms, safe 1.000 ms",
]
KEY_MAGIC = b"trimtab1"


class FirmwareFolder(NamedTuple):
    """Result of writing firmware: the folder, all files, the MAVLink dialect, and a line of text that describes each
    output."""

    folder: Path
    files: list[Path]
    dialect: Dialect
    outputs: list[str]


def write_firmware(
    scenario: Scenario,
    folder: Path,
    key: SigningKey,
    *,
    board: str = "cortex-m7",
    seed: int = 0,
    clock: Clock = SYSTEM_CLOCK,
) -> FirmwareFolder:
    """Write the firmware of a scenario's vehicle into a folder; `make` there builds firmware.elf.

    Args:
        scenario: scenario, checked before any file is written. Real links replace the scenario's links.
        folder: folder to write; created if missing.
        key: key with which vehicle and autopilot sign their packets. It is written only to the file key.bin, which only
            the file's owner can read.
        board: a key of `FIRMWARE_BOARDS`.
        seed: seed of the random numbers in the emulated world.
        clock: clock whose current time is written into the board's key data.

    Raises:
        InputError: unknown board, command without limits, firmware too large for the board, or a folder that is not
            writable.
    """
    real = _find_real(board)
    asked, scenario = scenario, replace_hardware(scenario)
    frame, command = carried_structures(scenario)
    dialect = derive_dialect(frame, command)
    identity = scenario_identity(asked, dialect)
    drive, texts, outputs = drive_texts(asked, command, board)
    texts |= {"exported/command.h": COMMAND_HEADER, "exported/command.c": command_source(dialect)}
    blocks = [block_text(world_block(scenario, seed=seed), real), *firmware_blocks(asked, command, real)]
    refuse_workspaces(blocks)
    for block in blocks:
        texts |= {f"exported/{block.name}.h": block.header, f"exported/{block.name}.c": block.source}
    texts["exported/identity.h"] = IDENTITY_HEADER
    texts["exported/identity.c"] = identity_source(identity, mav_type(asked.world.vehicle))
    texts["emulated/samples.h"] = samples_header(
        {name: s.period for name, s in scenario.world.sensors.items() if name in frame.samples}
    )
    texts["emulated/samples.c"] = samples_source(frame, dialect)
    texts["exported/rest.h"] = rest_header(scenario.limits)
    texts["emulated/instants.h"] = _instants_header(
        scenario, driven_fan(asked).motor.period if drive == "fan" else None
    )
    try:
        files = _copy_sources(folder, board, drive) + _write_texts(folder, texts)
        files.append(_write_key(folder / "key.bin", key, clock.unix()))
        write_c_headers(dialect, folder / "mavlink")
    except OSError as error:
        problem = f"cannot write in the folder {str(folder)!r}: {(error.strerror or str(error)).lower()}"
        raise InputError(
            argument_name("out"),
            problem,
            fix=f"{argument_name('out')} with a folder that you can write, e.g. {argument('out', 'firmware')}",
        ) from None
    return FirmwareFolder(folder, files, dialect, outputs)


IDENTITY_HEADER = """/* What the vehicle is, as text by path, and its digest: trimtab.flight.station.identity. */
#ifndef IDENTITY_H
#define IDENTITY_H
#include <stdint.h>

enum { IDENTITY_DIGEST = 8 };
extern const uint8_t vehicle_type; /* MAV_TYPE */
extern const uint8_t identity_digest[IDENTITY_DIGEST];
extern const uint16_t identity_lines;
extern const char *const identity_line[];
#endif
"""


def identity_source(identity: Mapping[str, str], mav_type: int) -> str:
    """Return C source with the identity of a scenario (the text of each setting, by path), for the vehicle's
    firmware."""
    digest = ", ".join(map(str, identity_digest(identity)))
    lines = [cut_line(path, text).decode("ascii", "replace") for path, text in sorted(identity.items())]
    quoted = [json.dumps(line.replace("?", "_")) for line in lines]  # avoids trigraphs
    return "\n".join(
        [
            '#include "identity.h"',
            "",
            f"const uint8_t vehicle_type = {int(mav_type)};",
            f"const uint8_t identity_digest[IDENTITY_DIGEST] = {{{digest}}};",
            f"const uint16_t identity_lines = {len(lines)};",
            "const char *const identity_line[] = {",
            *(f"    {line}," for line in quoted),
            "};",
            "",
        ]
    )


def replace_hardware(scenario: Scenario) -> Scenario:
    """Return the scenario with a world that replaces the hardware around the firmware.

    Links without delay (`Wire`) replace the scenario's links. The actuators have no servo frame, because the firmware
    sends the pulses in frames.
    """
    scenario.check()
    scenario, actuators = replace_links(scenario), scenario.world.actuators
    if isinstance(actuators, FanDrive):
        actuators = replace(actuators, frame=actuators.period, fan=None)
    elif SERVO_FRAME in imperfections(actuators):
        actuators = without(actuators, SERVO_FRAME)
    return replace(scenario, world=replace(scenario.world, actuators=actuators))


def firmware_outputs(scenario: Scenario, board: str = "cortex-m7") -> list[str]:
    """Return a line of text that describes each output of a scenario's firmware. Raise the same errors as
    `write_firmware`."""
    load_generator()
    refuse_stepped_vehicle(scenario)
    refuse_swarm(scenario, "firmware")
    _find_real(board)
    return drive_texts(scenario, carried_structures(replace_hardware(scenario))[1], board)[2]


def output_names(scenario: Scenario, board: str = "stm32f405") -> tuple[str, ...]:
    """Return the name of each output of a scenario's board. An output is an element of the command, e.g. elevator or
    moment[0], or belongs to a fan drive."""
    if isinstance(scenario.world.actuators, FanDrive):
        return FAN_DRIVE
    command = carried_structures(replace_hardware(scenario))[1]
    return tuple(o.name for o in find_outputs(scenario, command, MOST_OUTPUTS_OF.get(board, MOST_OUTPUTS)))


def _find_real(board: str) -> str:
    """Return the floating-point type (f32 or f64) of a board's FPU."""
    if board not in FIRMWARE_BOARDS:
        raise InputError(
            "firmware", f"unknown board {board!r}", choices=FIRMWARE_BOARDS, fix=argument("board", "cortex-m7")
        )
    return FIRMWARE_BOARDS[board]


def drive_texts(scenario: Scenario, command: Command, board: str) -> tuple[str, dict[str, str], list[str]]:
    """Return the name of the output driver that a scenario needs (fan or pulses), the driver's files by path, and a
    line of text for each output."""
    if isinstance(scenario.world.actuators, FanDrive):
        return "fan", {}, FAN_OUTPUTS
    outputs = find_outputs(scenario, command, MOST_OUTPUTS_OF.get(board, MOST_OUTPUTS))
    texts = {
        "drive/outputs.h": outputs_header(outputs, frame_of(scenario)),
        "drive/outputs.c": outputs_source(outputs),
        "emulated/outputs.c": world_source(outputs),
    }
    return "pulses", texts, describe_outputs(outputs)


def driven_fan(scenario: Scenario) -> RegulatedFan:
    """Return the scenario's regulated fan (regulator, motor and battery), or the firmware's default fan with a constant
    battery voltage."""
    return getattr(scenario.world.actuators, "fan", None) or without(RegulatedFan(), "battery-sag")


def motor_block(fan: RegulatedFan) -> BlockDefinition:
    """Define the block of motor, encoder and battery. The input is the duty cycle, and the outputs are speed and
    encoder count."""

    def turn(p: Any, s: Any, now: StepInput) -> Any:
        state, speed_rpm, _ = p.turn(now.t, s, now.input)
        return state, MotorOutput(speed_rpm=speed_rpm, count=state.count)

    doc = "Motor, propeller, encoder and battery of the thrust fan."
    first = StepInput(t=np.int64(0), input=np.float64(0.0))
    return BlockDefinition("motor", doc, turn, lambda p: p.init(), to_arrays(fan), first)


def firmware_blocks(scenario: Scenario, command: Command, real: str) -> list[BlockText]:
    """Return the compiled blocks of the firmware as C: the failsafe, and for a fan drive the regulator and the
    motor."""
    failsafe = failsafe_block(choose_failsafe(scenario, command), command)
    if not isinstance(scenario.world.actuators, FanDrive):
        return [block_text(failsafe, real)]
    zero = np.float64(0.0)
    doc = "Speed of the thrust fan: counts in, duty out; every 10 ms."
    speed = SpeedRegulatorInput(rpm_command=zero, count=np.int32(0))
    fan = driven_fan(scenario)
    regulator = timed_block("speed_regulator", doc, fan.regulator, speed)
    return [block_text(block, real) for block in (failsafe, regulator, motor_block(fan))]


def refuse_workspaces(blocks: list[BlockText]) -> None:
    """Raise InputError if a block needs memory besides the stack, because the firmware provides only the stack."""
    for block in blocks:
        if block.workspace:
            problem = (
                f"block {block.name!r} needs a workspace of {block.workspace} bytes, which the firmware does not have"
            )
            raise InputError(
                "firmware",
                problem,
                fix="use smaller arrays, or type `trimtab export`: the caller of the exported code provides the memory",
            )


def _instants_header(scenario: Scenario, motor_period: int | None) -> str:
    periods = ", ".join(map(str, sorted(set(scenario.world.periods()))))
    longest, autopilot_period = scenario.world.max_step, scenario.autopilot.period
    motor = "" if motor_period is None else f", MOTOR_PERIOD = {motor_period}"
    return f"""{LICENCE_NOTE}
/* When something is due in the world, in units of 100 ns; its longest step is {to_seconds(longest) * 1e3:g} ms. */
#ifndef INSTANTS_H
#define INSTANTS_H
#include <stdint.h>

enum {{ MAX_STEP = {longest}{motor} }};
#ifdef LOCKSTEP
static const int64_t AUTOPILOT_PERIOD = {autopilot_period}, DURATION = {scenario.duration};
static const int64_t PERIODS[] = {{{periods}, {autopilot_period}}};
#else
static const int64_t PERIODS[] = {{{periods}}};
#endif
#endif
"""


def _copy_sources(folder: Path, board: str, drive: str) -> list[Path]:
    """Copy the portable C, the output driver and the start-up code. The board becomes the Makefile's default."""
    source = PACKAGED_FIRMWARE if PACKAGED_FIRMWARE.is_dir() else CHECKOUT_FIRMWARE
    for name in ("drive", "emulated", "exported", "build"):  # may contain files of another scenario
        shutil.rmtree(folder / name, ignore_errors=True)
    shutil.copytree(source, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("drives"))
    shutil.copytree(source / "drives" / drive, folder / "drive")
    shutil.move(folder / "drive" / "actuators.c", folder / "emulated" / "actuators.c")
    for name, to in START_UP_FILES.items():
        shutil.copyfile(START / name, folder / to)
    make = folder / "Makefile"
    make.write_text(make.read_text("utf-8").replace("BOARD ?= cortex-m7", f"BOARD ?= {board}"), "utf-8")
    kept = (p.relative_to(source) for p in sorted(source.rglob("*")) if p.is_file())
    drives = [*sorted((folder / "drive").iterdir()), folder / "emulated" / "actuators.c"]
    own = [folder / p for p in kept if p.parts[0] != "drives"]
    return own + drives + [folder / to for to in START_UP_FILES.values()]


def _write_texts(folder: Path, texts: dict[str, str]) -> list[Path]:
    for name, text in texts.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, "utf-8")
    return [folder / name for name in texts]


def key_image(key: SigningKey, since: float) -> bytes:
    """Return the bytes from which a board reads its key (layout: firmware/portable/key.h). since: Unix time (s) before
    which the board accepts no signed packet."""
    stamp = int((since - EPOCH) * PER_SECOND)
    body = KEY_MAGIC + key.secret + stamp.to_bytes(8, "little")
    return body + zlib.crc32(body).to_bytes(4, "little")


def _write_key(path: Path, key: SigningKey, now: float) -> Path:
    """Write the key and the current time. The board, which has no calendar, accepts no packet signed earlier."""
    path.unlink(missing_ok=True)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(key_image(key, now))
    return path
