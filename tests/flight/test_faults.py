"""Faults over a live pair: some cases in virtual time in every run, all of them in the thorough tier.

The verdict is tested with logs of unsafe vehicles.
"""

import contextlib
import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from answers import complaints
from click.testing import CliRunner
from flight.mavlink.line import every
from run.stand_ins import KEY
from run.stand_ins import dialect as make_dialect

from studies.live_faults.campaign import _fly_virtual_case, select_cases
from studies.live_faults.case import STOPS, Case, CaseOutcome, evaluate_flight
from studies.live_faults.cases import PARTS, WORDS, all_cases
from studies.live_faults.cases_of_lines import renumber_frame
from studies.live_faults.flight import ProcessResult
from studies.live_faults.page import describe_flights as flown_in_words
from studies.live_faults.page import format_page
from studies.live_faults.verdict import failsafe_causes, find_violations
from studies.live_faults.words import Evidence, list_unexplained
from trimtab.actuators.failsafe import CAUSES, MODES
from trimtab.cli import main
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap

PAGE = Path(__file__).parents[2] / "docs" / "studies" / "live-faults.md"
QUICK = "cut-0.3", "uplink-stuck", "autopilot-killed"
IN_VIRTUAL_TIME = (*QUICK, "vehicle-killed", "vehicle-frozen", "taken-over", "autopilot-disk-full-again", "drawn-1-8")
"""Cases that are flown in every run: line, fault word, killed and frozen ends, two autopilots, disk, clock."""
ONE_FLIGHT = """
import sys, tempfile
from pathlib import Path
from studies.live_faults.campaign import _fly_virtual_case
with tempfile.TemporaryDirectory() as folder:
    print(_fly_virtual_case(1, sys.argv[1], Path(folder) / "flight").digest)
"""
MODE = {name: k for k, name in enumerate(MODES)}
CAUSE = {name: k for k, name in enumerate(CAUSES)}


def flown(stops=2.25, duration=5.0, lift=1.0, force_until=None):
    """The log of a vehicle: armed at 1 s, commands each 20 ms until 250 ms before it goes to failsafe."""
    t = np.arange(0, duration, 1e-3)
    ticks = np.rint(t * 1e7).astype(np.int64)
    t = ticks * 1e-7
    mode = np.where(t < 1, MODE["disarmed"], np.where(t < stops, MODE["computer"], MODE["failsafe"]))
    cause = np.where(t < 1, CAUSE["start"], np.where(t < stops, CAUSE["arm request"], CAUSE["no command"]))
    last = stops - 0.25
    pushes = (t >= 1) & (t < (stops if force_until is None else force_until))
    zero = np.zeros(len(t))
    return Log(
        t,
        ticks,
        {
            "firmware.mode": mode,
            "firmware.cause": cause,
            "firmware.lift": (t >= 1) & (t < stops + lift),
            "firmware.command.fresh": (t >= 1) & (t <= last + 1e-4) & (np.arange(len(t)) % 20 == 0),
            "firmware.rejected": np.zeros(len(t), int),
            "actuators.u.FX": np.where(pushes, 1.2, 0.0),
            "actuators.u.FY": zero,
            "truth.surge_velocity": zero,
            "truth.sway_velocity": zero,
            "truth.yaw_rate": zero,
        },
        {},
        {},
        {},
    )


def no_log(file):
    """A missing file and its reader."""
    return file, partial(read_mcap, file)


def waited(log, seconds):
    """The same log with a process delayed by this many seconds."""
    late = np.where(np.abs(log.t - 2.0) < 1e-6, seconds, 0.0)
    return changed(log, firmware__late=late, firmware__held=log.t < 1)


def changed(log, **signals):
    return dataclasses.replace(log, signals={**log.signals, **{n.replace("__", "."): v for n, v in signals.items()}})


def test_log_of_a_timely_stop_has_no_violation():
    log = flown()
    assert find_violations(log) == []
    assert failsafe_causes(log) == ["no command"]


