"""Measurement of the one-way delays of a link, with the method of the thesis [1].

A request contains the sender's time t0. The far end appends its timer reading and sends the request back. The reply
arrives at the time now. If both ends share one clock,

    uplink = timer - t0,    downlink = now - t0 - uplink

If the ends have two clocks, the offset of the clocks is estimated from the quickest round trips, assuming equal delays
up and down. The results are the statistics in the thesis's table, recordings for the link model LatencyTrace, and a
link model with the same mean and standard deviation.
Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, chapter 5.
"""

import random
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.clock import NS_PER_SECOND, SYSTEM_CLOCK, Clock
from trimtab.core.interfaces import Link
from trimtab.core.time import ms, to_seconds
from trimtab.flight.clock_time import (
    LOAD_DOWN,
    LOAD_UP,
    STATUS,
    UP,
    ClockMessageParser,
    ClockTimeExchange,
    Hello,
    boot_digest,
    echo_request,
    parse_hello,
)
from trimtab.flight.real_time import NS
from trimtab.links.fifo import required_slots
from trimtab.links.latency import BELOW_MIN_MS, SEND_PERIODS, Latencies, gamma_table
from trimtab.links.latency_trace import Trace

MOST_LOAD = 100_000
"""Largest load (bytes per second) that the far end sends, even if a larger load is requested: 1 Mb/s with ten bits per
byte."""
LOAD_TIMEOUT = 3.0
"""Time (s) for which the far end sends load after the last request for load."""
BURST = 4
"""Maximum number of load messages that are sent together after a delay of this machine."""
HELLO_PERIOD = 0.5
"""Time between two hello messages to the far end (s)."""
BITS_PER_BYTE = 10
"""Number of bits per byte on a serial line, including start and stop bit. The data rates in [1] include these two
bits."""
QUICKEST_SHARE = 0.05
"""Fraction of the round trips, the quickest ones, from which the offset of two clocks is estimated."""
LEAST_SD = 1e-5
"""Smallest standard deviation (s) of the delays in a fitted link model. It is used if the measured delays vary less."""


class LinkTestPlan(NamedTuple):
    """Settings of a delay measurement: load in each direction (kb/s, with ten bits per byte), number of requests,
    requests per second."""

    up: float
    down: float
    requests: int = 300
    rate: float = 10.0
    patience: float = 3.0
    """Time (s) to wait for replies after the last request."""
    seed: int = 0

    @property
    def first_patience(self) -> float:
        """Return the longest time (s) to wait for the first reply."""
        return 10 * self.patience


class Delays(NamedTuple):
    """Measured delays (s): one value per request, in the order of sending, NaN for a request without a reply."""

    plan: LinkTestPlan
    send_times: np.ndarray[Any, Any]
    up: np.ndarray[Any, Any]
    down: np.ndarray[Any, Any]
    lost_up: int
    """Number of requests that did not reach the far end. For the other unanswered requests, the reply was lost."""
    has_one_clock: bool
    """True if both ends share one clock. Otherwise only the round-trip delay is measured, and its division into up and
    down is estimated."""
    data_rates: tuple[float, float]
    """Measured data rates (kb/s), sent and received."""

    @property
    def has_reply(self) -> np.ndarray[Any, Any]:
        """Return a Boolean array with one element per request: True if the request has a reply."""
        return np.isfinite(self.up)


class LoadPace:
    """Pacer of load messages. Load messages fill up the sent data to a given rate (byte/s)."""

    def __init__(self, size: int) -> None:
        self._size, self._due, self.rate = size, 0.0, 0.0

    def wait(self, t: float) -> float:
        """Return the time (s) from t until the next load message is due, or one hour if the rate is zero."""
        return max(self._due - t, 0.0) if self.rate > 0 else 3600.0

    def due(self, t: float) -> bool:
        """Return True if a load message is due at time t (s). The message then counts as sent."""
        if self.rate <= 0 or t < self._due:
            return False
        self.count_bytes(self._size, t)
        return True

    def count_bytes(self, size: int, t: float) -> None:
        """Count bytes that were sent at time t (s), which reduces the number of load messages."""
        if self.rate > 0:
            earliest = t - BURST * self._size / self.rate if self._due else t
            self._due = max(self._due, earliest) + size / self.rate


