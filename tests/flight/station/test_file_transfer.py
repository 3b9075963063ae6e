"""File transfer with pymavlink's client: only listed files can be read, and none written."""

import os
import struct
import threading
from types import SimpleNamespace

import pytest
from flight.station.clients import Master, common
from hypothesis import given, settings
from hypothesis import strategies as st

from trimtab.core.time import seconds
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.station.file_transfer import FILE_TRANSFER, FileTransferService
from trimtab.flight.station.served_files import ServedFiles

mavftp = pytest.importorskip("pymavlink.mavftp")
LIST, OPEN, READ, BURST, TERMINATE, RESET = 3, 4, 5, 15, 1, 2
ACK, NAK = 128, 129


@pytest.fixture
def folder(tmp_path):
    logs = tmp_path / "logs"
    logs.mkdir()
    (logs / "vehicle.mcap").write_bytes(os.urandom(100_003))
    (logs / "exact.mcap").write_bytes(os.urandom(239 * 3))
    (logs / "empty.mcap").write_bytes(b"")
    (logs / ".hidden.mcap").write_bytes(b"hidden")
    (logs / "outputs.bin").write_bytes(b"not a log")
    (logs / "folder.mcap").mkdir()
    (tmp_path / "secret.mcap").write_bytes(b"secret")
    (logs / "link.mcap").symlink_to(tmp_path / "secret.mcap")
    os.mkfifo(logs / "pipe.mcap")
    return logs


def connect(dialect, folder, rate=1e6, **how):
    endpoint = Endpoint(dialect, 1, 1, unsigned=True)
    service = FileTransferService(endpoint, ServedFiles({"parameters.json": b"{}"}, folder, patience=60.0), rate)
    return Master(dialect, [service], **how)


def client(master):
    return mavftp.MAVFTP(master, 1, 1)


def ask(master, operation, *, number=7, session=0, offset=0, data=b"", size=None, steps=0):
    """Send one raw request. Return answers as (number, operation, asked operation, end of burst, offset, data)."""
    size = len(data) if size is None else size
    payload = struct.pack("<HBBBBBBI", number, session, operation, size, 0, 0, 0, offset) + data
    master.mav.file_transfer_protocol_send(0, 1, 1, list(payload.ljust(251, b"\0")))
    answers = []
    for m in master.heard(FILE_TRANSFER, steps):
        n, _, op, count, asked, end, _, at = struct.unpack_from("<HBBBBBBI", bytes(m.payload))
        answers.append((n, op, asked, end, at, bytes(m.payload)[12 : 12 + count]))
    return answers


def test_listing_shows_logs_only(dialect, folder):
    found = client(connect(dialect, folder)).cmd_list(["/logs"]).directory_listing
    assert [(e.name, e.size_b) for e in found] == [
        ("empty.mcap", 0),
        ("exact.mcap", 717),
        ("vehicle.mcap", 100_003),
    ]
    top = client(connect(dialect, folder)).cmd_list(["/"]).directory_listing
    assert {(e.name, e.is_dir) for e in top} == {("logs", True), ("parameters.json", False)}


@pytest.mark.parametrize("name", ["vehicle.mcap", "exact.mcap"])
def test_log_is_transferred_completely(dialect, folder, name):
    got = client(connect(dialect, folder)).read(f"/logs/{name}", 1 << 30)
    assert got == (folder / name).read_bytes()


def test_log_is_transferred_completely_over_a_lossy_link(dialect, folder):
    master = connect(dialect, folder, lossy=lambda n: n % 7 == 3)
    reader = client(master)
    reader.ftp_settings.retry_time, reader.ftp_settings.read_retry_time = 0.2, 0.1
    assert reader.read("/logs/vehicle.mcap", 1 << 30) == (folder / "vehicle.mcap").read_bytes()


@pytest.mark.parametrize(
    "path",
    [
        "/secret.mcap",
        "/logs/../secret.mcap",
        "../secret.mcap",
        "/logs/link.mcap",
        "/logs/.hidden.mcap",
        "/logs/folder.mcap",
        "/logs/pipe.mcap",
        "/logs/outputs.bin",
        "/etc/passwd",
        "/logs//etc/passwd",
        "/logs/./../../secret.mcap",
        "@PARAM/param.pck",
        "",
        "/",
        "/logs",
    ],
)
def test_files_outside_the_listing_cannot_be_opened(dialect, folder, path):
    ((_, operation, asked, _, _, why),) = ask(connect(dialect, folder), OPEN, data=path.encode())
    assert (operation, asked, why) == (NAK, OPEN, bytes((10,)))


def test_write_operations_are_refused_without_changing_the_folder(dialect, folder):
    master, before = connect(dialect, folder), sorted(p.name for p in folder.iterdir())
    for operation in range(6, 15):
        ((_, answer, _, _, _, why),) = ask(master, operation, number=operation, data=b"/logs/vehicle.mcap")
        assert (answer, why) == (NAK, bytes((9,)))
    for operation in (16, 99, 200):
        ((_, answer, _, _, _, why),) = ask(master, operation, number=operation)
        assert (answer, why) == (NAK, bytes((7,)))
    assert sorted(p.name for p in folder.iterdir()) == before


