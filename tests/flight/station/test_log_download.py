"""Log download by MAVLink's LOG messages, as used by most ground stations."""

import os

import pytest
from flight.station.clients import Master

from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.station.log_download import LogService
from trimtab.flight.station.served_files import ServedFiles


@pytest.fixture
def master(dialect, tmp_path):
    (tmp_path / "flight.mcap").write_bytes(os.urandom(1000))
    (tmp_path / "vehicle.mcap").write_bytes(os.urandom(900))
    os.utime(tmp_path / "vehicle.mcap", (1_700_000_000, 1_700_000_000))
    endpoint = Endpoint(dialect, 1, 1, unsigned=True)
    return Master(dialect, [LogService(endpoint, ServedFiles(folder=tmp_path, patience=60.0), 1e6)])


def listed(master):
    master.mav.log_request_list_send(1, 1, 0, 0xFFFF)
    return [(m.id, m.num_logs, m.last_log_num, m.size) for m in master.heard("LOG_ENTRY")]


def test_list_gives_number_and_size_of_each_log(master):
    assert listed(master) == [(1, 2, 2, 1000), (2, 2, 2, 900)]
    master.mav.log_request_list_send(1, 1, 2, 2)
    (entry,) = master.heard("LOG_ENTRY")
    assert (entry.id, entry.time_utc) == (2, 1_700_000_000)


def test_empty_list_is_answered_by_one_entry(dialect):
    master = Master(dialect, [LogService(Endpoint(dialect, 1, 1, unsigned=True), ServedFiles(), 1e6)])
    master.mav.log_request_list_send(1, 1, 0, 0xFFFF)
    (entry,) = master.heard("LOG_ENTRY", 0)
    assert (entry.id, entry.num_logs) == (0, 0)


@pytest.mark.parametrize(("number", "size"), [(1, 1000), (2, 900)])
def test_log_bytes_are_complete_and_last_piece_is_short(master, tmp_path, number, size):
    listed(master)
    master.mav.log_request_data_send(1, 1, number, 0, 0xFFFFFFFF)
    pieces = master.heard("LOG_DATA")
    assert pieces[-1].count < 90
    whole = b"".join(bytes(m.data[: m.count]) for m in pieces)
    assert whole == (tmp_path / ("flight.mcap", "vehicle.mcap")[number - 1]).read_bytes()
    assert len(whole) == size


def test_part_of_a_log_can_be_requested(master, tmp_path):
    listed(master)
    master.mav.log_request_data_send(1, 1, 1, 180, 90)
    (piece,) = master.heard("LOG_DATA")
    assert (piece.ofs, piece.count) == (180, 90)
    assert bytes(piece.data) == (tmp_path / "flight.mcap").read_bytes()[180:270]


def test_log_can_be_requested_without_listing_first(master, tmp_path):
    """Some stations do so, also after a vehicle restart."""
    master.mav.log_request_data_send(1, 1, 1, 0, 90)
    (piece,) = master.heard("LOG_DATA")
    assert bytes(piece.data) == (tmp_path / "flight.mcap").read_bytes()[:90]


def test_no_bytes_of_unlisted_logs_or_in_flight(master):
    listed(master)
    master.mav.log_request_data_send(1, 1, 3, 0, 90)
    assert [m.count for m in master.heard("LOG_DATA")] == [0]
    master.mav.log_request_data_send(1, 1, 1, 0, 1000)
    master.fly(True)
    assert master.heard("LOG_DATA") == []
    master.mav.log_request_data_send(1, 1, 1, 0, 90)
    assert [m.count for m in master.heard("LOG_DATA")] == [0]


def test_erase_request_is_refused_with_a_text(master, tmp_path):
    master.mav.log_erase_send(1, 1)
    assert ["not erased" in m.text for m in master.heard("STATUSTEXT")] == [True]
    assert len(list(tmp_path.iterdir())) == 2


def test_end_request_stops_the_download(master):
    listed(master)
    master.mav.log_request_data_send(1, 1, 1, 0, 1000)
    assert len(master.heard("LOG_DATA", 2)) == 2
    master.mav.log_request_end_send(1, 1)
    assert master.heard("LOG_DATA") == []
