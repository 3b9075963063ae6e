"""The study of the hypersonic vehicle: rows that must hold do, the others say why not; errata cover what is known.

[H] is the specification of the system; its sections and acceptance checks are cited by number.
"""

from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from studies import catalogue
from studies.erratum import KINDS, errata_by_section
from studies.hypersonic2022.errata import ERRATA
from trimtab.vehicles.hypersonic_printed import A_PRINTED, B_PRINTED, K_PRINTED

NAME = "hypersonic2022"
QUICK = ("printed-matrices", "gains")
"""Groups without a flight; the others compile several."""
GROUPS = catalogue.list_groups(NAME)
CASES = [pytest.param(g, id=g.name, marks=[] if g.name in QUICK else [pytest.mark.slow]) for g in GROUPS]
PAGES = Path(__file__).parents[2] / "docs"
FOUND = {
    1: "list of coefficients",
    2: "V' in affine form",
    3: "eq. 4, x' = f + g u",
    4: "b51, b52",
    5: "k1 and k2; f7, f9",
    6: "f9, constant term",
    7: "Lf² h",
    8: "G_ξ; g(x)",
    9: "eq. 9",
    10: "eq. 9, innovation",
    11: "gain and Riccati equation",
    12: "R_η(0) = diag(10, 10)",
    13: "equation that is linearised",
    14: "internal dynamics, linear",
    15: "after eq. 13, M_F",
    16: "assumption 2",
    17: "eq. 16, u_h",
    18: "eq. 15",
    19: "eq. 18",
    20: "derivative of e_η' P_η⁻¹ e_η",
    21: "ideal internal dynamics, method",
    22: "B, row of η2''",
}
"""Item of [H] 4.4 -> words of the place of its entry."""
MISSING = ("R_e", "Q_e", "q0", "q1", "κ_G", "noise", "P(0)", "commands", "filters")


@cache
def rows_of(name):
    (group,) = catalogue.list_groups(NAME, [name])
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
    assert {g.name for g in GROUPS if g.draws} >= {"closed-loop"}


def test_check_03_every_printed_number_of_the_matrices_has_its_row():
    """[H] 4.1, 4.3, check 3: 34 numbers in rows 4, 5, 7 and 9; eight of them fixed a constant, and say so."""
    rows = {r.id: r for r in rows_of("printed-matrices")}
    for letter, matrix in (("A", A_PRINTED), ("B", B_PRINTED)):
        for i, j in np.argwhere(matrix):
            if i in (3, 4, 6, 8):
                assert rows[f"{letter}/{i + 1},{j + 1}"].printed_text == abs(matrix[i, j])
    assert sum("[basis]" in r.note for r in rows.values()) == 8
    assert {i for i, r in rows.items() if r.verdict == "not reproduced" and "/sign" not in i} == {"B/9,1", "B/9,2"}
    assert sum(i.endswith("/sign") for i in rows) == 10


@pytest.mark.slow
def test_check_12_every_printed_entry_of_the_gain_has_its_row():
    """[H] 4.1, 4.2: 18 entries, none reproduced, for its weights are not printed; lost with either sign."""
    rows = {r.id: r for r in rows_of("printed-gain")}
    for i, j in np.ndindex(2, 9):
        assert rows[f"K/{i + 1},{j + 1}"].printed_text == K_PRINTED[i, j]
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
    (group,) = catalogue.list_groups(NAME, ["closed-loop"])
    files = list(group.figures(tmp_path))
    assert len(files) == 4
    assert all(f.read_bytes().startswith(b"\x89PNG") for f in files)


@pytest.mark.parametrize("entry", ERRATA, ids=lambda e: e.place)
def test_erratum_is_whole_and_its_modules_exist(entry):
    assert all((entry.section, entry.place, entry.printed_text, entry.replacement, entry.why))
    assert entry.kind in KINDS
    for module in entry.code:
        assert find_spec(f"trimtab.{module}") is not None, module


@pytest.mark.parametrize("item", FOUND)
def test_errata_cover_the_list(item):
    """[H] 4.4, by number."""
    assert [e for e in ERRATA if FOUND[item] in e.place]


def test_errata_name_what_is_not_printed():
    """[H] 4.1, last sentence."""
    gaps = " ".join(e.place for e in ERRATA if e.kind == "gap")
    assert [m for m in MISSING if m not in gaps] == []


def test_the_page_shows_every_section_of_the_errata():
    page = (PAGES / "errata-hypersonic.md").read_text(encoding="utf-8")
    for section in errata_by_section(ERRATA):
        assert f"\n## {section}\n" in page
        assert f'Markdown(table(found["{section}"]))' in page


def test_the_page_of_the_study_names_every_group_of_the_source():
    page = (PAGES / "studies" / "hypersonic2022.md").read_text(encoding="utf-8")
    own = [g.name for g in GROUPS if g.name not in ("further-work", "elevator-trade")]
    assert [n for n in own if f"`{n}`" not in page] == []
