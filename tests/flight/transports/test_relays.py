"""The relays used by other tests apply the configured disturbances."""

import statistics

import pytest
from flight.transports.ends import EVERY_BYTE, collect, free_port, meet
from flight.transports.relays import LEFT, RIGHT, SerialPair, UdpRelay, Weather

from trimtab.flight.transports.open_link import open_link


def fates(n=4000, size=8, **settings):
    weather = Weather(**settings)
    return [weather.passes(LEFT, 10.0 * k, bytes(size)) for k in range(n)]


def test_delay_and_jitter_have_the_moments_asked_for():
    delays = [due - 10.0 * k for k, (due, _) in enumerate(fates(delay=0.040, jitter=0.010, seed=3))]
    assert statistics.mean(delays) == pytest.approx(0.040, abs=5 * 0.010 / 4000**0.5)
    assert statistics.stdev(delays) == pytest.approx(0.010, rel=0.06)
    assert min(delays) >= 0


def test_loss_and_corruption_are_as_frequent_as_asked_for():
    found = fates(loss=0.02, corruption=0.1, seed=5)
    kept = [data for fate in found if fate for data in fate[1:]]
    assert 4000 - len(kept) == pytest.approx(80, abs=5 * 9)
    turned = [data for data in kept if any(data)]
    assert len(turned) == pytest.approx(0.1 * len(kept), abs=5 * 19)
    assert all(sum(byte.bit_count() for byte in data) == 1 for data in turned)


def test_same_seed_gives_same_packet_fates():
    settings = {"delay": 0.1, "jitter": 0.1, "loss": 0.3}
    assert fates(50, **settings, seed=1) == fates(50, **settings, seed=1) != fates(50, **settings, seed=2)


def test_both_directions_draw_their_own_fates():
    weather = Weather(loss=0.3)
    left, right = ([weather.passes(side, 10.0 * k, b"x") is None for k in range(50)] for side in (LEFT, RIGHT))
    assert 0 < sum(left) < 50
    assert left != right


@pytest.mark.thorough
def test_weather_keeps_order_limits_rate_and_cuts():
    jittery = Weather(delay=0.1, jitter=0.05, ordered=True)
    due = [jittery.passes(LEFT, 0.001 * k, b"x")[0] for k in range(200)]
    assert due == sorted(due)
    loose = Weather(delay=0.1, jitter=0.05, ordered=False)
    free = [loose.passes(LEFT, 0.001 * k, b"x")[0] for k in range(200)]
    assert free != sorted(free)
    slow = Weather(rate=9600)
    due = [slow.passes(LEFT, 0.0, bytes(96))[0] for _ in range(3)]
    assert due == pytest.approx([0.1, 0.2, 0.3])
    slow.cut = True
    assert slow.passes(LEFT, 0.0, b"x") is None


@pytest.mark.real_time
def test_a_serial_pair_delays_and_can_be_cut(tmp_path):
    with SerialPair(tmp_path) as cable:
        a, b = (open_link(uri) for uri in cable.uris)
        meet(a, b)
        cable.weather.delay = 0.05
        cable.passages.clear()
        a.send(EVERY_BYTE)
        assert collect(b, 256) == EVERY_BYTE
        assert min(p.delay for p in cable.passages) >= 0.05
        cable.weather.cut = True
        b.send(b"lost")
        assert a.receive(0.1) is None
        cable.weather.cut = False
        meet(a, b)
        a.close()
        b.close()


@pytest.mark.real_time
def test_udp_relay_passes_both_ways_and_records_delays():
    import socket

    port = free_port(socket.SOCK_DGRAM)
    far = open_link(f"udp://:{port}", listen=True)
    with UdpRelay(("127.0.0.1", port), delay=0.02) as relay:
        near = open_link(f"udp://:{relay.port}")
        meet(near, far)
        assert {p.side for p in relay.passages} == {LEFT, RIGHT}
        assert all(p.delay >= 0.02 for p in relay.passages)
        near.close()
    far.close()
