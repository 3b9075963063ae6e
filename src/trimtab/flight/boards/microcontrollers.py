"""Exported autopilot on an emulated microcontroller: check of the computed outputs, and measurement of instructions and
memory.

``emulate`` cross-compiles the C of an exported folder with Debian's arm-none-eabi gcc, and runs the autopilot with the
inputs of ``vectors.csv`` on a board that QEMU emulates. It reads back the outputs bit for bit, the number of
instructions of every step, and the use of flash, RAM and stack. The firmware around the autopilot is in ``firmware/``.
The page docs/export/boards.md explains the results.
"""

import contextlib
import itertools
import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trimtab.core.errors import InputError

FIRMWARE = Path(__file__).parent / "firmware"
PREFIX = "arm-none-eabi-"
EMULATOR = "qemu-system-arm"
STEPS = 500
NS_PER_INSTRUCTION_LOG2 = 8  # QEMU's -icount shift: 6.4 ticks of a 25 MHz timer for each instruction
AUTOPILOT_STACK = 256 * 1024
FLAGS = ("-mthumb", "-mfloat-abi=hard", "-O2", "-ffunction-sections", "-fdata-sections")
EXACT = ("-std=c99", "-ffp-contract=off", "-fno-tree-slp-vectorize", "-fwrapv", "-fno-math-errno")
WARNINGS = ("-Wall", "-Wextra", "-Werror")


class BoardTarget(NamedTuple):
    """Processor for an exported autopilot, and the board on which QEMU emulates the processor."""

    machine: str
    """QEMU's name of the board."""
    processor: tuple[str, ...]
    """Compiler flags for processor and FPU."""
    real: str
    """Precision of the processor's FPU and of the exported code: single or double."""
    flash: tuple[int, int] = (0x0000_0000, 0x40_0000)
    """First address and size (bytes) of the board's memory for code."""
    ram: tuple[int, int] = (0x2000_0000, 0x40_0000)
    """First address and size (bytes) of the board's memory for data."""
    timer: int = 0x4000_0004
    """Address of the register with the count of a 32-bit timer that counts down."""
    clock: int = 25_000_000
    """Frequency of the timer (Hz)."""


