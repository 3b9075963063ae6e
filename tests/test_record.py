"""The recorder of tiers, run in a small git repository of its own."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import record

CONFTEST = """
import pytest
from parts import deselect_other_parts, parse_part
from verdicts import Verdicts

def pytest_configure(config):
    config.pluginmanager.register(Verdicts())

def pytest_addoption(parser):
    parser.addoption("--random-seed", type=int, default=7)
    parser.addoption("--part", type=parse_part)

def pytest_collection_modifyitems(config, items):
    deselect_other_parts(config, items)

@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    if item.name == "test_under_load" and report.failed:
        report.void = "attempt 3: CPU 0 ran other programs for 80 ms"
    return report
"""
TESTS = """
import pytest

@pytest.mark.thorough
def test_passes():
    pass

@pytest.mark.thorough
def test_is_skipped():
    pytest.skip("no tool")

def test_of_the_gate():
    raise AssertionError("not of this tier")
"""
FAILS = "@pytest.mark.thorough\ndef test_fails():\n    assert 1 == 2\n"
UNDER_LOAD = FAILS.replace("test_fails", "test_under_load")
WAITS = """@pytest.mark.thorough
def test_waits():
    import time
    print("waits", flush=True)
    time.sleep(120)
"""
INI = "[pytest]\nmarkers =\n    thorough: minutes long\n    real_time: by the clock\n"


class Repository:
    """A repository with the recorder, a file of tests, and one commit."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.tests = folder, folder / "tests"
        self.records = self.tests / "records.jsonl"
        self.tests.mkdir()
        for name in ("record.py", "parts.py", "verdicts.py", "host_witness.py"):
            shutil.copy(Path(record.__file__).with_name(name), self.tests)
        (self.tests / "conftest.py").write_text(CONFTEST)
        (folder / "pytest.ini").write_text(INI)
        (folder / ".gitignore").write_text("__pycache__\n.pytest_cache\n")
        self.git("init", "-q")
        self.commit(TESTS)

    def git(self, *arguments: str) -> str:
        who = ["-c", "user.name=a", "-c", "user.email=a@example.org", "-c", f"safe.directory={self.folder}"]
        command = ["git", *who, "-C", str(self.folder), *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    def commit(self, tests: str) -> str:
        (self.tests / "test_it.py").write_text(tests)
        self.git("add", "-A")
        self.git("commit", "-q", "--allow-empty", "-m", "a change")
        return self.git("rev-parse", "HEAD")

    def start(self, *command: str) -> subprocess.Popen[str]:
        kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTEST_", "GIT_"))}
        environment = kept | {"PYTHONPATH": str(self.tests), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
        return subprocess.Popen(
            [sys.executable, str(self.tests / "record.py"), *command],
            env=environment,
            cwd=self.folder.parent,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def record(self, *command: str) -> tuple[int, str]:
        process = self.start(*command)
        out, trouble = process.communicate()
        return process.returncode, out + trouble

    def last(self) -> dict[str, object]:
        return json.loads(self.records.read_text().splitlines()[-1])


@pytest.fixture
def repository(tmp_path: Path) -> Repository:
    folder = tmp_path / "repository"
    folder.mkdir()
    return Repository(folder)


def test_records_green_run_and_its_age(repository: Repository) -> None:
    commit = repository.git("rev-parse", "HEAD")
    assert repository.record("ages") == (0, "thorough: never recorded\nreal_time: never recorded\n")
    status, said = repository.record("thorough")
    assert (status, "thorough is green" in said) == (0, True), said
    found = repository.last()
    assert (found["tier"], found["commit"], found["random_seed"]) == ("thorough", commit, 7)
    assert (found["passed"], found["failed"], found["skipped"], found["not_judged"]) == (1, 0, 1, 0)
    assert (found["failures"], found["voids"]) == ([], [])
    assert isinstance(machine := found["machine"], dict)
    assert sorted(machine) == ["cores", "cpu", "os", "python"]
    assert os.uname().nodename not in json.dumps(machine)
    assert f"thorough: last green 0 commits ago ({commit[:10]}" in repository.record("ages")[1]
    repository.commit(TESTS)  # adds the record alone: such a commit does not count
    assert "thorough: last green 0 commits ago" in repository.record("ages")[1]
    repository.commit(TESTS + "\n")
    assert "thorough: last green 1 commits ago" in repository.record("ages")[1]


def test_records_a_red_run_after_a_green_one(repository: Repository) -> None:
    assert repository.record("thorough")[0] == 0
    repository.commit(TESTS + FAILS)
    status, said = repository.record("thorough")
    assert (status, "thorough is red" in said) == (1, True), said
    found = repository.last()
    assert (found["passed"], found["failed"], found["failures"]) == (1, 1, ["tests/test_it.py::test_fails"])
    assert len(repository.records.read_text().splitlines()) == 2
    ages = repository.record("ages")[1]
    assert "thorough: last green 1 commits ago" in ages
    assert "last run red: 1 failed, 0 not judged" in ages


def test_a_test_that_is_not_judged_makes_the_record_red(repository: Repository) -> None:
    repository.commit(TESTS + UNDER_LOAD)
    assert repository.record("thorough")[0] == 1
    found = repository.last()
    test = "tests/test_it.py::test_under_load"
    assert (found["failed"], found["not_judged"], found["not_judged_tests"]) == (0, 1, [test])
    assert found["voids"] == [{"test": test, "evidence": "attempt 3: CPU 0 ran other programs for 80 ms"}]
    assert "thorough: never green; last run red: 0 failed, 1 not judged" in repository.record("ages")[1]


def test_parts_recorded_at_one_commit_form_a_full_run(repository: Repository) -> None:
    tests = "".join(f"@pytest.mark.thorough\ndef test_{k}():\n    pass\n\n" for k in range(6))
    commit = repository.commit("import pytest\n\n" + tests)
    status, said = repository.record("thorough", "--part", "2/2")
    assert (status, "thorough, part 2/2, is green" in said) == (0, True), said
    second = repository.last()
    assert 0 < second["passed"] < 6
    ages = repository.record("ages")[1]
    assert f"thorough: never recorded; 1 of 2 parts recorded at {commit[:10]}\n" in ages
    repository.commit("import pytest\n\n" + tests)  # adds the record
    repository.git("checkout", "-q", "--detach", commit)
    repository.records.write_text(json.dumps(second) + "\n")
    assert repository.record("thorough", "--part", "1/2")[0] == 0
    assert repository.last()["passed"] + second["passed"] == 6
    assert f"thorough: last green 0 commits ago ({commit[:10]}" in repository.record("ages")[1]


def test_a_red_part_makes_the_run_red(repository: Repository) -> None:
    repository.commit(TESTS + FAILS + FAILS.replace("test_fails", "test_fails_too"))
    statuses = [repository.record("thorough", "--part", f"{k}/2")[0] for k in (1, 2)]
    assert 1 in statuses
    assert "thorough: never green; last run red" in repository.record("ages")[1]


@pytest.mark.parametrize("part", ["0/2", "3/2", "2", "a/b"])
def test_refuses_a_part_that_does_not_exist(repository: Repository, part: str) -> None:
    status, said = repository.record("thorough", "--part", part)
    assert (status, "must be K/N with 1 <= K <= N" in said) == (2, True), said
    assert not repository.records.exists()


def test_refuses_a_working_tree_with_changes(repository: Repository) -> None:
    (repository.tests / "test_new.py").write_text(TESTS)
    status, said = repository.record("thorough")
    assert status == 2
    assert said.startswith("The working tree must be clean. Commit or remove:\n?? tests/test_new.py")
    assert not repository.records.exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_reports_an_interrupted_run_and_records_nothing(repository: Repository, number: int) -> None:
    repository.commit(TESTS + WAITS.replace("print(", "open('../begun', 'w'); print("))
    process = repository.start("thorough")
    while not (repository.folder.parent / "begun").exists():
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(number)
    assert "The run of thorough was interrupted. Nothing is recorded." in process.communicate()[1]
    assert process.returncode == 2
    assert not repository.records.exists()


def test_records_nothing_where_tests_cannot_be_collected(repository: Repository) -> None:
    repository.commit("import missing_module")
    status, said = repository.record("thorough")
    assert (status, "Nothing is recorded." in said) == (2, True), said
    assert not repository.records.exists()


def test_reports_record_of_commit_outside_history(repository: Repository) -> None:
    repository.commit(TESTS + "# another\n")
    assert repository.record("thorough")[0] == 0
    repository.git("reset", "-q", "--soft", "HEAD~1")
    repository.commit(TESTS)
    assert "which is not in this history" in repository.record("ages")[1]
