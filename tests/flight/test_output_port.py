"""Port of the outputs: a driver reads the active values and detects a dead or frozen writer."""

import os
import struct

import pytest

from trimtab.flight import output_port
from trimtab.flight.output_port import DRIVEN, STALE, WAITING, OutputPort, OutputReader, OutputRow, memory_folder

MS = 1_000_000


@pytest.fixture
def port(tmp_path):
    return OutputPort(tmp_path / "outputs.bin", [0.0, 1.5], 300 * MS)


def test_reader_gets_the_current_row_and_its_time(port):
    reader = OutputReader(port.path)
    assert reader.read() == (0, OutputRow(WAITING, False, (0.0, 1.5)))
    port.write(OutputRow(DRIVEN, True, (0.9, 1.7)), 5 * MS)
    assert reader.read() == (5 * MS, OutputRow(DRIVEN, True, (0.9, 1.7)))


def test_unchanged_row_is_applied_while_the_writer_renews_it(port):
    reader, row = OutputReader(port.path), OutputRow(DRIVEN, True, (0.9, 1.7))
    port.write(row, 0)
    for now in range(0, 1000, 20):
        port.renew(now * MS)
        assert reader.row_to_apply(now * MS) == row


def test_dead_writer_gives_safe_outputs_then_stops_lift(port):
    reader, row = OutputReader(port.path), OutputRow(DRIVEN, True, (0.9, 1.7))
    port.write(row, 0)
    assert reader.row_to_apply(99 * MS) == row
    assert reader.row_to_apply(100 * MS) == OutputRow(STALE, True, (0.0, 1.5))
    assert reader.row_to_apply(399 * MS) == OutputRow(STALE, True, (0.0, 1.5))
    assert reader.row_to_apply(400 * MS) == OutputRow(STALE, False, (0.0, 1.5))
    port.renew(500 * MS)
    assert reader.row_to_apply(501 * MS) == row


def test_half_written_row_does_not_block_the_driver(port):
    reader, row = OutputReader(port.path), OutputRow(DRIVEN, True, (0.9, 1.7))
    port.write(row, 0)
    assert reader.row_to_apply(1 * MS) == row
    struct.pack_into("<Q", port._memory, 0, port._count + 1)  # the count is odd while a row is written
    assert reader.row_to_apply(99 * MS) == row
    assert reader.row_to_apply(100 * MS) == OutputRow(STALE, True, (0.0, 1.5))
    fresh = OutputReader(port.path)
    assert fresh.row_to_apply(50 * MS) == OutputRow(WAITING, False, (0.0, 1.5))


def test_port_file_is_writable_by_its_owner_only(tmp_path):
    """Whoever can write to the port can move the craft."""
    before = os.umask(0)
    try:
        port = OutputPort(tmp_path / "outputs.bin", [0.0], 0)
    finally:
        os.umask(before)
    assert port.path.stat().st_mode & 0o022 == 0
    port.close()
    assert not port.path.exists()


def test_rejects_memory_folder_accessible_to_others(tmp_path, monkeypatch):
    monkeypatch.setattr(output_port, "SHARED_MEMORY", tmp_path)
    folder = memory_folder()
    assert folder.stat().st_mode & 0o077 == 0
    folder.chmod(0o755)
    with pytest.raises(PermissionError, match="other users have access"):
        memory_folder()
