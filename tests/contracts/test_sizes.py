"""Files and functions stay small enough to read, and what is public says what it is."""

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[2] / "src" / "trimtab"
FILES = sorted(SOURCE.rglob("*.py"))
FILE_LINES, FUNCTION_LINES = 400, 80


def too_long(tree):
    """Functions of FUNCTION_LINES lines or more, with their length."""
    functions = [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]
    lengths = {f.name: (f.end_lineno or 0) - f.lineno + 1 for f in functions}
    return {name: n for name, n in lengths.items() if n >= FUNCTION_LINES}


def undocumented(tree):
    """Public modules, classes, functions and methods without a docstring; empty modules need none."""
    missing = [] if ast.get_docstring(tree) or not tree.body else ["module"]

    def visit(node, where):
        for child in node.body:
            if not isinstance(child, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) or child.name.startswith(
                "_"
            ):
                continue
            if not ast.get_docstring(child):
                missing.append(f"{where}{child.name}")
            if isinstance(child, ast.ClassDef):
                visit(child, f"{where}{child.name}.")

    visit(tree, "")
    return missing


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_file_is_small_and_documented(path):
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    assert len(text.splitlines()) < FILE_LINES, "two concepts in one file? split it"
    assert not too_long(tree)
    assert not undocumented(tree)


def test_there_is_no_drawer_for_odds_and_ends():
    assert not [p for p in FILES if p.stem in ("utils", "helpers", "misc", "common")]


def test_the_checks_find_what_they_are_for():
    long = "def f():\n" + "    x = 1\n" * FUNCTION_LINES
    assert too_long(ast.parse(long)) == {"f": FUNCTION_LINES + 1}
    assert undocumented(ast.parse("class A:\n    def b(self): ...\n    def _c(self): ...\n")) == ["module", "A", "A.b"]
    assert not undocumented(ast.parse(""))
