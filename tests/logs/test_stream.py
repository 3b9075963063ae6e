"""A log written during a flight equals one written afterwards, even if a process is killed."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity
from trimtab.core.time import to_seconds
from trimtab.flight.flight_log import list_log_problems
from trimtab.logs.log import Log, provenance
from trimtab.logs.mcap import read_mcap, write_mcap
from trimtab.logs.ring import Ring
from trimtab.logs.stream import LogStream, start_writer

SIGNALS = [
    ("downlink.imu.value.acceleration", (3,), np.float64, Quantity("m/s^2", "Felt.", shape=(3,))),
    ("downlink.imu.t", (), np.int64, Quantity("100 ns", "When.", kind="time")),
    ("downlink.imu.valid", (), np.bool_, Quantity("1", "Whether.", kind="flag")),
    ("law.mode", (), np.int32, Quantity("1", "Which.", kind="mode", modes=("damp", "turn"))),
    ("law.demand.FX", (), np.float64, Quantity("N", "Surge.")),
]
WIDTH = 8
METADATA = {"scenario": "hovercraft/spin", "seed": 7, "parameters": {"world.vehicle.mass": 2.6}}
FLYING = """
import sys, time
import numpy as np
from test_stream import METADATA, SIGNALS, WIDTH, rows_of
from trimtab.logs.log import provenance
from trimtab.logs.ring import Ring
from trimtab.logs.stream import start_writer
ring = Ring.create(columns=WIDTH)
stream = start_writer(sys.argv[1], ring, signals=SIGNALS, metadata=METADATA)
rows = rows_of(100_000)
print(stream.pid, flush=True)
for k, row in enumerate(rows):
    ring.write_row(row)
    if k % 100 == 0:
        print(k, flush=True)
        time.sleep(0.1)
"""


def rows_of(n: int) -> np.ndarray:
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(n, WIDTH)) * 10.0 ** rng.integers(-300, 300, (n, WIDTH))
    rows[:, 0] = np.arange(n) * 10_000
    rows[:, 4] = np.where(np.arange(n) < 5, -(2.0**62), np.arange(n) * 10_000)
    rows[:, 5] = np.arange(n) >= 5
    rows[:, 6] = np.arange(n) // 50 % 2
    rows[::7, 7] = np.nan
    rows[::11, 7] = -0.0
    return rows


def log_of(rows: np.ndarray) -> Log:
    ticks = rows[:, 0].astype(np.int64)
    arrays, at = {}, 1
    for path, shape, dtype, _ in SIGNALS:
        size = int(np.prod(shape))
        arrays[path] = rows[:, at : at + size].astype(dtype).reshape(len(rows), *shape)
        at += size
    return Log(to_seconds(ticks), ticks, arrays, {path: q for path, _, _, q in SIGNALS if q}, METADATA)


def same(found: Log, rows: np.ndarray) -> None:
    """Every signal, to the bit."""
    expected = log_of(rows)
    np.testing.assert_array_equal(found.ticks, expected.ticks)
    for path in expected.paths:
        assert found[path].dtype == expected[path].dtype
        np.testing.assert_array_equal(found[path], expected[path])
        if found[path].dtype.kind == "f":
            assert (np.signbit(found[path]) == np.signbit(expected[path])).all()


@pytest.fixture
def ring():
    made = Ring.create(columns=WIDTH, rows=512, events=8)
    yield made
    made.close()
    made.unlink()


def until(condition) -> None:
    """Wait for the writer's process; pytest's own time limit ends a wait for something that never comes."""
    while not condition():
        time.sleep(0.02)


def flown(path: Path, ring: Ring, rows: np.ndarray):
    """All rows, as fast as they are taken."""
    stream = start_writer(path, ring, signals=SIGNALS, metadata=METADATA)
    for row in rows:
        until(lambda: ring.waiting_rows < ring.rows)
        ring.write_row(row)
    return stream


def test_streamed_log_equals_write_mcap_output(tmp_path, ring):
    rows = rows_of(700)
    stream = flown(tmp_path / "flight.mcap", ring, rows)
    assert stream.is_alive
    ring.write_text("target reached")
    written = stream.close({"truth.heading": 0.5})
    assert not stream.is_alive
    assert written is not None
    assert (written.rows, written.dropped, written.unwritten, written.whole) == (700, 0, 0, True)
    assert written.size == (tmp_path / "flight.mcap").stat().st_size
    log = read_mcap(tmp_path / "flight.mcap")
    same(log, rows)
    assert "truncated" not in log.metadata
    assert log.metadata["closed"] is True
    assert log.metadata["events"] == [{"t": log.t[-1], "text": "target reached"}]
    assert {k: log.metadata[k] for k in METADATA} == METADATA
    assert {k: log.metadata[k] for k in provenance()} == provenance()
    assert dict(log.final) == {"truth.heading": 0.5}
    assert log.declarations["law.mode"].modes == ("damp", "turn")
    write_mcap(log_of(rows), tmp_path / "after.mcap")
    assert schemas(tmp_path / "after.mcap").items() <= schemas(tmp_path / "flight.mcap").items()


def schemas(path: Path) -> dict[str, bytes]:
    with open(path, "rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return {c.topic: summary.schemas[c.schema_id].data for c in summary.channels.values()}


def test_mcap_library_reads_the_streamed_log(tmp_path, ring):
    """By the mcap library alone, with its checks and by way of its index; and its metadata by a text search."""
    rows = rows_of(150)
    flown(tmp_path / "flight.mcap", ring, rows).close()
    with open(tmp_path / "flight.mcap", "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        found = list(reader.iter_messages(topics=["/law"]))
        summary = reader.get_summary()
        assert sum(1 for _ in reader.iter_messages()) == 3 * 150
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 3 * 150
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (0, 149_000_000)
    assert [m.log_time for _, _, m in found] == list(range(0, 150_000_000, 1_000_000))
    assert [json.loads(m.data)["mode"] for _, _, m in found] == rows[:, 6].astype(int).tolist()
    head = (tmp_path / "flight.mcap").read_bytes()[:4000]
    assert b"hovercraft/spin" in head
    assert b"world.vehicle.mass" in head


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("cut") / "flight.mcap"
    with Ring.create(columns=WIDTH, rows=512) as ring:
        flown(path, ring, rows_of(1200)).close()
        ring.unlink()
    return path


@pytest.mark.thorough
@settings(max_examples=150)
@given(share=st.floats(0, 1, exclude_max=True))
def test_truncated_stream_gives_all_chunks_before_the_cut(tmp_path_factory, whole, share):
    """All chunks that end before the cut, as the file's own index has them; refused only without the description."""
    path = tmp_path_factory.mktemp("cut") / "cut.mcap"
    path.write_bytes(whole.read_bytes()[: int(share * whole.stat().st_size)])
    with open(whole, "rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    chunks = [c for c in summary.chunk_indexes if c.chunk_start_offset + c.chunk_length <= path.stat().st_size]
    least = 1 + max((c.message_end_time for c in chunks), default=-1_000_000) // 1_000_000
    described = summary.metadata_indexes[1].offset + summary.metadata_indexes[1].length
    if path.stat().st_size < described:
        with pytest.raises(InputError, match=r"is cut before the first sample|not an MCAP|is empty"):
            read_mcap(path)
        return
    cut = read_mcap(path)
    assert cut.metadata["truncated"] is True
    assert cut.metadata["seed"] == 7
    assert len(cut) >= least
    same(cut, rows_of(1200)[: len(cut)])


def test_unreadable_log_error_reports_remaining_metadata(tmp_path, whole):
    data = whole.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: data.index(b"trimtab.layout") + 40])
    with pytest.raises(InputError, match="the rest of the file gives scenario hovercraft/spin, seed 7"):
        read_mcap(tmp_path / "cut.mcap")