def echo_requests(
    link: Link,
    *,
    stop: Callable[[], bool] = lambda: False,
    clock: Clock = SYSTEM_CLOCK,
    boot: bytes | None = None,
) -> int:
    """Send received requests back until stop() returns True. Return the number of requests that arrived.

    Args:
        link: link to the measuring end.
        stop: function called ten times a second. If it returns True, this function ends.
        clock: clock of this end.
        boot: digest that identifies this end's clock, or None to use the digest of this machine.
    """
    parser, pace, boot = ClockMessageParser(UP), LoadPace(len(LOAD_DOWN)), boot_digest() if boot is None else boot
    session, heard, echoed, until = -1, 0, 0, 0.0

    def now() -> float:
        return clock.monotonic_ns() / NS_PER_SECOND

    while not stop():
        data = link.receive(min(0.1, pace.wait(now())))
        arrived = clock.monotonic_ns() // NS
        for message in parser.feed(data) if data else ():
            link.accept_sender()
            answer = echo_request(message, arrived)
            hello = parse_hello(message.data) if message.id == STATUS else None
            if hello is not None:
                heard = heard if hello.session == session else 0
                session, pace.rate, until = hello.session, min(hello.number, MOST_LOAD), now() + LOAD_TIMEOUT
                answer = Hello(boot, session, heard).pack()
            elif answer:
                heard, echoed = heard + 1, echoed + 1
            if answer:
                link.send(answer)
                pace.count_bytes(len(answer), now())
        if now() > until:
            pace.rate = 0.0
        if pace.due(now()):
            link.send(LOAD_DOWN)
    return echoed


def measure_delays(
    link: Link, exchange: ClockTimeExchange, plan: LinkTestPlan, clock: Clock = SYSTEM_CLOCK
) -> Delays | None:
    """Measure the delays of a link: send requests under load and collect the replies. Return None if the far end does
    not answer.

    Args:
        link: link to a far end that runs `echo_requests`.
        exchange: encoder and decoder of the messages.
        plan: load, number of requests, and rate of the requests.
        clock: clock of this end.
    """
    session = _DelayMeasurement(link, exchange, plan, clock)
    if not session.await_far_end():
        return None
    before, start = link.statistics, clock.monotonic_ns()
    session.ask()
    after, took = link.statistics, (clock.monotonic_ns() - start) / NS_PER_SECOND
    session.finish()
    counts = (after.bytes_out - before.bytes_out, after.bytes_in - before.bytes_in)
    up, down = (1e-3 * BITS_PER_BYTE * n / took for n in counts)
    return session.delays((up, down))


class _DelayMeasurement:
    """State of one measurement: departure time of each request, and content and arrival time of each reply."""

    def __init__(self, link: Link, exchange: ClockTimeExchange, plan: LinkTestPlan, clock: Clock) -> None:
        self._link, self._exchange, self._plan, self._clock = link, exchange, plan, clock
        self._sent: dict[int, int] = {}
        self._back: dict[int, tuple[int, int]] = {}
        self._hello = exchange.pack_hello(round(plan.down * 1e3 / BITS_PER_BYTE))

    def _seconds(self) -> float:
        return self._clock.monotonic_ns() / NS_PER_SECOND

    def await_far_end(self) -> bool:
        """Send hello messages until the far end answers. Return False if no answer arrives in time."""
        end = self._seconds() + self._plan.first_patience
        while self._exchange.shared is None and self._seconds() < end:
            self._link.send(self._hello)
            self._gather_replies(0.2)
        return self._exchange.shared is not None

    def ask(self) -> None:
        """Send requests, with load messages between the requests. The sending times are irregular, so that they do not
        coincide with a periodic task."""
        draw, pace = random.Random(self._plan.seed), LoadPace(len(LOAD_UP))
        pace.rate = self._plan.up * 1e3 / BITS_PER_BYTE
        at = hello_at = self._seconds()
        while len(self._sent) < self._plan.requests:
            t = self._seconds()
            if t >= at:
                departed = self._clock.monotonic_ns() // NS
                key, packet = self._exchange.request(departed)
                self._link.send(packet)
                self._sent[key] = departed
                pace.count_bytes(len(packet), t)
                at += draw.uniform(0.5, 1.5) / self._plan.rate
            if t >= hello_at:
                self._link.send(self._hello)
                pace.count_bytes(len(self._hello), t)
                hello_at += HELLO_PERIOD
            if pace.due(t):
                self._link.send(LOAD_UP)
            self._gather_replies(min(at - t, hello_at - t, pace.wait(t)))

    def finish(self) -> None:
        """Continue to send load and wait for the last replies, then for the number of requests that reached the far
        end."""
        end = self._seconds() + self._plan.patience
        while self._seconds() < end and len(self._back) < len(self._sent):
            self._link.send(self._hello)
            until = self._seconds() + 0.1
            while (left := until - self._seconds()) > 0:
                self._gather_replies(left)

    def _gather_replies(self, wait: float) -> None:
        """Store the replies that arrive within `wait` seconds. If a request has two replies, store only the first
        reply."""
        data = self._link.receive(max(wait, 0.0))
        arrived = self._clock.monotonic_ns() // NS
        for key, uplink in self._exchange.read_replies(data) if data else ():
            if key in self._sent:
                self._back.setdefault(key, (uplink, arrived))

    def delays(self, data_rates: tuple[float, float]) -> Delays:
        """Return the measured delays. data_rates: measured data rates (kb/s), sent and received."""
        left = np.array(list(self._sent.values()), np.int64)
        came = np.array([key in self._back for key in self._sent], bool)
        answered = [(self._back[key], t0) for key, t0 in self._sent.items() if key in self._back]
        up, trip = np.full((2, len(left)), np.nan)
        up[came] = to_seconds(np.array([uplink for (uplink, _), _ in answered], np.float64))
        trip[came] = to_seconds(np.array([arrived - t0 for (_, arrived), t0 in answered], np.float64))
        shared = bool(self._exchange.shared)
        if not shared and came.any():
            up = up - clock_offset(up[came], trip[came])
        lost_up = max(len(left) - max(self._exchange.heard, len(answered)), 0)
        return Delays(self._plan, to_seconds(left - left[0]), up, trip - up, lost_up, shared, data_rates)


