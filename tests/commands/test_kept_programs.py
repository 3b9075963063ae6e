"""A catalogue scenario flown before flies again without JAX, and gives the same; whatever has changed is noticed."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import trimtab
from trimtab.commands.kept_programs import (
    RunPrograms,
    describe_installation,
    load_programs,
    program_key,
    store_programs,
)
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.quantity import Quantity
from trimtab.logs.metrics import Target
from trimtab.run.program import Column, Program

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")

RUN = """
import json, sys
sys.argv = ["trimtab", "run", *sys.argv[1:], "--json"]
from trimtab.cli import main
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
print(json.dumps("jax" in sys.modules))
"""
BOAT = """
from trimtab.core.record import replace
from trimtab.core.time import ms
from trimtab.scenarios import catalogue

def scenario():
    made, _ = catalogue.load_scenario("hovercraft/zero-velocity")
    return replace(made, duration=ms(DURATION), name="boat")
"""
WORDS = ("hovercraft/spin", "--duration", "1")


@pytest.fixture
def run(tmp_path):
    """Run trimtab in a new process with a cache of this test's own; gives (result, whether JAX was imported)."""
    surroundings = os.environ | {
        "TRIMTAB_CACHE": str(tmp_path / "cache"),
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
    }

    def go(*words):
        command = [sys.executable, "-c", RUN, *words]
        done = subprocess.run(
            command, capture_output=True, text=True, env=surroundings, cwd=tmp_path, timeout=120, check=False
        )
        assert done.returncode == 0, done.stderr
        result, jax = done.stdout.strip().splitlines()
        return json.loads(result), json.loads(jax)

    return go


def same(a, b):
    return {k: v for k, v in a.items() if k != "wall_s"} == {k: v for k, v in b.items() if k != "wall_s"}


def kept(tmp_path):
    return sorted((tmp_path / "cache" / "programs").glob("*"))


@pytest.mark.thorough
def test_second_run_needs_no_jax_and_is_equal(run):
    first, jax = run(*WORDS, "--seed", "4")
    assert jax
    assert first["backend"] == "c"
    again, jax = run(*WORDS, "--seed", "4")
    assert not jax
    assert same(first, again)
    other, jax = run(*WORDS, "--seed", "5")
    assert not jax
    assert other["real"] != first["real"]
    assert run(*WORDS, "--seed", "4", "--set", "world.vehicle.mass=3")[1]


@pytest.mark.thorough
def test_scenarios_of_the_user_are_not_kept(run, tmp_path):
    file = tmp_path / "boat.py"
    for duration in (200, 300):
        file.write_text(BOAT.replace("DURATION", str(duration)))
        result, jax = run("boat.py:scenario")
        assert result["duration_s"] == pytest.approx(duration / 1000)
        assert jax
    assert kept(tmp_path) == []


@pytest.mark.thorough
def test_damaged_entries_are_made_again(run, tmp_path):
    first, _ = run(*WORDS, "--no-ideal")
    (file,) = kept(tmp_path)
    assert file.stat().st_mode & 0o777 == 0o600
    whole = file.read_bytes()
    for damaged in (b"", whole[:1000], whole.replace(b"hovercraft", b"Hovercraft", 1)):
        file.write_bytes(damaged)
        again, jax = run(*WORDS, "--no-ideal")
        assert jax
        assert same(first, again)
    assert file.read_bytes() == whole
    assert not run(*WORDS, "--no-ideal")[1]


@pytest.mark.thorough
def test_a_library_that_is_gone_or_damaged_is_made_again(run, tmp_path):
    first, _ = run(*WORDS, "--no-ideal")
    [library] = (tmp_path / "cache" / "c").glob("*.so")
    library.write_bytes(library.read_bytes()[:1000])
    again, jax = run(*WORDS, "--no-ideal")
    assert jax
    assert same(first, again)
    assert not run(*WORDS, "--no-ideal")[1]


def key(scenario="hovercraft/spin", settings=(), without=(), faults=(), ideal=True):
    return program_key(scenario, dict(settings), without, faults, ideal)


def test_each_part_of_a_request_makes_another_key():
    settings = {"world.vehicle.mass": "3", "links": "measured"}
    requests = [
        {},
        {"scenario": "hovercraft/forward"},
        {"settings": settings},
        {"without": ["navigation-error"]},
        {"faults": ["navigation-error"]},
        {"ideal": False},
    ]
    assert len({key(**request) for request in requests}) == len(requests)
    assert key(settings=settings) == key(settings=dict(reversed(settings.items())))


