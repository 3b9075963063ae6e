"""Verdicts of real-time tests: pure logic with evidence handed in, and small tests run by pytest beside real load."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from host_witness import NS_PER_MS, Evidence, Gap, HostWitness, Wait, longest_wait
from verdicts import BEARS_MS, judge

LATE = Evidence(gaps=(Gap(0, 0, 90 * NS_PER_MS, 80 * NS_PER_MS), Gap(1, 0, 30 * NS_PER_MS, 30 * NS_PER_MS)))


def ms(*times: float) -> list[int]:
    return [int(t * NS_PER_MS) for t in times]


def test_a_passed_attempt_is_never_void() -> None:
    assert judge(False, LATE, bears_ms=20) == "pass"
    assert judge(False, None, bears_ms=20) == "pass"


def test_failed_attempt_is_void_only_with_evidence_beyond_limit() -> None:
    assert judge(True, None, bears_ms=20) == "fail"
    assert judge(True, Evidence(), bears_ms=20) == "fail"
    assert judge(True, LATE, bears_ms=20) == "void"
    assert judge(True, LATE, bears_ms=80) == "void"
    assert judge(True, LATE, bears_ms=80.1) == "fail"
    assert LATE.blame(20) == "CPU 0 ran other programs for 80 ms; the test bears 20 ms"


def test_own_load_is_not_evidence() -> None:
    gap, wait = Gap(0, *ms(0, 90), host_ns=0), Wait("7", *ms(0, 50), host_ns=0)
    assert judge(True, Evidence((gap,), (wait,)), bears_ms=1) == "fail"


def test_cpu_wait_of_a_task_is_evidence() -> None:
    waits = tuple(Wait("7", *ms(50 * k, 50 * k + 50, 12)) for k in range(3))
    assert judge(True, Evidence(waits=waits[:1]), bears_ms=20) == "fail"
    assert judge(True, Evidence(waits=waits), bears_ms=20) == "void"
    assert Evidence(waits=waits).blame(20) == "task 7 waited 24 ms for a CPU; the test bears 20 ms"


def test_waits_are_summed_per_task_within_a_time_span() -> None:
    waits = [Wait("7", *ms(50 * k, 50 * k + 50, 10)) for k in range(8)]
    assert longest_wait(waits, 100 * NS_PER_MS) == ("7", 20 * NS_PER_MS)
    assert longest_wait(waits, 400 * NS_PER_MS) == ("7", 80 * NS_PER_MS)
    assert longest_wait(waits, NS_PER_MS) == ("7", 10 * NS_PER_MS)
    far = [Wait("7", *ms(0, 50, 10)), Wait("7", *ms(900, 950, 15)), Wait("8", *ms(900, 950, 12))]
    assert longest_wait(far, 100 * NS_PER_MS) == ("7", 15 * NS_PER_MS)
    assert longest_wait([], 100 * NS_PER_MS) == ("", 0)


CONFTEST = """
from host_witness import Evidence, Gap
from verdicts import Verdicts

class HandedIn:
    late = []
    def collect(self, start_ns, end_ns):
        late = self.late.pop(0)
        return Evidence((Gap(0, start_ns, end_ns, late * 1_000_000),)) if late else Evidence()
    def close(self):
        pass

def pytest_configure(config):
    verdicts = Verdicts()
    config.pluginmanager.register(verdicts)
    if HandedIn.late != "measured":
        verdicts.witness = HandedIn
"""
TESTS = """
import pytest
calls = []
setups = []

@pytest.fixture(scope="module")
def flight():
    setups.append("module")
    yield len(setups)
    setups.append("end")

@pytest.fixture
def own(flight):
    setups.append("function")
    return flight

@pytest.mark.real_time({mark})
def test_deadline(own):
    calls.append(list(setups))
    print(calls)
    assert len(calls) == {passes}
