"""All pages build with their cells; the shown cells of the tutorial run without the hidden ones."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
CELL = re.compile(r"^```\{code-cell\}[^\n]*\n(?::[^\n]*\n)*(.*?)^```$", re.MULTILINE | re.DOTALL)
TAGGED_CELL = re.compile(r"^```\{code-cell\}[^\n]*\n((?::[^\n]*\n)*)\s*(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.mark.thorough
@pytest.mark.timeout(3600)
def test_all_pages_build_with_their_cells(tmp_path):
    command = [sys.executable, "-m", "sphinx", "-j", "auto", "-W", "-b", "html", str(DOCS), str(tmp_path / "html")]
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "TRIMTAB_PAGES": ""}, check=False)
    assert done.returncode == 0, done.stderr[-6000:]


@pytest.mark.parametrize("page", sorted((DOCS / "tutorial").glob("*.md")), ids=lambda page: page.stem)
def test_shown_cells_do_not_depend_on_hidden_cells(page):
    """Names that a chapter's shown cells use are bound by shown cells; pictures are shown by `Image` for the page."""
    shown, hidden = [], []
    for tags, text in TAGGED_CELL.findall(page.read_text(encoding="utf-8")):
        if not text.startswith(("%%", "!")):
            (hidden if "remove-cell" in tags else shown).append(text)
    assert not (_loaded(shown) - _bound(shown)) & _bound(hidden) - {"Image"}


def test_every_table_begins_with_a_header():
    """A blank line within a table would print the rows after it as plain text."""
    cut = []
    for page in [*DOCS.rglob("*.md"), DOCS.parent / "README.md"]:
        lines = ["", *page.read_text(encoding="utf-8").splitlines(), ""]
        first = [k for k, line in enumerate(lines) if line.startswith("| ") and not lines[k - 1].startswith("|")]
        cut += [f"{page.name}:{k}" for k in first if not re.fullmatch(r"\|[-| :]+\|", lines[k + 1])]
    assert cut == []


def _loaded(cells):
    nodes = ast.walk(ast.parse("\n".join(cells)))
    return {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)}


def _bound(cells):
    nodes = list(ast.walk(ast.parse("\n".join(cells))))
    stored = {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    imported = [name for node in nodes if isinstance(node, ast.Import | ast.ImportFrom) for name in node.names]
    return stored | {(name.asname or name.name).split(".")[0] for name in imported}
