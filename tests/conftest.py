"""Settings of all tests: property tests without deadline, a runtime folder for each process, memory freed file by file.

Property tests have no deadline, because first calls compile, and draw the same examples each time where CI is set.

What XLA compiles is kept beside pytest's own cache, so that after an edit only what it touched is compiled again; and
XLA's flags of `emitters.py` save half of the time to compile. XLA_FLAGS= (empty) leaves XLA as users have it.
"""

import os
import socket
import sys
import tempfile
from pathlib import Path
from typing import Any

import answers
import emitters
import pytest
import slow_parts
from hypothesis import settings

if emitters.FLAGS:
    os.environ.setdefault("XLA_FLAGS", emitters.FLAGS)
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parents[1] / ".pytest_cache" / "jax"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")

settings.register_profile("trimtab", deadline=None, derandomize=bool(os.environ.get("CI")))
settings.load_profile("trimtab")

SLOW_S = 900
"""After which a slow test is given up, where it doesn't say otherwise: a busy machine takes five times as long."""


@pytest.fixture(autouse=True, scope="session")
def _own_runtime_folder():
    """Give each process of pytest its own folder for sockets: otherwise all of a user share the names of links."""
    with tempfile.TemporaryDirectory(prefix="trimtab-") as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", folder)
        yield


BOUND: list[Any] = []
"""Addresses of network sockets that this process has bound."""


def _note_address(event: str, arguments: tuple[Any, ...]) -> None:
    if event == "socket.bind" and arguments[0].family in (socket.AF_INET, socket.AF_INET6):
        BOUND.append(arguments[1])


sys.addaudithook(_note_address)


@pytest.fixture(autouse=True)
def _ports_are_for_real_time_tests(request: pytest.FixtureRequest):
    """Fail a test that opens a network port without the mark real_time: two runs at once may want the same port."""
    before = len(BOUND)
    yield
    if not request.node.get_closest_marker("real_time"):
        assert BOUND[before:] == [], "mark this test real_time: it opens a network port"


@pytest.fixture(autouse=True, scope="module")
def _compiled_programs_are_dropped():
    """What one file compiled is of no use to the next, and takes gigabytes in the end."""
    yield
    if "jax" in sys.modules:
        sys.modules["jax"].clear_caches()


@pytest.fixture(autouse=True, scope="session")
def _answers_are_as_published():
    """Every answer that a command prints in a test's own process is held to the schema of answers."""
    from trimtab.commands import output

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(output, "compose_answer", answers.compose_checked)
        yield


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--part", type=int, metavar="K", help=f"only the part K of {slow_parts.PARTS} of the slow tests")
    parser.addoption("--slice", type=int, default=0, metavar="N", help="and slice N of those that are cut in slices")


def pytest_report_header(config: pytest.Config) -> str | None:
    part = config.getoption("part")
    return part and f"slow tests: part {part} of {slow_parts.PARTS}, slice {config.getoption('slice')}"


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Files that have nothing of the part are not read: collecting all takes each process 15 s."""
    part = config.getoption("part")
    if not part or not collection_path.name.startswith("test_"):
        return None
    text = collection_path.read_text(encoding="utf-8")
    file = collection_path.relative_to(config.rootpath).as_posix()
    own = slow_parts.read_table()["files"].get(file, [0])[0]
    return ("slow" not in text or (own not in (0, part) and "slow(of" not in text)) or None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Of slow tests those of the part that was asked for, if one was; they may take longer than others."""
    for item in items:
        if item.get_closest_marker("slow") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(SLOW_S))
    part = config.getoption("part")
    if not part:
        return
    files = slow_parts.read_table()["files"]

    def is_due(item: pytest.Item) -> bool:
        mark = item.get_closest_marker("slow")
        if mark and "of" in mark.kwargs:
            return sum(item.callspec.indices.values()) % mark.kwargs["of"] == config.getoption("slice")  # pyright: ignore[reportAttributeAccessIssue]
        return mark is not None and slow_parts.part_of(item.nodeid, files) == part

    due = [item for item in items if is_due(item)]
    config.hook.pytest_deselected(items=[item for item in items if item not in due])
    items[:] = due


@pytest.fixture
def wide_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tables with all their columns: pytest's workers say that a screen is 80 wide."""
    monkeypatch.setenv("COLUMNS", "160")
