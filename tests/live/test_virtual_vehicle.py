"""Instants of a virtual vehicle: the timetable of a run, without end."""

from itertools import takewhile

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from trimtab.core.time import timetable
from trimtab.live.virtual_vehicle import instants


@settings(deadline=None)
@given(
    st.lists(st.integers(3, 300), min_size=1, max_size=4),
    st.integers(2, 100),
    st.integers(1, 2000),
)
def test_instants_are_those_of_the_timetable(periods, max_step, duration):
    wanted = timetable(periods, 3000, max_step).t
    found = np.array(list(takewhile(lambda t: t < 3000, instants(periods, max_step))))
    np.testing.assert_array_equal(found[found < duration], wanted[wanted < duration])
