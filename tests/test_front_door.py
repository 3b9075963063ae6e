"""The names at the package's front door: all there, typed, and free until used."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import trimtab


@pytest.mark.parametrize("name", trimtab.HOMES)
def test_every_name_is_the_thing_at_its_home(name):
    home = importlib.import_module(f"trimtab.{trimtab.HOMES[name]}")
    assert getattr(trimtab, name) is getattr(home, name)


def test_type_checkers_see_the_same_names():
    stub = Path(trimtab.__file__).with_suffix(".pyi").read_text(encoding="utf-8")
    seen = {name: home for home, name in re.findall(r"from trimtab\.(\S+) import (\w+) as \2", stub)}
    assert seen == trimtab.HOMES


def test_importing_the_package_imports_nothing_heavy():
    code = "import sys, trimtab; print([m for m in ('jax', 'numpy', 'scipy', 'click') if m in sys.modules])"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"


def test_a_name_there_is_not_says_which_there_are():
    with pytest.raises(AttributeError, match="Campaign"):
        trimtab.campain  # noqa: B018
