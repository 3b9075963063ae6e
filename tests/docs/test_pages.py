"""Pages build with their cells, shown cells run without hidden ones, and safety promises name their tests."""

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
TESTS_SECTION = re.compile(r"^## Tests\n(.*?)(?=^## |\Z)", re.MULTILINE | re.DOTALL)
NAMED_TEST = re.compile(r"\btests/[\w./-]+\.py(?:::(\w+))?")
SAFETY_PAGES = [
    "actuators/failsafe",
    "actuators/servo-pulses",
    "commands/grammar",
    "console/console",
    "console/protocol",
    "export/boards",
    "export/stm32f405",
    "how-to/first-flight",
    "how-to/fly-in-the-page",
    "how-to/ground-station",
    "laws/formation",
    "laws/ground-avoidance",
    "links/transports",
    "live/ardupilot",
    "live/arming",
    "live/fly",
    "live/ground-stations",
    "live/link-test",
    "live/px4",
    "live/real-time",
    "live/trust",
    "live/vehicle",
    "logs/log",
    "logs/stream",
    "loop/faults",
    "loop/monitor",
    "loop/supervisor",
    "wire/keys",
    "wire/mavlink",
    "wire/station",
]
"""Pages that state a safety promise, and therefore state what the promise was tested against."""


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


@pytest.mark.parametrize("page", SAFETY_PAGES)
def test_safety_pages_state_what_was_tested(page):
    """The section Tests says what was tested and what was not. Each test that the section names exists."""
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    (section,) = TESTS_SECTION.findall(text)
    bullets = [line for line in section.splitlines() if line.startswith("- ")]
    assert any(bullet.startswith("- Tested:") for bullet in bullets)
    assert any(bullet.startswith("- Not tested:") for bullet in bullets)
    assert _missing_tests(section) == []


def test_safety_pages_are_those_with_a_list_of_tests():
    pages = [page.relative_to(DOCS).with_suffix("").as_posix() for page in DOCS.rglob("*.md")]
    stated = [p for p in pages if "\n- Not tested:" in (DOCS / f"{p}.md").read_text(encoding="utf-8")]
    assert sorted(stated) == sorted(SAFETY_PAGES)


def test_missing_tests_are_found():
    here = "tests/docs/test_pages.py"
    assert _missing_tests(f"`{here}`, `{here}::test_missing_tests_are_found`, `{here}::CELL`, `tests/none.py`") == [
        f"{here}::CELL",
        "tests/none.py",
    ]


def _missing_tests(text):
    """Return the tests that a text names and that do not exist: files, or functions of a file after `::`."""
    return [named[0] for named in NAMED_TEST.finditer(text) if not _exists(named[0].partition("::")[0], named[1])]


def _exists(file, function):
    path = DOCS.parent / file
    if function is None or not path.is_file():
        return path.is_file()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return any(isinstance(node, ast.FunctionDef) and node.name == function for node in ast.walk(tree))


def _loaded(cells):
    nodes = ast.walk(ast.parse("\n".join(cells)))
    return {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)}


def _bound(cells):
    nodes = list(ast.walk(ast.parse("\n".join(cells))))
    stored = {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    imported = [name for node in nodes if isinstance(node, ast.Import | ast.ImportFrom) for name in node.names]
    return stored | {(name.asname or name.name).split(".")[0] for name in imported}
