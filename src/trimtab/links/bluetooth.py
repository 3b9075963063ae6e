"""The latencies of five pairs of Bluetooth modules, as they were measured.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, table 5.1.
The columns are not additive: a mean round trip differs from up + down by -1.2 to +5.4 ms.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from trimtab.core.errors import InputError, closest
from trimtab.core.time import ms
from trimtab.links.fifo import required_slots
from trimtab.links.latency import MeasuredLatency, gamma_table


class Latencies(NamedTuple):
    """One row of the table, in milliseconds."""

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
"""Module on the vehicle / module on the ground, data rate up/down in kb/s -> path -> latencies. [1] table 5.1."""

SEND_PERIODS: Mapping[str, int] = MappingProxyType({"up": ms(20), "down": ms(6)})
"""How often a packet leaves on each path: servo commands up, navigation down. [1] section 6.1."""

BELOW_MIN_MS = 2.0
"""How far the gamma distribution starts below the smallest latency seen (reconstructed, see docs Errata)."""


def bluetooth_link(
    pair: str, path: str, *, loss: float = 0.0, send_period: int | None = None, period: int = ms(1)
) -> MeasuredLatency:
    """A link with the measured mean and spread of one path of one pair of modules.

    Args:
        pair: a key of TABLE, e.g. "free2move/linksys 2.9/22.0".
        path: "up" (ground to vehicle) or "down".
        loss: probability that a packet is lost; the table has no figure.
        send_period: time between packets (100 ns); that of SEND_PERIODS if not given.
        period: how often the receiving end looks (100 ns).
    """
    if pair not in TABLE:
        near = closest(pair, TABLE)
        raise InputError(
            "bluetooth", f"no pair {pair!r} in the table", choices=TABLE, fix=f"write {near[0]!r}" if near else ""
        )
    if path not in SEND_PERIODS:
        why = ": it is two links, not one" if path == "round trip" else ""
        raise InputError("bluetooth", f"no path {path!r}{why}", choices=SEND_PERIODS, fix="make one link for each way")
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
