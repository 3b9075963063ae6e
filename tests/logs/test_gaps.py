"""Rows joined by time, and descriptions of gaps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trimtab.logs.contents import Damage
from trimtab.logs.gaps import describe_gaps, join_by_time

MS = 1_000_000


def test_topics_with_equal_times_are_joined_unchanged():
    joined = join_by_time({"a": [1, 2, 3], "b": [1, 2, 3]})
    assert joined.times.tolist() == [1, 2, 3]
    assert joined.places["b"].tolist() == [0, 1, 2]
    assert not len(joined.missing)


@settings(max_examples=50)
@given(st.lists(st.sets(st.integers(0, 30), max_size=25), min_size=1, max_size=4), st.randoms())
def test_joined_rows_contain_only_the_common_times(sets, random):
    columns = {}
    for k, times in enumerate(sets):
        columns[str(k)] = random.sample(sorted(times), len(times))
    joined = join_by_time(columns)
    common = sorted(set.intersection(*sets))
    same = len({tuple(column) for column in columns.values()}) == 1
    if not same:  # equal columns are taken in their own order
        assert joined.times.tolist() == common
    for topic, column in columns.items():
        assert [column[k] for k in joined.places[topic]] == joined.times.tolist()
    if not same and common:
        assert joined.missing.tolist() == sorted(t for t in set.union(*sets) - set(common) if t < common[-1])


def test_gap_text_names_instants_around_the_damage():
    joined = join_by_time({"a": [k * MS for k in (0, 1, 2, 3, 9)], "b": [k * MS for k in (0, 1, 2, 8, 9)]})
    (gap,) = describe_gaps([Damage("a chunk is damaged: CRC", 3 * MS)], joined, 0)
    assert gap["after_s"] == pytest.approx(0.002)
    assert gap["text"] == "instants after 0.002 s before 0.009 s are missing: a chunk is damaged: CRC"


def test_gap_text_counts_instants_with_missing_messages():
    joined = join_by_time({"a": [0, MS, 2 * MS, 3 * MS, 5 * MS], "b": [0, 3 * MS, 5 * MS]})
    (gap,) = describe_gaps([], joined, 0)
    assert gap["after_s"] == 0.0
    assert gap["text"] == "2 instants, 0.001 s to 0.002 s, are left out: the message of at least one topic is missing"


@pytest.mark.parametrize(
    ("after", "words"), [(None, "from the start before 0 s"), (9 * MS, "after 0.009 s to the end")]
)
def test_gap_text_for_damage_at_file_start_or_end(after, words):
    joined = join_by_time({"a": np.arange(10) * MS})
    (gap,) = describe_gaps([Damage("why", after)], joined, 0)
    assert words in gap["text"]
    assert gap["after_s"] == (None if after is None else pytest.approx(0.009))
