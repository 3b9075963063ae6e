"""Rows of a study as a table in Markdown, for pages that are executed."""

from collections.abc import Iterable

from studies.row import Row, format_value

HEADINGS = ("figure", "printed", "computed", "accepted", "unit", "verdict", "where", "")


def rows_table(rows: Iterable[Row]) -> str:
    """One line a row; a star marks what is no number or statement of the publication itself (see Row.basis)."""
    lines = [_table_line(HEADINGS), _table_line("---" for _ in HEADINGS)]
    for row in rows:
        printed = format_value(row.printed) + ("" if row.basis in ("printed", "text") else " \\*")
        unit = "" if row.unit == "1" else row.unit
        verdict = "holds" if row.holds else f"**{row.verdict}**"
        cells = (row.what, printed, format_value(row.computed), row.tolerance, unit, verdict, row.citation, row.note)
        lines.append(_table_line(cell.replace("|", "\\|") for cell in cells))
    return "\n".join(lines)


def _table_line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"
