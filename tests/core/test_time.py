"""Integer time: exact periods with no common divisor, the timetable's invariants, and what is refused."""

import itertools
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trimtab.core.errors import InputError
from trimtab.core.time import Instant, format_time, ms, parse_time, seconds, timetable, to_seconds


def test_loop_periods_are_exact_integers():
    assert (ms(1), ms(6.5536), ms(20)) == (10_000, 65_536, 200_000)


def test_loop_periods_coincide_only_at_time_zero():
    """10 000, 65 536 and 200 000 meet first after lcm(2^4 5^4, 2^16, 2^6 5^5) = 2^16 5^5 units, 20.48 s."""
    periods = (ms(1), ms(6.5536), ms(20))
    table = timetable(periods, seconds(2), ms(1))
    for p in periods:
        wanted = set(range(0, seconds(2), p))
        assert wanted <= set(table.t.tolist())
    together = [t for t in table.t.tolist() if all(t % p == 0 for p in periods)]
    assert together == [0]
    assert int(np.lcm.reduce(np.array(periods))) == 2**16 * 5**5 == seconds(20.48)


@pytest.mark.parametrize(
    ("value", "units"),
    [(1, 10_000_000), ("0.0065536", 65_536), (Decimal("1e-7"), 1), (0.1, 1_000_000), (-2, -(2 * 10**7))],
)
def test_seconds_converts_to_integer_units(value, units):
    assert seconds(value) == units


@pytest.mark.parametrize("value", [1e-8, "abc", float("nan"), float("inf"), "0.00000001", None])
def test_seconds_rejects_fractions_of_a_unit(value):
    with pytest.raises(InputError, match="time"):
        seconds(value)


@pytest.mark.parametrize("value", ["abc", None, 1e-5, float("nan"), float("inf")])
def test_ms_rejects_fractions_of_a_unit(value):
    with pytest.raises(InputError, match="time"):
        ms(value)


@pytest.mark.parametrize(
    ("text", "units"),
    [
        ("20 ms", 200_000),
        ("6.5536ms", 65_536),
        ("150 us", 1_500),
        ("150 µs", 1_500),
        ("100 ns", 1),
        ("2 s", 20_000_000),
        ("2", 20_000_000),
        (0.02, 200_000),
        (" 1e-3 s ", 10_000),
        ("-1 ms", -10_000),
    ],
)
def test_parse_time_reads_texts_with_units(text, units):
    assert parse_time(text) == units


@pytest.mark.parametrize("text", ["", "ms", "20 mi", "1..2 s", "1 2 s", "50 ns", "e", "--1", "1e99999999 s", "20 m s"])
def test_parse_time_rejects_invalid_text(text):
    with pytest.raises(InputError, match="time"):
        parse_time(text)


@pytest.mark.parametrize(
    ("units", "text"),
    [
        (0, "0 ms"),
        (1, "0.0001 ms"),
        (65_536, "6.5536 ms"),
        (200_000, "20 ms"),
        (20_000_000, "2 s"),
        (15_000_000, "1500 ms"),
    ],
)
def test_format_time_writes_texts_with_units(units, text):
    assert format_time(units) == text


@given(st.integers(-(2**62), 2**62))
def test_parse_time_inverts_format_time(units):
    assert parse_time(format_time(units)) == units


def test_to_seconds_is_float_and_works_on_arrays():
    assert to_seconds(65_536) == pytest.approx(0.0065536, rel=1e-15)
    np.testing.assert_allclose(to_seconds(np.array([0, 10_000_000])), [0.0, 1.0])


PERIODS = st.lists(st.integers(1, 3_000), min_size=0, max_size=5)


@given(PERIODS, st.integers(1, 9_000), st.integers(1, 4_000))
def test_timetable_holds_every_due_instant(periods, duration, max_step):
    """Against a set of plain integers: every due instant, and otherwise only instants that max_step requires."""
    table = timetable(periods, duration, max_step)
    t, h = table.t.tolist(), table.h.tolist()
    due = sorted({0} | {i for p in periods for i in range(0, duration, p)})
    assert t[0] == 0
    assert all(a < b for a, b in itertools.pairwise(t))
    assert t[-1] < duration
    assert set(due) <= set(t)
    assert all(0 < step <= max_step for step in h)
    assert sum(h) == duration
    assert [a + b for a, b in zip(t, h, strict=True)] == [*t[1:], duration]
    splits = sum(-(-(b - a) // max_step) for a, b in zip(due, [*due[1:], duration], strict=True))
    assert len(t) == splits
    assert table.t.dtype == table.h.dtype == np.int64


@given(PERIODS, st.integers(1, 9_000), st.integers(1, 4_000))
def test_timetable_splits_gaps_evenly(periods, duration, max_step):
    table = timetable(periods, duration, max_step)
    due = np.array([i in {0} or any(i % p == 0 for p in periods) for i in table.t.tolist()])
    for group in np.split(table.h, np.flatnonzero(due)[1:]):
        assert group.max() - group.min() <= 1


@given(PERIODS, st.integers(1, 9_000), st.integers(1, 4_000))
def test_always_lists_the_periods_due_at_every_instant(periods, duration, max_step):
    table = timetable(periods, duration, max_step)
    assert table.always == {p for p in periods if all(t % p == 0 for t in table.t.tolist())}


def test_timetable_excludes_the_end_of_the_duration():
    table = timetable([ms(10)], ms(30), ms(10))
    assert table.t.tolist() == [0, ms(10), ms(20)]
    assert table.h.tolist() == [ms(10)] * 3


def test_due_is_python_true_only_for_always_due_periods():
    clock = Instant(np.int64(20), frozenset({10}))
    assert clock.due(10) is True
    assert bool(clock.due(20))
    assert not bool(clock.due(15))
    assert clock.due(20) is not True
