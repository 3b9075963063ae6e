"""Packet link with random latencies from a measured distribution, and the distributions for five pairs of Bluetooth
modules. [1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, imperfection, option, period, quantity, record
from trimtab.core.rng import Key, normal2, uniform2
from trimtab.core.signals import Sample
from trimtab.core.suggestions import closest
from trimtab.core.time import ms
from trimtab.links.fifo import Fifo, check_ring, deliver, empty_fifo, required_slots

NODES = 65
SPAN = 4.0
"""Largest normal score (standard normal quantile) of a latency table. The normal scores of the table's NODES latencies
are evenly spaced from -SPAN to SPAN."""


@record
class MeasuredLatency:
    """Packet link with random latencies, delivery in order, and random losses.

        latency of packet k = table(z_k), linear between its nodes, z_k ~ N(0, 1);
        arrival_k = max(arrival_(k-1), send_k + latency_k);   lost with probability `loss`

    At most one packet is sent per `send_period`, and only if its sample is newer than the last sample sent. Lost
    packets are not sent again. The receiving end polls the link once per `period` and holds the newest sample that has
    arrived. The random draws of a packet depend only on the time of sending, so a change of `loss` or of the latencies
    does not change the draws of other packets.

    Frames:  those of the transmitted values.    Not modelled: correlation of successive latencies, bursts of loss.
    Valid:   `send_period` >= `period`; ring buffer longer than the longest latency (see `check`).
    Source:  [1] table 5.1 for means and standard deviations. The shape of the distribution is reconstructed, see docs
    page Errata.
    """

    latency: Scalar = quantity(
        "s",
        "Table of latencies, one for each of NODES evenly spaced normal scores.",
        low=0,
        shape=(NODES,),
        off={"delay": np.zeros(NODES), "jitter": lambda link: np.full(NODES, mean_latency(link.latency))},
    )
    loss: Scalar = imperfection("1", "Probability that a packet is lost.", "loss", high=1)
    send_period: int = period("Time between packets.", default=ms(20))
    period: int = period("Period at which the receiving end polls the link.", default=ms(1))
    capacity: int = option("Number of slots of the ring buffer, one per send period.", default=64)

    def check(self) -> None:
        """Raise InputError if the latencies in the table decrease, or if the ring buffer is too short for the longest
        latency."""
        table = np.asarray(self.latency)
        if table.shape != (NODES,) or not np.isfinite(table).all() or (np.diff(table) < 0).any() or table[0] < 0:
            raise InputError(
                "MeasuredLatency.latency",
                f"{np.array2string(table, threshold=6, precision=4)} s, of shape {table.shape}, must be"
                f" {NODES} rising latencies, at least 0",
                fix=(
                    "use gamma_table(mean, sd, shift), or measured quantiles of the latency at the probabilities "
                    "ndtr(normal_scores())"
                ),
            )
        check_ring("MeasuredLatency", self.capacity, float(table[-1]), self.send_period, self.period)

    def draw(self, key: Key, packet: Any) -> tuple[Any, Any]:
        """Return the latency (s) of a packet, and True if the packet is lost. packet: number of the packet, i.e. its
        time of sending divided by `send_period`."""
        z, _ = normal2(key, packet, 0)
        u, _ = uniform2(key, packet, 1)
        return interpolate_latency(self.latency, z), u < self.loss

    def init(self, key: Key, like: Sample) -> Fifo:
        """Return the initial state, without packets, for samples with the structure of `like`."""
        return empty_fifo(key, like, self.capacity)

    def step(self, t: Any, state: Fifo, sample: Sample) -> tuple[Fifo, Sample]:
        """Return the new state, and the sample at the receiving end at integer time t."""
        return deliver(
            t,
            state,
            sample,
            lambda: self.draw(state.key, t // self.send_period),
            send_period=self.send_period,
            period=self.period,
        )


def interpolate_latency(table: Any, z: Any) -> Any:
    """Return the latency (s) at a normal score z, interpolated in a table (NODES,), and constant beyond ±SPAN."""
    place = jnp.clip((z + SPAN) * ((NODES - 1) / (2 * SPAN)), 0.0, NODES - 1.0)
    node = jnp.minimum(place.astype(np.int32), NODES - 2)
    table = jnp.asarray(table)
    low, high = table[node], table[node + 1]
    return low + (high - low) * (place - node)


def normal_scores() -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the normal scores (NODES,) of the latencies in a table."""
    return np.linspace(-SPAN, SPAN, NODES)


