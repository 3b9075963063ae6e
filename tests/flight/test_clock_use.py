"""Live code reads the time from the clock it is given. Only the files listed here may wait for sockets directly."""

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[2] / "src" / "trimtab"
FOLDERS = ("flight", "links")
READERS = {"time", "sched", "asyncio"}
"""Modules by which code could wait or read the time without a clock."""
POLLERS = {"select"}
WAITS_FOR_SOCKETS = {"flight/transports/reconnecting_stream.py", "flight/transports/accepting_dialer.py"}
"""Links over kernel descriptors. They wait by `core.clock.wait_until_ready`, and need select's constants."""


def imports(path):
    """Names of the modules that a file imports."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module.partition(".")[0])
    return names


FILES = sorted(path for folder in FOLDERS for path in (SOURCE / folder).rglob("*.py"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_live_code_reads_time_only_from_its_clock(path):
    name, found = path.relative_to(SOURCE).as_posix(), imports(path)
    assert found & READERS == set(), f"{name} must be handed a Clock (core/clock.py)"
    if name not in WAITS_FOR_SOCKETS:
        assert found & POLLERS == set(), f"{name} must wait by its Clock"


def test_files_exempt_from_the_check_exist():
    assert all((SOURCE / name).is_file() for name in WAITS_FOR_SOCKETS)


def test_the_check_finds_every_way_to_import_time(tmp_path):
    for text in ("import time", "from time import sleep", "import time as t", "def f():\n    import time"):
        file = tmp_path / "x.py"
        file.write_text(text)
        assert imports(file) == {"time"}
