"""A log in memory equals a log file, also with a full disk and a dead writer."""

from pathlib import Path

import numpy as np
import pytest

from trimtab.core.clock import SYSTEM_CLOCK
from trimtab.core.record import Quantity
from trimtab.flight.flight_log import FlightRows, LogSource, open_flight_log
from trimtab.flight.virtual_disk import NO_SPACE, VirtualDisk
from trimtab.flight.virtual_time import VirtualTime
from trimtab.logs.mcap import read_mcap
from trimtab.logs.stream import END_S
from trimtab.scenarios import catalogue

OWN = {
    "own.count": ("i8", Quantity("1", "A count.", kind="count")),
    "own.flag": ("?", Quantity("1", "A flag.", kind="flag")),
    "own.late": ("f8", Quantity("s", "A time.")),
}
TEXTS = ["armed", "a line with ümlauts", "ended"]


@pytest.fixture(scope="module")
def scenario():
    return catalogue.load_scenario("hovercraft/zero-velocity")[0]


def open_memory_log(scenario, path=Path("/virtual/x.mcap")):
    said = []
    disk = VirtualDisk(VirtualTime(1), "vehicle", said.append)
    sources = [LogSource(np.zeros(0), [], lambda p: p)]
    options = {"side": "vehicle", "seed": 3, "log_period": 10_000, "is_live": True}
    return disk, open_flight_log(path, sources, OWN, scenario, disk=disk, **options), said


def write_rows(log):
    log.start_clock(SYSTEM_CLOCK.monotonic_ns(), SYSTEM_CLOCK)
    log.write_event(TEXTS[0])
    for k in range(1, 6):
        log.write_row(10_000 * k, (k, k % 2, 0.1 * k))
        if k == 3:
            log.write_event(TEXTS[1])
    log.write_event(TEXTS[2])
    return log.close({"truth.x": 1.5})


def test_memory_and_file_hold_the_same_log(scenario, tmp_path):
    options = {"side": "vehicle", "seed": 3, "log_period": 10_000, "is_live": True}
    sources = [LogSource(np.zeros(0), [], lambda p: p)]
    file = open_flight_log(tmp_path / "x.mcap", sources, OWN, scenario, **options)
    _, memory, _ = open_memory_log(scenario)
    written, kept = write_rows(file), write_rows(memory)
    on_disk, in_memory = read_mcap(tmp_path / "x.mcap"), memory.read()
    assert (written.rows, written.dropped, written.unwritten) == (kept.rows, kept.dropped, kept.unwritten) == (5, 0, 0)
    assert on_disk.paths == in_memory.paths
    assert (on_disk.ticks == in_memory.ticks).all()
    for path in on_disk.paths:
        assert on_disk[path].dtype == in_memory[path].dtype
        np.testing.assert_array_equal(on_disk[path], in_memory[path])
        assert on_disk.declaration(path) == in_memory.declaration(path)
    assert on_disk.metadata["events"] == in_memory.metadata["events"]
    assert on_disk.final == in_memory.final
    assert set(in_memory.metadata) <= set(on_disk.metadata)
    for name in set(in_memory.metadata) - {"wall_epoch_ns", "events"}:
        if "epoch" not in name:
            assert on_disk.metadata[name] == in_memory.metadata[name]


def test_row_with_repeated_time_is_skipped_and_counted(scenario):
    _, log, _ = open_memory_log(scenario)
    log.start_clock(0, SYSTEM_CLOCK)
    for t in (10_000, 20_000, 20_000, 30_000):
        log.write_row(t, (t, 0, 0.0))
    summary = log.close()
    assert (summary.rows, summary.unwritten) == (3, 1)
    assert log.read().ticks.tolist() == [10_000, 20_000, 30_000]