def gamma_table(mean: float, sd: float, shift: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return a table of latencies (NODES,) (s) with this mean and standard deviation (s).

    The distribution is a gamma distribution shifted by `shift` (s):

        k = ((mean - shift) / sd)^2,   scale = sd^2 / (mean - shift),   latency(z) = shift + scale Q_k(ndtr(z))

    Q_k is the quantile function of the gamma distribution of shape k. Source: [1] table 5.1 for the moments; the shape
    of the distribution is reconstructed, see docs page Errata.
    """
    from scipy import special  # the import takes 0.2 s and is needed for tables only

    if not (0 <= shift < mean and sd > 0 and math.isfinite(mean) and math.isfinite(sd)):
        raise InputError(
            "gamma_table",
            f"mean {mean} s, standard deviation {sd} s and shift {shift} s do not define a distribution",
            fix="pass values in seconds with 0 <= shift < mean and sd > 0",
        )
    k, scale = ((mean - shift) / sd) ** 2, sd**2 / (mean - shift)
    z = normal_scores()
    tails = np.where(z < 0, special.gammaincinv(k, special.ndtr(z)), special.gammainccinv(k, special.ndtr(-z)))
    return shift + scale * tails


def mean_latency(table: Any) -> float:
    """Return the mean latency (s) of a table, exact for linear interpolation and normally distributed scores."""
    from scipy import special  # the import takes 0.2 s and is needed for tables only

    values, z = np.asarray(table, np.float64), normal_scores()
    weight, density = special.ndtr(z), np.exp(-(z**2) / 2) / math.sqrt(2 * math.pi)
    slope = np.diff(values) / np.diff(z)
    inside = (values[:-1] - slope * z[:-1]) * np.diff(weight) - slope * np.diff(density)
    return float(inside.sum() + values[0] * weight[0] + values[-1] * special.ndtr(-z[-1]))


class Latencies(NamedTuple):
    """Measured statistics of the latency of one path, in milliseconds."""

    mean_ms: float
    sd_ms: float
    min_ms: float
    max_ms: float


TABLE: Mapping[str, Mapping[str, Latencies]] = MappingProxyType(
    {
        "free2move/linksys 2.9/41.0": {
            "up": Latencies(51.04, 15.09, 22, 118),
            "down": Latencies(39.02, 9.23, 20, 74),
            "round trip": Latencies(95.48, 18.01, 58, 157),
        },
        "free2move/free2move 2.9/41.0": {
            "up": Latencies(66.01, 10.22, 40, 102),
            "down": Latencies(95.36, 12.02, 59, 141),
            "round trip": Latencies(160.21, 13.86, 124, 194),
        },
        "free2move/linksys 2.9/22.0": {
            "up": Latencies(40.81, 10.61, 22, 90),
            "down": Latencies(34.32, 8.18, 19, 67),
            "round trip": Latencies(77.54, 14.44, 46, 110),
        },
        "free2move/free2move 2.9/22.0": {
            "up": Latencies(62.76, 11.13, 40, 106),
            "down": Latencies(100.01, 13.64, 53, 161),
            "round trip": Latencies(162.98, 16.58, 113, 208),
        },
        "free2move/linksys 2.9/16.2": {
            "up": Latencies(38.83, 8.80, 20, 68),
            "down": Latencies(32.62, 8.49, 14, 65),
            "round trip": Latencies(75.69, 13.82, 49, 126),
        },
    }
)
"""Measured latencies, by pair of modules and then by path. The key of a pair is the module on the vehicle / the module
on the ground, then the data rates up/down in kb/s. Source: [1] table 5.1.

The latencies are not additive: a mean round trip differs from the sum of up and down by -1.2 to +5.4 ms.
"""

SEND_PERIODS: Mapping[str, int] = MappingProxyType({"up": ms(20), "down": ms(6)})
"""Time between packets on each path (100 ns): servo commands up, navigation data down. Source: [1] section 6.1."""

BELOW_MIN_MS = 2.0
"""Distance (ms) from the start of the gamma distribution to the smallest measured latency. It is our own estimate, see
docs page Errata."""


def bluetooth_link(
    pair: str, path: str, *, loss: float = 0.0, send_period: int | None = None, period: int = ms(1)
) -> MeasuredLatency:
    """Return a link with the measured mean and standard deviation of the latency, for one path of one pair of modules.

    Args:
        pair: a key of TABLE, e.g. "free2move/linksys 2.9/22.0".
        path: "up" (ground to vehicle) or "down".
        loss: probability that a packet is lost. The table contains no measured value.
        send_period: time between packets (100 ns), by default the value of SEND_PERIODS for the path.
        period: polling period of the receiving end (100 ns).
    """
    if pair not in TABLE:
        near = closest(pair, TABLE)
        raise InputError(
            "bluetooth",
            f"the table has no pair of modules {pair!r}",
            choices=TABLE,
            fix=f"write {near[0]!r}" if near else "",
        )
    if path not in SEND_PERIODS:
        why = ": a round trip is two links, not one" if path == "round trip" else ""
        raise InputError(
            "bluetooth",
            f"the table has no path {path!r}{why}",
            choices=SEND_PERIODS,
            fix="make one link for each direction, up and down",
        )
    row = TABLE[pair][path]
    table = gamma_table(row.mean_ms / 1e3, row.sd_ms / 1e3, (row.min_ms - BELOW_MIN_MS) / 1e3)
    every = SEND_PERIODS[path] if send_period is None else send_period
    return MeasuredLatency(
        latency=table,
        loss=loss,
        send_period=every,
        period=period,
        capacity=required_slots(float(table[-1]), every, period),
    )
