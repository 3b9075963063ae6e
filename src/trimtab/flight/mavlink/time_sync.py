"""Estimate of the other end's clock, its offset and drift, from TIMESYNC exchanges with short round trips.

A request leaves this end at t0. The other end answers at the time r of its clock. The answer arrives at this end at t1:

    offset = r - (t0 + t1)/2        |error| <= (t1 - t0)/2        local = remote - offset

The error is half the difference between the delays of the two directions. So exchanges with short round trips have a
larger weight. A straight line is fitted to the offsets of the last minute, each weighted by 1/(excess over the shortest
round trip)^2. The offset used by `to_local` approaches this line by at most 1 ms a second, so that increasing times
stay increasing.
Source: D. L. Mills, "Internet time synchronization: the network time protocol", IEEE Trans. Communications 39 (1991),
section V (minimum filter); https://mavlink.io/en/services/timesync.html.
"""

from collections import deque
from typing import NamedTuple

from trimtab.core.time import ms, seconds

NS_PER_UNIT = 100
WINDOW = seconds(60)
LONGEST_WAIT = seconds(10)
JUMP = seconds("0.5")
"""Change of the measured offset (100 ns), in excess of its error bound, above which the other clock counts as set or
replaced."""
SLEW = 1e-3
"""Maximum rate of change (s/s) of the offset that is used in conversions."""
HORIZON = seconds(1)
FLOOR = 0.1, ms("0.01")
"""Excess over the shortest round trip that is still treated as zero: a fraction of the shortest round trip, plus a time
(100 ns)."""
DRIFT = 1e-4
"""Assumed standard deviation of the drift between two clocks (s/s)."""
EXCHANGES_MAX = 600


class TimeSyncExchange(NamedTuple):
    """Result of a request and its answer: time of the other clock, measured offset, and round-trip time (100 ns)."""

    remote: int
    offset: float
    round_trip: int


class OffsetLine(NamedTuple):
    """Straight line through measured offsets, over the time r of the other clock: offset(r) = offset + drift (r -
    at)."""

    at: int
    offset: float
    drift: float

    def value(self, remote: int) -> float:
        """Return the offset (100 ns) at a time of the other clock."""
        return self.offset + self.drift * (remote - self.at)


