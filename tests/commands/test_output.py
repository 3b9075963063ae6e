"""Printed output: numbers are never truncated, a lost flight is named first, and typos are reported quickly."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.commands import output
from trimtab.commands.typed_names import check_names, read_paths
from trimtab.core.errors import InputError
from trimtab.loop.settings import setting_paths
from trimtab.scenarios.build import build

REST = "hovercraft/zero-velocity"
HEADINGS = ("signal", ">final", ">settled (s)", "meaning")
CELLS = ("truth.yaw_rate", "-0.0123456789", "12345.678", "Rate of turn, which is long enough to be broken in lines.")


@pytest.mark.parametrize("columns", [20, 40, 60, 80, 140, None])
def test_numbers_are_never_truncated_on_narrow_terminal(columns, monkeypatch, capsys):
    monkeypatch.delenv("COLUMNS", raising=False)
    monkeypatch.setenv("NO_COLOR", "1")
    if columns is not None:
        monkeypatch.setenv("COLUMNS", str(columns))
    table = output.new_table(*HEADINGS, title="a table", unwrapped=("signal",))
    table.add_row(*CELLS)
    output.print_table(table)
    said = capsys.readouterr().out
    assert all(cell in said for cell in CELLS[:3])
    assert " ".join(CELLS[3].split()) in " ".join(re.sub(r"\s+", " ", said).split()) or columns in (60, 80)
    assert "…" not in said
    assert "\x1b" not in said
    assert max(map(len, said.splitlines())) <= (columns or 140) or columns == 20


def test_names_with_spaces_are_quoted_in_suggested_commands():
    assert [output.quote(name) for name in ("board", Path("my board"))] == ["board", "'my board'"]


def test_title_is_not_wrapped_at_the_width_of_a_narrow_table(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("NO_COLOR", "1")
    title = "my_boat.py:scenario [1], 20 runs from seed 0: rms over the second half"
    table = output.new_table("a", ">b", title=title)
    table.add_row("1", "2")
    output.print_table(table)
    assert capsys.readouterr().out.splitlines()[0] == title


@pytest.mark.parametrize("columns", ["60", "80"])
def test_narrow_terminal_shows_same_numbers_as_wide_one(columns, monkeypatch):
    words = ["run", REST, "--duration", "1", "--no-ideal"]
    monkeypatch.setenv("COLUMNS", "160")
    wide = CliRunner().invoke(main, words).stdout
    monkeypatch.setenv("COLUMNS", columns)
    narrow = CliRunner().invoke(main, words).stdout
    assert set(re.findall(r"-?\d+\.\d+", wide)) == set(re.findall(r"-?\d+\.\d+", narrow))
    assert ("────" in narrow) == (columns == "80")  # a table still, on a terminal as it opens


@pytest.mark.parametrize("columns", [58, 66, 80, 97, 110])
def test_too_wide_table_wraps_words_without_truncation(columns, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("NO_COLOR", "1")
    table = output.new_table("what", ">first in band (s)", ">settled (s)", "verdict", "meaning", unwrapped=("what",))
    rows = [
        ("yaw rate (rad/s)", "0.123", "12345.678", "pessimistic, on the whole", "how fast it turns round and round")
    ]
    rows += [("heading", "-", "-6.79e-05", "undecided", "")]
    for row in rows:
        table.add_row(*row)
    output.print_table(table)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= columns
    assert any("──" in line for line in lines)
    said = set(" ".join(lines).replace("─", "").split())
    assert said == set(" ".join([*(c.header for c in table.columns), *(cell for row in rows for cell in row)]).split())
    for row in rows:  # what stays on one line does
        assert any(all(cell in line for cell in row[:3]) for line in lines)


def test_all_commands_print_tables_through_print_table():
    """Rich cuts cells that are too wide; `print_table` does not."""
    printing = re.compile(r"\.print\((?!f?\")")
    files = {f.name for f in Path(output.__file__).parent.glob("*.py") if printing.search(f.read_text("utf-8"))}
    assert files == {"output.py", "progress.py"}  # a table, and a line above the bar


@pytest.mark.thorough
def test_lost_flight_exits_with_1_and_prints_lost_first():
    words = ["run", REST, "--duration", "1", "--no-ideal", "--set", "initial.yaw_rate=1e200"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 1, done.output
    assert done.stdout.startswith("real:  LOST")


def test_python_m_trimtab_prints_trimtab_as_program_name():
    done = subprocess.run([sys.executable, "-m", "trimtab", "run", "--nothing"], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith("Usage: trimtab run ")
    assert "-m trimtab" not in done.stderr
    assert "\nFix: trimtab run " in done.stderr


@pytest.mark.parametrize(
    "words",
    [("rum",), ("run", "hovercraft/spinn"), ("campaign", "hovercraft/spinn"), ("run", REST, "--set", "wrld.mass=3")],
    ids=" ".join,
)
def test_typo_is_reported_before_heavy_imports(words):
    code = f"""
