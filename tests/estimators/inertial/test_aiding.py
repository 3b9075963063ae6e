"""How samples become numbers of events."""

from types import SimpleNamespace

import numpy as np

from trimtab.estimators.inertial.aided import position_aid, range_aid
from trimtab.estimators.inertial.measurement_history import POSITION, RANGES


def test_positions_with_and_without_a_variance():
    aid = position_aid(SimpleNamespace(correct_position=lambda node, z, variance: (node, *z, variance)))
    assert aid.kind == POSITION
    assert aid.numbers(SimpleNamespace(north=1.0, east=2.0)) == (1.0, 2.0, 0.0)
    assert aid.numbers(SimpleNamespace(north=1.0, east=2.0, variance=0.5))[2] == 0.5
    assert aid.correct("node", np.array([1.0, 2.0, 0.5])) == ("node", 1.0, 2.0, 0.5)


def test_ranges_that_are_none_are_told_apart():
    form = SimpleNamespace(beacons=np.zeros((5, 3)), correct_ranges=lambda node, value: value)
    aid = range_aid(form)
    assert (aid.kind, aid.width) == (RANGES, 6)
    sent = SimpleNamespace(
        range=np.array([3.0, np.nan, 3.2, 0.0, np.inf]), arrived=np.array([True, True, False, True, True]), unit=1
    )
    assert [float(v) for v in aid.numbers(sent)] == [3.0, -1.0, 0.0, -1.0, -1.0, 1.0]