@pytest.mark.parametrize(
    ("log", "says"),
    [
        (flown(force_until=2.5), r"1\.20 N at 2\.2\d\d s, failsafe \(no command\)"),
        (flown(lift=1.5), "lift fan turned 0.499 s too long"),
        (flown(duration=2.0), "at the end: computer"),
        (changed(flown(), truth__yaw_rate=np.full(5000, 7.0)), "yaw rate reached 7.00"),
        (changed(flown(), truth__surge_velocity=np.full(5000, np.nan)), "surge velocity reached nan"),
    ],
)
def test_each_broken_rule_is_found_in_the_log(log, says):
    assert any(re.search(says, found) for found in find_violations(log)), find_violations(log)


def test_flying_on_without_commands_is_a_violation():
    log = flown(stops=4.0)
    fresh = log["firmware.command.fresh"] & ((log.t < 2) | (log.t > 2.3))
    assert any("flew on through 3" in found for found in find_violations(changed(log, firmware__command__fresh=fresh)))
    refused = np.cumsum(log["firmware.command.fresh"] & (log.t >= 2) & (log.t <= 2.3))
    assert any("flew on through 3" in found for found in find_violations(changed(log, firmware__rejected=refused)))


def test_leaving_failsafe_without_request_is_a_violation():
    log = flown()
    mode = np.where(log.t > 3, MODE["computer"], log["firmware.mode"])
    cause = np.where(log.t > 3, CAUSE["takeover ended"], log["firmware.cause"])
    found = find_violations(changed(log, firmware__mode=mode, firmware__cause=cause))
    assert any("left failsafe" in one for one in found)


def test_a_crash_and_a_missing_log_are_found(tmp_path):
    left = [
        ProcessResult("vehicle-1", 1, "Traceback (most recent call last):", None, *no_log(tmp_path / "vehicle.mcap")),
        ProcessResult("autopilot-1", 0, "", None, *no_log(tmp_path / "flight.mcap")),
    ]
    outcome = evaluate_flight(Case("x", "nothing", lambda _: None, STOPS), left)
    assert outcome.verdict == "fails"
    for says in ("vehicle-1 ended with 1, which", "vehicle-1 crashed", "log of autopilot-1 cannot be read"):
        assert any(says in problem for problem in outcome.problems)


def test_exit_status_contradicting_the_result_is_found(tmp_path):
    calm, hurt = {"problems": []}, {"problems": ["failsafe: no command"]}
    for status, result, agrees in ((0, calm, True), (1, hurt, True), (0, hurt, False), (1, calm, False)):
        one = ProcessResult("autopilot-1", status, "", result, *no_log(tmp_path / "flight.mcap"))
        outcome = evaluate_flight(Case("x", "nothing", lambda _: None, STOPS), [one])
        assert any("which contradicts its result" in p for p in outcome.problems) != agrees


def test_campaign_covers_each_fault_word_on_each_part():
    names = [case.name for case in all_cases()]
    assert len(names) == len(set(names)) >= 120
    parts = [part.rpartition(":")[2] for part in PARTS]
    assert {f"{part}-{word}" for part in parts for word in WORDS} <= set(names)
    assert all(case.evidence_checks for case in all_cases())
    assert len(select_cases([])) > len(names)


def test_rejects_unknown_case():
    done = CliRunner().invoke(main, ["live-faults", "--only", "cut-2"])
    assert done.exit_code == 2
    assert "unknown case 'cut-2'" in done.output
    assert "cut-0.3" in done.output


def test_docs_page_shows_all_cases_as_holding():
    rows = re.findall(r"^\| `([^`]+)` \|.*\| ([^|]*) \|$", PAGE.read_text("utf-8"), re.MULTILINE)
    shown, names = [name for name, _ in rows], [case.name for case in all_cases()]
    assert shown == [name for name in names if name in shown]
    assert set(names) == set(shown)
    assert {verdict for _, verdict in rows} <= {"holds"}


