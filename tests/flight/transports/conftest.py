"""A runtime folder for the sockets of loopback links."""

from typing import Any

import pytest


@pytest.fixture
def runtime(tmp_path: Any, monkeypatch: Any) -> Any:
    """A folder of its own for the sockets of loopback links."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path
