"""firmware: the vehicle's end of the distributed autopilot as C for a microcontroller, with a world to drive in it.

The portable C is in the folder `firmware` of this package; what is written beside it belongs to the scenario: the
exported world, failsafe, regulator and motor, the messages of its dialect, and the key.
"""

import json
import os
import shutil
import time
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.actuators.drive import FanDrive, drive_failsafe
from trimtab.actuators.failsafe import Failsafe
from trimtab.actuators.motor import MotorOutput
from trimtab.actuators.regulated_fan import RegulatedFan
from trimtab.actuators.speed_regulator import SpeedRegulatorInput
from trimtab.compiler.block import BlockDefinition, BlockText, block_text
from trimtab.compiler.elementary import LICENCE_NOTE
from trimtab.compiler.structs import identifier
from trimtab.core.errors import InputError
from trimtab.core.imperfections import without
from trimtab.core.record import replace, to_arrays
from trimtab.core.signals import Command, Frame
from trimtab.core.time import to_seconds
from trimtab.export.boards import FIRMWARE as START
from trimtab.export.boards import TARGETS
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import (
    StepInput,
    failsafe_block,
    message_structures,
    replace_links,
    timed_block,
    world_block,
)
from trimtab.run.identity import scenario_identity
from trimtab.wire.dialect import Dialect, derive_dialect
from trimtab.wire.generated import write_c_headers
from trimtab.wire.identity import cut_line, identity_digest
from trimtab.wire.keys import SigningKey
from trimtab.wire.stamps import EPOCH, PER_SECOND

PACKAGED_FIRMWARE = Path(__file__).resolve().parents[1] / "firmware"
CHECKOUT_FIRMWARE = Path(__file__).resolve().parents[3] / "firmware"
"""Where the portable C lies: in an installed package, or beside `src`."""
START_UP_FILES = {"start.c": "boards/mps2/start.c", "link.ld": "boards/mps2/link.ld", "board.h": "boards/mps2/board.h"}
REALS = {"single": "f32", "double": "f64"}
FIRMWARE_BOARDS = {name: REALS[target.real] for name, target in TARGETS.items()} | {"stm32f405": REALS["single"]}
"""Boards that the firmware runs on, and what their FPU computes in."""
KEY_MAGIC = b"trimtab1"


class FirmwareFolder(NamedTuple):
    """What was written: the folder, all files, and the dialect in which the firmware speaks."""

    folder: Path
    files: list[Path]
    dialect: Dialect


def write_firmware(
    scenario: Scenario, folder: Path, key: SigningKey, *, board: str = "cortex-m7", seed: int = 0
) -> FirmwareFolder:
    """Write the firmware of a scenario's vehicle into a folder; `make` there builds firmware.elf.

    Args:
        scenario: checked whole before anything is written. Its links are left out: the real ones take their place.
        folder: made where it is missing.
        key: with which both ends sign; it goes into the file key.bin, owner-only, and is in no other file.
        board: a key of `FIRMWARE_BOARDS`.
        seed: of the random numbers in the emulated world.

    Raises:
        InputError: another board, a vehicle without a fan drive, a folder that can't be written.
    """
    if board not in FIRMWARE_BOARDS:
        raise InputError("firmware", f"board {board!r} is not one", choices=FIRMWARE_BOARDS, fix="--board cortex-m7")
    real = FIRMWARE_BOARDS[board]
    asked, scenario = scenario, replace_hardware(scenario)
    frame, command = message_structures(scenario)
    dialect = derive_dialect(frame, command)
    identity = scenario_identity(asked, dialect)
    blocks = [block_text(world_block(scenario, seed=seed), real), *firmware_blocks(asked, command, real)]
    refuse_workspaces(blocks)
    texts = {
        f"exported/{name}": text
        for block in blocks
        for name, text in ((f"{block.name}.h", block.header), (f"{block.name}.c", block.source))
    }
    texts["exported/identity.h"] = IDENTITY_HEADER
    texts["exported/identity.c"] = identity_source(identity)
    texts["emulated/samples.h"] = samples_header({name: s.period for name, s in scenario.world.sensors.items()})
    texts["emulated/samples.c"] = samples_source(frame, dialect)
    texts["emulated/instants.h"] = _instants_header(scenario, driven_fan(asked).motor.period)
    try:
        files = _copy_sources(folder, board) + _write_texts(folder, texts)
        files.append(_write_key(folder / "key.bin", key))
        write_c_headers(dialect, folder / "mavlink")
    except OSError as error:
        problem = f"cannot write in {str(folder)!r}: {(error.strerror or str(error)).lower()}"
        raise InputError("--out", problem, fix="--out with a folder of yours, e.g. --out firmware") from None
    return FirmwareFolder(folder, files, dialect)


