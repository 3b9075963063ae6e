"""Limits of file and function length; public definitions have docstrings."""

import ast
from pathlib import PurePath

from contracts.sources import read_sources, read_statements

FILE_LINES, FUNCTION_LINES = 400, 80


def long_functions(tree):
    """Functions of FUNCTION_LINES lines or more, with their length."""
    functions = [n for n in read_statements(tree) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]
    lengths = {f.name: (f.end_lineno or 0) - f.lineno + 1 for f in functions}
    return {name: n for name, n in lengths.items() if n >= FUNCTION_LINES}


def undocumented(tree):
    """Public modules, classes, functions and methods without a docstring; empty modules need none."""
    names = [] if ast.get_docstring(tree) or not tree.body else ["module"]

    def visit(node, where):
        for child in node.body:
            if not isinstance(child, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                continue
            if child.name.startswith("_"):
                continue
            if not ast.get_docstring(child):
                names.append(f"{where}{child.name}")
            if isinstance(child, ast.ClassDef):
                visit(child, f"{where}{child.name}.")

    visit(tree, "")
    return names


def test_no_file_exceeds_the_line_limit():
    assert {name: n for name, (text, _) in read_sources().items() if (n := len(text.splitlines())) > FILE_LINES} == {}


def test_no_function_exceeds_the_line_limit():
    assert {name: long for name, (_, tree) in read_sources().items() if (long := long_functions(tree))} == {}


def test_every_public_definition_has_a_docstring():
    assert {name: bare for name, (_, tree) in read_sources().items() if (bare := undocumented(tree))} == {}


def test_no_module_is_named_utils_or_helpers():
    assert not [p for p in read_sources() if PurePath(p).stem in ("utils", "helpers", "misc", "common")]


def test_size_checks_detect_violations():
    long = "def f():\n" + "    x = 1\n" * FUNCTION_LINES
    assert long_functions(ast.parse(long)) == {"f": FUNCTION_LINES + 1}
    assert undocumented(ast.parse("class A:\n    def b(self): ...\n    def _c(self): ...\n")) == ["module", "A", "A.b"]
    assert not undocumented(ast.parse(""))