def test_cases_flown_separately_are_merged_into_the_page():
    order = ["a", "b", "c"]
    ones = {n: CaseOutcome(n, "does", "happened", (f"said {n}",), ()) for n in order}
    first = format_page(
        [ones["a"], ones["c"]], flown_in_words(["a", "c"], 60.0, 2, apart=False, is_real=False), order=order
    )
    failed = ones["c"]._replace(problems=("broke",))
    again = format_page([ones["b"], failed], flown_in_words(["b", "c"], 9.0, 2, apart=True, is_real=True), first, order)
    rows = re.findall(r"^\| `([^`]+)` \|.*\| ([^|]*) \|$", again, re.MULTILINE)
    assert rows == [("a", "holds"), ("b", "holds"), ("c", "**fails**: broke")]
    assert "3 cases, 2 hold, 0 skipped, 1 fail." in again
    runs = re.search(r"^Flown: (.*)\.$", again, re.MULTILINE)
    assert runs
    assert [one.partition(" on ")[0] for one in runs[1].split("; ")] == [
        "2 cases in virtual time in 60 s",
        "`b`, `c` in real time in 9 s",
    ]
    assert format_page([ones["a"]], "x", "", order).count("`a`") == 1


def test_skipped_case_keeps_its_row_in_the_page():
    flown = CaseOutcome("serial", "does", "happened", (), ())
    skipped = flown._replace(skipped="needs --real-time")
    assert "skipped: needs --real-time" in (new := format_page([skipped], "x"))
    assert "| holds |" in (page := format_page([flown], "y", new))
    assert "| holds |" in format_page([skipped], "x", page)


def test_unexplained_log_lines_are_found():
    texts = ["computer: arm request", "failsafe: no command", "vehicle: " + "x" * 50, "vehicle: y"]
    log = dataclasses.replace(flown(), metadata={"events": [{"t": 0.0, "text": text} for text in texts]})
    evidence = Evidence({}, {"vehicle-1": log})
    assert list_unexplained(evidence, ["failsafe: no command", "x{50}y"]) == []
    assert list_unexplained(evidence, ["x{50}y"]) == ["vehicle-1: “failsafe: no command”"]
    assert list_unexplained(evidence, ["failsafe", "x{50}$"]) == [f"vehicle-1: “vehicle: {'x' * 50}y”"]


@pytest.mark.parametrize(("seconds", "stopped", "verdict"), [(0.3, {}, "kept waiting"), (0.05, {}, "fails")])
def test_failure_of_a_starved_flight_gives_no_verdict(seconds, stopped, verdict, tmp_path):
    log = waited(flown(), seconds)
    left = [ProcessResult("vehicle-1", 0, "", {"problems": []}, tmp_path / "vehicle.mcap", lambda: log)]
    outcome = evaluate_flight(Case("x", "nothing", lambda _: None, "flies on", stopped_s=stopped), left)
    assert any("for which the case is no reason" in problem for problem in outcome.problems)
    assert outcome.verdict == verdict
    frozen = evaluate_flight(Case("x", "nothing", lambda _: None, "flies on", stopped_s={"vehicle-1": 0.3}), left)
    assert frozen.verdict == "fails"  # it was stopped on purpose


def test_renumbered_frame_is_signed_with_the_given_key():
    _, dialect = make_dialect({"compass": every()}, every())
    sender, receiver = Endpoint(dialect, 1, 191, KEY), Endpoint(dialect, 1, 1, KEY)
    frame = sender.pack("STATUSTEXT", {"text": "one"})
    other = renumber_frame(dialect.by_id, KEY.secret, frame, 77)
    assert other[4] == 77
    (message,) = receiver.feed(other)
    assert message.get("text") == "one"
    assert receiver.feed(renumber_frame(dialect.by_id, b"x" * 32, sender.pack("STATUSTEXT"), 78)) == []


def campaign(*words, timeout):
    command = [sys.executable, "-m", "trimtab", "live-faults", "--json", *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, env=dict(os.environ))
    assert done.stdout, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert not complaints(found)
    return done, found