@pytest.mark.real_time
@pytest.mark.parametrize("victim", ["flight", "writer"])
def test_killed_process_loses_at_most_half_a_second(tmp_path, victim):
    path = tmp_path / "flight.mcap"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    command = [sys.executable, "-c", FLYING, str(path)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment)
    assert process.stdout is not None
    writer = int(process.stdout.readline())
    put: list[tuple[float, int]] = []
    while not put or put[-1][1] < 1500:
        line = process.stdout.readline()
        put.append((time.monotonic(), int(line)))
    killed = time.monotonic()
    os.kill(process.pid if victim == "flight" else writer, signal.SIGKILL)
    if victim == "writer":
        assert int(process.stdout.readline()) > put[-1][1]  # the flight goes on
        process.kill()
    process.communicate()
    if victim == "flight":
        until(lambda: read_mcap(path).metadata.get("closed") is False)
    log = read_mcap(path)
    safe = max(k for t, k in put if t <= killed - 0.5)
    assert len(log) > safe
    same(log, rows_of(100_000)[: len(log)])
    if victim == "flight":
        assert "truncated" not in log.metadata
        assert log.metadata["events"][-1]["text"] == "the flying process is gone, without a word"
    else:
        assert log.metadata["truncated"] is True


@pytest.mark.real_time
def test_full_disk_leaves_a_counted_gap(tmp_path, ring, capfd):
    """The space for the file is limited from outside, then restored."""
    rows = rows_of(3000)
    path = tmp_path / "flight.mcap"
    stream = flown(path, ring, rows[:500])
    until(lambda: len(read_mcap(path)) == 500)
    _, hard = resource.prlimit(stream.pid, resource.RLIMIT_FSIZE, (path.stat().st_size + 100, -1))
    for row in rows[500:1000]:
        until(lambda: ring.waiting_rows < ring.rows)
        ring.write_row(row)
    until(lambda: "can't be written" in capfd.readouterr().err)
    resource.prlimit(stream.pid, resource.RLIMIT_FSIZE, (hard, hard))
    for row in rows[1000:]:
        until(lambda: ring.waiting_rows < ring.rows)
        assert ring.write_row(row)
    written = stream.close()
    assert written is not None
    assert written.whole
    assert written.dropped == 0
    assert 0 < written.unwritten <= 2500
    assert written.rows == 3000 - written.unwritten
    assert f"a gap of {written.unwritten} rows" in capfd.readouterr().err
    log = read_mcap(path)
    gap = int(np.argmax(np.diff(log.ticks) > 10_000)) + 1
    assert gap == 500
    same(log, np.concatenate([rows[:500], rows[500 + written.unwritten :]]))
    assert log["log.unwritten"].tolist() == [0] * 500 + [written.unwritten] * (2500 - written.unwritten)
    assert "gap" in log.metadata["events"][0]["text"]
    assert log.metadata["log"] == {"rows": written.rows, "dropped": 0, "unwritten": written.unwritten}


