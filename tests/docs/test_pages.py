"""The pages that CI builds without running them, docs/conf.py, run; what the tutorial shows can be typed."""

import ast
import re
from pathlib import Path

import nbclient
import nbformat
import pytest

DOCS = Path(__file__).parents[2] / "docs"
PAGES = re.findall(r'"([\w/-]+\.md)"', (DOCS / "conf.py").read_text(encoding="utf-8"))
CELL = re.compile(r"^```\{code-cell\}[^\n]*\n(?::[^\n]*\n)*(.*?)^```$", re.MULTILINE | re.DOTALL)
TAGGED_CELL = re.compile(r"^```\{code-cell\}[^\n]*\n((?::[^\n]*\n)*)\s*(.*?)^```$", re.MULTILINE | re.DOTALL)


def test_the_pages_are_there_and_have_cells():
    assert len(PAGES) == 3
    for page in PAGES:
        text = (DOCS / page).read_text(encoding="utf-8")
        assert len(CELL.findall(text)) == text.count("```{code-cell}") > 0


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("page", PAGES)
def test_a_page_that_ci_leaves_out_runs(page, monkeypatch):
    """Beside the repository's packages, as where the pages are built; docs/studies is none of them."""
    monkeypatch.setenv("PYTHONPATH", str(DOCS.parent))
    cells = [nbformat.v4.new_code_cell(text) for text in CELL.findall((DOCS / page).read_text(encoding="utf-8"))]
    notebook = nbformat.v4.new_notebook(cells=cells)
    nbclient.NotebookClient(notebook, timeout=900, resources={"metadata": {"path": str(DOCS)}}).execute()


@pytest.mark.parametrize("page", sorted((DOCS / "tutorial").glob("*.md")), ids=lambda page: page.stem)
def test_what_a_reader_types_needs_no_cell_that_is_hidden(page):
    """Names that a chapter's shown cells use are bound by shown cells; pictures are shown by `Image` for the page."""
    shown, hidden = [], []
    for tags, text in TAGGED_CELL.findall(page.read_text(encoding="utf-8")):
        if not text.startswith(("%%", "!")):
            (hidden if "remove-cell" in tags else shown).append(text)
    assert not (_loaded(shown) - _bound(shown)) & _bound(hidden) - {"Image"}


def _loaded(cells):
    nodes = ast.walk(ast.parse("\n".join(cells)))
    return {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)}


def _bound(cells):
    nodes = list(ast.walk(ast.parse("\n".join(cells))))
    stored = {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    imported = [name for node in nodes if isinstance(node, ast.Import | ast.ImportFrom) for name in node.names]
    return stored | {(name.asname or name.name).split(".")[0] for name in imported}
