"""The study of [1] Z. Kulis 2006: rows that must hold do, the others say why they don't."""

from functools import cache

import pytest

from trimtab.study import list_groups

RIG = (
    "heading-filter",
    "mended-covariances",
    "velocity-position-filter",
    "gyro-square-wave",
    "navigation-summary",
)
DEAR = ("simulated-autopilot", "simulated-heading", *RIG)
"""Groups that fly many runs of several scenarios, each compiled first."""
GROUPS = list_groups("hovercraft2006")
CASES = [pytest.param(g, id=g.name, marks=[pytest.mark.slow] if g.name in DEAR else []) for g in GROUPS]


@cache
def rows_of(group):
    return list(group.rows())


@pytest.mark.parametrize("group", CASES)
def test_rows_hold_or_say_why_not(group):
    rows = rows_of(group)
    assert rows
    assert [r.id for r in rows if r.fails] == []
    assert all(r.citation.startswith("[1] ") for r in rows)
    assert len({r.id for r in rows}) == len(rows)
    needless = [r.id for r in rows if not r.must_hold and r.holds]
    assert needless == [], "said not to be reproduced, but it is"


def test_check_24_every_printed_latency_has_its_row():
    """Table 5.1: five pairs, three paths; mean and deviation of each, and both extremes of the single paths."""
    (group,) = list_groups("hovercraft2006", ["radio-links"])
    rows = {r.id: r for r in rows_of(group)}
    found = [i for i in rows if i.startswith("table-5.1/")]
    assert len(found) == 5 * (4 + 4 + 3)
    assert rows["table-5.1/free2move/linksys 2.9/41.0 up/mean"].printed == 51.04
    assert rows["table-5.1/free2move/free2move 2.9/22.0 round trip/sd"].printed == 16.58


@pytest.mark.slow
def test_pictures_of_the_simulated_autopilot(tmp_path):
    files = [f for g in GROUPS for f in g.figures(tmp_path)]
    names = {f.name for f in files}
    assert names >= {f"fig-6.{n}.png" for n in (7, 8, 9, 10)}
    assert names >= {f"fig-6.{n}-{law}.png" for n in (11, 12) for law in ("bang-bang", "proportional")}
    assert all(f.read_bytes().startswith(b"\x89PNG") for f in files)