IDENTITY_HEADER = """/* What the vehicle is, as text by path, and its digest: trimtab.wire.identity. */
#ifndef IDENTITY_H
#define IDENTITY_H
#include <stdint.h>

enum { IDENTITY_DIGEST = 8 };
extern const uint8_t identity_digest[IDENTITY_DIGEST];
extern const uint16_t identity_lines;
extern const char *const identity_line[];
#endif
"""


def identity_source(identity: Mapping[str, str]) -> str:
    """C that holds an identity, text by path, as the vehicle's end tells it."""
    digest = ", ".join(map(str, identity_digest(identity)))
    lines = [cut_line(path, text).decode("ascii", "replace") for path, text in sorted(identity.items())]
    quoted = [json.dumps(line.replace("?", "_")) for line in lines]  # no trigraphs
    return "\n".join(
        [
            '#include "identity.h"',
            "",
            f"const uint8_t identity_digest[IDENTITY_DIGEST] = {{{digest}}};",
            f"const uint16_t identity_lines = {len(lines)};",
            "const char *const identity_line[] = {",
            *(f"    {line}," for line in quoted),
            "};",
            "",
        ]
    )


def replace_hardware(scenario: Scenario) -> Scenario:
    """The scenario whose world stands in for the hardware: wires for links, servo frames left to the firmware."""
    actuators = scenario.world.actuators
    if not isinstance(actuators, FanDrive):
        problem = (
            f"has {type(actuators).__name__} for actuators; the firmware drives a rudder and a thrust fan, FanDrive"
        )
        raise InputError(f"scenario {scenario.name!r}", problem, fix="trimtab firmware hovercraft/forward --out DIR")
    scenario.check()
    drive = replace(actuators, frame=actuators.period, fan=None)
    scenario = replace_links(scenario)
    return replace(scenario, world=replace(scenario.world, actuators=drive))


def driven_fan(scenario: Scenario) -> RegulatedFan:
    """The scenario's own regulator, motor and battery, or those that the firmware has by default, always full."""
    return getattr(scenario.world.actuators, "fan", None) or without(RegulatedFan(), "battery-sag")


def motor_block(fan: RegulatedFan) -> BlockDefinition:
    """Motor and encoder on their battery, as the regulator's timers meet them: a duty in, speed and count out."""

    def turn(p: Any, s: Any, now: StepInput) -> Any:
        state, speed_rpm, _ = p.turn(now.t, s, now.input)
        return state, MotorOutput(speed_rpm=speed_rpm, count=state.count)

    doc = "Motor, propeller, encoder and battery of the thrust fan."
    first = StepInput(t=np.int64(0), input=np.float64(0.0))
    return BlockDefinition("motor", doc, turn, lambda p: p.init(), to_arrays(fan), first)


def firmware_blocks(scenario: Scenario, command: Command, real: str) -> list[BlockText]:
    """The blocks of the firmware, and the motor, as C."""
    failsafe = scenario.failsafe if isinstance(scenario.failsafe, Failsafe) else drive_failsafe()
    zero = np.float64(0.0)
    doc = "Speed of the thrust fan: counts in, duty out; every 10 ms."
    speed = SpeedRegulatorInput(wanted_rpm=zero, count=np.int32(0))
    fan = driven_fan(scenario)
    regulator = timed_block("speed_regulator", doc, fan.regulator, speed)
    return [block_text(block, real) for block in (failsafe_block(failsafe, command), regulator, motor_block(fan))]


def refuse_workspaces(blocks: list[BlockText]) -> None:
    """Refuse blocks that need memory beside the stack: the firmware's sources give them none."""
    for block in blocks:
        if block.workspace:
            problem = f"block {block.name!r} needs a workspace of {block.workspace} bytes, which the firmware has not"
            raise InputError(
                "firmware", problem, fix="smaller arrays, or trimtab export, whose caller gives the memory"
            )


