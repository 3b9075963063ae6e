"""The tables of the page of tightly coupled ranging, printed: pytest -s -m slow, and this file."""

import jax
import numpy as np
import pytest
from estimators import range_flights as rf
from estimators.flights import weave
from estimators.test_tightly_coupled import FROM, GAP, LONG, THREE_LEFT, TIGHT, TWO_LEFT, flown, loose, rms, still

from trimtab.core.record import numeric, replace

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
ONE_LEFT = rf.spoil(LONG, 3.0, who=[False, True, True, True])


def row(label, out):
    heading, place, _ = rms(out)
    print(f"{label:32s} {np.rad2deg(heading):6.2f} deg {100 * place:6.2f} cm")
    return np.rad2deg(heading), 100 * place


@pytest.mark.parametrize(
    ("label", "how", "heading", "place"),
    [
        ("four beacons", lambda: flown(), 0.30, 0.9),
        ("best use of fixes", lambda: flown(loose(True)), 0.40, 1.1),
        ("fix and heading as they come", lambda: flown(loose(False)), 5.8, 1.3),
        ("three beacons", lambda: flown(spoilt=THREE_LEFT), 0.36, 0.9),
        ("three, best use of fixes", lambda: flown(loose(True), spoilt=THREE_LEFT), 0.96, 4.2),
        ("two beacons", lambda: flown(spoilt=TWO_LEFT), 0.46, 1.2),
        ("two, best use of fixes", lambda: flown(loose(True), spoilt=TWO_LEFT), 0.60, 3.0),
        ("one beacon", lambda: flown(spoilt=ONE_LEFT), 1.2, 5.0),
        ("a tenth wrong", lambda: flown(sensor=rf.strays()), 0.30, 0.9),
    ],
)
def test_errors_of_the_page(label, how, heading, place):
    """Each figure of the page, to what its digits say."""
    found = row(label, how())
    assert found[0] == pytest.approx(heading, abs=0.1 if heading > 1 else 0.011)
    assert found[1] == pytest.approx(place, abs=0.06 if place < 5 else 0.6)


def test_after_a_silence():
    out = flown(spoilt=GAP)
    at_its_end, later = 100 * rms(out, 97, 98)[1], 100 * rms(out, 103, 104)[1]
    print(f"silence: {at_its_end:.2f} cm at its end, {later:.2f} cm half a second later")
    assert at_its_end == pytest.approx(7.5, abs=0.1)
    assert later == pytest.approx(0.9, abs=0.1)


@pytest.mark.parametrize(("name", "path"), [("platform", rf.platform), ("weaving", weave), ("at rest", still)])
def test_nees_of_the_page(name, path):
    found = {}
    for kind in ("consider", "estimate", "ignore"):
        form = replace(TIGHT, errors=replace(TIGHT.errors, survey_errors=kind))
        calm = rf.spoil(10.0)
        out = rf.monte_carlo(form, numeric(rf.network()), calm, path=path, seconds=10.0, runs=100)
        found[kind] = float(rf.nees_of(jax.tree.map(np.asarray, out))[:, FROM:].mean())
    print(name, found)
    assert found["consider"] < found["estimate"] < found["ignore"]
