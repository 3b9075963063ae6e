"""Run a tier of tests completely and append the result to tests/records.jsonl.

    python tests/record.py thorough     run the thorough tests
    python tests/record.py thorough --part 2/4    run the second of four parts; all four at one commit are a run
    python tests/record.py real_time    run the real-time tests, in one process
    python tests/record.py ages         print for each tier how long ago it was green

A run needs a clean working tree. A record is green if tests passed, none failed and none was left not judged. The exit
status is 0 for a green record, 1 for a red record, and 2 if nothing was recorded.
"""

import argparse
import json
import os
import platform
import signal
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
RECORDS = Path(__file__).with_name("records.jsonl")
TIERS = {"thorough": ["-m", "thorough"], "real_time": ["-m", "real_time", "-n", "0"]}
GREEN, RED, NOT_RECORDED = 0, 1, 2


class Recorder:
    """A plugin of pytest that counts outcomes."""

    def __init__(self) -> None:
        self.random_seed: int | None = None
        self.was_interrupted = False
        self._passed: set[str] = set()
        self._skipped: set[str] = set()
        self._failed: list[str] = []
        self._not_judged: list[str] = []
        self._voids: list[dict[str, str]] = []

    def pytest_sessionstart(self, session: Any) -> None:
        self.random_seed = getattr(session.config.option, "random_seed", None)

    def pytest_keyboard_interrupt(self) -> None:
        self.was_interrupted = True

    def pytest_runtest_logreport(self, report: Any) -> None:
        if hasattr(report, "void"):
            self._voids.append({"test": report.nodeid, "evidence": report.void})
        if report.outcome == "failed":
            (self._not_judged if hasattr(report, "void") else self._failed).append(report.nodeid)
        elif report.outcome == "skipped":
            self._skipped.add(report.nodeid)
        elif report.outcome == "passed" and report.when == "call":
            self._passed.add(report.nodeid)

    def outcomes(self) -> dict[str, Any]:
        """Return the counts and the names of a record."""
        failed, not_judged = sorted(set(self._failed)), sorted(set(self._not_judged) - set(self._failed))
        return {
            "passed": len(self._passed - {*failed, *not_judged}),
            "failed": len(failed),
            "skipped": len(self._skipped),
            "not_judged": len(not_judged),
            "failures": failed,
            "not_judged_tests": not_judged,
            "voids": self._voids,
        }