import sys
from click.testing import CliRunner
from trimtab.cli import main
done = CliRunner().invoke(main, {words!r})
assert done.exit_code == 2, done.output
assert "Fix: " in done.stderr, done.stderr
print([name for name in ("jax", "numpy", "scipy", "rich") if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == "[]\n", done.stderr


def test_suggestions_without_cached_paths_are_not_invented(tmp_path, monkeypatch):
    monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path))
    for path in ("vehicle.mas", "navigation.sigma", "law.k9"):  # the subcommand reports these, from all paths
        check_names(["run", REST, "--set", f"{path}=3"], None)
    with pytest.raises(InputError) as caught:
        check_names(["run", REST, "--set", "wolrd.vehicle.mass=3"], None)
    assert caught.value.choices == ("world.vehicle.mass",)


@pytest.mark.thorough
def test_repeated_wrong_path_is_reported_without_importing_jax(tmp_path):
    code = """
import sys
from click.testing import CliRunner
from trimtab.cli import main
done = CliRunner().invoke(main, ["run", "hovercraft/spin", "--set", "world.vehicle.mas=3"])
assert done.exit_code == 2, done.output
assert "world.vehicle.mass" in done.stderr
print("jax" in sys.modules)
"""
    env = os.environ | {"TRIMTAB_CACHE": str(tmp_path / "mistyped")}
    run = [subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env) for _ in range(2)]
    assert [done.stdout for done in run] == ["True\n", "False\n"], run[0].stderr + run[1].stderr


@pytest.mark.thorough
def test_run_caches_setting_paths_of_scenario(tmp_path, monkeypatch):
    monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path))
    assert CliRunner().invoke(main, ["run", REST, "--no-ideal"]).exit_code == 0
    known = read_paths(REST)
    assert "world.vehicle.mass" in known
    assert known == setting_paths(build(REST))


def test_text_printed_by_a_users_file_does_not_mix_with_the_answer(tmp_path):
    text = (Path(__file__).parents[2] / "examples" / "my_boat.py").read_text(encoding="utf-8")
    text = text.replace("    link, tick = ", "    print('in the function')\n    link, tick = ")
    (tmp_path / "chatty.py").write_text(f"{text}\nprint('at the import')\n", encoding="utf-8")
    words = [f"{tmp_path / 'chatty.py'}:scenario", "--no-ideal", "--duration", "0.1"]
    done = CliRunner().invoke(main, ["run", *words, "--json"])
    assert json.loads(done.stdout)["answer"] == "run/1"
    assert "at the import\n" in done.stderr
    assert "in the function\n" in done.stderr
    refused = CliRunner().invoke(main, ["run", words[0], "--json", "--set", "world.vehicle.mas=1"])
    assert json.loads(refused.stdout)["answer"] == "error/1"
