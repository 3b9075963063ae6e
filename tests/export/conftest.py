"""Boards and other platforms where their tools are."""

import os
import shutil

import pytest

from trimtab.flight.boards.microcontrollers import missing_tools

PLATFORM_TOOLS = {"clang": "clang", "aarch64-linux-gnu-gcc": "gcc-aarch64-linux-gnu", "qemu-aarch64": "qemu-user"}
"""Program -> Debian's package, beside gcc."""


def require(missing):
    """Skip the test if Debian packages are missing; fail it instead where TRIMTAB_CI_TOOLS is set, as .ci/run does."""
    if packages := missing():
        assert "TRIMTAB_CI_TOOLS" not in os.environ, packages
        pytest.skip(f"needs Debian's {', '.join(packages)}")


@pytest.fixture(scope="session")
def board_tools():
    """Compiler and emulator of microcontrollers."""
    require(missing_tools)


@pytest.fixture(scope="session")
def platform_tools():
    """Compilers and emulator of other platforms."""
    require(lambda: [package for program, package in PLATFORM_TOOLS.items() if not shutil.which(program)])
