"""`trimtab reproduce`: output, exit codes and JSON."""

import json
import subprocess
import sys

import pytest
from click.testing import CliRunner

from trimtab import study
from trimtab.cli import main

ROW = {
    *("group", "id", "what", "printed", "computed", "unit", "relation", "accepted", "tolerance", "basis"),
    *("must_hold", "verdict", "citation", "note"),
}
MADE_UP = '''"""Figures of chapter 1.

Made up.
"""

from trimtab.study import missing_row, within

SECTION = "1"


def rows():
    """Three rows."""
    yield within("a/1", "[length]", 2.0, {value}, "[1] table 1", tolerance=0.1, unit="m")
    yield within("a/2", "width", 2.0, 3.0, "[1] table 1", tolerance=0.1, must_hold=False, note="It was raining.")
    yield missing_row("a/3", "colour", "blue", "[1] fig. 2", note="Black and white.")


def figures(folder):
    """One."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "fig-1.png").write_bytes(b"drawn")
    yield folder / "fig-1.png"
'''


@pytest.fixture(autouse=True)
def _no_cache(monkeypatch, tmp_path_factory):
    monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path_factory.getbasetemp() / "cache"))


@pytest.fixture
def made_up(tmp_path, monkeypatch):
    """make(value): a study of one group whose first row computes value, where 2.0 is printed."""
    monkeypatch.setattr(study, "CLONE", tmp_path)
    monkeypatch.setattr(study, "import_study", lambda file: namespace)
    namespace = type("Module", (), {})

    def make(value):
        folder = tmp_path / "somebody1999"
        folder.mkdir(exist_ok=True)
        (folder / "__init__.py").write_text('"""Somebody, "Something", 1999."""\n')
        text = MADE_UP.replace("{value}", str(value))
        (folder / "chapter_one.py").write_text(text)
        found = {}
        exec(text, found)
        namespace.rows, namespace.figures = staticmethod(found["rows"]), staticmethod(found["figures"])

    return make


def call(*words):
    return CliRunner().invoke(main, ["reproduce", *(str(w) for w in words)])


def test_without_arguments_studies_are_listed():
    done = call()
    assert done.exit_code == 0
    assert "hovercraft2006" in done.stdout
    assert "--only inertia" in done.stdout
    found = json.loads(call("--json").stdout)["studies"]["hovercraft2006"]
    assert set(found) == {"title", "groups"}
    assert "inertia" in found["groups"]


@pytest.mark.usefixtures("wide_screen")
def test_prints_one_group_of_hovercraft_study():
    done = call("hovercraft2006", "--only", "inertia")
    assert done.exit_code == 0, done.output
    for text in ("0.0952", "[1] table 4.2", "holds", "not reproduced", "rounded to two digits"):
        assert text in done.stdout
    assert all("so far" in line or "left on" in line for line in done.stderr.splitlines())


def test_json_has_the_documented_keys():
    done = call("hovercraft2006", "--only", "inertia", "--only", "rudder-and-thrust", "--json")
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert set(result) == {"answer", "study", "good", "verdicts", "bases", "rows"}
    assert sum(basis["rows"] for basis in result["bases"].values()) == len(result["rows"])
    assert sum(basis["holds"] for basis in result["bases"].values()) == result["verdicts"]["holds"]
    assert result["good"] is True
    assert sum(result["verdicts"].values()) == len(result["rows"])
    assert {row["group"] for row in result["rows"]} == {"inertia", "rudder-and-thrust"}
    assert all(set(row) == ROW for row in result["rows"])


@pytest.mark.parametrize(("value", "code"), [(2.05, 0), (2.2, 1)])
def test_exit_code_is_1_only_if_a_required_row_fails(made_up, value, code):
    made_up(value)
    table, result = call("somebody1999"), call("somebody1999", "--json")
    assert (table.exit_code, result.exit_code) == (code, code)
    assert json.loads(result.stdout)["good"] is (code == 0)
    assert json.loads(result.stdout)["verdicts"] == {"holds": 1 - code, "differs": code, "not reproduced": 2}
    for text in ("[length]", "It was raining.", "Black and white.", "[1] Somebody"):
        assert text in table.stdout
    assert ("differs" in table.stdout) == bool(code)
    assert f"{1 - code} of 3 rows confirm a value or statement of the publication" in table.stdout


def test_out_option_writes_the_figures(made_up, tmp_path):
    made_up(2.0)
    out = tmp_path / "new" / "pictures"
    done = call("somebody1999", "--out", out, "--json")
    assert json.loads(done.stdout)["files"] == [str(out / "fig-1.png")]
    assert (out / "fig-1.png").read_bytes() == b"drawn"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            ("hovercraft2007",),
            ("hovercraft2007", "Choices: fossen, hovercraft2006", "Fix: trimtab reproduce hovercraft2006"),
        ),
        (("hovercraft2006", "--only", "inertias"), ("inertias", "Choices", "Fix: --only inertia")),
        (("hovercraft2006", "--out", "/dev/null/x"), ("--out", "/dev/null", "Fix")),
    ],
)
def test_invalid_arguments_are_rejected_with_fix(words, says):
    done = call(*words, "--json")
    assert done.exit_code == 2
    assert json.loads(done.stdout)["error"]["fix"]
    for text in says:
        assert text in done.stderr


@pytest.mark.thorough
def test_whole_thesis_is_recomputed_in_less_than_1500_megabytes():
    code = """
import resource, subprocess, sys
done = subprocess.run([sys.executable, "-m", "trimtab", "reproduce", "hovercraft2006"], stdout=subprocess.DEVNULL)
print(done.returncode, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    code, kilobytes = map(int, done.stdout.split())
    assert code == 0, done.stderr
    assert kilobytes < 1.5e6