"""


class Ran:
    """The end of a run of pytest: exit status, closing line, everything printed."""

    def __init__(self, folder: Path, conftest: str, tests: str) -> None:
        (folder / "conftest.py").write_text(conftest)
        (folder / "pytest.ini").write_text("[pytest]\nmarkers = real_time: by the clock\n")
        (folder / "test_it.py").write_text(tests)
        kept = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST_")}
        environment = kept | {"PYTHONPATH": str(Path(__file__).parent), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "pytest_timeout", "test_it.py"]
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
        self.status, self.text = done.returncode, done.stdout + done.stderr
        self.closing = done.stdout.splitlines()[-1] if done.stdout else ""


def run_with_evidence(folder: Path, late_ms: list[int], passes: int, mark: str = "") -> Ran:
    """Run a test that passes at one attempt, with the lateness of the host at each failed attempt."""
    conftest = CONFTEST.replace("late = []", f"late = {late_ms}")
    return Ran(folder, conftest, TESTS.format(mark=mark, passes=passes))


def test_a_void_attempt_is_repeated_with_new_fixtures(tmp_path: Path) -> None:
    ran = run_with_evidence(tmp_path, [50], passes=2)
    assert (ran.status, ran.closing.split(" in ")[0]) == (0, "1 passed, 1 void"), ran.text
    assert "attempt 1: CPU 0 ran other programs for 50 ms; the test bears 20 ms" in ran.text


def test_a_repeat_sees_fixtures_of_the_module_from_scratch(tmp_path: Path) -> None:
    ran = run_with_evidence(tmp_path, [50, 50, 50], passes=0)
    assert "['module', 'function', 'end', 'module', 'function', 'end', 'module', 'function']" in ran.text


def test_a_failure_on_a_quiet_host_fails_at_once(tmp_path: Path) -> None:
    ran = run_with_evidence(tmp_path, [0], passes=2)
    assert (ran.status, ran.closing.split(" in ")[0]) == (1, "1 failed"), ran.text


def test_a_failure_after_a_void_attempt_fails(tmp_path: Path) -> None:
    ran = run_with_evidence(tmp_path, [50, 0], passes=0)
    assert (ran.status, ran.closing.split(" in ")[0]) == (1, "1 failed, 1 void"), ran.text


def test_three_void_attempts_are_not_judged_and_not_a_pass(tmp_path: Path) -> None:
    ran = run_with_evidence(tmp_path, [50, 50, 50], passes=0)
    assert ran.status == 1
    assert "1 not judged" in ran.closing
    assert "2 void" in ran.closing
    assert ran.text.count("Captured stdout call") == 3  # one of each attempt
    assert "failed" not in ran.closing
    assert "passed" not in ran.closing
    assert "test_it.py::test_deadline, attempt 3: CPU 0 ran other programs" in ran.text


def test_bears_ms_mark_sets_the_tolerated_delay(tmp_path: Path) -> None:
    assert run_with_evidence(tmp_path, [50], passes=2, mark="bears_ms=51").status == 1
    assert run_with_evidence(tmp_path, [50], passes=2, mark="bears_ms=49").status == 0
    assert BEARS_MS == 20


def test_without_witness_a_failed_attempt_fails(tmp_path: Path) -> None:
    conftest = CONFTEST.replace("verdicts.witness = HandedIn", "verdicts.witness = lambda: None")
    ran = Ran(tmp_path, conftest, TESTS.format(mark="", passes=2))
    assert (ran.status, ran.closing.split(" in ")[0]) == (1, "1 failed"), ran.text


def test_a_timeout_holds_for_each_attempt(tmp_path: Path) -> None:
    tests = """
import pytest, time
@pytest.mark.real_time
@pytest.mark.timeout(1)
def test_hangs():
    time.sleep(1000)
"""
    ran = Ran(tmp_path, CONFTEST.replace("late = []", "late = [50, 50, 0]"), tests)
    assert (ran.status, ran.closing.split(" in ")[0]) == (1, "1 failed, 2 void"), ran.text


@contextmanager
def load(policy: int, priority: int) -> Iterator[None]:
    """Keep each CPU busy for 0.3 s of every 0.4 s, so that other programs still run."""
    text = """
import os, sys, time
os.sched_setaffinity(0, {int(sys.argv[1])})
os.sched_setscheduler(0, int(sys.argv[2]), os.sched_param(int(sys.argv[3])))
parent = os.getppid()
while os.getppid() == parent:
    end = time.monotonic() + 0.3
    while time.monotonic() < end:
        pass
    time.sleep(0.1)
