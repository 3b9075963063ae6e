"""The firmware of hovercraft/forward: written once, built for the computer and for the board."""

import ctypes
import os
import shutil
import subprocess
from pathlib import Path

import pytest
from firmware.host import KEY, Host

from trimtab.flight.boards.firmware_folder import write_firmware
from trimtab.flight.boards.microcontrollers import missing_tools
from trimtab.scenarios import catalogue

FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off", "-fwrapv"]
PARTS = ("portable", "drive", "emulated", "exported")
SANITIZERS = ["-O0", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]


def compile_here(folder, output, *arguments):
    """Build the portable part with files of this folder for this computer."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler here")
    sources = [str(f) for part in PARTS for f in sorted((folder / part).glob("*.c"))]
    include = [f"-I{folder / part}" for part in PARTS]
    command = [
        "cc",
        *FLAGS,
        *include,
        "-isystem",
        str(folder / "mavlink"),
        *arguments,
        *sources,
        "-lm",
        "-o",
        str(output),
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return output


@pytest.fixture(scope="session")
def written(tmp_path_factory):
    scenario, _ = catalogue.load_scenario("hovercraft/forward", {})
    return write_firmware(scenario, tmp_path_factory.mktemp("firmware"), KEY)


@pytest.fixture(scope="session")
def fuzzer(written, tmp_path_factory):
    here = Path(__file__).parent
    output = tmp_path_factory.mktemp("fuzz") / "fuzz"
    sources = [str(here / name) for name in ("host.c", "power.c", "fuzz.c")]
    return compile_here(written.folder, output, *SANITIZERS, *sources)


def load_library(written, folder, *options):
    """The firmware in a folder as a library of this computer."""
    sources = [str(Path(__file__).parent / name) for name in ("host.c", "power.c")]
    made = ctypes.CDLL(
        str(compile_here(written.folder, folder / "host.so", "-O1", "-shared", "-fPIC", *options, *sources))
    )
    made.host_sent.restype = ctypes.c_size_t
    made.host_width.restype = made.host_duty.restype = ctypes.c_uint16
    made.host_kept.restype = ctypes.c_uint64
    made.host_truth.restype = ctypes.POINTER(ctypes.c_double)
    made.host_record.restype = ctypes.POINTER(ctypes.c_uint32)
    return made


@pytest.fixture(scope="session")
def library(written, tmp_path_factory):
    return load_library(written, tmp_path_factory.mktemp("host"))


@pytest.fixture
def host(library, written):
    return Host(library, written.dialect)


@pytest.fixture(scope="session")
def elf(written):
    return build_elf(written.folder)


def build_elf(folder, *options):
    """Build the image for the board, with options of its Makefile.

    Without the tools the test is skipped; where TRIMTAB_CI_TOOLS is set, as in .ci/run, it fails.
    """
    if missing := missing_tools():
        assert "TRIMTAB_CI_TOOLS" not in os.environ, missing
        pytest.skip(f"needs Debian's {', '.join(missing)}")
    if not shutil.which("make"):
        pytest.skip("needs make")
    done = subprocess.run(["make", "-s", "-j2", *options], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder / "firmware.elf"
