"""The mark thorough, applied to named cases of a parametrised test."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import thorough_cases

CONFTEST = """
import pytest
from thorough_cases import keep_quick_cases

@pytest.hookimpl(wrapper=True)
def pytest_pycollect_makeitem():
    made = yield
    if isinstance(made, list):
        keep_quick_cases(made)
    return made
"""
TESTS = """
import pytest

@pytest.mark.thorough("2", "a-b")
@pytest.mark.parametrize("case", ["1", "2", "a-b"])
def test_some(case):
    pass

@pytest.mark.thorough
@pytest.mark.parametrize("case", ["1", "2"])
def test_all(case):
    pass

@pytest.mark.thorough("1")
@pytest.mark.parametrize("case", ["1", pytest.param("2", marks=pytest.mark.thorough), "3"])
def test_both(case):
    pass

def test_none():
    pass
"""
THOROUGH = ["test_some[2]", "test_some[a-b]", "test_all[1]", "test_all[2]", "test_both[1]", "test_both[2]"]


def collect(folder: Path, tests: str, expression: str) -> tuple[list[str], str]:
    """Names of the collected tests, and all that pytest printed."""
    (folder / "conftest.py").write_text(CONFTEST)
    (folder / "test_it.py").write_text(tests)
    (folder / "pytest.ini").write_text("[pytest]\nmarkers =\n    thorough: long\n")
    kept = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST_")}
    environment = kept | {
        "PYTHONPATH": str(Path(thorough_cases.__file__).parent),
        "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
    }
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-m", expression]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    return [line.partition("::")[2] for line in done.stdout.splitlines() if "::test_" in line], done.stdout


@pytest.mark.parametrize(
    ("expression", "wanted"),
    [
        ("not thorough", ["test_some[1]", "test_both[3]", "test_none"]),
        ("thorough", THOROUGH),
    ],
)
def test_thorough_mark_applies_to_named_cases(tmp_path: Path, expression: str, wanted: list[str]) -> None:
    assert collect(tmp_path, TESTS, expression)[0] == wanted


def test_unknown_case_in_thorough_mark_is_an_error(tmp_path: Path) -> None:
    _, said = collect(tmp_path, TESTS.replace('"a-b")\n@', '"ab")\n@'), "thorough")
    assert (
        "test_some: the mark thorough names ['ab'], which are no cases of the test. Its cases: ['1', '2', 'a-b']"
        in said
    )
