"""Delay measurement against a far end with known delays in virtual time, and over a relay in wall-clock time."""

import heapq
import random
import socket
import statistics
import threading

import numpy as np
import pytest
from flight.transports.ends import free_port
from flight.transports.relays import LEFT, RIGHT, UdpRelay

from trimtab.core.interfaces import LinkStatistics
from trimtab.flight import line_delays
from trimtab.flight.clock_time import (
    STATUS,
    UP,
    ClockMessageParser,
    ClockTimeExchange,
    Hello,
    echo_request,
    parse_hello,
)
from trimtab.flight.line_delays import LinkTestPlan, echo_requests, fit_delay_model, latency_rows, link_traces
from trimtab.flight.transports.open_link import open_link
from trimtab.links.latency import MeasuredLatency, gamma_table, mean_latency
from trimtab.links.latency_trace import LatencyTrace, read_trace, write_trace

BOOT = b"one boot"


class Sky:
    """A link with known random delays and losses, its far end, and the clock of both ends."""

    def __init__(self, far_boot=BOOT, ahead=0, loss=0.0, spread=1.0):
        self.t, self.ahead, self.boot, self.loss = 1_000_000, ahead, far_boot, loss
        self.random, self.spread = random.Random(3), spread
        self.parser, self.heard, self.coming, self.n = ClockMessageParser(UP), 0, [], 0
        self.up, self.down, self.bytes_out, self.lost_up = [], [], 0, 0

    def monotonic_ns(self):
        return self.t * 100

    def receive(self, timeout):
        until = self.t + round(timeout * 1e7)
        if self.coming and self.coming[0][0] <= until:
            at, _, data = heapq.heappop(self.coming)
            self.t = max(self.t, at)
            return data
        self.t = max(until, self.t + 1)
        return None

    def send(self, packet):
        self.bytes_out += len(packet)
        for message in self.parser.feed(packet):
            up, down = (round(self.random.uniform(1 - self.spread, 1 + self.spread) * 400_000) for _ in range(2))
            if message.id == STATUS:
                self._back(Hello(self.boot, parse_hello(message.data).session, self.heard).pack(), 10)
            elif answer := echo_request(message, self.t + up + self.ahead):
                fate = self.random.random()
                if fate < self.loss:
                    self.lost_up += 1
                    continue
                self.heard += 1
                if fate > 2 * self.loss:
                    self.up.append(up * 1e-7)
                    self.down.append(down * 1e-7)
                    self._back(answer, up + down)
        return True

    def _back(self, data, later):
        self.n += 1
        heapq.heappush(self.coming, (self.t + later, self.n, data))

    @property
    def statistics(self):
        return LinkStatistics(0, self.bytes_out, 0, 0, 0, 0, True)


@pytest.fixture
def under():
    """Function that measures the delays of a Sky."""

    def run(sky, plan):
        return line_delays.measure_delays(sky, ClockTimeExchange(7, BOOT), plan, sky)

    return run


def test_shared_clock_measures_each_direction_separately(under):
    sky = Sky()
    found = under(sky, LinkTestPlan(2.9, 22.0, 200, 10.0))
    assert found.has_one_clock
    assert found.has_reply.all()
    assert found.lost_up == 0
    np.testing.assert_allclose(found.up, sky.up, atol=1.01e-4)  # the resolution, 0.1 ms
    np.testing.assert_allclose(found.up + found.down, np.add(sky.up, sky.down), atol=1e-7)
    table = latency_rows(found)
    assert table["round trip"].mean_ms == pytest.approx(1e3 * statistics.mean(np.add(sky.up, sky.down)))
    assert table["up"].sd_ms == pytest.approx(1e3 * statistics.stdev(sky.up), abs=0.02)
    assert found.send_times[-1] == pytest.approx(20.0, rel=0.1)
    assert found.data_rates[0] == pytest.approx(2.9, rel=0.03)


def test_clock_offset_is_estimated_from_fastest_round_trip(under):
    """Round trips are exact. The offset error is half the up-down difference of the fastest round trip."""
    sky = Sky(far_boot=b"another.", ahead=36_000_000_000, spread=0.3)
    found = under(sky, LinkTestPlan(2.9, 22.0, 400, 20.0))
    assert not found.has_one_clock
    np.testing.assert_allclose(found.up + found.down, np.add(sky.up, sky.down), atol=1e-7)
    shift = found.up - sky.up
    assert np.ptp(shift) < 1e-9
    assert abs(shift[0]) < 0.004  # up is 28 to 52 ms


def test_uplink_and_downlink_losses_are_separated(under):
    sky = Sky(loss=0.1)
    found = under(sky, LinkTestPlan(2.9, 22.0, 400, 20.0))
    assert 20 < sky.lost_up == found.lost_up
    assert found.has_reply.sum() == len(sky.up) == 400 - sky.lost_up - link_traces(found)["down"].lost.sum()
    np.testing.assert_allclose(found.up[found.has_reply], sky.up, atol=1.01e-4)
    recorded = link_traces(found)
    assert recorded["up"].lost.sum() == sky.lost_up
    assert len(recorded["down"].lost) == 400 - sky.lost_up
    for trace in recorded.values():
        assert (np.diff(trace.sent_s) >= 0).all()
        LatencyTrace.of(trace).check()


