"""Port of the outputs: a driver sees what acts, and that a writer is dead or frozen."""

import os
import struct

import pytest

from trimtab.flight import output_port
from trimtab.flight.output_port import DRIVEN, STALE, WAITING, OutputPort, OutputReader, OutputRow, memory_folder

MS = 1_000_000


@pytest.fixture
def port(tmp_path):
    return OutputPort(tmp_path / "outputs.bin", [0.0, 1.5], 300 * MS)


def test_a_reader_gets_the_row_that_acts_and_when_it_was_written(port):
    reader = OutputReader(port.path)
    assert reader.read() == (0, OutputRow(WAITING, False, (0.0, 1.5)))
    port.write(OutputRow(DRIVEN, True, (0.9, 1.7)), 5 * MS)
    assert reader.read() == (5 * MS, OutputRow(DRIVEN, True, (0.9, 1.7)))


def test_a_steady_row_is_applied_as_long_as_the_writer_shows_life(port):
    reader, row = OutputReader(port.path), OutputRow(DRIVEN, True, (0.9, 1.7))
    port.write(row, 0)
    for now in range(0, 1000, 20):
        port.renew(now * MS)
        assert reader.row_to_apply(now * MS) == row


def test_a_dead_writer_is_safe_after_100_ms_and_the_lift_stops_after_its_delay(port):
    reader, row = OutputReader(port.path), OutputRow(DRIVEN, True, (0.9, 1.7))
    port.write(row, 0)
    assert reader.row_to_apply(99 * MS) == row
    assert reader.row_to_apply(100 * MS) == OutputRow(STALE, True, (0.0, 1.5))
    assert reader.row_to_apply(399 * MS) == OutputRow(STALE, True, (0.0, 1.5))
    assert reader.row_to_apply(400 * MS) == OutputRow(STALE, False, (0.0, 1.5))
    port.renew(500 * MS)
    assert reader.row_to_apply(501 * MS) == row


def test_a_writer_that_stops_within_a_row_does_not_hold_up_the_driver(port):
    reader, row = OutputReader(port.path), OutputRow(DRIVEN, True, (0.9, 1.7))
    port.write(row, 0)
    assert reader.row_to_apply(1 * MS) == row
    struct.pack_into("<Q", port._memory, 0, port._count + 1)  # the count is odd while a row is written
    assert reader.row_to_apply(99 * MS) == row
    assert reader.row_to_apply(100 * MS) == OutputRow(STALE, True, (0.0, 1.5))
    fresh = OutputReader(port.path)
    assert fresh.row_to_apply(50 * MS) == OutputRow(WAITING, False, (0.0, 1.5))


def test_nobody_else_writes_what_acts_whatever_the_mask(tmp_path):
    """Who writes the port moves the craft."""
    before = os.umask(0)
    try:
        port = OutputPort(tmp_path / "outputs.bin", [0.0], 0)
    finally:
        os.umask(before)
    assert port.path.stat().st_mode & 0o022 == 0
    port.close()
    assert not port.path.exists()


def test_a_folder_that_others_can_enter_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(output_port, "SHARED_MEMORY", tmp_path)
    folder = memory_folder()
    assert folder.stat().st_mode & 0o077 == 0
    folder.chmod(0o755)
    with pytest.raises(PermissionError, match="other users have access"):
        memory_folder()
