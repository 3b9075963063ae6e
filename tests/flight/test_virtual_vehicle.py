"""Instants of a virtual vehicle, which follow a run's timetable without end, and rows of its log."""

from itertools import takewhile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loop.test_world_turbulence import throw

from trimtab import simulate
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.time import ms, timetable
from trimtab.flight.exchange import slot_indices
from trimtab.flight.mavlink.dialect import derive_dialect
from trimtab.flight.virtual_vehicle import VirtualVehicle, instants
from trimtab.run.blocks import compile_world


@settings(deadline=None)
@given(
    st.lists(st.integers(3, 300), min_size=1, max_size=4),
    st.integers(2, 100),
    st.integers(1, 2000),
)
def test_instants_match_the_timetable(periods, max_step, duration):
    wanted = timetable(periods, 3000, max_step).t
    found = np.array(list(takewhile(lambda t: t < 3000, instants(periods, max_step))))
    np.testing.assert_array_equal(found[found < duration], wanted[wanted < duration])


@pytest.mark.thorough
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
def test_logged_gust_matches_the_simulation():
    """An uncontrolled body in turbulence: gust and truth of each row equal the simulation bit for bit."""
    scenario = throw()
    log = simulate(scenario, seed=3, duration="200 ms")
    world, frame, command = compile_world(scenario, seed=3)
    body = VirtualVehicle(scenario, derive_dialect(frame, command), world)
    rows = []
    for t in body.instants():
        body.advance(t, fresh=False)
        if t:  # then it knows what acted at the instant before, and that row is whole
            rows.append(body.row.copy())
        if t >= ms(200):
            break
    paths = [p for p in log.paths if p.startswith("gust.")]
    assert len(paths) >= 2
    for path in [*paths, "truth.velocity", "truth.rate"]:
        np.testing.assert_array_equal(np.array(rows)[:, slot_indices(world.writes, [path], len(rows[0]))], log[path])
    assert np.std(log["gust.velocity"]) > 0.1
