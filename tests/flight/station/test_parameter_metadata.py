"""Parameter metadata: location given by a message, file read by pymavlink's file client."""

import json
import lzma

import pytest
from flight.station.clients import Master
from flight.station.test_parameter_hash import crc_by_bits
from flight.station.test_parameters import parameters

from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.station.file_transfer import FileTransferService
from trimtab.flight.station.parameter_metadata import component_metadata, metadata_documents
from trimtab.flight.station.served_files import ServedFiles
from trimtab.flight.station.streams import Streams

mavftp = pytest.importorskip("pymavlink.mavftp")


@pytest.fixture
def master(dialect):
    endpoint = Endpoint(dialect, 1, 1, unsigned=True)
    documents, streams = metadata_documents(parameters()), Streams(endpoint, {})
    streams.add_on_request("COMPONENT_METADATA", lambda now: component_metadata(now, documents))
    return Master(dialect, [FileTransferService(endpoint, ServedFiles(documents), 1e6)], streams=streams)


def fetch(master, uri):
    assert uri.startswith("mftp:///")
    return mavftp.MAVFTP(master, 1, 1).read(uri.removeprefix("mftp://"), 1 << 20)


def test_metadata_gives_unit_bounds_and_default_of_parameters(master, dialect):
    master.mav.request_data_stream_send(1, 1, 0, 4, 1)  # all: of those that every station knows
    master.mav.heartbeat_send(6, 8, 0, 0, 0)
    assert [m.get_type() for m in master.heard("HEARTBEAT", 1500)] != []
    assert not master.unknown
    own = Endpoint(dialect, 255, 190, unsigned=True)  # pymavlink's common dialect lacks the message
    (packet,) = master.station._streams.handle_command(512, 397, 0, 0)[1]
    (told,) = own.feed(packet)
    general = fetch(master, told.get("uri"))
    assert told.get("file_crc") == crc_by_bits(general)
    (kind,) = json.loads(lzma.decompress(general))["metadataTypes"]
    assert kind["type"] == 1
    file = fetch(master, kind["uri"])
    assert kind["fileCrc"] == crc_by_bits(file)
    about = json.loads(lzma.decompress(file))
    assert about["version"] == 1
    by_name = {p["name"]: p for p in about["parameters"]}
    assert list(by_name) == list(parameters().table())
    mass = by_name["WVI_MASS"]
    assert (mass["units"], mass["min"], mass["max"], mass["default"]) == ("kg", 0.26, 26.0, 2.6)
    assert mass["type"] == "Float"
    assert (by_name["WVI_GAINS_1"]["min"], by_name["WVI_GAINS_1"]["max"]) == (-1, 1)
    assert by_name["WVI_CHOICE"]["values"] == [{"value": 0, "description": "a"}, {"value": 1, "description": "b"}]
    assert (by_name["WVI_ON"]["min"], by_name["WVI_ON"]["max"], by_name["WVI_ON"]["decimalPlaces"]) == (0, 1, 0)
