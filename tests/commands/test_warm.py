"""A run flown before flies again without JAX, and gives the same; whatever has changed is noticed."""

import json
import os
import subprocess
import sys
import time

import pytest

from trimtab.native.compiler import find_compiler

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
    made, _ = catalogue.load("hovercraft/zero-velocity")
    return replace(made, duration=ms(DURATION), name="boat")
"""


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


def test_second_run_needs_no_jax_and_is_equal(run):
    first, jax = run("hovercraft/spin", "--duration", "1", "--seed", "4")
    assert jax
    assert first["backend"] == "c"
    again, jax = run("hovercraft/spin", "--duration", "1", "--seed", "4")
    assert not jax
    assert same(first, again)
    other, jax = run("hovercraft/spin", "--duration", "1", "--seed", "5")
    assert not jax
    assert other["real"] != first["real"]
    assert run("hovercraft/spin", "--duration", "1", "--seed", "4", "--set", "world.vehicle.mass=3")[1]


def test_changed_scenario_of_the_user_is_noticed(run, tmp_path):
    file = tmp_path / "boat.py"
    file.write_text(BOAT.replace("DURATION", "200"))
    time.sleep(2.5)  # a file as new as the run itself is never trusted
    assert run("boat.py:scenario")[0]["duration_s"] == pytest.approx(0.2)
    result, jax = run("boat.py:scenario")
    assert result["duration_s"] == pytest.approx(0.2)
    assert not jax
    file.write_text(BOAT.replace("DURATION", "300"))
    result, jax = run("boat.py:scenario")
    assert result["duration_s"] == pytest.approx(0.3)
    assert jax


@pytest.mark.slow
def test_a_library_that_is_gone_or_damaged_is_made_again(run, tmp_path):
    words = ("hovercraft/spin", "--duration", "1", "--no-ideal")
    first, _ = run(*words)
    [library] = (tmp_path / "cache" / "c").glob("*.so")
    library.write_bytes(library.read_bytes()[:1000])
    again, jax = run(*words)
    assert jax
    assert same(first, again)
    assert not run(*words)[1]