TARGETS = {
    "cortex-m4": BoardTarget("mps2-an386", ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16"), "single"),
    "cortex-m7": BoardTarget("mps2-an500", ("-mcpu=cortex-m7", "-mfpu=fpv5-d16"), "double"),
}


class EmulationResult(NamedTuple):
    """Results of an exported autopilot on an emulated board: outputs, instructions, and use of memory."""

    target: str
    outputs: NDArray[np.float64]
    """Outputs computed by the board: an array of shape (steps, number of outputs)."""
    expected_outputs: NDArray[np.float64]
    """Outputs expected by vectors.csv, with the shape of the computed outputs."""
    names: tuple[str, ...]
    """Names of the outputs, from the header of vectors.csv."""
    instructions: NDArray[np.int64]
    """Number of instructions of each call of autopilot_step, including its return."""
    flash_bytes: int
    """Size (bytes) of the code and constants of autopilot.c."""
    library_bytes: int
    """Size (bytes) of the code and constants that autopilot.c needs from the C, mathematics and compiler libraries."""
    ram_bytes: int
    """Size (bytes) of the autopilot's data: parameters, state, inputs, outputs, workspace, and static data of the
    libraries.

    autopilot.c has no static data.
    """
    stack_bytes: int
    """Largest depth of the stack (bytes) during defaults, init and the steps, measured with a painted stack."""
    image_bytes: int
    """Flash (bytes) of the whole image: autopilot, harness and inputs."""

    @property
    def instructions_per_step(self) -> tuple[int, int, int]:
        """Return smallest, median and largest number of instructions per step."""
        return int(self.instructions.min()), int(np.median(self.instructions)), int(self.instructions.max())


class BoardVectors(NamedTuple):
    """Test vectors for the board, from the first steps of vectors.csv: inputs, expected outputs and names of the
    outputs."""

    inputs: NDArray[np.float64]
    outputs: NDArray[np.float64]
    names: tuple[str, ...]


class HarnessOutput(NamedTuple):
    """Results that the firmware printed (see harness.c), as numbers."""

    sizes: list[int]
    empty: int
    loops: list[tuple[int, int]]
    steps: list[tuple[int, list[int]]]
    stack: int


def missing_tools() -> list[str]:
    """Return the names of the Debian packages that ``emulate`` needs and that are not installed."""
    missing = []
    if not shutil.which(PREFIX + "gcc"):
        missing += ["gcc-arm-none-eabi", "libnewlib-arm-none-eabi"]
    else:
        asked = [PREFIX + "gcc", *TARGETS["cortex-m7"].processor, *FLAGS, "-print-file-name=libm.a"]
        answer = subprocess.run(asked, capture_output=True, text=True).stdout.strip()
        if not Path(answer).is_absolute():  # gcc returns the requested name if the library is missing
            missing.append("libnewlib-arm-none-eabi")
    if not shutil.which(EMULATOR):
        missing.append("qemu-system-arm")
    return missing


def require_tools(target: str) -> None:
    """Raise InputError, with the command that installs the missing packages, if a Debian package is missing."""
    if missing := missing_tools():
        fix = "apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"
        raise InputError(
            f"target {target!r}", f"needs the Debian packages {', '.join(missing)}, which are not installed", fix=fix
        )


def emulate(folder: Path, target: str, steps: int = STEPS, limit_s: float = 120.0) -> EmulationResult:
    """Build the autopilot of an exported folder for a target board, run the autopilot on its test vectors under QEMU,
    and return the results.

    Args:
        folder: folder written by ``trimtab export``: autopilot.h, .c, vectors.h, .c, .csv, export.json.
        target: a key of TARGETS.
        steps: maximum number of steps of vectors.csv.
        limit_s: longest time (s) that the emulator may run.
    """
    if target not in TARGETS:
        raise InputError(f"target {target!r}", "cannot be emulated", choices=TARGETS)
    require_tools(target)
    folder, board = Path(folder).resolve(), TARGETS[target]
    vectors = read_vectors(folder, steps)
    with tempfile.TemporaryDirectory(prefix="trimtab-") as scratch:
        build = Path(scratch)
        flash, library, static, image = _build_image(folder, board, vectors, build)
        said = _parse_output(_run_emulator(board, build, limit_s), folder)
    bits = np.array([row for _, row in said.steps], dtype=np.uint64).reshape(len(said.steps), -1)
    return EmulationResult(
        target=target,
        outputs=bits.view(np.float64),
        expected_outputs=vectors.outputs,
        names=vectors.names,
        instructions=_instruction_counts(said, board),
        flash_bytes=flash,
        library_bytes=library,
        ram_bytes=sum(said.sizes) + static,
        stack_bytes=said.stack,
        image_bytes=image,
    )


def read_vectors(folder: Path, steps: int = STEPS) -> BoardVectors:
    """Return the first steps of vectors.csv in a folder. The file vectors.h defines the columns of inputs and
    outputs."""
    try:
        header = (folder / "vectors.h").read_text()
        with open(folder / "vectors.csv") as file:
            names = file.readline().strip().split(",")
            rows = [[float(cell) for cell in line.split(",")] for line in itertools.islice(file, steps)]
    except (OSError, ValueError) as error:
        fix = "write the folder again with `trimtab export`"
        raise InputError(str(folder), f"the test vectors cannot be read: {error}", fix=fix) from error
    counts = dict(re.findall(r"\b(VECTORS_IN|VECTORS_OUT)\s*=\s*(\d+)", header))
    n_in, n_out = int(counts.get("VECTORS_IN", -1)), int(counts.get("VECTORS_OUT", -1))
    widths = sorted({len(names), *map(len, rows)})
    if not rows or widths != [n_in + n_out]:
        problem = (
            f"vectors.csv has {len(rows)} steps, and header and rows of {' and '.join(map(str, widths))} columns; "
        )
        problem += f"vectors.h defines {n_in} inputs and {n_out} outputs"
        raise InputError(str(folder), problem, fix="write the folder again with `trimtab export`")
    table = np.array(rows)
    return BoardVectors(table[:, :n_in], table[:, n_in:], tuple(names[n_in:]))


def _build_image(folder: Path, board: BoardTarget, vectors: BoardVectors, build: Path) -> tuple[int, int, int, int]:
    """Build image.elf. Return four sizes (bytes): code of autopilot.c, code of the libraries, static data of the
    libraries, and flash of the complete image."""
    (build / "inputs.bin").write_bytes(np.ascontiguousarray(vectors.inputs, dtype="<f8").tobytes())
    steps, n_in = vectors.inputs.shape
    places = {"FLASH_ORIGIN": board.flash[0], "FLASH_SIZE": board.flash[1], "RAM_ORIGIN": board.ram[0]}
    places |= {"RAM_SIZE": board.ram[1], "AUTOPILOT_STACK": AUTOPILOT_STACK, "TIMER_VALUE": board.timer}
    counts = {"STEPS": steps, "INPUTS": n_in, "WORKSPACE": _workspace_bytes(folder)}
    numbers = [f"-D{name}={value:#x}" for name, value in (places | counts).items()]
    code = ["-c", *EXACT, *WARNINGS, *numbers, f"-I{folder}", f"-I{FIRMWARE}"]
    sources = [
        folder / "autopilot.c",
        folder / "vectors.c",
        *(FIRMWARE / f for f in ("start.c", "harness.c", "calls.S")),
    ]
    _run_gcc([*code, *sources], board, build, folder)
    (flash, data, bss), *_ = _read_sizes(["autopilot.o"], build)
    if data or bss:
        problem = f"has {data} bytes of static data and {bss} bytes of static zeros, which two autopilots would share"
        raise InputError(str(folder / "autopilot.c"), problem, fix="keep all data in the structure autopilot_state")
    link = ["-nostartfiles", "-specs=nano.specs", "-Wl,--gc-sections"]
    script = [*(f"-Wl,--defsym={name}={value:#x}" for name, value in places.items()), f"-T{FIRMWARE / 'link.ld'}"]
    objects = ["autopilot.o", "vectors.o", "start.o", "harness.o", "calls.o", "-lm"]
    _run_gcc([*link, *script, *objects, "-o", "image.elf"], board, build, folder)
    roots = [f"-Wl,--undefined=autopilot_{name}" for name in ("defaults", "init", "step")]
    _run_gcc(
        [*link, "-Wl,--entry=autopilot_step", *roots, "autopilot.o", "-lm", "-o", "alone.elf"], board, build, folder
    )
    (alone, data, bss), (image, *_) = _read_sizes(["alone.elf", "image.elf"], build)
    return flash, alone - flash, data + bss, image


def _workspace_bytes(folder: Path) -> int:
    """Return the size (bytes) of the workspace that autopilot_init and autopilot_step need, or 0 if export.json does
    not state one."""
    try:
        return int(json.loads((folder / "export.json").read_text(encoding="utf-8")).get("workspace_bytes", 0))
    except FileNotFoundError:
        return 0


def _run_gcc(arguments: list[str | Path], board: BoardTarget, build: Path, folder: Path) -> None:
    command = [PREFIX + "gcc", *board.processor, *FLAGS, *arguments]
    done = subprocess.run(command, cwd=build, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    if done.returncode:
        first = "\n".join(done.stderr.strip().splitlines()[:8])
        raise InputError(str(folder), f"the autopilot cannot be compiled for the board:\n{first}")


def _read_sizes(files: list[str], build: Path) -> list[tuple[int, int, int]]:
    """Return three sizes (bytes) for each object file: code and constants, static data, static zeros."""
    done = subprocess.run([PREFIX + "size", *files], cwd=build, capture_output=True, text=True, check=True)
    return [(int(a), int(b), int(c)) for a, b, c, *_ in (line.split() for line in done.stdout.splitlines()[1:])]


def _run_emulator(board: BoardTarget, build: Path, limit_s: float) -> str:
    """Run the emulator, without network, monitor, display or disk. Return the output of the firmware."""
    command = [EMULATOR, "-M", board.machine, "-kernel", "image.elf", "-nodefaults", "-no-reboot", "-display", "none"]
    command += ["-monitor", "none", "-serial", "none", "-chardev", "file,id=said,path=said.txt"]
    command += ["-semihosting-config", "enable=on,target=native,chardev=said"]
    command += ["-icount", f"shift={NS_PER_INSTRUCTION_LOG2},sleep=off"]
    with subprocess.Popen(
        command, cwd=build, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as emulator:
        try:
            if sys.platform == "linux":  # the emulator ends if this process is killed
                import resource

                seconds = 2 * int(limit_s) + 2
                with contextlib.suppress(OSError):
                    resource.prlimit(emulator.pid, resource.RLIMIT_CPU, (seconds, seconds))
            _, errors = emulator.communicate(timeout=limit_s)
        except subprocess.TimeoutExpired:
            errors = f"the emulator was stopped after {limit_s:g} s, before the end of the test"
        finally:
            emulator.kill()
    said = build / "said.txt"
    return (said.read_text() if said.exists() else "") + "\n" + re.sub(r"(?m)^.*: warning: .*\n", "", errors)


def _parse_output(said: str, folder: Path) -> HarnessOutput:
    """Return the results that the firmware printed. Raise InputError, with the last lines of the output, if the output
    is incomplete."""
    lines = said.split("\n")
    if "done" not in lines:
        last = " / ".join([line for line in lines if line.strip()][-2:])
        problem = f"the board did not reach the end of the flight; its last output: {last or 'none'}"
        raise InputError(str(folder), problem, fix="replay the same folder on this computer: `trimtab export --verify`")
    words: dict[str, list[list[int]]] = {}
    for word, *numbers in (line.split() for line in lines[: lines.index("done")]):
        words.setdefault(word, []).append([int(number, 16) for number in numbers])
    loops = [(n, ticks) for n, ticks in words["loop"]]
    steps = [(ticks, row) for ticks, *row in words["step"]]
    return HarnessOutput(words["sizes"][0], words["empty"][0][0], loops, steps, words["stack"][0][0])


def _instruction_counts(said: HarnessOutput, board: BoardTarget) -> NDArray[np.int64]:
    """Convert the timer ticks of each step to instructions.

    The ticks of an empty measurement are subtracted, except those of the one instruction that it contains.
    """
    ticks_per_instruction = board.clock * 2**NS_PER_INSTRUCTION_LOG2 / 1e9

    def count(ticks: list[int]) -> NDArray[np.int64]:
        return np.rint((np.array(ticks) - said.empty) / ticks_per_instruction).astype(np.int64) + 1

    known, found = [2 * n + 1 for n, _ in said.loops], count([ticks for _, ticks in said.loops]).tolist()
    if found != known:
        problem = (
            f"the board's timer does not run as expected: it counts {found} instructions for test loops of {known} "
            "instructions"
        )
        raise InputError(EMULATOR, problem, fix="use QEMU 7.2 or newer")
    return count([ticks for ticks, _ in said.steps])
