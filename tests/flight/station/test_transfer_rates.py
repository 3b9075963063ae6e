"""Data rates of the transfers of logs and documents, over a network and over a radio, disarmed and armed."""

import struct

import pytest

from trimtab.commands.line import transfer_rate
from trimtab.core.time import seconds
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.station.file_transfer import FILE_TRANSFER, Operation
from trimtab.flight.station.served_files import FileEntry
from trimtab.flight.station_options import StationOptions, station_services

NETWORK, RADIO = "udp://:14550", "serial:///dev/ttyUSB0?baud=57600"
RATES = {NETWORK: 200e3, "tcp://:5760": 200e3, RADIO: 4e3, "rfcomm://00:11:22:AA:BB:CC/1": 4e3}
DOCUMENT = "parameters.json"


class Transfer:
    """A vehicle's services for one link, and a ground station that starts a transfer and never waits."""

    def __init__(self, dialect, folder, uri):
        (folder / "flight.mcap").write_bytes(bytes(1_000_000))
        self.vehicle, self.ground = (Endpoint(dialect, system, 1, unsigned=True) for system in (1, 255))
        options = StationOptions(log_folder=folder, transfer_rate=transfer_rate(uri))
        _, self.files, self.logs = station_services(self.vehicle, options, {DOCUMENT: bytes(1_000_000)})
        self.files._files._patience = 60.0
        self.files._files.list_logs(is_armed=False)

    def ask(self, service, name, fields, is_armed):
        for message in self.vehicle.feed(self.ground.pack(name, {"target_system": 1} | fields)):
            service.answer(message, 0, is_armed=is_armed)

    def ask_file(self, operation, data, number, is_armed):
        payload = struct.pack("<HBBBBBBI", number, 0, operation, len(data), 0, 0, 0, 0) + data
        self.ask(self.files, FILE_TRANSFER, {"payload": tuple(payload.ljust(251, b"\0"))}, is_armed)

    def rate(self, service, limit, is_armed):
        """Average rate (byte/s) of the 30 packets that are due, looked for once in each half of a byte's time."""
        step, packets, now = round(0.5 * seconds(1) / limit), [], 0
        while len(packets) < 31 and now < 20_000 * step:
            packets += [(now, len(packet)) for packet in service.due(now, is_armed=is_armed)]
            now += step
        return sum(size for _, size in packets[:-1]) / (packets[-1][0] - packets[0][0]) * seconds(1)


@pytest.fixture
def open_transfer(dialect, tmp_path):
    return lambda uri: Transfer(dialect, tmp_path, uri)


def read_document(transfer, is_armed):
    transfer.ask_file(Operation.OPEN_READ, f"/{DOCUMENT}".encode(), 1, is_armed)
    transfer.ask_file(Operation.BURST_READ, b"", 2, is_armed)
    return transfer.files


def download_log(transfer, is_armed):
    transfer.ask(transfer.logs, "LOG_REQUEST_DATA", {"id": 1, "ofs": 0, "count": 1_000_000}, is_armed)
    return transfer.logs


def list_logs(transfer, is_armed):
    transfer.files._files._listed = [FileEntry(f"{k}.mcap", 1) for k in range(200)]
    transfer.ask(transfer.logs, "LOG_REQUEST_LIST", {"start": 0, "end": 0xFFFF}, is_armed=True)
    return transfer.logs


@pytest.mark.parametrize(("uri", "rate"), RATES.items())
def test_transfer_rate_depends_on_the_kind_of_link(uri, rate):
    assert transfer_rate(uri) == rate


@pytest.mark.parametrize("uri", [NETWORK, RADIO])
@pytest.mark.parametrize(
    ("start", "is_armed"),
    [(read_document, False), (read_document, True), (download_log, False), (list_logs, False), (list_logs, True)],
)
def test_transfer_stays_below_the_rate_and_a_twentieth_while_armed(open_transfer, uri, start, is_armed):
    transfer, limit = open_transfer(uri), RATES[uri] / (20 if is_armed else 1)
    rate = transfer.rate(start(transfer, is_armed), limit, is_armed)
    assert 0.95 * limit < rate <= limit * (1 + 1e-6)
