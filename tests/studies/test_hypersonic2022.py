"""The study of the hypersonic vehicle: rows that must hold do, the others say why not.

[H] is the specification of the system; its sections and acceptance checks are cited by number.
"""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from trimtab.study import list_groups
from trimtab.vehicles.hypersonic_printed import A_PRINTED, B_PRINTED, K_PRINTED

NAME = "hypersonic2022"
QUICK = ("printed-matrices", "gains")
"""Groups without a flight; the others compile several."""
GROUPS = list_groups(NAME)
CASES = [pytest.param(g, id=g.name, marks=[] if g.name in QUICK else [pytest.mark.slow]) for g in GROUPS]
PAGES = Path(__file__).parents[2] / "docs"


@cache
def rows_of(name):
    (group,) = list_groups(NAME, [name])
    return list(group.rows())


@pytest.mark.parametrize("group", CASES)
def test_rows_hold_or_say_why_not(group):
    rows = rows_of(group.name)
    assert rows
    assert [r.id for r in rows if r.fails] == []
    assert all(r.citation.startswith("[1] ") for r in rows)
    assert len({r.id for r in rows}) == len(rows)
    needless = [r.id for r in rows if not r.must_hold and r.holds]
    assert needless == [], "said not to be reproduced, but it is"


def test_groups_are_in_the_order_of_the_equations():
    names = [g.name for g in GROUPS]
    ordered = ["exact-linearisation", "internal-dynamics", "filter", "printed-matrices"]
    ordered += ["printed-gain", "gains", "closed-loop"]
    assert [n for n in names if n in ordered] == ordered
    assert {g.name for g in GROUPS if g.has_figures} >= {"closed-loop"}


def test_check_03_every_printed_number_of_the_matrices_has_its_row():
    """[H] 4.1, 4.3, check 3: 34 numbers in rows 4, 5, 7 and 9; eight of them fixed a constant, and say so."""
    rows = {r.id: r for r in rows_of("printed-matrices")}
    for letter, matrix in (("A", A_PRINTED), ("B", B_PRINTED)):
        for i, j in np.argwhere(matrix):
            if i in (3, 4, 6, 8):
                assert rows[f"{letter}/{i + 1},{j + 1}"].printed == abs(matrix[i, j])
    assert sum("[basis]" in r.note for r in rows.values()) == 8
    assert {i for i, r in rows.items() if r.verdict == "not reproduced" and "/sign" not in i} == {"B/9,1", "B/9,2"}
    assert sum(i.endswith("/sign") for i in rows) == 10


@pytest.mark.slow
def test_check_12_every_printed_entry_of_the_gain_has_its_row():
    """[H] 4.1, 4.2: 18 entries, none reproduced, for its weights are not printed; lost with either sign."""
    rows = {r.id: r for r in rows_of("printed-gain")}
    for i, j in np.ndindex(2, 9):
        assert rows[f"K/{i + 1},{j + 1}"].printed == K_PRINTED[i, j]
    assert rows["flight/minus"].computed < 10
    assert rows["flight/plus"].computed < 10


@pytest.mark.slow
def test_every_setting_of_the_filter_stands_beside_no_measurement():
    """[H] 5.4: mandatory."""
    rows = [r for r in rows_of("filter") if r.id.startswith("table/")]
    assert len(rows) == 4 * 3 * 4
    assert all(r.id.startswith("table/none/") or r.note.startswith("Without measurement: ") for r in rows)
    claims = {r.id: r for r in rows_of("filter") if r.id.startswith("claim/")}
    assert claims["claim/none"].holds, "the claim proves nothing: no measurement meets it too"


@pytest.mark.slow
def test_pictures_of_the_closed_loop(tmp_path):
    (group,) = list_groups(NAME, ["closed-loop"])
    files = list(group.figures(tmp_path))
    assert len(files) == 4
    assert all(f.read_bytes().startswith(b"\x89PNG") for f in files)


def test_the_page_of_the_study_names_every_group_of_the_source():
    page = (PAGES / "studies" / "hypersonic2022.md").read_text(encoding="utf-8")
    own = [g.name for g in GROUPS if g.name not in ("further-work", "elevator-trade")]
    assert [n for n in own if f"`{n}`" not in page] == []
