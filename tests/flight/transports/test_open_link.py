"""Each transport carries bytes both ways, and reconnects after its peer or device was gone.

Tests of the modules stream and open_link of trimtab.flight.transports.
"""

import select
import socket
import threading
import time

import pytest
from flight.transports.ends import EVERY_BYTE, PATIENCE, collect, deliver, free_port, meet
from flight.transports.relays import SerialPair

from trimtab.core.errors import InputError
from trimtab.core.interfaces import Link, LinkStatistics
from trimtab.flight.transports.open_link import open_link

pytestmark = pytest.mark.usefixtures("runtime")


@pytest.fixture(params=["serial", "udp", "tcp", "loopback"])
def pair(request, tmp_path):
    """Two connected ends of each kind of link."""
    if request.param == "serial":
        with SerialPair(tmp_path) as cable:
            ends = [open_link(uri) for uri in cable.uris]
            meet(*ends)
            yield ends
            for end in ends:
                end.close()
        return
    port = free_port(socket.SOCK_DGRAM if request.param == "udp" else socket.SOCK_STREAM)
    uri = "loopback://pair" if request.param == "loopback" else f"{request.param}://127.0.0.1:{port}"
    ends = [open_link(uri, listen=True), open_link(uri)]
    meet(*ends)
    yield ends
    for end in ends:
        end.close()


@pytest.mark.real_time
def test_every_byte_passes_both_ways_and_is_counted(pair):
    a, b = pair
    before = a.statistics, b.statistics
    assert all(isinstance(link, Link) and s.connected for link, s in zip(pair, before, strict=True))
    assert deliver(a, b, EVERY_BYTE) == EVERY_BYTE
    assert deliver(b, a, EVERY_BYTE[::-1]) == EVERY_BYTE[::-1]
    for link, old in zip(pair, before, strict=True):
        new = link.statistics
        assert new.bytes_in - old.bytes_in == new.bytes_out - old.bytes_out == 256
        assert new.packets_out - old.packets_out == 1
        assert new.packets_in > old.packets_in
        assert new.reconnects == old.reconnects


@pytest.mark.real_time
def test_receive_returns_at_its_timeout_or_on_data(pair):
    a, b = pair
    start = time.monotonic()
    assert a.receive(0.15) is None
    assert time.monotonic() - start >= 0.149
    assert a.receive(0.0) is None
    later = threading.Timer(0.05, lambda: b.send(b"now"))
    later.start()
    start = time.monotonic()
    assert collect(a, 3) == b"now"
    assert time.monotonic() - start < PATIENCE / 2
    later.join()


@pytest.mark.real_time
def test_descriptor_becomes_readable_when_data_arrives(pair):
    a, b = pair
    assert select.select([a.fileno()], [], [], 0)[0] == []
    assert b.send(b"x")
    assert select.select([a.fileno()], [], [], PATIENCE)[0] == [a.fileno()]
    assert a.receive(0) == b"x"


@pytest.mark.real_time
def test_sending_without_a_reader_drops_and_never_blocks(pair, request):
    """4000 packets of 1000 bytes exceed every buffer. Accepted packets arrive complete and in order."""
    a, b = pair
    packets = [i.to_bytes(4, "big") + bytes([i % 251]) * 996 for i in range(4000)]
    start = time.process_time()
    taken = [p for p in packets if a.send(p)]
    assert time.process_time() - start < 5.0
    assert a.statistics.dropped >= len(packets) - len(taken)
    if "udp" in request.node.name:  # the system drops at the receiver's end, and says nothing
        return
    assert 0 < len(taken) < 4000
    whole = b"".join(taken)
    got = b""
    while len(got) < len(whole) and (piece := b.receive(1.0) or a.receive(0.01) or b.receive(1.0)):
        got += piece
    assert got == whole


@pytest.mark.real_time
def test_closed_link_raises_no_errors(pair):
    a, b = pair
    a.close()
    a.close()
    assert a.receive(0.01) is None
    dropped = a.statistics.dropped
    assert a.send(b"x") is False
    assert a.statistics.dropped == dropped + 1
    assert a.fileno() == -1
    b.receive(0.05)
    b.send(b"x")
    b.receive(0.05)


@pytest.mark.real_time
@pytest.mark.parametrize("scheme", ["tcp", "loopback"])
def test_client_reconnects_to_a_restarted_server(scheme):
    uri = "loopback://again" if scheme == "loopback" else f"tcp://127.0.0.1:{free_port()}"
    client = open_link(uri)  # before there is anyone
    assert client.send(b"lost") is False
    assert client.statistics == LinkStatistics(0, 0, 0, 0, 1, 0, False)
    for life in range(3):
        server = open_link(uri, listen=True)
        meet(client, server)
        assert deliver(client, server, EVERY_BYTE) == EVERY_BYTE
        assert client.statistics.reconnects == life
        server.close()
        while client.statistics.connected:
            client.receive(0.01)
        assert client.fileno() == -1
    client.close()


