"""A table as HTML, for display in a notebook."""

from collections.abc import Iterable, Sequence
from html import escape


def html_table(title: str, header: Sequence[str], rows: Iterable[Sequence[str]], note: str = "") -> str:
    """Return a table as HTML, with title and note. All texts are escaped. header: titles of the columns, or empty."""
    head = "".join(f"<th style='text-align:left'>{escape(h)}</th>" for h in header)
    body = "".join(
        "<tr>" + "".join(f"<td style='text-align:left'>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    above = f"<b>{escape(title)}</b>" if title else ""
    below = f"<small>{escape(note)}</small>" if note else ""
    return f"<div>{above}<table>{f'<tr>{head}</tr>' if header else ''}{body}</table>{below}</div>"
