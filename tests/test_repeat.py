"""The script that repeats the test suite and finds tests whose verdict changes."""

import pytest
import repeat

STEADY = """
import pytest
def test_passes(): pass
def test_fails(): assert False
@pytest.mark.skip
def test_skips(): pass
"""
UNSTEADY = """
from pathlib import Path
def test_alternates():
    mark = Path(__file__).with_suffix(".mark")
    if mark.exists():
        mark.unlink()
        assert False
    mark.touch()
"""
ALONE = ("-p", "no:cacheprovider", "-c", "/dev/null")


@pytest.fixture(autouse=True)
def _without_plugins(monkeypatch):
    """A run of pytest without the installed plugins starts ten times as fast."""
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")


@pytest.mark.thorough
def test_reports_a_test_whose_verdict_changes(tmp_path, capsys):
    (tmp_path / "test_steady.py").write_text(STEADY)
    (tmp_path / "test_unsteady.py").write_text(UNSTEADY)
    assert repeat.main(["--runs", "2", "--busy", "1", *ALONE, str(tmp_path)]) == 1
    said = capsys.readouterr().out
    assert "test_alternates: passed, failure" in said
    assert "test_fails" not in said
    assert "run 2, 1 busy loops: 2 failure, 1 passed, 1 skipped" in said


@pytest.mark.thorough
def test_steady_verdicts_exit_with_0(tmp_path, capsys):
    (tmp_path / "test_steady.py").write_text(STEADY)
    assert repeat.main(["--runs", "2", "--busy", "0", *ALONE, str(tmp_path)]) == 0
    assert "3 tests had the same verdict in all 2 runs" in capsys.readouterr().out


def test_a_test_that_is_missing_in_one_run_is_a_difference():
    assert repeat.list_differences([{"a": "passed", "b": "passed"}, {"a": "passed"}]) == ["b: passed, missing"]


def test_continues_a_series_that_was_interrupted(tmp_path, capsys):
    tests, results = tmp_path / "tests", tmp_path / "results"
    tests.mkdir()
    (tests / "test_unsteady.py").write_text(UNSTEADY)
    words = ["--runs", "2", "--busy", "0", "--folder", str(results), *ALONE, str(tests)]
    assert repeat.main(words) == 1
    capsys.readouterr()
    (results / "2.xml").unlink()
    assert repeat.main(words) == 0
    said = capsys.readouterr().out
    assert f"run 1: read from {results / '1.xml'}" in said
    assert "run 2, 0 busy loops: 1 passed" in said


def test_refuses_results_of_another_commit(tmp_path):
    (tmp_path / "commit").write_text("0123")
    with pytest.raises(SystemExit, match="holds results of commit 0123"):
        repeat.main(["--folder", str(tmp_path)])
