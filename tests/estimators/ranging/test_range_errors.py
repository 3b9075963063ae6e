"""Diagnosis of rejected ranges: one moved beacon, or a lost filter."""

from types import SimpleNamespace

import numpy as np
import pytest

from trimtab.core.record import replace
from trimtab.estimators.ranging.range_errors import (
    FORGIVENESS_FACTOR,
    RangeErrorModel,
    count_ranges,
    diagnose_beacons,
    no_range_fix,
)

ERRORS = RangeErrorModel(patience=4)


def pings(*accepted, heard=(True,) * 4, innovation=1.0, fix=None):
    fix = no_range_fix(4) if fix is None else fix
    for row in accepted:
        done = SimpleNamespace(
            accepted=np.array(row, bool),
            innovation=np.full(4, innovation),
            variance=np.full(4, 1.0 + 1e-4),
            nis=np.ones(4),
        )
        fix = count_ranges(fix, np.array(heard), done, ERRORS)
    return fix, [np.asarray(a) for a in diagnose_beacons(fix, ERRORS)]


def test_single_rejected_beacon_is_declared_moved():
    fix, (moved, _, lost) = pings(*[(1, 0, 1, 1)] * 4)
    np.testing.assert_array_equal(moved, [False, True, False, False])
    assert not lost
    assert int(fix.used) == 12
    assert int(fix.rejected) == 4
    _, (moved, _, lost) = pings(*[(1, 0, 1, 1)] * 3)
    assert not moved.any()
    assert not lost


def test_filter_contradicted_by_most_beacons_is_lost():
    fix, (moved, _, lost) = pings(*[(0, 0, 0, 1)] * 4)
    assert lost
    assert not moved.any()
    assert int(fix.rejected_pings_in_a_row) == 4


def test_filter_contradicted_by_half_the_beacons_is_lost():
    _, (moved, _, lost) = pings(*[(0, 0, 1, 1)] * 4)
    assert lost
    assert not moved.any()


def test_missing_ranges_are_not_counted_as_rejected():
    fix, (moved, _, lost) = pings(*[(0, 0, 0, 0)] * 9, heard=(False,) * 4)
    assert not moved.any()
    assert not lost
    assert int(fix.rejected) == 0


@pytest.mark.parametrize(("innovation", "forgiven"), [(0.02, True), (0.5, False)])
def test_moved_beacon_is_forgiven_after_consistent_ranges(innovation, forgiven):
    fix = replace(no_range_fix(4), moved=np.array([False, True, False, False]))
    fix, (_, forgives, _) = pings(*[(1, 1, 1, 1)] * (FORGIVENESS_FACTOR * 4), innovation=innovation, fix=fix)
    np.testing.assert_array_equal(forgives, [False, forgiven, False, False])


def test_ignored_survey_errors_have_zero_variance():
    np.testing.assert_allclose(RangeErrorModel(scale=0.01, survey=0.1).variances(2), [1e-4, 1e-2, 1e-2])
    np.testing.assert_allclose(RangeErrorModel(scale=0.01, survey_errors="ignore").variances(2), [1e-4, 0, 0])
