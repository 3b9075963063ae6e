"""Histogram of times, compared with sorted values."""

import numpy as np

from trimtab.flight.real_time import BUCKETS, Histogram, bucket_end


def test_quantiles_match_sorted_times_within_a_bucket():
    rng = np.random.default_rng(1)
    times = np.concatenate([rng.lognormal(8, 2, 20000), [0, 1, 31, 32, 63, 64, 65]]).astype(np.int64)
    found = Histogram()
    for ns in times.tolist():
        found.add(ns)
    ordered = np.sort(times)
    for share in (0.01, 0.5, 0.9, 0.99, 0.999, 1.0):
        exact = ordered[int(np.ceil(share * len(ordered))) - 1] * 1e-9
        assert exact <= found.quantile(share) <= exact * 1.033 + 1e-9
    assert found.summary().n == len(times)
    assert found.summary().longest == times.max() * 1e-9


def test_bucket_covers_times_up_to_its_end():
    previous = -1
    for bucket in range(BUCKETS):
        end = bucket_end(bucket)
        assert end > previous
        if end < 2**62:
            one = Histogram()
            one.add(end)
            one.add(previous + 1)
            assert one.counts[bucket] == 2
        previous = end


def test_empty_summary_is_zero_and_negative_counts_as_zero():
    assert Histogram().summary() == (0, 0.0, 0.0, 0.0, 0.0)
    early = Histogram()
    early.add(-5)
    assert early.counts[0] == 1