@pytest.mark.real_time
@pytest.mark.parametrize("scheme", ["tcp", "loopback"])
def test_restarted_client_is_accepted_again(scheme):
    uri = "loopback://again" if scheme == "loopback" else f"tcp://127.0.0.1:{free_port()}"
    server = open_link(uri, listen=True)
    for life in range(3):
        client = open_link(uri)
        meet(client, server)
        assert deliver(server, client, b"hello") == b"hello"
        assert server.statistics.reconnects == life
        client.close()
    server.close()


def test_connection_retries_back_off_to_two_seconds():
    """Measured with a clock set by the test."""
    from trimtab.flight.transports import reconnecting_stream

    class Nobody:
        times = []

        def dial(self):
            self.times.append(now[0])
            raise OSError

        def wait_event(self):
            return -1, 0

        def exchange(self, fd):
            return -1

        def close(self):
            pass

    class Clock:
        def monotonic_ns(self):
            return round(now[0] * 1e9)

        def wait(self, ready, timeout):
            now[0] += timeout
            return False

    now = [100.0]
    link = reconnecting_stream.StreamLink(Nobody(), Clock())
    assert link.receive(20.0) is None
    gaps = [b - a for a, b in zip(Nobody.times, Nobody.times[1:], strict=False)]
    assert gaps[:6] == pytest.approx([0.05, 0.1, 0.2, 0.4, 0.8, 1.6], abs=2e-3)
    assert gaps[6:] == pytest.approx([2.0] * len(gaps[6:]), abs=2e-3)
    assert len(gaps) == 14


@pytest.mark.real_time
def test_packet_boundaries_are_kept_on_loopback_and_udp():
    for uri in ("loopback://apart", f"udp://127.0.0.1:{free_port(socket.SOCK_DGRAM)}"):
        a, b = open_link(uri, listen=True), open_link(uri)
        meet(a, b)
        assert all(b.send(bytes([n]) * n) for n in range(1, 9))
        assert [len(a.receive(PATIENCE)) for _ in range(8)] == list(range(1, 9))
        a.close()
        b.close()


@pytest.mark.real_time
@pytest.mark.parametrize("scheme", ["udp", "tcp"])
def test_listens_on_localhost_unless_a_host_is_given(scheme):
    for place, want in (("", "127.0.0.1"), ("0.0.0.0", "0.0.0.0")):
        port = free_port(socket.SOCK_DGRAM if scheme == "udp" else socket.SOCK_STREAM)
        link = open_link(f"{scheme}://{place}:{port}", listen=True)
        found = link._socket if scheme == "udp" else link._dialer._listener
        assert found.getsockname() == (want, port)
        link.close()


@pytest.mark.parametrize(
    ("uri", "why"),
    [
        ("/dev/ttyUSB0", "the address has no scheme"),
        ("", "the address has no scheme"),
        ("udp:/127.0.0.1:14550", "'//' is missing after 'udp:'"),
        ("serial:/dev/ttyUSB0", "'//' is missing after 'serial:'"),
        ("ftp://host", "unknown scheme 'ftp'"),
        ("udp://host", "is not HOST:PORT"),
        ("udp://host:0", "is not HOST:PORT"),
        ("udp://host:99999", "is not HOST:PORT"),
        ("udp://127.0.0.1:14550/x", "is not HOST:PORT"),
        ("udp://::1:14550", "contains colons"),
        ("udp://[::1:14550", "Invalid IPv6"),
        ("udp://no-such-host.invalid:14550", "unknown host"),
        ("udp://127.0.0.1:14550?ttl=3", "udp has no option 'ttl'"),
        ("tcp://me@127.0.0.1:5760", "must not contain '#' or '@'"),
        ("serial://dev/ttyUSB0", "starts with a third '/'"),
        ("serial:///dev/no-such-device", "can't be opened"),
        ("serial:///dev/null", "can't be opened"),
        ("serial:///dev/null?baud=12345", "'12345' is not a baud rate"),
        ("serial:///dev/null?speed=9600", "serial has no option 'speed'"),
        ("serial:///dev/null?baud=9600&baud=9600", "given twice"),
        ("rfcomm://00:11:22/1", "is not the address of a module"),
        ("rfcomm://00:11:22:AA:BB:CC/31", "is not a channel from 1 to 30"),
        ("rfcomm://00:11:22:AA:BB:CC", "is not a channel"),
        ("loopback://", "is not a name"),
        ("loopback://a/b", "is not a name"),
        ("loopback://..%2f", "is not a name"),
    ],
)
def test_rejects_invalid_uri_with_a_fix(uri, why):
    with pytest.raises(InputError) as caught:
        open_link(uri)
    assert why in str(caught.value)
    assert repr(uri) in caught.value.part
    assert caught.value.fix
    if "scheme" in why:
        assert {c.split("://")[0] for c in caught.value.choices} == {"serial", "udp", "tcp", "rfcomm", "loopback"}


@pytest.mark.real_time
def test_rejects_port_in_use():
    for scheme, kind in (("tcp", socket.SOCK_STREAM), ("udp", socket.SOCK_DGRAM)):
        uri = f"{scheme}://127.0.0.1:{free_port(kind)}"
        link = open_link(uri, listen=True)
        with pytest.raises(InputError, match="cannot listen there"):
            open_link(uri, listen=True)
        link.close()
