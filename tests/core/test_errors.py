"""Errors name the part, the value, the choices and the fix."""

import pickle
import sys
from pathlib import Path

import pytest

import trimtab
from trimtab.core.errors import InputError, install_command


def test_message_has_part_problem_choices_and_fix():
    error = InputError("world.law", "there is no law 'spn'", choices=["spin", "zero"], fix="--law spin")
    assert str(error) == "world.law: there is no law 'spn'.\nChoices: spin, zero.\nFix: --law spin"
    assert (error.part, error.problem, error.choices, error.fix) == (
        "world.law",
        "there is no law 'spn'",
        ("spin", "zero"),
        "--law spin",
    )


def test_message_without_choices_and_fix_is_one_line():
    assert str(InputError("mass", "-1 kg is not above 0.")) == "mass: -1 kg is not above 0."


def test_input_error_is_a_value_error():
    with pytest.raises(ValueError, match="mass"):
        raise InputError("mass", "bad")


def test_choices_may_be_any_iterable():
    assert InputError("a", "b", choices=(c for c in "xy")).choices == ("x", "y")


def test_survives_pickling_between_processes():
    error = InputError("mass", "bad", choices=["a"], fix="do b")
    copy = pickle.loads(pickle.dumps(error))
    assert str(copy) == str(error)
    assert copy.choices == ("a",)


def test_install_command_uses_the_running_python(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    python = str(tmp_path / "a b" / "python")
    monkeypatch.setattr(sys, "executable", python)
    assert install_command("logs") == f"'{python}' -m pip install \"trimtab[logs]\""
    assert install_command("cuda12", "jax") == f"'{python}' -m pip install \"jax[cuda12]\""
    assert install_command(package="pytest") == f"'{python}' -m pip install pytest"


def test_only_core_errors_contains_pip_install_commands():
    package = Path(trimtab.__file__).parent
    saying = [p.relative_to(package).as_posix() for p in package.rglob("*.py") if "pip install" in p.read_text("utf-8")]
    assert saying == ["core/errors.py"]