def samples_header(sensors: Mapping[str, int]) -> str:
    """The header of what sends the samples: each sensor with its period, so that a board sees what is asked of it."""
    periods = "\n".join(f"#define SAMPLES_{identifier(name).upper()} {period}" for name, period in sensors.items())
    return f"""{LICENCE_NOTE}
#ifndef SAMPLES_H
#define SAMPLES_H
#include "link.h"
#include "world.h"

/* The scenario's sensors, and how often each measures, in units of 100 ns. */
{periods}

/* Send what the sensors measured at this instant. */
void samples_send(link *l, const world_out *out);
#endif
"""


def samples_source(frame: Frame, dialect: Dialect) -> str:
    """C that sends each fresh sample of the world as the messages of the dialect."""
    lines = [
        LICENCE_NOTE,
        '#include "samples.h"\n',
        "#include <string.h>\n",
        "void samples_send(link *l, const world_out *out)",
    ]
    lines += ["{", "    mavlink_message_t message;"]
    for sensor in frame.samples:
        here = f"out->sensors.{identifier(sensor)}"
        lines.append(f"    if ({here}.fresh) {{")
        for name in dialect.groups[f"samples.{sensor}"]:
            lines += _sending_lines(name, dialect)
        lines.append("    }")
    return "\n".join([*lines, "    (void)l; (void)out; (void)message;", "}\n"])


def _sending_lines(name: str, dialect: Dialect) -> list[str]:
    """Lines that fill in one message and send it."""
    low, pad = name.lower(), " " * 8
    lines = [f"{pad}mavlink_{low}_t {low};", f"{pad}memset(&{low}, 0, sizeof {low});"]
    for f in dialect.definitions[name].fields:
        for k in range(f.slots):
            place = dialect.places[name][f.at + k]
            _, sensor, *rest = place.path.split(".")
            source = ".".join(["out->sensors", identifier(sensor), *map(identifier, rest)])
            source += f"[{place.slot}]" if f.length else ""
            target = f"{low}.{f.name}" + (f"[{k}]" if f.length else "")
            lines.append(f"{pad}{target} = ({f.type}){source};")
    lines.append(f"{pad}mavlink_msg_{low}_encode_status(SYSTEM, COMPONENT, &l->status, &message, &{low});")
    return [*lines, f"{pad}link_send(l, &message);"]


def _instants_header(scenario: Scenario, motor_period: int) -> str:
    periods = ", ".join(map(str, sorted(set(scenario.world.periods()))))
    longest = scenario.world.max_step
    return f"""{LICENCE_NOTE}
/* When something is due in the world, in units of 100 ns; its longest step is {to_seconds(longest) * 1e3:g} ms. */
#ifndef INSTANTS_H
#define INSTANTS_H
#include <stdint.h>

static const int64_t PERIODS[] = {{{periods}}};
enum {{ MAX_STEP = {longest}, MOTOR_PERIOD = {motor_period} }};
#endif
"""


def _copy_sources(folder: Path, board: str) -> list[Path]:
    """The portable C and the start-up code, with the board as the Makefile's default."""
    source = PACKAGED_FIRMWARE if PACKAGED_FIRMWARE.is_dir() else CHECKOUT_FIRMWARE
    shutil.copytree(source, folder, dirs_exist_ok=True)
    for name, to in START_UP_FILES.items():
        shutil.copyfile(START / name, folder / to)
    make = folder / "Makefile"
    make.write_text(make.read_text("utf-8").replace("BOARD ?= cortex-m7", f"BOARD ?= {board}"), "utf-8")
    return [folder / p.relative_to(source) for p in sorted(source.rglob("*")) if p.is_file()] + [
        folder / to for to in START_UP_FILES.values()
    ]


def _write_texts(folder: Path, texts: dict[str, str]) -> list[Path]:
    for name, text in texts.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, "utf-8")
    return [folder / name for name in texts]


def key_image(key: SigningKey, since: float) -> bytes:
    """What a board reads its key from (firmware/portable/key.h); `since` is in Unix time."""
    stamp = int((since - EPOCH) * PER_SECOND)
    body = KEY_MAGIC + key.secret + stamp.to_bytes(8, "little")
    return body + zlib.crc32(body).to_bytes(4, "little")


def _write_key(path: Path, key: SigningKey) -> Path:
    """The key, and when it was written: nothing signed earlier is believed, for this board knows no calendar."""
    path.unlink(missing_ok=True)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(key_image(key, time.time()))
    return path
