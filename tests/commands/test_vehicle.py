"""`trimtab vehicle`: written logs, the summary from a log, and the shortest watchdog time."""

import numpy as np
import pytest

from trimtab.commands import console, flight_summary, vehicle
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.time import ms, seconds, to_seconds
from trimtab.flight.mavlink.stamps import Stamps
from trimtab.logs.log import Log
from trimtab.logs.mcap import write_mcap
from trimtab.logs.metrics import Target


def test_rejects_watchdog_shorter_than_a_few_heartbeats():
    assert vehicle._parse_watchdog("50 ms") == ms(50)
    with pytest.raises(InputError, match="heartbeats"):
        vehicle._parse_watchdog("10 ms")


def test_missing_or_too_large_log_is_not_summarised(tmp_path):
    long = tmp_path / "vehicle.mcap"
    with long.open("wb") as file:
        file.truncate(flight_summary.MOST_SUMMARISED + 1)  # a hole: reading it would be refused, for it is no log
    assert flight_summary.summarise_truth(None, 0, ()) == {"real": None}
    assert flight_summary.summarise_truth(long, 0, ()) == {"real": None}


def test_summary_excludes_time_after_disarming(tmp_path):
    ticks = np.arange(0, 60) * seconds(1)
    speed = np.where(ticks < seconds(30), 1.0, 7.0)  # what it does once it is disarmed
    log = Log(to_seconds(ticks), ticks, {"truth.surge_velocity": speed}, {}, {}, {"truth.surge_velocity": 7.0})
    file = write_mcap(log, tmp_path / "vehicle.mcap")
    target = Target("truth.surge_velocity", 1.0, 0.1)
    real = flight_summary.summarise_truth(file, seconds(10), [target], seconds(29))["real"]
    assert real["final"]["surge_velocity"] == 1.0
    assert real["metrics"]["surge_velocity"]["tail_mean"] == 1.0
    assert real["verdict"]["on_target"]
    whole = flight_summary.summarise_truth(file, 0, [target], seconds(60))["real"]
    assert whole["final"]["surge_velocity"] == 7.0


def test_flight_is_assessed_from_estimates_since_arming(tmp_path):
    ticks = np.arange(0, 60) * seconds(1)
    speed = np.where(ticks < seconds(20), 0.0, 1.02)
    log = Log(to_seconds(ticks), ticks, {"estimate.state.surge_velocity": speed})
    file = write_mcap(log, tmp_path / "flight.mcap")
    target = Target("truth.surge_velocity", 1.0, 0.1)
    found = flight_summary.assess_estimate(file, seconds(15), [target])
    assert found == {"on_target": True, "says": "on target after 5 s"}
    missed = flight_summary.assess_estimate(file, seconds(15), [Target("truth.surge_velocity", 0.0, 0.1)])
    assert missed["says"] == "not at rest: surge_velocity ended at 1.02, target 0 ± 0.1"


def test_flight_without_assessment_reports_reason(tmp_path):
    ticks = np.arange(0, 3) * seconds(1)
    file = write_mcap(Log(to_seconds(ticks), ticks, {"law.mode": np.zeros(3)}), tmp_path / "flight.mcap")
    empty = tmp_path / "empty.mcap"
    empty.touch()
    target = Target("truth.heading", 1.0, 0.1)
    assert flight_summary.assess_estimate(file, 0, [target]) == "the autopilot does not estimate heading"
    assert flight_summary.assess_estimate(empty, 0, [target]) == "the log has no rows"
    assert flight_summary.assess_estimate(None, 0, [target]) == "no log was written; to write one: --out DIR"
    assert flight_summary.assess_estimate(file, None, [target]) == "the autopilot did not arm"
    assert flight_summary.assess_estimate(file, 0, []) == "the scenario has no targets"


def test_console_passes_on_error_and_fix_of_its_vehicle(tmp_path):
    store = tmp_path / "hovercraft.key.time"
    first = Stamps(store)
    with pytest.raises(InputError) as refused:
        Stamps(store)
    first.close()
    passed_on = console._refuse_start(f"new key hovercraft.key\nerror: {refused.value}\n")
    assert passed_on.fix == refused.value.fix
    assert str(passed_on) == str(refused.value).replace("time stamps", "the vehicle: did not start: time stamps")
    silent = console._refuse_start("")
    assert "no output" in str(silent)
    assert "--listen" in silent.fix


@pytest.mark.real_time
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
def test_vehicle_without_out_folder_writes_no_log(tmp_path, monkeypatch):
    """Earlier the vehicle wrote a log of 191 kB/s to the temporary folder."""
    from flight.pair import Program, make_key

    make_key(tmp_path)
    (tmp_path / "temporary").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    words = ("vehicle", "hovercraft/zero-velocity", "--listen", "udp://127.0.0.1:14672", "--json")
    there = Program(*words, folder=tmp_path)
    try:
        there.wait_for("listens on")
        assert not list((tmp_path / "temporary").rglob("*.mcap"))
        there.process.terminate()
        ended = there.finished()
        assert (ended.status, ended.result["log"], ended.result["real"]) == (0, None, None)
    finally:
        if there.process.poll() is None:
            there.process.kill()
            there.process.communicate()
