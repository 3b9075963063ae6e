"""Settings of all tests: the three tiers, and a runtime folder for each process.

Property tests have no deadline, because first calls compile. At the gate they draw the same examples in every run.

What XLA compiles is kept beside pytest's own cache, so that after an edit only what it touched is compiled again. XLA's
flags of `xla_settings.py` save more than half of the time to compile. XLA_FLAGS= (empty) leaves XLA as users have it.
"""

import contextlib
import os
import re
import secrets
import socket
import sys
import tempfile
from pathlib import Path
from typing import Any

import answers
import pytest
import xla_settings
from host_witness import HostWitness
from hypothesis import settings
from memory import Memory
from parts import deselect_other_parts, parse_part
from thorough_cases import keep_quick_cases
from verdicts import Verdicts

os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parents[1] / ".pytest_cache" / "jax"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # of several workers, threads of BLAS wait for each other and spin
os.environ.setdefault("JAX_TRACEBACK_IN_LOCATIONS_LIMIT", "0")  # nobody reads the places in programs of XLA

settings.register_profile("gate", deadline=None, derandomize=True)
settings.register_profile("thorough", deadline=None, derandomize=False, print_blob=True)
settings.load_profile("gate")

EXAMPLE_TIMEOUT_S = 6
"""Additional timeout for each random example of a test."""

RANDOM_EXAMPLES = 300
"""Number of random examples of each test that takes the fixture random_examples, where no other number is given."""


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


@pytest.fixture(autouse=True, scope="session")
def _answers_are_as_published():
    """Every answer that a command prints in a test's own process is held to the schema of answers."""
    from trimtab.commands import output

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(output, "compose_answer", answers.compose_checked)
        yield


@pytest.fixture(autouse=True, scope="session")
def _no_reminders():
    """A command in a test's own process prints no line for every ten seconds that it takes: machines differ."""
    from trimtab.commands import progress

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(progress, "_reminders", contextlib.nullcontext)
        yield


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--random-seed", type=int, metavar="SEED", help="first seed of the random examples; default: drawn"
    )
    parser.addoption(
        "--random-examples",
        type=int,
        metavar="N",
        default=RANDOM_EXAMPLES,
        help=f"number of random examples in each of the tests that draw them; default: {RANDOM_EXAMPLES}",
    )

    parser.addoption("--part", type=parse_part, metavar="K/N", help="run part K of N parts of the tests")


def pytest_configure(config: pytest.Config) -> None:
    """Draw the random seed, which workers of xdist receive with the other options, and register the plugins."""
    config.pluginmanager.register(Verdicts(), "verdicts")
    config.pluginmanager.register(Memory(), "memory")
    if config.option.random_seed is None:
        config.option.random_seed = secrets.randbelow(10**8) * 10
    if _names(config, "thorough"):
        settings.load_profile("thorough")
    has_long_programs = _names(config, "thorough") or _names(config, "real_time")
    os.environ.setdefault("XLA_FLAGS", xla_settings.choose_flags(optimise=has_long_programs))
    if hasattr(config, "workerinput") and [Path(arg).resolve() for arg in config.args] == [TESTS]:
        config.args = _rotate_folders(config.workerinput["workerid"], config.workerinput["workercount"])


TESTS = Path(__file__).parent


def _rotate_folders(worker: str, count: int) -> list[str]:
    """Return all folders and files of tests, in another order for each worker of xdist.

    Each worker then compiles another part of the files first, and reads what the others have compiled meanwhile.
    """
    all_of_them = sorted(str(p) for p in TESTS.iterdir() if p.is_dir() or p.name.startswith("test_"))
    start = int(worker.removeprefix("gw")) * len(all_of_them) // count
    return [*all_of_them[start:], *all_of_them[:start]]


def _names(config: pytest.Config, mark: str) -> bool:
    """Return True if the user asked for this mark by -m."""
    return re.search(rf"(?<!not ){mark}\b", config.option.markexpr) is not None


def pytest_report_header(config: pytest.Config) -> str | None:
    if not _names(config, "thorough"):
        return None
    return (
        f"random examples: --random-examples {config.option.random_examples} --random-seed {config.option.random_seed}"
    )


@pytest.fixture
def host_witness(pytestconfig: pytest.Config) -> HostWitness:
    """Return the witness of the host beside this process. Skip the test where the kernel gives no evidence."""
    verdicts = pytestconfig.pluginmanager.get_plugin("verdicts")
    assert isinstance(verdicts, Verdicts)
    return verdicts.witness() or pytest.skip("no /proc/self/schedstat here")


@pytest.fixture
def random_examples(request: pytest.FixtureRequest) -> range:
    """Seeds of the random examples: as many as --random-examples says, from --random-seed on."""
    first = request.config.option.random_seed
    print(f"seeds {first} to {first + request.config.option.random_examples - 1}")
    print(f"run again: pytest -m thorough --random-seed {first} {request.node.nodeid}")
    return range(first, first + request.config.option.random_examples)


@pytest.hookimpl(wrapper=True)
def pytest_pycollect_makeitem():
    """Apply a mark thorough that names cases to these cases only."""
    made = yield
    if isinstance(made, list):
        keep_quick_cases(made)
    return made


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect real-time tests unless -m names them, and give random examples a longer timeout.

    The files are sorted, since the workers of xdist must have one order.
    """
    if hasattr(config, "workerinput"):
        items.sort(key=lambda item: str(item.path))
    if config.option.markexpr and "real_time" not in config.option.markexpr:
        timed = [item for item in items if item.get_closest_marker("real_time")]
        config.hook.pytest_deselected(items=timed)
        items[:] = [item for item in items if not item.get_closest_marker("real_time")]
    deselect_other_parts(config, items)
    for item in items:
        if "random_examples" in getattr(item, "fixturenames", ()) and not item.get_closest_marker("timeout"):
            more = config.option.random_examples * EXAMPLE_TIMEOUT_S
            item.add_marker(pytest.mark.timeout(float(config.getini("timeout")) + more))


@pytest.fixture
def wide_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tables with all their columns: pytest's workers say that a screen is 80 wide."""
    monkeypatch.setenv("COLUMNS", "160")
