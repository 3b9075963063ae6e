"""Times counted as they come: a fixed table, a few hundred nanoseconds each, nothing allocated.

Source: G. Tene, HdrHistogram (buckets of constant relative width).
"""

from typing import NamedTuple

HALF = 5
"""Each doubling is cut into 2**HALF buckets: 3 % wide."""
BUCKETS = (64 - HALF) << HALF


class Summary(NamedTuple):
    """Times in seconds; a quantile is the upper end of its bucket."""

    n: int
    p50: float
    p99: float
    p999: float
    longest: float


class Histogram:
    """Counts of times, given in ns."""

    def __init__(self) -> None:
        self.counts = [0] * BUCKETS
        self.longest = 0

    def add(self, ns: int) -> None:
        """Count one; below 0 counts as 0."""
        ns = max(ns, 0)
        self.longest = max(self.longest, ns)
        shift = max(ns.bit_length() - HALF - 1, 0)
        self.counts[min((shift << HALF) + (ns >> shift), BUCKETS - 1)] += 1

    def quantile(self, share: float) -> float:
        """The time (s) that this share of all does not exceed; 0 when there is none."""
        wanted, seen = share * sum(self.counts), 0
        for bucket, count in enumerate(self.counts):
            seen += count
            if count and seen >= wanted:
                return min(upper(bucket), self.longest) * 1e-9
        return 0.0

    def summary(self) -> Summary:
        """Count, median, tails."""
        tails = [self.quantile(share) for share in (0.5, 0.99, 0.999)]
        return Summary(sum(self.counts), tails[0], tails[1], tails[2], self.longest * 1e-9)

    def decades(self) -> list[tuple[float, float, int]]:
        """(from, to, count) over times doubling from 1 us on: for a table or a picture."""
        edges = [0.0, *(1e-6 * 2**k for k in range(24)), float("inf")]
        found = [0] * (len(edges) - 1)
        for bucket, count in enumerate(self.counts):
            if count:
                middle = upper(bucket) * 1e-9
                found[max(i for i, e in enumerate(edges[:-1]) if middle > e or i == 0)] += count
        rows = zip(edges, edges[1:], found, strict=False)
        return [(low, high, count) for low, high, count in rows if count]


def upper(bucket: int) -> int:
    """The longest time (ns) that falls into a bucket."""
    shift = max((bucket >> HALF) - 1, 0)
    return ((bucket - (shift << HALF) + 1) << shift) - 1
