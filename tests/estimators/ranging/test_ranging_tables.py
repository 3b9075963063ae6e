"""The tables of the page of tightly coupled ranging, printed: pytest -s -m thorough, and this file."""

import jax
import numpy as np
import pytest
from estimators import range_flights as rf
from estimators.flights import weave
from estimators.ranging.test_tightly_coupled import (
    FROM,
    GAP,
    LONG,
    THREE_LEFT,
    TIGHT,
    TWO_LEFT,
    flown,
    loose,
    rms,
    still,
)

from trimtab.core.record import replace, to_arrays

pytestmark = [pytest.mark.thorough, pytest.mark.timeout(900)]
ONE_LEFT = rf.spoil(LONG, 3.0, who=[False, True, True, True])


def row(label, out):
    heading, place, _ = rms(out)
    print(f"{label:32s} {np.rad2deg(heading):6.2f} deg {100 * place:6.2f} cm")
    return np.rad2deg(heading), 100 * place


@pytest.mark.parametrize(
    ("label", "how", "heading", "place"),
    [
        ("four beacons", lambda: flown(), 0.27, 0.85),
        ("best use of fixes", lambda: flown(loose(True)), 0.35, 1.06),
        ("fix and heading as they come", lambda: flown(loose(False)), 5.78, 1.18),
        ("three beacons", lambda: flown(spoilt=THREE_LEFT), 0.32, 0.85),
        ("three, best use of fixes", lambda: flown(loose(True), spoilt=THREE_LEFT), 0.92, 4.15),
        ("two beacons", lambda: flown(spoilt=TWO_LEFT), 0.40, 1.13),
        ("two, best use of fixes", lambda: flown(loose(True), spoilt=TWO_LEFT), 0.55, 2.94),
        ("one beacon", lambda: flown(spoilt=ONE_LEFT), 1.49, 6.39),
        ("a tenth wrong", lambda: flown(sensor=rf.strays()), 0.28, 0.87),
    ],
)
def test_errors_match_the_documented_table(label, how, heading, place):
    """Each figure of the page, to what its digits say."""
    found = row(label, how())
    assert found[0] == pytest.approx(heading, abs=0.006)
    assert found[1] == pytest.approx(place, abs=0.006)


def test_outage_errors_match_the_documented_values():
    out = flown(spoilt=GAP)
    at_its_end, later = 100 * rms(out, 97, 98)[1], 100 * rms(out, 103, 104)[1]
    print(f"silence: {at_its_end:.2f} cm at its end, {later:.2f} cm half a second later")
    assert at_its_end == pytest.approx(7.11, abs=0.006)
    assert later == pytest.approx(0.85, abs=0.006)


@pytest.mark.parametrize(("name", "path"), [("platform", rf.platform), ("weaving", weave), ("at rest", still)])
def test_nees_matches_the_documented_values(name, path):
    found = {}
    for kind in ("consider", "estimate", "ignore"):
        form = replace(TIGHT, errors=replace(TIGHT.errors, survey_errors=kind))
        calm = rf.spoil(10.0)
        out = rf.monte_carlo(form, to_arrays(rf.network()), calm, path=path, seconds=10.0, runs=100)
        found[kind] = float(rf.nees_of(jax.tree.map(np.asarray, out))[:, FROM:].mean())
    print(name, found)
    assert 8.35 < found["consider"] < 8.65  # of 8, as the page says
    assert found["consider"] < found["estimate"] < found["ignore"]