def test_full_disk_loses_rows_and_reports_the_gap(scenario):
    disk, log, said = open_memory_log(scenario)
    log.start_clock(0, SYSTEM_CLOCK)
    assert disk.free_bytes(Path("/")) > 1e9
    for k in range(1, 10):
        disk.is_full = 3 < k < 7
        log.write_row(10_000 * k, (k, 0, 0.0))
    disk.is_full = True
    assert disk.free_bytes(Path("/")) == 0
    disk.is_full = False
    summary, kept = log.close(), log.read()
    assert (summary.rows, summary.unwritten) == (6, 3)
    assert kept["own.count"].tolist() == [1, 2, 3, 7, 8, 9]
    assert kept["log.unwritten"].tolist() == [0, 0, 0, 3, 3, 3]
    assert [e["text"] for e in kept.metadata["events"]] == [f"the log has a gap of 3 rows: {NO_SPACE}"]
    assert said == [f"log: can't be written ({NO_SPACE}); the flight goes on, rows are counted"]


def test_log_of_a_killed_program_records_its_death(scenario):
    disk, log, _ = open_memory_log(scenario)
    log.start_clock(0, SYSTEM_CLOCK)
    log.write_row(10_000, (1, 0, 0.0))
    disk.is_dead = True
    log.write_row(20_000, (2, 0, 0.0))
    log.write_event("never")
    assert log.close() is None
    kept = log.read()
    assert len(kept) == 1
    assert [e["text"] for e in kept.metadata["events"]] == ["the flying process is gone, without a word"]


def test_log_keeps_rows_written_before_writer_death(scenario):
    disk, log, _ = open_memory_log(scenario)
    log.start_clock(0, SYSTEM_CLOCK)
    log.write_row(10_000, (1, 0, 0.0))
    disk.is_writer_dead = True
    log.write_row(20_000, (2, 0, 0.0))
    assert log.close() is None
    assert len(log.read()) == 1


def test_without_a_path_there_is_no_log(scenario):
    assert open_memory_log(scenario, None)[1] is None


def test_rows_and_events_change_the_digest(scenario):
    digests = set()
    for late in (0.0, 1e-12):
        disk, log, _ = open_memory_log(scenario)
        log.write_row(10_000, (1, 0, late))
        digests.add(disk._time.digest)
        log.write_event("x")
        digests.add(disk._time.digest)
    assert len(digests) == 4
    assert FlightRows([], OWN).width == 3


def hang_log(scenario, rows):
    """A log whose disk hangs after its first row and event."""
    disk, log, _ = open_memory_log(scenario)
    disk._time.adopt("user")
    log.start_clock(0, SYSTEM_CLOCK)
    log.write_row(10_000, (1, 0, 0.0))
    log.write_event("before")
    disk.hangs = True
    for k in range(2, 2 + rows):
        log.write_row(10_000 * k, (k, 0, 0.0))
        log.write_event(str(k))
    return disk, log


def test_rows_wait_while_the_disk_hangs(scenario):
    disk, log = hang_log(scenario, 5)
    assert disk.free_bytes(Path("/")) > 1e9
    disk._time.call_at(3.0, lambda: setattr(disk, "hangs", False))
    summary, kept = log.close(), log.read()
    assert (summary.rows, summary.dropped, log.unread_rows) == (6, 0, 0)
    assert 3.0 <= disk._time.seconds < 3.01
    assert len(kept) == 6
    assert len(kept.metadata["events"]) == 6


def test_disk_hanging_forever_keeps_only_earlier_rows(scenario):
    disk, log = hang_log(scenario, 5)
    assert log.close() is None
    assert log.unread_rows == 5
    assert END_S <= disk._time.seconds < END_S + 0.01
    kept = log.read()
    assert len(kept) == 1
    assert [e["text"] for e in kept.metadata["events"]] == ["before", "the flying process is gone, without a word"]


def test_rows_beyond_the_ring_are_dropped_and_counted(scenario, monkeypatch):
    monkeypatch.setattr("trimtab.flight.virtual_disk.ROWS", 3)
    disk, log = hang_log(scenario, 5)
    disk.hangs = False
    log.write_row(100_000, (10, 0, 0.0))
    summary = log.close()
    assert (summary.rows, summary.dropped) == (5, 2)
    assert log.read()["own.count"].tolist() == [1, 2, 3, 4, 10]
