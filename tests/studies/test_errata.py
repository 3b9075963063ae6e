"""The errata pages: entries are whole, their kinds are explained, their modules exist, and nothing known is left out.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
[2] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206.
"""

import re
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import pytest

PAGES = Path(__file__).parents[2] / "docs"
HOVERCRAFT, HYPERSONIC = PAGES / "errata.md", PAGES / "errata-hypersonic.md"
HYPERSONIC_ERRORS = (
    "list of coefficients",
    "V' in affine form",
    "eq. 4, x' = f + g u",
    "b51, b52",
    "k1 and k2; f7, f9",
    "f9, constant term",
    "Lf² h",
    "G_ξ; g(x)",
    "eq. 9",
    "eq. 9, innovation",
    "gain and Riccati equation",
    "R_η(0) = diag(10, 10)",
    "equation that is linearised",
    "internal dynamics, linear",
    "after eq. 13, M_F",
    "assumption 2",
    "eq. 16, u_h",
    "eq. 15",
    "eq. 18",
    "derivative of e_η' P_η⁻¹ e_η",
    "ideal internal dynamics, method",
    "B, row of η2''",
)
"""Errors of [2] -> words of the place of their entry."""
HYPERSONIC_GAPS = ("R_e", "Q_e", "q0", "q1", "κ_G", "noise", "P(0)", "commands", "filters")


class Erratum(NamedTuple):
    where: str
    kind: str
    printed: str
    here: str
    why: str
    code: str


def read_errata(page):
    """The lines of all tables of a page."""
    rows = [line for line in page.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    cells = [re.split(r"(?<!\\)\|", row)[1:-1] for row in rows if not row.startswith(("| where |", "| --- |"))]
    return [Erratum(*(cell.strip() for cell in row)) for row in cells]


@pytest.mark.parametrize("page", [HOVERCRAFT, HYPERSONIC], ids=lambda p: p.stem)
def test_entries_are_complete_and_their_modules_exist(page):
    kinds = re.findall(r"^- \*\*(\w+)\*\*: ", page.read_text(encoding="utf-8"), re.M)
    entries = read_errata(page)
    assert len(entries) >= 46
    for entry in entries:
        assert all(entry), entry
        assert entry.kind in kinds, entry
        for module in re.findall(r"`([^`]+)`", entry.code):
            name = module if module.startswith("studies.") else f"trimtab.{module}"
            assert find_spec(name) is not None, module


@pytest.mark.parametrize("words", HYPERSONIC_ERRORS)
def test_known_errors_of_the_hypersonic_source_have_an_entry(words):
    assert [e for e in read_errata(HYPERSONIC) if words in e.where]


def test_unprinted_values_of_hypersonic_source_are_listed_as_gaps():
    gaps = " ".join(e.where for e in read_errata(HYPERSONIC) if e.kind == "gap")
    assert [name for name in HYPERSONIC_GAPS if name not in gaps] == []
