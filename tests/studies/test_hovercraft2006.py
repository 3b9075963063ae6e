"""The study of [1] Z. Kulis 2006: rows that must hold do; the others state the reason."""

from functools import cache

import pytest

from contracts.front_page import row_counts, stated_counts
from trimtab.study import list_groups

RIG = ("heading-filter", "velocity-position-filter", "gyro-square-wave")
DEAR = ("simulated-autopilot", "simulated-heading", "hardware-flights", *RIG)
"""Groups that fly many runs of several scenarios, each compiled first."""
GROUPS = list_groups("hovercraft2006")
PICTURES = {
    "gyro-compensation": {"table-6.5.png"},
    "gyro-square-wave": {"rig-square-wave.png"},
    "hardware-flights": {f"hardware-{name}.png" for name in ("reverse", "spin", "270-to-90-bang-bang")},
    "heading-filter": {"rig-magnetometer.png", "rig-ultrasound.png"},
    "inertia": {"fig-4.6.png"},
    "radio-links": {"fig-5.4.png"},
    "rudder-and-thrust": {"fig-4.2.png", "fig-4.3.png", "fig-4.5.png"},
    "simulated-autopilot": {f"fig-6.{n}.png" for n in (7, 8, 9, 10)},
    "simulated-heading": {f"fig-6.{n}-{law}.png" for n in (11, 12) for law in ("bang-bang", "proportional")},
    "ultrasonic-cone": {"fig-5.8.png", "table-5.2.png"},
    "velocity-position-filter": {"rig-encoder.png"},
}
"""Group -> the pictures that it must draw."""
CASES = [pytest.param(g, id=g.name, marks=[pytest.mark.thorough] if g.name in DEAR else []) for g in GROUPS]


@cache
def rows_of(group):
    return list(group.rows())


@pytest.mark.thorough("stabilisability", "control-laws", "radio-links", "ultrasonic-cone")
@pytest.mark.parametrize("group", CASES)
def test_rows_hold_or_give_a_reason(group):
    rows = rows_of(group)
    assert rows
    assert [r.id for r in rows if r.fails] == []
    assert all(r.citation.startswith("[1] ") for r in rows)
    assert len({r.id for r in rows}) == len(rows)
    needless = [r.id for r in rows if not r.must_hold and r.holds]
    assert needless == [], "said not to be reproduced, but it is"


@pytest.mark.thorough
def test_every_printed_latency_has_a_row():
    """Table 5.1: five pairs, three paths; mean and deviation of each, and the greatest of the single paths."""
    (group,) = list_groups("hovercraft2006", ["radio-links"])
    rows = {r.id: r for r in rows_of(group)}
    table = [i for i in rows if i.startswith("table-5.1/")]
    assert len(table) == 5 * (3 + 3 + 2)
    assert rows["table-5.1/free2move/linksys 2.9/41.0 up/mean"].printed == 51.04
    assert rows["table-5.1/free2move/free2move 2.9/22.0 round trip/sd"].printed == 16.58


@pytest.mark.thorough
@pytest.mark.timeout(1800)
def test_front_page_counts_match_the_rows():
    rows = [row for group in GROUPS for row in rows_of(group)]
    assert stated_counts("hovercraft2006") == row_counts(rows)


QUICK = [pytest.param(g, id=g.name) for g in GROUPS if g.has_figures and g.name not in DEAR]
LONG = [pytest.param(g, id=g.name, marks=pytest.mark.thorough) for g in GROUPS if g.has_figures and g.name in DEAR]


@pytest.mark.thorough
@pytest.mark.parametrize("group", [*QUICK, *LONG])
def test_pictures_are_named_after_the_published_figures(group, tmp_path):
    files = list(group.figures(tmp_path))
    assert files
    assert all(f.read_bytes().startswith(b"\x89PNG") for f in files)
    assert {f.name for f in files} >= PICTURES[group.name]
