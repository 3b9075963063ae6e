"""RFCOMM between two virtual Bluetooth controllers, with a software stack below the link."""

import time

import pytest

pytest.importorskip("bumble", reason="the virtual Bluetooth radios need: pip install bumble", exc_type=ImportError)

from flight.transports.ends import EVERY_BYTE, PATIENCE, collect, deliver, meet
from flight.transports.radios import VEHICLE, Radios

from trimtab.flight.transports.open_link import parse_uri
from trimtab.flight.transports.rfcomm import open_rfcomm

pytestmark = pytest.mark.real_time

URI = f"rfcomm://{VEHICLE}/1"


@pytest.fixture
def radios():
    made = Radios()
    yield made
    made.close()


@pytest.fixture
def pair(radios):
    ends = open_rfcomm(parse_uri(URI), listen=True, stack=radios.stack), open_rfcomm(parse_uri(URI), stack=radios.stack)
    meet(*ends)
    yield ends
    for end in ends:
        end.close()


def test_every_byte_passes_both_ways(pair):
    vehicle, ground = pair
    assert deliver(ground, vehicle, EVERY_BYTE) == EVERY_BYTE
    assert deliver(vehicle, ground, EVERY_BYTE[::-1]) == EVERY_BYTE[::-1]
    assert vehicle.statistics.connected
    assert ground.statistics.connected


def test_a_stream_longer_than_a_frame_arrives_whole_and_in_order(pair):
    vehicle, ground = pair
    packets = [k.to_bytes(2, "big") * 50 for k in range(300)]
    got = b""
    for packet in packets:
        while not ground.send(packet):
            got += vehicle.receive(0.01) or b""
    whole = b"".join(packets)
    assert got + collect(vehicle, len(whole) - len(got)) == whole


def test_radios_reconnect_after_losing_each_other(pair, radios):
    vehicle, ground = pair
    radios.lose()
    end = time.monotonic() + PATIENCE
    while (vehicle.statistics.connected or ground.statistics.connected) and time.monotonic() < end:
        vehicle.receive(0.01)
        if ground.fileno() >= 0:
            ground.receive(0.01)
    meet(*pair)
    assert deliver(ground, vehicle, EVERY_BYTE) == EVERY_BYTE
    assert (vehicle.statistics.reconnects, ground.statistics.reconnects) == (1, 1)


def test_restarted_ground_station_is_accepted_again(pair, radios):
    vehicle, ground = pair
    ground.close()
    while vehicle.statistics.connected:
        vehicle.receive(0.01)
    again = open_rfcomm(parse_uri(URI), stack=radios.stack)
    meet(vehicle, again)
    assert deliver(vehicle, again, EVERY_BYTE) == EVERY_BYTE
    assert vehicle.statistics.reconnects == 1
    again.close()
