"""The page on trust: the tests it names exist. Its claims without another test are tested here."""

import ast
import re
from pathlib import Path

import pytest
from click.testing import CliRunner
from design.systems import ball_system

from trimtab.cli import main
from trimtab.design.certificate import design_certificate
from trimtab.design.certificate_file import certificate_json

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "live" / "trust.md"
BARE = ("listen", "hold packets back")
"""Rows of what nothing guards against."""


def named_tests():
    return re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", PAGE.read_text("utf-8"))


def test_each_test_named_on_the_page_exists():
    named = named_tests()
    assert len(named) > 25
    for file, name in named:
        functions = {
            node.name
            for node in ast.walk(ast.parse((ROOT / file).read_text("utf-8")))
            if isinstance(node, ast.FunctionDef)
        }
        assert name in functions, f"{file}::{name}"


def test_each_row_names_a_test_or_is_unguarded():
    rows = [line for line in PAGE.read_text("utf-8").splitlines() if line.startswith("| ")]
    bodies = [row for row in rows if not row.startswith(("| code |", "| file |", "| file or process |", "| attack |"))]
    assert len(bodies) > 20
    bare = [row for row in bodies if "::test_" not in row]
    assert [next(b for b in BARE if row.startswith(f"| {b}")) for row in bare] == list(BARE)


@pytest.mark.parametrize("system", ["os:abort", "evil:craft", "evil.py", "__import__('os').abort()"])
def test_certificate_naming_a_module_runs_no_code(system, tmp_path, monkeypatch):
    mark = tmp_path / "was-imported"
    (tmp_path / "evil.py").write_text(f"open({str(mark)!r}, 'w')\n", "ascii")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    certificate = design_certificate(ball_system())._replace(system=system)
    (tmp_path / "c.json").write_text(certificate_json(certificate), "utf-8")
    done = CliRunner().invoke(main, ["design", "--check", str(tmp_path / "c.json")])
    assert done.exit_code == 2, done.output
    assert "which is not in the package" in done.output
    assert not mark.exists()