@pytest.mark.thorough(*sorted(set(IN_VIRTUAL_TIME) - {"vehicle-killed"}))
@pytest.mark.parametrize("name", IN_VIRTUAL_TIME)
def test_a_case_holds_in_virtual_time(name, tmp_path):
    outcome = _fly_virtual_case(1, name, tmp_path / "flight", keeps_logs=name == "cut-0.3")
    assert outcome.problems == ()
    assert outcome.verdict == "holds"
    assert len(outcome.digest) == 64
    if name == "cut-0.3":
        assert failsafe_causes(read_mcap(tmp_path / "flight" / "vehicle-1" / "vehicle.mcap")) == ["no command"]


@pytest.mark.thorough
def test_flight_in_another_process_is_bit_identical(tmp_path):
    """Another process has another hash seed, so that sets have another order."""
    mine = _fly_virtual_case(1, "taken-over", tmp_path / "flight").digest
    environment = {**os.environ, "PYTHONHASHSEED": "7", "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", ONE_FLIGHT, "taken-over"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    assert done.stdout.split() == [mine]
    assert _fly_virtual_case(2, "taken-over", tmp_path / "other").digest != mine


@pytest.mark.thorough
def test_all_cases_hold_in_virtual_time():
    done, found = campaign(timeout=880)
    print(f"{len(found['cases'])} cases in {found['wall_s']:.0f} s")
    assert done.returncode == 0, done.stderr
    assert {case["verdict"] for case in found["cases"]} == {"holds", "skipped"}
    assert sum(case["verdict"] == "holds" for case in found["cases"]) >= 100


@pytest.mark.thorough
@pytest.mark.timeout(7200)
def test_a_thousand_drawn_flights_end_safe_with_the_right_cause():
    done, found = campaign("--draw", "1000", "--seed", "1", timeout=7000)
    print(f"{len(found['cases'])} flights in {found['wall_s']:.0f} s")
    assert done.returncode == 0, done.stderr
    assert {case["verdict"] for case in found["cases"]} == {"holds"}


def find_session(number):
    """The processes of a session that have not ended."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, _, _, session = stat.read_text().rpartition(")")[2].split()[:4]
            found += [int(stat.parent.name)] if int(session) == number and state != "Z" else []
    return found


@pytest.mark.real_time
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_campaign_that_is_stopped_leaves_no_process(number):
    command = [sys.executable, "-m", "trimtab", "live-faults", "--jobs", "2"]
    started = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True)
    try:
        end = time.monotonic() + 120
        while len(find_session(started.pid)) < 4:  # the command, a helper of multiprocessing, and two flights
            assert started.poll() is None
            assert time.monotonic() < end
            time.sleep(0.1)
        time.sleep(2.0)
        os.kill(started.pid, number)
        assert started.wait(10) == (-number if number == signal.SIGKILL else 128 + number)
        end = time.monotonic() + 10
        while left := find_session(started.pid):
            assert time.monotonic() < end, left
            time.sleep(0.1)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(started.pid, signal.SIGKILL)
        started.communicate()


@pytest.mark.real_time
@pytest.mark.timeout(900)
def test_three_cases_hold_in_real_time(tmp_path):
    done, found = campaign(
        "--real-time", *(w for name in QUICK for w in ("--only", name)), "--out", str(tmp_path), timeout=880
    )
    assert done.returncode == 0, done.stderr
    assert [case["verdict"] for case in found["cases"]] == ["holds"] * 3
    assert all("failsafe (no command)" in case["happened"] for case in found["cases"])


@pytest.mark.real_time
@pytest.mark.timeout(3600)
def test_all_cases_hold_in_real_time():
    """Takes about ten minutes on an idle machine."""
    done, found = campaign("--real-time", timeout=3500)
    print(f"{len(found['cases'])} cases in {found['wall_s']:.0f} s")
    assert done.returncode == 0, done.stderr
    assert {case["verdict"] for case in found["cases"]} <= {"holds", "skipped"}
