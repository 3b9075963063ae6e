"""What a link test has found: the table's figures, recordings to replay, and a channel model with the same moments."""

from typing import Any, NamedTuple

import numpy as np

from trimtab.core.time import ms
from trimtab.links.bluetooth import BELOW_MIN_MS, SEND_PERIODS, Latencies
from trimtab.links.fifo import required_slots
from trimtab.links.latency import gamma_table
from trimtab.links.latency_trace import Trace

QUICKEST_SHARE = 0.05
"""Share of the round trips from which the offset of two clocks is taken."""
LEAST_SD = 1e-5
"""Spread (s) of a model of a link that has none."""


class LinkTestPlan(NamedTuple):
    """What to measure: load in kb/s each way (all that is sent, ten bits a byte), requests, and how many a second."""

    up: float
    down: float
    requests: int = 300
    rate: float = 10.0
    patience: float = 3.0
    """Seconds to wait for the last replies; ten times that for the first sign of life."""
    seed: int = 0


class Delays(NamedTuple):
    """What was measured, in s; one entry a request in the order sent, NaN where no reply came."""

    plan: LinkTestPlan
    send_times: np.ndarray[Any, Any]
    up: np.ndarray[Any, Any]
    down: np.ndarray[Any, Any]
    lost_up: int
    """Requests that did not arrive; the others without a reply were lost on the way down."""
    has_one_clock: bool
    """Measured with one clock; else only the sum of up and down is certain."""
    data_rates: tuple[float, float]
    """kb/s that were sent, and that arrived."""

    @property
    def has_reply(self) -> np.ndarray[Any, Any]:
        """Which requests were."""
        return np.isfinite(self.up)


def clock_offset(up: np.ndarray[Any, Any], trip: np.ndarray[Any, Any]) -> float:
    """How far the far clock is ahead (s), were the quickest round trips as quick up as down."""
    quickest = np.argsort(trip)[: max(1, int(QUICKEST_SHARE * len(trip)))]
    return float(np.median((up - trip / 2)[quickest]))


def link_traces(delays: Delays) -> dict[str, Trace]:
    """Recordings of both ways, for LatencyTrace; of those without a reply, which were lost on which way is not known.

    They count as lost up at even distances, as many as the far end has missed.
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
    # a request that was answered late or never did arrive: the mean stands for its unknown uplink
    upward = Trace(delays.send_times, np.where(lost_up, 0.0, np.where(delays.has_reply, up, mean)), lost_up)
    return {"up": upward, "down": Trace(left[order], np.where(fell, 0.0, down[arrived_up][order]), fell)}


def summarise_latencies(seconds: np.ndarray[Any, Any]) -> Latencies:
    """Mean, standard deviation, smallest and largest in ms, of those that are not NaN; a row of the source's table."""
    found = 1e3 * seconds[np.isfinite(seconds)]
    sd = float(found.std(ddof=1)) if len(found) > 1 else 0.0
    return Latencies(float(found.mean()), sd, float(found.min()), float(found.max()))


def latency_rows(delays: Delays) -> dict[str, Latencies]:
    """The rows "up", "down" and "round trip" of the source's table."""
    found = {"up": delays.up, "down": delays.down, "round trip": delays.up + delays.down}
    return {path: summarise_latencies(seconds) for path, seconds in found.items()}


class DelayModel(NamedTuple):
    """A shifted gamma distribution of latencies (s) with the moments that were measured, and the share lost."""

    mean: float
    sd: float
    shift: float
    loss: float

    def settings(self, path: str) -> list[str]:
        """As settings of `trimtab run` for a scenario with links=measured; path: "up" or "down"."""
        table, period = np.round(gamma_table(self.mean, self.sd, self.shift), 6), SEND_PERIODS[path]
        where = f"world.{path}link"
        values = ",".join(f"{value:.6g}" for value in table)
        slots = required_slots(float(table[-1]), period, ms(1))
        return [f"{where}.latency=[{values}]", f"{where}.loss={self.loss:.4g}", f"{where}.capacity={slots}"]


def fit_delay_model(trace: Trace) -> DelayModel:
    """Of one way: the distribution starts 2 ms below the smallest latency, as that of the source's table here."""
    found = trace.latency_s[~trace.lost]
    row = summarise_latencies(found)
    shift = max(row.min_ms - BELOW_MIN_MS, 0.0) / 1e3
    mean = max(row.mean_ms / 1e3, shift + LEAST_SD)
    return DelayModel(mean, max(row.sd_ms / 1e3, LEAST_SD), shift, float(trace.lost.mean()))
