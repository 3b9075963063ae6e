"""Flight log: rows taken from vectors, and written to a file by another process."""

import os
import signal
import threading

import numpy as np
import pytest

from trimtab.compiler.structs import Member
from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity
from trimtab.flight.flight_log import ROWS, WRITER_DIED, FlightLog, FlightRows, LogSource, list_log_problems
from trimtab.logs.mcap import read_mcap

PERIOD = 10_000
OWN = {"loop.late": ("f8", Quantity("s", "Lateness.")), "vehicle.armed": ("?", Quantity("1", "Armed.", kind="flag"))}


def member(name, dtype, shape=()):
    return Member("c_" + name, shape, dtype, None, name)


MEMBERS = [member("t", "i64"), member("a-b.v", "f64", (3,)), member("hidden", "f64"), member("ok", "bool")]


def renamed(path):
    return None if path in ("t", "hidden") else f"in.{path}"


def book(file):
    given, made = np.zeros(6), np.zeros(1)
    sources = [LogSource(given, MEMBERS, renamed), LogSource(made, [member("law.out", "i32")], lambda p: p)]
    return FlightLog(file, FlightRows(sources, OWN), {"scenario": "a test"}), given, made


def test_logged_rows_equal_the_source_vectors(tmp_path):
    log, given, made = book(tmp_path / "a.mcap")
    rng, rows = np.random.default_rng(1), []
    for k in range(300):
        given[:], made[:] = rng.standard_normal(6), rng.integers(-(2**31), 2**31)
        given[5] = k % 2
        own = (float(rng.standard_normal()), k % 3 == 0)
        rows.append((given.copy(), made.copy(), own))
        log.write_row(k * PERIOD, own)
        if k == 150:
            log.write_event("half of it")
    written = log.close({"truth.x": np.array(2.5)})
    assert (written.rows, written.dropped, written.unwritten, written.whole) == (300, 0, 0, True)
    found = read_mcap(tmp_path / "a.mcap")
    np.testing.assert_array_equal(found.ticks, np.arange(300) * PERIOD)
    np.testing.assert_array_equal(found["in.a-b.v"], [g[1:4] for g, _, _ in rows])
    np.testing.assert_array_equal(found["in.ok"], [g[5] == 1 for g, _, _ in rows])
    np.testing.assert_array_equal(found["law.out"], [m[0] for _, m, _ in rows])
    np.testing.assert_array_equal(found["loop.late"], [late for _, _, (late, _) in rows])
    np.testing.assert_array_equal(found["vehicle.armed"], [armed for _, _, (_, armed) in rows])
    assert not {"in.t", "in.hidden", "hidden"} & set(found.paths)
    assert found.metadata["scenario"] == "a test"
    assert found.final["truth.x"] == 2.5
    assert [(e["text"], e["t"]) for e in found.metadata["events"]] == [("half of it", 0.15)]


@pytest.mark.real_time
def test_death_of_the_log_writer_loses_only_rows(tmp_path):
    log, _given, _ = book(tmp_path / "a.mcap")
    for k in range(100):
        log.write_row(k * PERIOD, (0.0, True))
    os.kill(log._stream.pid, signal.SIGKILL)
    log._stream._process.wait(10)
    assert not log._stream.is_alive
    for k in range(100, 20_000):  # more than the ring holds
        log.write_row(k * PERIOD, (0.0, True))
    log.write_event("nobody hears this")
    assert log.close() is None
    assert log.unread_rows == ROWS
    assert list_log_problems(log, None) == [f"{WRITER_DIED}, at least {ROWS} rows are lost"]


@pytest.mark.real_time
def test_virtual_flight_waits_for_slow_but_not_dead_writer(tmp_path):
    log, _given, _ = book(tmp_path / "a.mcap")
    rows = 20_000  # more than the ring holds
    os.kill(log._stream.pid, signal.SIGSTOP)
    threading.Timer(1.0, os.kill, (log._stream.pid, signal.SIGCONT)).start()
    for k in range(rows):
        log.await_room()
        log.write_row(k * PERIOD, (0.0, True))
    assert log.close().dropped == 0
    assert len(read_mcap(tmp_path / "a.mcap")) == rows
    log, _given, _ = book(tmp_path / "b.mcap")
    os.kill(log._stream.pid, signal.SIGKILL)
    for k in range(rows):
        log.await_room()
        log.write_row(k * PERIOD, (0.0, True))
    assert log.close() is None


def test_rejects_existing_log_file_and_leaves_it_unchanged(tmp_path):
    (tmp_path / "a.mcap").write_bytes(b"mine")
    with pytest.raises(InputError):
        book(tmp_path / "a.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == b"mine"
