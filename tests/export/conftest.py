"""Boards where their tools are."""

import os
import time
from pathlib import Path

import pytest

from trimtab.export.boards import missing_tools


@pytest.fixture(scope="session")
def board_tools():
    """Skip where the tools for boards are not installed; wait for them, and insist, where .ci/run installs them."""
    installing = os.environ.get("TRIMTAB_CI_TOOLS")
    if installing:
        deadline = time.monotonic() + 280
        while not Path(installing).exists() and time.monotonic() < deadline:
            time.sleep(0.5)
        assert Path(installing).exists(), "the tools were still being installed"
        assert not missing_tools()
    elif missing := missing_tools():
        pytest.skip(f"needs Debian's {', '.join(missing)}")