"""
    command = [sys.executable, "-I", "-S", "-c", text]
    loops = [
        subprocess.Popen([*command, str(cpu), str(policy), str(priority)]) for cpu in sorted(os.sched_getaffinity(0))
    ]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


WORKS = """
import os, subprocess, sys, time
import pytest

def longest_gap(seconds):
    gap, last, end = 0.0, time.monotonic(), time.monotonic() + seconds
    while last < end:
        time.sleep(1e-3)
        now = time.monotonic()
        gap, last = max(gap, now - last), now
    return gap

@pytest.mark.real_time({mark})
@pytest.mark.timeout(60)
def test_sleeps_end_in_time():
    assert longest_gap(1.5) < 0.1
"""
STOPPED = """
import os, signal, subprocess, sys, time
import pytest

@pytest.mark.real_time(bears_ms=900)
@pytest.mark.timeout(60)
def test_a_child_that_is_stopped_answers_in_time():
    child = subprocess.Popen([sys.executable, "-I", "-S", "-c", "print(input(), flush=True)"],
                             stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    child.send_signal(signal.SIGSTOP)
    began = time.monotonic()
    child.stdin.write("hello\\n")
    child.stdin.flush()
    time.sleep(3)
    child.send_signal(signal.SIGCONT)
    child.stdout.readline()
    late = time.monotonic() - began
    child.kill()
    child.communicate()
    assert late < 2
"""
OWN_LOAD = """
import os, subprocess, sys, time
import pytest

@pytest.mark.real_time(bears_ms=1400)
@pytest.mark.timeout(60)
def test_own_busy_processes_let_a_deadline_pass():
    busy = [subprocess.Popen([sys.executable, "-I", "-S", "-c", "while True: pass"]) for _ in range(8)]
    time.sleep(3)
    for one in busy:
        one.kill()
        one.wait()
    assert False
"""
MEASURED = CONFTEST.replace("late = []", 'late = "measured"')
needs_schedstat = pytest.mark.skipif(not HostWitness.is_possible(), reason="no /proc/self/schedstat here")


@needs_schedstat
@pytest.mark.real_time
def test_high_priority_load_makes_missed_deadline_void(tmp_path: Path) -> None:
    """The load lasts for all three attempts, so that the test is not judged."""
    try:
        with load(os.SCHED_FIFO, 10):
            ran = Ran(tmp_path, MEASURED, WORKS.format(mark=""))
    except PermissionError:
        pytest.skip("SCHED_FIFO needs a permission")
    assert ran.status == 1
    assert "1 not judged" in ran.closing, ran.text
    assert "CPU" in ran.text


@needs_schedstat
@pytest.mark.real_time
def test_stopped_process_under_test_fails_and_is_not_void(tmp_path: Path) -> None:
    ran = Ran(tmp_path, MEASURED, STOPPED)
    assert (ran.status, ran.closing.split(" in ")[0]) == (1, "1 failed"), ran.text


@needs_schedstat
@pytest.mark.real_time
def test_own_busy_processes_do_not_make_failure_void(tmp_path: Path) -> None:
    ran = Ran(tmp_path, MEASURED, OWN_LOAD)
    assert (ran.status, ran.closing.split(" in ")[0]) == (1, "1 failed"), ran.text


@pytest.mark.real_time
def test_witness_detects_stall_of_its_cpu(host_witness: HostWitness) -> None:
    start = time.monotonic_ns()
    with load(os.SCHED_FIFO, 10):
        time.sleep(1.5)
    gaps = host_witness.collect(start, time.monotonic_ns()).gaps
    assert max(gap.host_ns for gap in gaps) > 100 * NS_PER_MS


@pytest.mark.real_time
def test_witness_exits_when_its_parent_is_killed(tmp_path: Path, host_witness: HostWitness) -> None:
    text = (
        "import host_witness, os; print(host_witness.HostWitness()._process.pid, flush=True); os.kill(os.getpid(), 9)"
    )
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parent), "TMPDIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", text], env=environment, capture_output=True, text=True)
    assert done.returncode == -signal.SIGKILL
    until = time.monotonic() + 20
    while Path(f"/proc/{int(done.stdout)}").exists():
        assert time.monotonic() < until
        time.sleep(0.05)