def test_in_flight_documents_are_read_but_not_logs(dialect, folder, monkeypatch):
    """The disk may hang or hold many files, so no disk access happens in flight. The last listing is sent."""
    master = connect(dialect, folder)
    ask(master, OPEN, data=b"/logs/vehicle.mcap")
    listed = ask(master, LIST, number=7, data=b"/logs")[0]
    master.fly(True)
    monkeypatch.setattr("trimtab.flight.station.served_files.os", None)
    assert ask(master, OPEN, number=8, data=b"/logs/vehicle.mcap")[0][1] == NAK
    assert ask(master, READ, number=9, size=100)[0][1] == NAK
    assert ask(master, OPEN, number=10, data=b"/parameters.json")[0][1] == ACK
    again = ask(master, LIST, number=11, data=b"/logs")[0]
    assert again[1] == ACK
    assert again[5] == listed[5]


@pytest.mark.parametrize("is_armed", [False, True])
def test_a_listing_on_a_disk_that_hangs_is_answered_at_once(folder, monkeypatch, is_armed):
    """Until the disk answers, the loop gets the last listing and starts no second one."""
    hung, listings = threading.Event(), []

    def scan(path):
        listings.append(path)
        hung.wait(60)
        return os.scandir(path)

    files = ServedFiles(folder=folder, patience=60.0)
    listed = [entry.name for entry in files.list_logs(is_armed=False)]
    files._lister.join()
    (folder / "later.mcap").touch()
    files._patience = 0.001
    monkeypatch.setattr("trimtab.flight.station.served_files.os", SimpleNamespace(scandir=scan))
    for _ in range(3):
        assert [entry.name for entry in files.list_logs(is_armed=is_armed)] == listed
    assert listings == ([] if is_armed else [folder])
    hung.set()
    files._lister.join()
    assert ("later.mcap" in [entry.name for entry in files.list_logs(is_armed=True)]) is not is_armed


def test_a_burst_ends_when_the_vehicle_is_armed(dialect, folder):
    master = connect(dialect, folder)
    ask(master, OPEN, data=b"/logs/vehicle.mcap")
    assert len(ask(master, BURST, number=8, size=239, steps=50)) == 50
    master.fly(True)
    assert master.heard(FILE_TRANSFER, 100) == []


def test_burst_respects_the_rate_limit_and_ends(dialect, folder):
    master = connect(dialect, folder, rate=20e3)
    ask(master, OPEN, data=b"/logs/vehicle.mcap")
    answers = ask(master, BURST, number=8, size=239, steps=1000)
    assert 70 <= len(answers) <= 80  # 263 bytes each with the frame's, of 20 kB/s
    assert [n for n, *_ in answers] == [9 + k for k in range(len(answers))]
    assert [at for *_, at, _ in answers] == [239 * k for k in range(len(answers))]
    rest = [bytes(m.payload) for m in master.heard(FILE_TRANSFER, 60_000)]
    assert len(answers) + len(rest) == 200
    assert [payload[6] for payload in rest] == [0] * (len(rest) - 1) + [1]


def test_repeated_request_gets_same_answer_without_new_session(dialect, folder):
    master = connect(dialect, folder)
    first = ask(master, OPEN, data=b"/logs/vehicle.mcap")
    for _ in range(10):
        assert ask(master, OPEN, data=b"/logs/vehicle.mcap") == first
    assert ask(master, OPEN, number=8, data=b"/logs/exact.mcap")[0][1] == ACK


def test_number_of_sessions_is_limited_and_idle_ones_reused(dialect, folder):
    master = connect(dialect, folder)
    opened = [ask(master, OPEN, number=n, data=b"/logs/exact.mcap")[0] for n in range(5)]
    assert [operation for _, operation, *_ in opened] == [ACK] * 4 + [NAK]
    master.now += seconds(31)
    assert ask(master, OPEN, number=9, data=b"/logs/exact.mcap")[0][1] == ACK
    assert ask(master, RESET, number=10)[0][1] == ACK
    assert ask(master, READ, number=11, session=1, size=10)[0][1] == NAK


def test_session_is_private_to_its_station(dialect, folder):
    master = connect(dialect, folder)
    ask(master, OPEN, data=b"/logs/exact.mcap")
    assert ask(master, READ, number=8, size=10)[0][5] == (folder / "exact.mcap").read_bytes()[:10]
    master.mav = common.MAVLink(master, srcSystem=254, srcComponent=190)
    master.mav.robust_parsing = True
    assert ask(master, READ, number=9, size=10)[0][1] == NAK
    assert ask(master, TERMINATE, number=10)[0][1] == ACK
    master.mav = common.MAVLink(master, srcSystem=255, srcComponent=190)
    master.mav.robust_parsing = True
    assert ask(master, READ, number=11, size=10)[0][1] == ACK


@pytest.mark.thorough
@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 255), st.integers(0, 4), st.integers(0, 2**32 - 1), st.binary(max_size=239))))
def test_every_fuzzed_request_is_answered(dialect, tmp_path_factory, requests):
    folder = tmp_path_factory.getbasetemp() / "fuzzed"
    folder.mkdir(exist_ok=True)
    (folder / "a.mcap").write_bytes(b"abc")
    master = connect(dialect, folder)
    ask(master, OPEN, number=1000, data=b"/logs/a.mcap")
    for number, (operation, session, offset, data) in enumerate(requests):
        answers = ask(master, operation, number=number, session=session, offset=offset, data=data, steps=2)
        assert len(answers) >= 1
