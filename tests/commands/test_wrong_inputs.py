"""A hundred wrong inputs: each is rejected with a fix, and no file is changed or left behind."""

import json
import shlex
import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner

from trimtab.cli import main

LISTED = tomllib.loads(Path(__file__).with_name("wrong_inputs.toml").read_text("utf-8"))
CASES = [(line, words) for group in LISTED.values() for line, words in group.items()]
QUICK = 10
"""Each so-manieth is tried with every change, all of them with the thorough tests."""
OWN = {
    "own.py": "number = 3\n\n\ndef mine():\n    return 3\n",
    "syntax.py": "import trimtab\ndef scenario(:\n",
    "raises.py": "import trimtab\n\nx = 1 / 0\n",
    "imports.py": "import no_such_package\n",
    "mine.txt": "something of my own\n",
    "mine.png": "something of my own\n",
}


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with files of one's own; the user's keys and cache are elsewhere."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    folder = tmp_path / "here"
    folder.mkdir()
    for name, text in OWN.items():
        (folder / name).write_text(text)
    monkeypatch.chdir(folder)
    return folder


def read_files(folder):
    return {p.name: p.read_text() for p in folder.rglob("*") if p.is_file() and p.suffix != ".pyc"}


def check_answer(line, words, here):
    done = CliRunner().invoke(main, shlex.split(line.replace("{here}", str(here))))
    assert done.exit_code == 2, done.output
    assert isinstance(done.exception, SystemExit), done.exception
    assert [word for word in words if word not in done.stderr] == [], done.stderr
    assert "Traceback" not in done.output
    assert "Fix:" in done.stderr or "--help" in done.stderr
    assert read_files(here) == OWN


def test_at_least_hundred_wrong_inputs_are_listed():
    assert len(CASES) >= 100


@pytest.mark.parametrize(("line", "words"), CASES[::QUICK], ids=[line for line, _ in CASES[::QUICK]])
def test_wrong_input_is_rejected_with_fix(line, words, here):
    check_answer(line, words, here)


@pytest.mark.thorough
@pytest.mark.parametrize(("line", "words"), CASES, ids=[line for line, _ in CASES])
def test_every_wrong_input_is_rejected_with_fix(line, words, here):
    check_answer(line, words, here)


@pytest.mark.parametrize(
    "line", ["run hovercraft/spinn --json", "run --json", "rum --json", "run hovercraft/spin --plto x --json"]
)
def test_json_error_is_an_object_with_fix(line):
    done = CliRunner().invoke(main, shlex.split(line))
    assert done.exit_code == 2
    error = json.loads(done.stdout)["error"]
    assert set(error) == {"part", "problem", "choices", "fix"}
    assert error["fix"]