def test_traces_round_trip_and_fitted_model_matches_moments(under, tmp_path):
    found = under(Sky(loss=0.05, spread=0.5), LinkTestPlan(2.9, 22.0, 300, 20.0))
    for path, trace in link_traces(found).items():
        write_trace(tmp_path / "t.csv", trace)
        for a, b in zip(read_trace(tmp_path / "t.csv"), trace, strict=True):
            np.testing.assert_array_equal(a, b)
        m = fit_delay_model(trace)
        seen = trace.latency_s[~trace.lost]
        assert (m.mean, m.sd) == pytest.approx((seen.mean(), seen.std(ddof=1)))
        assert m.shift == pytest.approx(seen.min() - 0.002)
        assert mean_latency(gamma_table(m.mean, m.sd, m.shift)) == pytest.approx(m.mean, rel=2e-3)
        latency, loss, capacity = (text.partition("=") for text in m.settings(path))
        assert latency[0] == f"world.{path}link.latency"
        values = np.array([float(v) for v in latency[2].strip("[]").split(",")])
        MeasuredLatency(values, loss=float(loss[2]), capacity=int(capacity[2])).check()


def test_no_measurement_without_a_far_end(under):
    sky = Sky()
    sky.send = lambda packet: False
    assert under(sky, LinkTestPlan(2.9, 22.0, 10)) is None


class Ground:
    """A link on which one request for load (byte/s) arrives, and the clock of the far end."""

    def __init__(self, load):
        self.t, self.sent, self._load = 50.0, [], load

    def monotonic_ns(self):
        return round(self.t * 1e9)

    def receive(self, timeout):
        if self._load is not None:
            load, self._load = self._load, None
            return Hello(BOOT, 1, load).pack()
        self.t += max(timeout, 1e-5)

    def accept_sender(self):
        pass

    def send(self, packet):
        self.sent.append((self.t, len(packet)))


def test_far_end_generates_requested_load_then_stops():
    """22 kb/s are 2200 bytes a second, replies included. The load stops three seconds after the last request."""
    ground = Ground(2200)
    assert echo_requests(ground, stop=lambda: ground.t > 60.0, clock=ground, boot=BOOT) == 0
    assert sum(n for t, n in ground.sent if t < 53.0) == pytest.approx(3 * 2200, abs=50)  # two messages
    assert max(t for t, _ in ground.sent) < 53.2
    gaps = np.diff([t for t, _ in ground.sent[2:]])
    assert gaps.max() < 0.013  # 25 bytes at 2200 byte/s: each 11.4 ms


@pytest.mark.parametrize("requested", [100_001, 125_000, 2**31])
def test_far_end_sends_at_most_1_megabit_per_second(requested):
    """With ten bits per byte, these are 100 000 bytes a second."""
    ground = Ground(requested)
    echo_requests(ground, stop=lambda: ground.t > 50.5, clock=ground, boot=BOOT)
    sent = sum(n for _, n in ground.sent)
    assert sent == pytest.approx(0.5 * 100_000, rel=0.01)


@pytest.mark.real_time
def test_measured_delays_match_those_of_the_relay():
    """40 ± 15 ms, 2 % lost. Limits: mean and sd within 3 ms of the delays that the relay applied.

    Standard errors with 600 requests are 0.6 and 0.4 ms. The rest allows for delays by a busy machine at both ends.
    """
    port = free_port(socket.SOCK_DGRAM)
    far, stop = open_link(f"udp://:{port}", listen=True), threading.Event()
    thread = threading.Thread(target=echo_requests, args=(far,), kwargs={"stop": stop.is_set})
    thread.start()
    try:
        with UdpRelay(("127.0.0.1", port), delay=0.040, jitter=0.015, loss=0.02, seed=11) as relay:
            near = open_link(f"udp://127.0.0.1:{relay.port}")
            found = line_delays.measure_delays(near, ClockTimeExchange(1), LinkTestPlan(2.9, 22.0, 600, 40.0))
            near.close()
            done = list(relay.passages)
    finally:
        stop.set()
        thread.join()
        far.close()
    for side, seconds in ((LEFT, found.up), (RIGHT, found.down)):
        put_in = [p.delay for p in done if p.side == side and p.delay is not None]
        assert np.nanmean(seconds) == pytest.approx(statistics.mean(put_in), abs=0.003)
        assert np.nanstd(seconds) == pytest.approx(statistics.stdev(put_in), abs=0.003)
        assert np.nanmean(seconds) == pytest.approx(0.040, abs=0.004)
    lost = [trace.lost.mean() for trace in link_traces(found).values()]
    assert lost == pytest.approx([0.02, 0.02], abs=4 * (0.02 * 0.98 / 600) ** 0.5)
