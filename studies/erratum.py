"""An erratum: what is wrong, missing or ambiguous in a publication, and what stands in its place here."""

from collections.abc import Iterable
from typing import Literal, NamedTuple

Kind = Literal["misprint", "gap", "reconstructed", "correction", "remark"]
KINDS: dict[Kind, str] = {
    "misprint": "printed otherwise, and the rest of the source contradicts it",
    "gap": "not printed, or lost; derived here",
    "reconstructed": "a choice that the source does not fix; the evidence is stated, and another may be as good",
    "correction": "a statement or a condition that does not hold as it stands; what holds is proved or measured here",
    "remark": "right as printed, but easily read or used wrongly",
}


class Erratum(NamedTuple):
    """One entry.

    section: heading under which it stands.  place: in [1].  kind: one of KINDS.  printed, here: what stands there, and
    what this package has.  why: the evidence.  code: modules where it matters, below `trimtab`.
    """

    section: str
    place: str
    kind: Kind
    printed_text: str
    replacement: str
    why: str
    code: tuple[str, ...] = ()


def errata_by_section(errata: Iterable[Erratum]) -> dict[str, list[Erratum]]:
    """Heading -> its entries, in the order given."""
    found: dict[str, list[Erratum]] = {}
    for entry in errata:
        found.setdefault(entry.section, []).append(entry)
    return found


def errata_table(errata: Iterable[Erratum]) -> str:
    """Entries as a table in Markdown."""
    lines = ["| where | kind | printed | here | why | code |", "|---|---|---|---|---|---|"]
    for e in errata:
        code = ", ".join(f"`{module}`" for module in e.code) or "–"
        cells = (e.place, e.kind, e.printed_text, e.replacement, e.why, code)
        lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
    return "\n".join(lines)
