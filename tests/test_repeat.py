"""The script that runs the tests again and again finds a test whose verdict changes."""

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
ALONE = ("-n", "0", "-p", "no:cacheprovider", "-c", "/dev/null")


def test_reports_a_test_whose_verdict_changes(tmp_path, capsys):
    (tmp_path / "test_steady.py").write_text(STEADY)
    (tmp_path / "test_unsteady.py").write_text(UNSTEADY)
    assert repeat.main(["--runs", "2", "--busy", "1", *ALONE, str(tmp_path)]) == 1
    said = capsys.readouterr().out
    assert "test_alternates: passed, failure" in said
    assert "test_fails" not in said
    assert "run 2, 1 busy loops: 2 failure, 1 passed, 1 skipped" in said


def test_steady_verdicts_are_well(tmp_path, capsys):
    (tmp_path / "test_steady.py").write_text(STEADY)
    assert repeat.main(["--runs", "2", "--busy", "0", *ALONE, str(tmp_path)]) == 0
    assert "3 tests had the same verdict in all 2 runs" in capsys.readouterr().out


def test_a_test_that_is_missing_in_one_run_is_a_difference():
    assert repeat.list_differences([{"a": "passed", "b": "passed"}, {"a": "passed"}]) == ["b: passed, missing"]
