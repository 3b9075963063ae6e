"""Differences of two logs, checked by a plain comparison."""

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.time import ms, to_seconds
from trimtab.logs.difference import find_difference
from trimtab.logs.log import Log


def make_log(ticks, **signals):
    return Log(t=to_seconds(ticks), ticks=ticks, signals={f"truth.{name}": x for name, x in signals.items()})


def test_identical_logs_with_nan_compare_equal():
    t = np.arange(5) * ms(10)
    x = np.array([0, 1, np.nan, 3, 4])
    difference = find_difference(make_log(t, x=x), make_log(t, x=x))
    assert difference.equal
    assert (difference.instants, difference.compared) == (5, 1)


def test_first_and_largest_differences_match_a_plain_search():
    rng = np.random.default_rng(0)
    t = np.arange(200) * ms(10)
    a, v = rng.normal(size=200), rng.normal(size=(200, 3))
    b, w = a.copy(), v.copy()
    b[[90, 150]] += 2.0, -5.0
    w[60:, 2] += 0.25
    found = {d.path: d for d in find_difference(make_log(t, a=a, v=v), make_log(t, a=b, v=w)).signals}
    assert list(found) == ["truth.v[2]", "truth.a"]
    assert found["truth.v[2]"][1:4] == pytest.approx((0.6, v[60, 2], w[60, 2]))
    assert found["truth.a"].first_s == pytest.approx(0.9)
    assert found["truth.a"].largest == pytest.approx(5.0)


def test_only_common_instants_and_signals_are_compared():
    one = make_log(np.arange(0, 100, 2) * ms(1), x=np.arange(50.0), only=np.zeros(50))
    other = make_log(np.arange(0, 100, 5) * ms(1), x=np.arange(20.0) * 2.5)
    difference = find_difference(one, other)
    assert difference.equal
    assert (difference.instants, difference.only_one, difference.only_other) == (10, ("truth.only",), ())


def test_rejects_logs_without_common_signals_or_instants():
    t = np.arange(5) * ms(10)
    with pytest.raises(InputError, match="no signal in common"):
        find_difference(make_log(t, x=np.zeros(5)), make_log(t, y=np.zeros(5)))
    with pytest.raises(InputError, match="no instant in common"):
        find_difference(make_log(t, x=np.zeros(5)), make_log(t + ms(1000), x=np.zeros(5)))
