"""Slow tests in parts: none left out, none twice, the oldest first."""

import os
import shutil
import subprocess
import sys
from collections import Counter

import pytest
import slow_parts
from slow_parts import PARTS, deal, due_part, page_rows, part_of, read_table


def test_sixteen_commits_in_a_row_run_all_parts_whether_or_not_they_are_recorded():
    ran = {"3": ["2026-11-02 10:00"], "1": ["2026-11-01 10:00"]}
    assert {due_part(ran, k) for k in range(5, 5 + PARTS)} == set(range(1, PARTS + 1))
    order = []
    for k in range(2 * PARTS):
        order.append(due_part(ran, 0))
        ran[str(order[-1])] = [f"2026-12-01 10:{k:02}"]
    assert order == [2, *range(4, PARTS + 1), 1, 3] * 2


def test_parts_are_even_and_a_long_file_is_in_all():
    seconds = {f"tests/test_{k}.py": 10.0 + k for k in range(60)} | {"tests/test_long.py": 4000.0}
    files = deal(seconds)
    assert files["tests/test_long.py"][0] == 0
    loads = Counter()
    for part, s in files.values():
        loads[part] += s if part else 0
    assert max(loads[k] for k in range(1, PARTS + 1)) - min(loads[k] for k in range(1, PARTS + 1)) < 30
    of_one = Counter(part_of(f"tests/test_long.py::test[{k}]", files) for k in range(100 * PARTS))
    assert set(of_one) == set(range(1, PARTS + 1))
    assert min(of_one.values()) > 60
    assert part_of("tests/test_new.py::test", files) == part_of("tests/test_new.py::test", {})


def test_the_page_shows_the_table_and_the_table_what_there_is():
    table = read_table()
    assert "\n".join(page_rows(table)) in slow_parts.PAGE.read_text(encoding="utf-8")
    missing = [file for file in table["files"] if not (slow_parts.ROOT / file).is_file()]
    assert not missing, f"python tests/slow_parts.py deal drops {missing}"


TESTS = """
import pytest
@pytest.mark.slow
@pytest.mark.parametrize("k", range(40))
def test_some(k): pass
@pytest.mark.slow(of=5)
@pytest.mark.parametrize("k", range(5))
def test_sliced(k): pass
def test_quick(): pass
"""


@pytest.mark.slow
def test_pytest_runs_one_part_of_a_file(tmp_path):
    """Every slow test in exactly one part; of one that is cut in slices, its slice with any part."""
    shutil.copy(slow_parts.ROOT / "tests" / "conftest.py", tmp_path)
    (tmp_path / "test_it.py").write_text(TESTS)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = slow\n")
    command = [
        sys.executable,
        "-m",
        "pytest",
        "--collect-only",
        "-q",
        "-p",
        "no:cacheprovider",
        "--slice",
        "3",
        "--part",
    ]
    environment = os.environ | {"PYTHONPATH": str(slow_parts.ROOT / "tests")}
    runs = [
        subprocess.Popen([*command, str(k)], cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True)
        for k in range(1, PARTS + 1)
    ]
    lines = [line for run in runs for line in run.communicate()[0].splitlines()]
    names = [line.partition("::")[2] for line in lines if line.startswith("test_it.py::")]
    some = [name for name in names if name.startswith("test_some")]
    assert sorted(some) == sorted(f"test_some[{k}]" for k in range(40))
    assert [name for name in names if name not in some] == ["test_sliced[3]"] * PARTS