@pytest.mark.real_time
def test_rows_dropped_by_the_ring_are_logged(tmp_path, ring):
    rows = rows_of(2000)
    stream = start_writer(tmp_path / "flight.mcap", ring, signals=SIGNALS, metadata={})
    os.kill(stream.pid, signal.SIGSTOP)
    kept = [ring.write_row(row) for row in rows[:600]]
    os.kill(stream.pid, signal.SIGCONT)
    until(lambda: ring.waiting_rows == 0)
    ring.write_row(rows[600])
    written = stream.close()
    assert written is not None
    assert written.dropped == ring.dropped_rows == kept.count(False) == 88
    log = read_mcap(tmp_path / "flight.mcap")
    assert log["log.dropped"].tolist() == [0] * 512 + [88]
    same(log, rows[[*range(512), 600]])


def test_deleted_log_is_reported_at_close(tmp_path, ring):
    stream = flown(tmp_path / "flight.mcap", ring, rows_of(6))
    (tmp_path / "flight.mcap").unlink()
    written = stream.close()
    assert (written.rows, written.gone) == (6, True)
    assert list_log_problems(Mock(), written) == ["the log was deleted or moved before its end"]


def test_rows_with_non_increasing_times_are_dropped_and_counted(tmp_path, ring):
    rows = rows_of(6)
    rows[3, 0] = rows[1, 0]
    stream = flown(tmp_path / "flight.mcap", ring, rows)
    written = stream.close()
    assert written is not None
    assert (written.rows, written.unwritten) == (5, 1)
    same(read_mcap(tmp_path / "flight.mcap"), np.delete(rows, 3, axis=0))


def test_rejects_unwritable_log_before_the_flight(tmp_path, ring):
    (tmp_path / "old.mcap").write_text("an old flight")
    with pytest.raises(InputError, match="File exists"):
        start_writer(tmp_path / "old.mcap", ring, signals=SIGNALS, metadata={})
    assert (tmp_path / "old.mcap").read_text() == "an old flight"
    with pytest.raises(InputError, match="No such file"):
        start_writer(tmp_path / "no" / "flight.mcap", ring, signals=SIGNALS, metadata={})
    with pytest.raises(InputError, match="have 8 numbers, but the time and these signals have 7"):
        start_writer(tmp_path / "new.mcap", ring, signals=SIGNALS[:-1], metadata={})
    with pytest.raises(InputError, match="a name reserved for the log"):
        start_writer(tmp_path / "new.mcap", ring, signals=[("log.x", (7,), np.float64, None)], metadata={})


def test_closing_after_writer_death_returns_none(tmp_path, ring):
    stream = start_writer(tmp_path / "flight.mcap", ring, signals=SIGNALS, metadata={})
    os.kill(stream.pid, signal.SIGKILL)
    until(lambda: not stream.is_alive)
    assert stream.close() is None
    assert read_mcap(tmp_path / "flight.mcap").metadata["truncated"] is True


def test_stopped_writer_delays_closing_by_at_most_its_limit(tmp_path, ring, monkeypatch):
    monkeypatch.setattr("trimtab.logs.stream.END_S", 0.1)
    stream = flown(tmp_path / "flight.mcap", ring, rows_of(20))
    until(lambda: len(read_mcap(tmp_path / "flight.mcap")) == 20)
    os.kill(stream.pid, signal.SIGSTOP)
    ring.write_row(rows_of(21)[20])
    assert stream.close() is None
    assert not stream.is_alive
    assert ring.waiting_rows == 1
    same(read_mcap(tmp_path / "flight.mcap"), rows_of(20))


def test_slow_writer_may_finish_while_it_makes_progress(tmp_path, ring, monkeypatch):
    """Each line that the writer prints after a chunk extends its time limit."""
    monkeypatch.setattr("trimtab.logs.stream.END_S", 0.2)
    script = "import time; [(time.sleep(0.05), print(flush=True)) for _ in range(40)]; print('{}', flush=True)"
    process = subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    assert LogStream(tmp_path / "a.mcap", process)._await_end(b"").splitlines()[-1] == b"{}"
