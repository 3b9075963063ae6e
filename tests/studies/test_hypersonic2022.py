"""The study of the hypersonic vehicle: rows that must hold do; the others state the reason.

[1] is Aerospace 2022, 9(4), 206, its equations corrected as docs/errata-hypersonic.md says; oracle: tests/oracles.
"""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from contracts.front_page import row_counts, stated_counts
from studies.hypersonic2022._oracle import oracle_values
from trimtab.study import PUBLISHED, list_groups
from trimtab.vehicles.hypersonic_printed import A_PRINTED, B_PRINTED, K_PRINTED

NAME = "hypersonic2022"
QUICK = ("printed-matrices", "gains")
"""Groups without a flight; the others compile several."""
GROUPS = list_groups(NAME)
CASES = [pytest.param(g, id=g.name, marks=[] if g.name in QUICK else [pytest.mark.thorough]) for g in GROUPS]
PAGES = Path(__file__).parents[2] / "docs"


@cache
def rows_of(name):
    (group,) = list_groups(NAME, [name])
    return list(group.rows())


@pytest.mark.thorough
@pytest.mark.parametrize("group", CASES)
def test_rows_hold_or_give_a_reason(group):
    rows = rows_of(group.name)
    assert rows
    assert [r.id for r in rows if r.fails] == []
    assert all(r.citation.startswith("[1] ") for r in rows if r.basis in PUBLISHED)
    assert len({r.id for r in rows}) == len(rows)
    needless = [r.id for r in rows if not r.must_hold and r.holds]
    assert needless == [], "said not to be reproduced, but it is"


@pytest.mark.thorough
@pytest.mark.timeout(1800)
def test_front_page_counts_match_the_rows():
    assert stated_counts(NAME) == row_counts([row for group in GROUPS for row in rows_of(group.name)])


def test_groups_are_in_the_order_of_the_equations():
    names = [g.name for g in GROUPS]
    ordered = ["exact-linearisation", "internal-dynamics", "filter", "printed-matrices"]
    ordered += ["printed-gain", "gains", "closed-loop"]
    assert [n for n in names if n in ordered] == ordered
    assert {g.name for g in GROUPS if g.has_figures} >= {"closed-loop"}


@pytest.mark.thorough
def test_every_printed_matrix_entry_has_a_row():
    """[1] eq. 12: 34 numbers in rows 4, 5, 7 and 9; eight fixed a constant and one is 1 in any model: 25 are left."""
    rows = {r.id: r for r in rows_of("printed-matrices")}
    for letter, matrix in (("A", A_PRINTED), ("B", B_PRINTED)):
        for i, j in np.argwhere(matrix):
            if i in (3, 4, 6, 8) and (letter, i, j) != ("A", 3, 4):
                assert rows[f"{letter}/{i + 1},{j + 1}"].printed == abs(matrix[i, j])
    assert sum(r.basis == "input" and "[basis]" in r.note for r in rows.values()) == 8
    assert {i for i, r in rows.items() if r.verdict == "not reproduced" and "/sign" not in i} == {"B/9,1", "B/9,2"}
    assert sum(i.endswith("/sign") for i in rows) == 10
    assert sum(r.confirms and r.basis == "printed" for r in rows.values()) == 23


@pytest.mark.thorough
def test_reference_values_come_from_the_oracle_table():
    """A row with basis "reference" compares with a number of the oracle's table, or with no number."""
    numbers = np.concatenate([np.ravel(v) for v in oracle_values().values()])
    for name in QUICK:
        for row in rows_of(name):
            if row.basis == "reference" and row.printed:
                assert np.isclose(numbers, float(row.printed), rtol=1e-12, atol=0.0).any(), row.id


@pytest.mark.thorough
def test_every_printed_gain_entry_has_a_row():
    """[1] printed K: 18 entries, none reproduced, for its weights are not printed; lost with either sign."""
    rows = {r.id: r for r in rows_of("printed-gain")}
    for i, j in np.ndindex(2, 9):
        assert rows[f"K/{i + 1},{j + 1}"].printed == K_PRINTED[i, j]
    assert rows["flight/minus"].computed < 10
    assert rows["flight/plus"].computed < 10


@pytest.mark.thorough
def test_every_filter_setting_is_compared_with_no_measurement():
    """A vanishing error alone is no evidence: it may vanish without any measurement."""
    rows = [r for r in rows_of("filter") if r.id.startswith("table/")]
    assert len(rows) == 4 * 3 * 4
    assert all(r.id.startswith("table/none/") or r.note.startswith("Without measurement: ") for r in rows)
    claims = {r.id: r for r in rows_of("filter") if r.id.startswith("claim/")}
    assert claims["claim/none"].holds, "the claim proves nothing: no measurement meets it too"


@pytest.mark.thorough
def test_closed_loop_pictures_are_written(tmp_path):
    (group,) = list_groups(NAME, ["closed-loop"])
    files = list(group.figures(tmp_path))
    assert len(files) == 4
    assert all(f.read_bytes().startswith(b"\x89PNG") for f in files)


def test_study_page_names_every_group():
    page = (PAGES / "studies" / "hypersonic2022.md").read_text(encoding="utf-8")
    own = [g.name for g in GROUPS if g.name not in ("further-work", "elevator-trade", "plane-truth")]
    assert [n for n in own if f"`{n}`" not in page] == []