def clock_offset(up: np.ndarray[Any, Any], trip: np.ndarray[Any, Any]) -> float:
    """Return the lead (s) of the far end's clock over this end's clock, assuming equal delays up and down in the
    quickest round trips."""
    quickest = np.argsort(trip)[: max(1, int(QUICKEST_SHARE * len(trip)))]
    return float(np.median((up - trip / 2)[quickest]))


def link_traces(delays: Delays) -> dict[str, Trace]:
    """Return two recordings for the link model LatencyTrace: delays to the far end (up), and delays back (down).

    If a request has no reply, either the request or the reply was lost. The far end reports the number of requests that
    it has received, so the number of lost requests is known. Evenly spread over the unanswered requests, this number of
    them counts as lost on the way up. For the other unanswered requests, the reply counts as lost on the way down.
    """
    missing = np.flatnonzero(~delays.has_reply)
    lost_up = np.zeros(len(delays.send_times), bool)
    count = min(delays.lost_up, len(missing))
    lost_up[missing[((np.arange(count) + 0.5) * len(missing) / max(count, 1)).astype(int)]] = True
    mean = float(np.nanmean(delays.up)) if delays.has_reply.any() else 0.0
    up, down = np.maximum(delays.up, 0.0), np.maximum(delays.down, 0.0)
    arrived_up = ~lost_up
    left = (delays.send_times + np.where(delays.has_reply, up, mean))[arrived_up]
    order = np.argsort(left, kind="stable")
    fell = ~delays.has_reply[arrived_up][order]
    # if only the reply was lost, the uplink delay is unknown: use the mean
    upward = Trace(delays.send_times, np.where(lost_up, 0.0, np.where(delays.has_reply, up, mean)), lost_up)
    return {"up": upward, "down": Trace(left[order], np.where(fell, 0.0, down[arrived_up][order]), fell)}


def summarise_latencies(seconds: np.ndarray[Any, Any]) -> Latencies:
    """Return mean, standard deviation, minimum and maximum (ms) of the finite delays, as in a row of the table in
    [1]."""
    delays_ms = 1e3 * seconds[np.isfinite(seconds)]
    sd = float(delays_ms.std(ddof=1)) if len(delays_ms) > 1 else 0.0
    return Latencies(float(delays_ms.mean()), sd, float(delays_ms.min()), float(delays_ms.max()))


def latency_rows(delays: Delays) -> dict[str, Latencies]:
    """Return the statistics of the delays as in the table in [1], for "up", "down" and "round trip"."""
    rows = {"up": delays.up, "down": delays.down, "round trip": delays.up + delays.down}
    return {path: summarise_latencies(seconds) for path, seconds in rows.items()}


class DelayModel(NamedTuple):
    """Model of one direction of a link: shifted gamma distribution of latencies (s), and fraction of lost packets.

    mean, sd: measured mean and standard deviation.
    """

    mean: float
    sd: float
    shift: float
    loss: float

    def settings(self, path: str) -> list[str]:
        """Return the options of `trimtab run` that set this model in a scenario with links=measured. path: direction,
        "up" or "down"."""
        table, period = np.round(gamma_table(self.mean, self.sd, self.shift), 6), SEND_PERIODS[path]
        where = f"world.{path}link"
        values = ",".join(f"{value:.6g}" for value in table)
        slots = required_slots(float(table[-1]), period, ms(1))
        return [f"{where}.latency=[{values}]", f"{where}.loss={self.loss:.4g}", f"{where}.capacity={slots}"]


def fit_delay_model(trace: Trace) -> DelayModel:
    """Return the model of one direction of a link that fits measured latencies. The distribution starts 2 ms below the
    smallest latency, as in [1]."""
    row = summarise_latencies(trace.latency_s[~trace.lost])
    shift = max(row.min_ms - BELOW_MIN_MS, 0.0) / 1e3
    mean = max(row.mean_ms / 1e3, shift + LEAST_SD)
    return DelayModel(mean, max(row.sd_ms / 1e3, LEAST_SD), shift, float(trace.lost.mean()))