def test_files_of_the_user_have_no_key(tmp_path):
    (tmp_path / "uplink.csv").write_text("")
    assert key("boat.py:scenario") is None
    assert key("boat:scenario") is None
    assert key(settings={"uplink": str(tmp_path / "uplink.csv")}) is None
    assert key(settings={"uplink": str(tmp_path / "none.csv")}) is not None  # which `build` refuses


@pytest.mark.parametrize("what", ["contents", "name", "installed", "python", "cpu"])
def test_changed_surroundings_make_another_key(what, tmp_path, monkeypatch):
    site, package = tmp_path / "site-packages", tmp_path / "package"
    (site / "jax-0.10.2.dist-info").mkdir(parents=True)
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "a.py").write_text("X = 1\n")
    monkeypatch.setattr(trimtab, "__file__", str(package / "__init__.py"))
    monkeypatch.setattr(sys, "path", [*sys.path, str(site)])
    describe_installation.cache_clear()
    try:
        before = key()
        if what == "contents":
            (package / "a.py").write_text("X = 2\n")
        elif what == "name":
            (package / "a.py").rename(package / "b.py")
        elif what == "installed":
            (site / "jax-0.10.2.dist-info").rename(site / "jax-0.10.3.dist-info")
        elif what == "python":
            monkeypatch.setattr(sys, "version", "3.99")
        else:
            monkeypatch.setattr("trimtab.commands.kept_programs.cpu_identity", lambda: "another")
        assert what == "cpu" or key() == before  # this process goes on with what it has loaded
        describe_installation.cache_clear()
        assert key() != before
    finally:
        describe_installation.cache_clear()


@pytest.fixture
def programs(tmp_path, monkeypatch):
    """Programs without a library: what is kept of them is read, never called."""
    monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("trimtab.commands.kept_programs.find_library", lambda name: Path(f"{name}.so"))
    mode = Quantity("1", "ψ", kind="mode", modes=("a", "b"), low=-math.inf)
    columns = [Column("law.mode", (), "int32", mode), Column("truth.x", (2,), "float64")]
    real = Program(
        Path("x.so"), np.array([1.5, np.nan, -np.inf, -0.0, 0.1]), (0, 1), (10_000, 65_536), 10**7, 50_000,
        columns, columns[1:], {"scenario": "ψ", "parameters": {"a": [1.0, math.inf], "b": None}}, (7, 2**32 - 1),
    )  # fmt: skip
    return RunPrograms("ψ", real, None, (Target("yaw_rate", 3.0, 0.1),))


def test_what_was_kept_is_found_to_the_bit(programs):
    assert load_programs("k") is None
    store_programs("k", programs)
    found = load_programs("k")
    assert found is not None
    inputs, expected = found.real.shared_inputs, programs.real.shared_inputs
    assert (inputs.dtype, inputs.tobytes()) == (expected.dtype, expected.tobytes())
    assert found.real._replace(shared_inputs=None) == programs.real._replace(shared_inputs=None)
    assert (found.name, found.ideal, found.targets) == (programs.name, None, programs.targets)
    assert load_programs("other") is None


def test_the_oldest_go(programs, tmp_path, monkeypatch):
    monkeypatch.setattr("trimtab.commands.kept_programs.LIMIT", 3)
    for n in range(5):
        store_programs(str(n), programs)
        os.utime(tmp_path / "cache" / "programs" / f"{n}.json", (n, n))
    store_programs("5", programs)
    assert [n for n in range(6) if load_programs(str(n))] == [3, 4, 5]


def test_entries_and_folders_that_others_can_write_to_are_refused(programs, tmp_path):
    store_programs("k", programs)
    (file,) = kept(tmp_path)
    file.chmod(0o666)
    assert load_programs("k") is None
    file.chmod(0o600)
    file.parent.chmod(0o777)
    assert load_programs("k") is None
    store_programs("l", programs)
    assert kept(tmp_path) == [file]
    file.parent.chmod(0o700)
    assert load_programs("k") is not None


def test_without_a_cache_nothing_is_kept(programs, tmp_path, monkeypatch):
    (tmp_path / "taken").write_text("")
    monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path / "taken"))
    store_programs("k", programs)
    assert load_programs("k") is None


def test_a_full_disk_leaves_the_old_entry_and_nothing_else(programs, tmp_path, monkeypatch):
    store_programs("k", programs)
    whole = kept(tmp_path)[0].read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    store_programs("k", programs._replace(name="other"))
    assert [file.read_bytes() for file in kept(tmp_path)] == [whole]
