"""Size limit of a log: a vehicle's log rolls over into numbered files, an autopilot's log ends."""

import os

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.time import ms
from trimtab.logs.frames import POSE_COLUMNS
from trimtab.logs.log_limit import LogLimit, format_size, list_files, parse_size
from trimtab.logs.mcap import read_mcap
from trimtab.logs.messages import layout_record, run_record
from trimtab.logs.ring import Ring
from trimtab.logs.stream import _empty_log
from trimtab.logs.stream_writer import Recorder

WIDTH, CHUNK = 40, 200
"""Numbers of a row, and rows of a chunk."""
SIGNALS = [("truth.x", (WIDTH,), np.float64, None)]
EPOCH = 1_790_000_000_000_000_000


def record(folder, chunks, limit):
    """Rows of noise, a chunk at a time; what became of the log, and the rows."""
    rng, path = np.random.default_rng(2), folder / "vehicle.mcap"
    ring, empty = Ring.create(columns=1 + WIDTH + POSE_COLUMNS), _empty_log(SIGNALS, {"scenario": "a"})
    rows = rng.standard_normal((chunks * CHUNK, WIDTH))
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)  # the recorder's from now on
    recorder = Recorder(ring, file, run_record(empty), layout_record(empty), frame="vehicle", path=path, limit=limit)
    recorder.set_epoch(EPOCH)
    for k, row in enumerate(rows):
        ring.write_row(np.array([k * ms(1), *row, *np.arange(9.0)]))
        if k % CHUNK == CHUNK - 1:
            recorder.read_ring()
            recorder.write()
    summary = recorder.finish("{}")
    ring.close()
    ring.unlink()
    return path, summary, rows


def test_log_rolls_into_numbered_files_without_losing_rows(tmp_path):
    path, summary, rows = record(tmp_path, 20, LogLimit(4_000_000, rolls=True))
    files = list_files(path)
    assert [f.name for f in files[:3]] == ["vehicle.mcap", "vehicle-2.mcap", "vehicle-3.mcap"]
    logs = [read_mcap(f) for f in files]
    assert np.concatenate([log.ticks for log in logs]).tolist() == [k * ms(1) for k in range(len(rows))]
    assert (np.concatenate([log["truth.x"] for log in logs]) == rows).all()
    for k, log in enumerate(logs, 1):
        assert "truncated" not in log.metadata
        assert (log.metadata["closed"], log.metadata.get("file", 1)) == (True, k)
        assert (log.metadata["epoch_ns"], log.metadata["scenario"]) == (EPOCH, "a")
    assert summary["rows"] == len(rows)
    assert summary["size"] == sum(f.stat().st_size for f in files)
    assert b'"/scene"'.strip(b'"') in files[-1].read_bytes()


@pytest.mark.thorough
def test_rolling_log_deletes_oldest_files_at_the_limit(tmp_path):
    limit = LogLimit(2_000_000, rolls=True)
    path, summary, rows = record(tmp_path, 60, limit)
    files = list_files(path)
    assert not path.exists()
    assert 5 <= len(files) <= 8
    assert sum(f.stat().st_size for f in files) <= limit.size * 1.1
    ticks = np.concatenate([read_mcap(f).ticks for f in files])
    assert (np.diff(ticks) == ms(1)).all()
    assert ticks[-1] == (len(rows) - 1) * ms(1)
    assert (summary["rows"], summary["unwritten"]) == (len(rows), 0)


def test_non_rolling_log_stops_at_limit_and_counts_unwritten_rows(tmp_path):
    path, summary, rows = record(tmp_path, 20, LogLimit(1_000_000, rolls=False))
    log = read_mcap(path)
    assert list_files(path) == [path]
    assert 1_000_000 <= path.stat().st_size < 1_200_000
    assert (log["truth.x"] == rows[: len(log)]).all()
    assert summary["rows"] == len(log) < len(rows)
    assert summary["unwritten"] == len(rows) - len(log)


@pytest.mark.thorough
def test_size_per_minute_includes_deleted_files(tmp_path):
    """Rows of 1 ms: the whole log, less what stands in it once, against the same rows where the oldest files go."""
    (tmp_path / "whole").mkdir()
    (tmp_path / "rolled").mkdir()
    path, whole, rows = record(tmp_path / "whole", 40, LogLimit(100_000_000, rolls=False))
    _, rolled, _ = record(tmp_path / "rolled", 40, LogLimit(2_400_000, rolls=True))
    assert rolled["size"] < 2_500_000 < whole["size"] == path.stat().st_size
    minutes = (len(rows) - 1) * 1e-3 / 60
    assert whole["minute_size"] == pytest.approx(whole["size"] / minutes, rel=0.02)
    assert rolled["minute_size"] == pytest.approx(whole["minute_size"], rel=0.05)
    (tmp_path / "none").mkdir()
    assert record(tmp_path / "none", 0, LogLimit(2_000_000, rolls=True))[1]["minute_size"] is None


def test_log_continues_in_same_file_if_next_names_exist(tmp_path):
    for k in range(2, 40):
        (tmp_path / f"vehicle-{k}.mcap").write_bytes(b"another's")
    path, summary, rows = record(tmp_path, 10, LogLimit(4_000_000, rolls=True))
    assert len(read_mcap(path)) == len(rows) == summary["rows"]
    assert (tmp_path / "vehicle-2.mcap").read_bytes() == b"another's"


@pytest.mark.parametrize(("text", "size"), [("2 GB", 2 * 10**9), ("1.5MB", 1_500_000), (" 5000 kB ", 5_000_000)])
def test_size_text_round_trip(text, size):
    assert parse_size(text) == size
    assert parse_size(format_size(size)) == size


@pytest.mark.parametrize("text", ["", "2", "2 gb", "-1 MB", "nan MB", "900 kB", "2 GB more"])
def test_rejects_invalid_log_size(text):
    with pytest.raises(InputError, match="log_limit"):
        parse_size(text)
