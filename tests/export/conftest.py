"""Boards and other platforms where their tools are."""

import os
import shutil
import time
from pathlib import Path

import pytest

from trimtab.export.boards import missing_tools

PLATFORM_TOOLS = {"clang": "clang", "aarch64-linux-gnu-gcc": "gcc-aarch64-linux-gnu", "qemu-aarch64": "qemu-user"}
"""Program -> Debian's package, beside gcc."""


def require(missing):
    """Skip where tools are not installed; wait for them, and insist, where .ci/run installs them."""
    installing = os.environ.get("TRIMTAB_CI_TOOLS")
    if installing:
        deadline = time.monotonic() + 280
        while not Path(installing).exists() and time.monotonic() < deadline:
            time.sleep(0.5)
        assert Path(installing).exists(), "the tools were still being installed"
        assert not missing()
    elif packages := missing():
        pytest.skip(f"needs Debian's {', '.join(packages)}")


@pytest.fixture(scope="session")
def board_tools():
    """Compiler and emulator of microcontrollers."""
    require(missing_tools)


@pytest.fixture(scope="session")
def platform_tools():
    """Compilers and emulator of other platforms."""
    require(lambda: [package for program, package in PLATFORM_TOOLS.items() if not shutil.which(program)])
