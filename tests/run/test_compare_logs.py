"""Comparison of two logs: rounding, mode switches, NaN."""

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity
from trimtab.logs.log import Log
from trimtab.run.replay import compare_logs

TICKS = np.arange(0, 50_000, 10_000)


def log(x, mode=(0, 0, 1, 1, 1)):
    return Log(TICKS * 1e-7, TICKS, {"truth.x": np.array(x, float), "law.mode": np.array(mode, np.int32)})


ONE = log([1.0, 2.0, 3.0, 4.0, 5.0])


def test_equal_logs_agree():
    found = compare_logs(ONE, ONE)
    assert found.is_equal
    assert found.switch is None
    assert found.instants == 5
    assert found.worst == {"truth.x": 0.0}


def test_rounding_differences_are_within_relative_tolerance():
    near = log([1.0, 2.0 + 1e-10, 3.0, 4.0, 5.0])
    assert compare_logs(ONE, near).is_equal
    assert not compare_logs(ONE, log([1.0, 2.0 + 1e-9, 3.0, 4.0, 5.0])).is_equal
    found = compare_logs(ONE, near, 1e-12)
    assert not found.is_equal
    assert found.number == (0.001, "truth.x", 2.0, 2.0 + 1e-10)


def test_error_signal_tolerance_scales_with_signals_of_same_unit():
    """One rounding of an altitude of 85 000 ft is 1.5e-11, more than 1e-10 of an altitude error of 0.01 ft."""

    def climb(error, unit):
        far = Quantity(unit=unit, doc="", kind="real")
        signals = {"truth.h": np.full(5, 85000.0), "law.h_error": np.full(5, error)}
        return Log(
            TICKS * 1e-7, TICKS, signals, declarations={"truth.h": Quantity("ft", "", kind="real"), "law.h_error": far}
        )

    off = 0.01 + 6 * np.spacing(85000.0)
    assert compare_logs(climb(0.01, "ft"), climb(off, "ft")).is_equal
    assert not compare_logs(climb(0.01, "rad"), climb(off, "rad")).is_equal  # an angle has nothing to do with altitude
    assert not compare_logs(climb(0.01, "ft"), climb(0.01 + 12 * np.spacing(85000.0), "ft")).is_equal


def test_rows_after_a_mode_switch_are_not_compared():
    other = log([1.0, 2.0, 3.0, 4.0, 9.0], mode=(0, 0, 1, 2, 2))
    found = compare_logs(ONE, other)
    assert found.is_equal
    assert found.switch == (0.003, "law.mode", 1.0, 2.0)
    assert found.instants == 3


def test_finds_a_difference_before_a_mode_switch():
    found = compare_logs(ONE, log([1.0, 2.5, 3.0, 4.0, 9.0], mode=(0, 0, 1, 2, 2)))
    assert found.number[1:] == ("truth.x", 2.0, 2.5)


def test_nan_equals_only_nan():
    nan = log([1.0, np.nan, 3.0, 4.0, 5.0])
    assert compare_logs(nan, nan).is_equal
    assert not compare_logs(ONE, nan).is_equal


def test_rejects_logs_with_different_instants_or_signals():
    short = Log(TICKS[:3] * 1e-7, TICKS[:3], {"truth.x": np.zeros(3), "law.mode": np.zeros(3, np.int32)})
    with pytest.raises(InputError, match="different instants"):
        compare_logs(ONE, short)
    renamed = Log(TICKS * 1e-7, TICKS, {"truth.y": np.zeros(5), "law.mode": np.zeros(5, np.int32)})
    with pytest.raises(InputError, match=r"truth\.x"):
        compare_logs(ONE, renamed)
