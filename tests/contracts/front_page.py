"""The front page's table of the studies: what it says of one, and what its rows say."""

from pathlib import Path

from trimtab.commands.reproduce import basis_counts

README = Path(__file__).parents[2] / "README.md"
COLUMNS = ("printed", "text", "axis", "reference", "own", "input")


def stated_counts(study):
    """Cells of a study's line."""
    line = next(li for li in README.read_text(encoding="utf-8").splitlines() if li.startswith(f"| `{study}`"))
    return [cell.strip() for cell in line.strip("|").split("|")[1:]]


def row_counts(rows):
    """The same of its rows; nothing where a basis has none."""
    counts = basis_counts(rows)
    cells = [f"{counts[basis][0]} of {counts[basis][1]}" if basis in counts else "" for basis in COLUMNS]
    return [*cells, f"{sum(row.confirms for row in rows)} of {len(rows)}"]