class TimeSync:
    """Estimator of the other end's clock. All times are integers of 100 ns."""

    def __init__(self) -> None:
        """Start before the first exchange with the other end."""
        self._asked: deque[int] = deque(maxlen=16)
        self._exchanges: deque[TimeSyncExchange] = deque(maxlen=EXCHANGES_MAX)
        self._line = OffsetLine(0, 0.0, 0.0)
        self._from, self._applied, self._turn, self._after = 0, 0.0, 0.0, 0.0
        self.doubles = 0
        """Number of requests that were answered by two different clocks.

        Duplicate packets contain the time of one clock and do not count.
        """
        self._answered: tuple[int, int, int] = -1, 0, 0
        self._doubtful: TimeSyncExchange | None = None
        self._last: int | None = None
        self._latest: int | None = None
        self._not_before: int | None = None
        self.refused = 0
        """Number of rejected answers, which matched no request of this end or arrived too late."""
        self.jumps = 0
        """Number of times that the other clock was set or replaced, as confirmed by two consecutive exchanges."""

    @property
    def is_doubtful(self) -> bool:
        """True if the offset of the last exchange disagrees with earlier exchanges. The next request should then follow
        soon."""
        return self._doubtful is not None

    def is_open(self, ts1: int) -> bool:
        """Return True if this end has sent a request with this `ts1` and has received no answer yet.

        If so, an answer to this request is current, not replayed.
        """
        return ts1 // NS_PER_UNIT in self._asked

    @property
    def is_known(self) -> bool:
        """True if an exchange has been completed since the last change of the other clock."""
        return bool(self._exchanges)

    @property
    def offset(self) -> float:
        """Estimated offset (100 ns) at the newest exchange: the other clock minus this clock."""
        return self._line.offset

    @property
    def drift(self) -> float:
        """Drift of the other clock relative to this clock (s/s)."""
        return self._line.drift

    @property
    def shortest(self) -> int:
        """Shortest round trip of the last minute (100 ns), or 0 before the first exchange. The error of the offset is
        at most half of this time."""
        return min((e.round_trip for e in self._exchanges), default=0)

    def ask(self, now: int) -> dict[str, int]:
        """Return the fields of a TIMESYNC request. Send requests at a high rate until the clock is known, then one a
        second."""
        self._asked.append(now)
        return {"tc1": 0, "ts1": now * NS_PER_UNIT}

    def handle_answer(self, tc1: int, ts1: int, now: int) -> bool:
        """Handle a TIMESYNC message that arrived at `now`. Return True if it answers a request of this end."""
        sent = ts1 // NS_PER_UNIT
        if tc1 > 0 and ts1 == self._answered[0]:
            _, first, at = self._answered
            self.doubles += abs((tc1 - first) // NS_PER_UNIT - (now - at)) > JUMP
        if tc1 <= 0 or sent not in self._asked or not 0 <= now - sent <= LONGEST_WAIT:
            self.refused += tc1 != 0
            return False
        self._asked.remove(sent)
        self._answered = ts1, tc1, now
        remote = tc1 // NS_PER_UNIT
        exchange = TimeSyncExchange(remote, remote - (sent + now) / 2, now - sent)
        if self.is_known and _is_other_clock(exchange, self._line.value(remote)):
            before, self._doubtful = self._doubtful, exchange
            if before is None or _is_other_clock(exchange, before.offset):
                return True
            self._restart()
        self._doubtful = None
        self._exchanges.append(exchange)
        while remote - self._exchanges[0].remote > WINDOW:
            self._exchanges.popleft()
        self._line = fit_offset_line(list(self._exchanges))
        self._turn_offset(remote)
        return True

    def _restart(self) -> None:
        self.jumps += 1
        self._exchanges.clear()
        self._last, self._not_before = None, self._latest

    def _turn_offset(self, remote: int) -> None:
        """Change the used offset towards the new line, from the last converted time on and without a jump."""
        drift = min(max(self._line.drift, -SLEW), SLEW)
        if self._last is None:
            self._from, self._applied, self._turn = remote, self._line.value(remote), drift
        else:
            applied = self._offset_at(self._last)
            turn = drift + (self._line.value(self._last) - applied) / HORIZON
            self._from, self._applied, self._turn = self._last, applied, min(max(turn, -SLEW), SLEW)
        self._after = drift

    def _offset_at(self, remote: int) -> float:
        """Return the offset that is used in conversions at a time of the other clock. It approaches the fitted line for
        one HORIZON, then changes with the line's drift."""
        since = remote - self._from
        return self._applied + self._turn * min(since, HORIZON) + self._after * max(since - HORIZON, 0)

    def show_local(self, remote: int) -> int:
        """Convert a time of the other clock like `to_local`, but change no state, because the caller may reject the
        time."""
        local = round(remote - self._offset_at(remote))
        return local if self._not_before is None else max(local, self._not_before)

    def to_local(self, remote: int) -> int:
        """Convert an accepted time of the other clock to this clock. Increasing times stay increasing, even if the
        other clock jumps.

        Before the first exchange, the time is returned unchanged.
        """
        local = self.show_local(remote)
        if self.is_known:
            self._last = remote if self._last is None else max(self._last, remote)
            self._latest = local if self._latest is None else max(self._latest, local)
        return local

    def to_remote(self, local: int) -> int:
        """Convert a time of this clock to the other clock. This is the inverse of `to_local`."""
        near = local + self._offset_at(local + round(self._applied))
        return round(local + self._offset_at(round(near)))


def _is_other_clock(exchange: TimeSyncExchange, offset: float) -> bool:
    return abs(exchange.offset - offset) > exchange.round_trip / 2 + JUMP


def fit_offset_line(exchanges: list[TimeSyncExchange]) -> OffsetLine:
    """Return the weighted straight line through the measured offsets, with the newest exchange as reference. With few
    exchanges, the estimated drift is near zero."""
    shortest = min(e.round_trip for e in exchanges)
    least = FLOOR[0] * shortest + FLOOR[1]
    weights = [(least / (least + e.round_trip - shortest)) ** 2 for e in exchanges]
    total = sum(weights)
    base = exchanges[0]
    times = [float(e.remote - base.remote) for e in exchanges]
    offsets = [e.offset - base.offset for e in exchanges]
    t = sum(w * x for w, x in zip(weights, times, strict=True)) / total
    o = sum(w * y for w, y in zip(weights, offsets, strict=True)) / total
    spread = sum(w * (x - t) ** 2 for w, x in zip(weights, times, strict=True))
    moment = sum(w * (x - t) * (y - o) for w, x, y in zip(weights, times, offsets, strict=True))
    drift = moment / (spread + (least / DRIFT) ** 2)
    newest = exchanges[-1].remote
    return OffsetLine(newest, base.offset + o + drift * (newest - base.remote - t), drift)
