"""Page of `trimtab reproduce --report`: a study's rows, pictures, errata and environment in one file.

The file is self-contained: pictures are embedded as data, and there are no scripts, fonts or links to local pages.
"""

import base64
import os
import platform
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import Any

from markdown_it import MarkdownIt

from trimtab.study import BASES, PUBLISHED, Row, StudyGroup, format_value

PACKAGES = "trimtab", "jax", "jaxlib", "numpy", "scipy", "matplotlib"
KINDS = {".png": "image/png", ".svg": "image/svg+xml", ".jpg": "image/jpeg"}
HEADINGS = "figure", "printed", "computed", "accepted", "unit", "basis", "verdict", "where", "note"
NUMERIC = "printed", "computed", "accepted"
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #1b1b1b; max-width: 76rem; margin: 2rem auto; padding: 0 1rem }
h1 { font-size: 1.5rem } h2 { font-size: 1.2rem; margin-top: 2.2rem } h3 { font-size: 1rem }
table { border-collapse: collapse; width: 100%; font-size: 13px; margin: .6rem 0 }
th, td { text-align: left; vertical-align: top; padding: .2rem .5rem; border-bottom: 1px solid #ddd }
th { border-bottom: 2px solid #888; background: #fff; position: sticky; top: 0 }
td.number { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums }
tr.differs td { background: #f8d7d0 } tr.not-reproduced td { background: #fff4d6 }
figure { margin: 1rem 0 } img { max-width: 100% } figcaption, .small { color: #555; font-size: 13px }
nav li { display: inline-block; margin-right: 1rem } nav ul { padding: 0 }
code { font-size: 12.5px } @media print { th { position: static } body { max-width: none } }
"""


def build_page(
    title: str,
    results: Iterable[tuple[StudyGroup, list[Row]]],
    summary: Mapping[str, Any],
    pictures: Mapping[str, list[Path]],
    errata: str,
    environment: Mapping[str, str],
) -> str:
    """Return the whole HTML page as text.

    Args:
        title: title of the study.
        results: groups of figures, each with its rows of compared values.
        summary: "sentence", "verdicts" and "bases", as in the JSON output of `trimtab reproduce`.
        pictures: name of a group -> picture files of the group.
        errata: errata in Markdown; empty if there are none.
        environment: name of a fact about the run, e.g. the version or the machine -> the fact.
    """
    groups = list(results)
    links = "".join(f'<li><a href="#{escape(g.name)}">{escape(g.name)}</a></li>' for g, _ in groups)
    links += '<li><a href="#errata">errata</a></li>' if errata else ""
    body = [
        f"<h1>{escape(title)}</h1>",
        f"<p><strong>{escape(summary['sentence'])}</strong></p>",
        f"<nav><ul>{links}<li><a href='#environment'>environment</a></li></ul></nav>",
        _bases_table(summary),
        *(part for group, rows in groups for part in _group_parts(group, rows, pictures.get(group.name, []))),
        f'<section id="errata">{_errata_html(errata)}</section>' if errata else "",
        '<h2 id="environment">Environment</h2>',
        _table(("item", "value"), ((escape(k), escape(v)) for k, v in environment.items())),
    ]
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{escape(title)}</title>'
    text = "\n".join(part for part in body if part)
    return (
        f'<!doctype html>\n<html lang="en"><head>{head}<style>{STYLE}</style></head>\n<body>\n{text}\n</body></html>\n'
    )


def describe_environment(arguments: Iterable[str], begin: str, seconds: float) -> dict[str, str]:
    """Return versions, machine, command and time of this run, without host name, user name and paths."""
    system = f"{platform.system()} {platform.release()}, {platform.machine()}, {os.cpu_count()} processors"
    return {
        "command": shlex.join(("trimtab", *arguments)),
        "begun": begin,
        "took": f"{seconds:.0f} s",
        "system": system,
        "Python": platform.python_version(),
        **{name: version(name) for name in PACKAGES},
    }


def read_errata(study: Path) -> str:
    """Return the errata of a study in Markdown: `errata*.md` in its folder, and in `docs` if they link to the study."""
    own = sorted(study.glob("errata*.md"))
    pages = sorted((study.parents[1] / "docs").glob("errata*.md"))
    named = [p for p in pages if f"[study](studies/{study.name}.md)" in p.read_text(encoding="utf-8")]
    return "\n\n".join(page.read_text(encoding="utf-8") for page in (*own, *named))


def _bases_table(summary: Mapping[str, Any]) -> str:
    lines = []
    for basis, counts in summary["bases"].items():
        whose = "the publication's" if basis in PUBLISHED else "not the publication's"
        cells = escape(basis), escape(BASES[basis]), whose, str(counts["holds"]), str(counts["rows"])
        lines.append(cells)
    verdicts = ", ".join(f"{n} {verdict}" for verdict, n in summary["verdicts"].items())
    table = _table(("basis", "source of the compared value", "", "hold", "rows"), lines, (3, 4))
    return f"<p>{escape(verdicts)}.</p>\n{table}"


def _group_parts(group: StudyGroup, rows: list[Row], pictures: list[Path]) -> Iterator[str]:
    yield f'<h2 id="{escape(group.name)}">{escape(group.title)}</h2>'
    yield f'<p class="small">{escape(group.place)}; group <code>{escape(group.name)}</code>, {len(rows)} rows</p>'
    numeric = tuple(HEADINGS.index(name) for name in NUMERIC)
    kinds = [row.verdict.replace(" ", "-") for row in rows]
    yield _table(HEADINGS, map(_row_cells, rows), numeric, kinds)
    for picture in pictures:
        yield _figure(picture)


def _row_cells(row: Row) -> tuple[str, ...]:
    unit = "" if row.unit == "1" else row.unit
    values = row.what, format_value(row.printed), format_value(row.computed), row.tolerance, unit, row.basis
    return tuple(escape(str(value)) for value in (*values, row.verdict, row.citation, row.note))


def _table(
    headings: Iterable[str], lines: Iterable[Iterable[str]], numeric: tuple[int, ...] = (), kinds: Iterable[str] = ()
) -> str:
    """Return an HTML table of the cells. kinds: CSS class of each row."""
    classes = iter(kinds)
    head = "".join(f"<th>{escape(h)}</th>" for h in headings)
    body = []
    for line in lines:
        cells = "".join(f'<td class="number">{c}</td>' if i in numeric else f"<td>{c}</td>" for i, c in enumerate(line))
        kind = next(classes, "")
        body.append(f'<tr class="{kind}">{cells}</tr>' if kind else f"<tr>{cells}</tr>")
    return f"<table><thead><tr>{head}</tr></thead><tbody>\n" + "\n".join(body) + "\n</tbody></table>"


def _figure(picture: Path) -> str:
    kind = KINDS.get(picture.suffix.lower())
    name = escape(picture.stem.replace("-", " "))
    if kind is None:
        return f'<p class="small">The picture {escape(picture.name)} has a format that a web page cannot show.</p>'
    data = base64.b64encode(picture.read_bytes()).decode()
    return f'<figure><img alt="{name}" src="data:{kind};base64,{data}"><figcaption>{name}</figcaption></figure>'


def _errata_html(markdown: str) -> str:
    """Convert Markdown to HTML. Raw HTML is escaped, and links to other documentation pages are removed."""
    text = MarkdownIt("commonmark", {"html": False}).enable("table").render(markdown)
    text = re.sub(r'<a href="(?!https?:)[^"]*">(.*?)</a>', r"\1", text, flags=re.DOTALL)
    return re.sub(r"<(/?)h(\d)>", lambda m: f"<{m[1]}h{min(int(m[2]) + 1, 6)}>", text)
