"""The pages that CI builds without running them, docs/conf.py: every cell of them runs."""

import re
from pathlib import Path

import nbclient
import nbformat
import pytest

DOCS = Path(__file__).parents[2] / "docs"
PAGES = re.findall(r'"([\w/-]+\.md)"', (DOCS / "conf.py").read_text(encoding="utf-8"))
CELL = re.compile(r"^```\{code-cell\}[^\n]*\n(?::[^\n]*\n)*(.*?)^```$", re.MULTILINE | re.DOTALL)


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