def ask_git(*arguments: str) -> str:
    """Return what git prints for this repository."""
    command = ["git", "-c", f"safe.directory={ROOT}", "-C", str(ROOT), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def list_changes(*options: str) -> list[str]:
    """Return the lines of git's status without that of the records."""
    records = RECORDS.relative_to(ROOT).as_posix()
    lines = ask_git("status", "--porcelain", *options, "--", ".", f":(exclude){records}")
    return lines.splitlines()


def describe_machine() -> dict[str, Any]:
    """Return processor, cores, system and Python, without the name of the host."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8").splitlines() if cpuinfo.is_file() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return {
        "cpu": models[0] if models else platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "os": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
    }


def is_green(record: dict[str, Any]) -> bool:
    """Return True if tests passed, none failed and none was left not judged."""
    return record["passed"] > 0 and record["failed"] == 0 and record["not_judged"] == 0


def record_tier(tier: str, part: str | None = None) -> int:
    """Run a tier, or a part K/N of it, and append its record."""
    import pytest

    if changes := list_changes():
        print("The working tree must be clean. Commit or remove:", *changes, sep="\n", file=sys.stderr)
        return NOT_RECORDED
    commit, began, start = ask_git("rev-parse", "HEAD"), datetime.now(UTC), time.monotonic()
    os.chdir(ROOT)
    os.environ.pop("PYTEST_ADDOPTS", None)  # these options could leave tests out
    for number in (signal.SIGINT, signal.SIGTERM):  # a shell has programs in the background ignore SIGINT
        signal.signal(number, signal.default_int_handler)
    recorder = Recorder()
    try:
        status = pytest.main([*TIERS[tier], *([] if part is None else ["--part", part])], plugins=[recorder])
    except KeyboardInterrupt:
        recorder.was_interrupted, status = True, pytest.ExitCode.INTERRUPTED
    if recorder.was_interrupted:
        print(f"The run of {tier} was interrupted. Nothing is recorded.", file=sys.stderr)
        return NOT_RECORDED
    if status not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        print(f"pytest did not run {tier} to its end: exit status {int(status)}. Nothing is recorded.", file=sys.stderr)
        return NOT_RECORDED
    changes = list_changes("--untracked-files=no")
    if changes or ask_git("rev-parse", "HEAD") != commit:
        print("Tracked files changed during the run. Nothing is recorded.", *changes, sep="\n", file=sys.stderr)
        return NOT_RECORDED
    record: dict[str, Any] = {"tier": tier, "commit": commit, "date": began.isoformat(timespec="seconds")}
    record |= {"machine": describe_machine(), "seconds": round(time.monotonic() - start)} | recorder.outcomes()
    if part is not None:
        record["part"] = part
    if recorder.random_seed is not None:
        record["random_seed"] = recorder.random_seed
    with RECORDS.open("a", encoding="utf-8") as file:
        file.write(json.dumps(record, ensure_ascii=False) + "\n")
    colour = "green" if is_green(record) else "red"
    name = tier if part is None else f"{tier}, part {part},"
    print(f"{name} is {colour} at {commit[:10]}. Commit {RECORDS.relative_to(ROOT)} with the next change.")
    return GREEN if is_green(record) else RED


def read_records() -> list[dict[str, Any]]:
    """Return all records, the oldest first."""
    if not RECORDS.is_file():
        return []
    return [json.loads(line) for line in RECORDS.read_text(encoding="utf-8").splitlines()]


def join_parts(records: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], str]:
    """Return the complete runs of a tier, and a text about the newest run if some of its parts are missing.

    N parts of N at one commit make a run. A red part alone makes a red run.
    """
    runs, parts, missing = [], dict[tuple[str, str], dict[str, dict[str, Any]]](), ""
    for record in records:
        missing = ""
        if "part" not in record:
            runs.append(record)
            continue
        n = record["part"].partition("/")[2]
        known = parts.setdefault((record["commit"], n), {})
        known[record["part"]] = record
        if not is_green(record):
            runs.append(record)
        elif len(known) < int(n):
            missing = f"; {len(known)} of {n} parts recorded at {record['commit'][:10]}"
        elif all(map(is_green, known.values())):
            runs.append(record)
    return runs, missing


def count_commits_since(commit: str) -> int | None:
    """Return the number of commits since one, or None if it is not in this history. Commits of records do not count."""
    try:
        ask_git("merge-base", "--is-ancestor", commit, "HEAD")
        records = RECORDS.relative_to(ROOT).as_posix()
        return int(ask_git("rev-list", "--count", f"{commit}..HEAD", "--", ".", f":(exclude){records}"))
    except (OSError, subprocess.CalledProcessError):
        return None


def describe_age(tier: str) -> str:
    """Return how long ago a tier was last green, and how its last run ended."""
    records, after = join_parts([record for record in read_records() if record["tier"] == tier])
    if not records:
        return f"{tier}: never recorded{after}"
    last = records[-1]
    if not is_green(last):
        after = f"; last run red: {last['failed']} failed, {last['not_judged']} not judged{after}"
    green = [record for record in records if is_green(record)]
    known = [(ago, record) for record in green if (ago := count_commits_since(record["commit"])) is not None]
    if known:
        ago, record = min(known, key=lambda found: found[0])
        return f"{tier}: last green {ago} commits ago ({record['commit'][:10]}, {record['date'][:10]}){after}"
    if green:
        commit, date = green[-1]["commit"][:10], green[-1]["date"][:10]
        return f"{tier}: last green at {commit}, {date}, which is not in this history{after}"
    return f"{tier}: never green{after}"


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=[*TIERS, "ages"])
    parser.add_argument("--part", metavar="K/N", help="run part K of N parts of the tier")
    given = parser.parse_args()
    if given.command in TIERS:
        return record_tier(given.command, given.part)
    print(*map(describe_age, TIERS), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
