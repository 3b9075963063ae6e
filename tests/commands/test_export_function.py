"""`trimtab export FILE.py:function`: where the example arguments come from, and what is written."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from trimtab.commands.export import find_function
from trimtab.core.errors import InputError

FILE = """
import jax.numpy as jnp
import numpy as np
from trimtab.loop.scenario import Scenario

def by_default(x=0.1, y=np.zeros(3)):
    return jnp.sin(x) + y

def by_name(v):
    return v * 2

def scenario(mass: float = 3.0) -> Scenario:
    raise AssertionError

example = {"by_name": (np.arange(4.0),)}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "own_functions.py"
    path.write_text(FILE)
    return path


def test_example_arguments_come_from_defaults_or_example_attribute(file: Path) -> None:
    found = find_function(f"{file}:by_default")
    assert found is not None
    assert found[1][0] == 0.1
    found = find_function(f"{file}:by_name")
    assert found is not None
    assert found[1][0].shape == (4,)
    assert find_function(f"{file}:scenario") is None
    assert find_function("hovercraft/spin") is None


def test_function_with_default_none_is_not_exportable(tmp_path: Path) -> None:
    path = tmp_path / "own_scenario.py"
    path.write_text("def scenario(assumed=None):\n    return assumed\n")
    assert find_function(f"{path}:scenario") is None


def test_rejects_example_that_is_not_a_tuple(tmp_path: Path) -> None:
    path = tmp_path / "own_wrong.py"
    path.write_text("example = 3.0\ndef f(x):\n    return x\n")
    with pytest.raises(InputError, match="not a tuple"):
        find_function(f"{path}:f")


@pytest.mark.thorough
def test_exported_function_is_verified(file: Path, tmp_path: Path) -> None:
    out = tmp_path / "c"
    command = [sys.executable, "-m", "trimtab", "export"]
    done = subprocess.run([*command, f"{file}:by_default", "--out", str(out), "--json"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["inputs"], told["outputs"], told["workspace_bytes"]) == (4, 3, 0)
    done = subprocess.run([*command, "--verify", str(out)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.thorough
def test_rejects_function_without_example_and_suggests_one(tmp_path: Path) -> None:
    path = tmp_path / "own_bare.py"
    path.write_text("def f(x):\n    return x\n")
    command = [sys.executable, "-m", "trimtab", "export", f"{path}:f", "--out", str(tmp_path / "c")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    assert "argument 'x' of the scenario's function has no default" in done.stderr
    assert "example = (" in done.stderr
