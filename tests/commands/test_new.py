"""`trimtab new`: generated files work unchanged under any name; invalid names are rejected with a fix."""

import json
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.commands.new import KINDS, LONGEST, TEMPLATES, main_file, nearest_name
from trimtab.compiler.native.compiler import find_compiler

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
NAMES = ("b", "my_own_part", "x" * LONGEST, "a_b_c_d_e_f_g_h_i_j_k_l")


def call(*words):
    return CliRunner().invoke(main, list(map(str, words)))


def make(kind, name, folder):
    done = call("new", kind, name, "--out", folder, "--json")
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


def run(command, folder, *words):
    """Run a program of this environment, which must succeed; return its output."""
    done = subprocess.run([sys.executable, "-m", command, *map(str, words)], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_writes_three_short_files_and_prints_commands(kind, tmp_path):
    said = make(kind, "my_own", tmp_path / "deep" / "folder")
    ending = "toml" if kind == "scenario" else "py"
    assert [Path(file).name for file in said["files"]] == [f"my_own.{ending}", "test_my_own.py", "my_own.md"]
    texts = [Path(file).read_text(encoding="utf-8") for file in said["files"]]
    assert all(len(text.splitlines()) <= 60 for text in texts)
    assert not any(f"my_{kind}" in text or f"My{kind.capitalize()}" in text for text in texts)
    assert texts[2].startswith("# My own\n")
    for line in said["next"]:
        assert line.startswith(("trimtab ", "pytest "))
        assert "my_own" in line


def test_text_output_lists_written_files_and_next_commands(tmp_path):
    said = call("new", "vehicle", "bike", "--out", tmp_path).output
    assert f"wrote {tmp_path / 'bike.py'}" in said
    for line in (f"trimtab run {tmp_path / 'bike.py'}:scenario", f"pytest {tmp_path / 'test_bike.py'}"):
        assert line in said


@pytest.mark.thorough("my_own_part", "a_b_c_d_e_f_g_h_i_j_k_l")
@pytest.mark.parametrize("name", NAMES)
def test_generated_files_pass_ruff_for_any_name(name, tmp_path):
    for kind in KINDS:
        make(kind, name, tmp_path / kind)
    settings = ("--config", ROOT / "pyproject.toml", "--no-cache", tmp_path)
    run("ruff", ROOT, "check", *settings)
    run("ruff", ROOT, "format", "--check", *settings)


def test_template_with_its_own_name_is_copied_unchanged(tmp_path):
    for kind in KINDS:
        for file in make(kind, f"my_{kind}", tmp_path)["files"]:
            assert Path(file).read_bytes() == (TEMPLATES / Path(file).name).read_bytes()


REFUSED = [
    ("law", "my-law", "not a valid name", "trimtab new law my_law"),
    ("law", "MyLaw!", "not a valid name", "trimtab new law my_law"),
    ("law", "3d", "not a valid name", "trimtab new law my_3d"),
    ("law", "Größe", "not a valid name", "trimtab new law grosse"),
    ("law", "", "not a valid name", "trimtab new law my_part"),
    ("law", "x" * (LONGEST + 1), "at most 24", f"trimtab new law {'x' * LONGEST}"),
    ("law", "class", "reserved word of Python", "trimtab new law my_class"),
    ("law", "numpy", "module 'numpy'", "trimtab new law my_numpy"),
    ("law", "trimtab", "module 'trimtab'", "trimtab new law my_trimtab"),
    ("vehicle", "test", "module 'test'", "trimtab new vehicle my_test"),
    ("vehicle", "test_boat", "pytest", "trimtab new vehicle my_boat"),
    ("vehicle", "boats/boat.py", "is a path", "trimtab new vehicle boat --out boats"),
    ("scenario", "boat.toml", "is a path", "trimtab new scenario boat"),
    ("vehicle", "motion", "class Motion", "trimtab new vehicle my_motion"),
    ("estimator", "planar_pose", "class PlanarPoseState", "trimtab new estimator my_planar_pose"),
    ("vehicel", "boat", "no such kind", "trimtab new vehicle boat"),
    ("controller", "pid", "no such kind", "trimtab new law pid"),
]


@pytest.mark.parametrize(("kind", "name", "problem", "fix"), REFUSED, ids=lambda value: str(value)[:20])
def test_invalid_names_are_rejected_with_working_fix(kind, name, problem, fix, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # An example that was flown before in this process may have put its folder, and so my_boat, on the path.
    monkeypatch.setattr(sys, "path", [place for place in sys.path if Path(place).resolve() != EXAMPLES])
    done = call("new", kind, name, "--json")
    assert done.exit_code == 2
    assert problem in done.output
    assert f"Fix: {fix}\n" in done.output
    assert json.loads(done.stdout)["error"]["fix"] == fix
    assert not list(tmp_path.iterdir())
    again = fix.split()[1:]
    assert call(*again).exit_code == 0  # what it says works


def test_missing_arguments_print_an_example():
    assert "Fix: trimtab new vehicle my_bike\n" in call("new").output
    assert "Fix: trimtab new vehicle my_bike\n" in call("create").output


def test_existing_files_are_not_overwritten(tmp_path):
    (tmp_path / "boat.md").write_text("mine")
    done = call("new", "vehicle", "boat", "--out", tmp_path)
    assert done.exit_code == 2
    assert "boat.md' is an existing file" in done.output
    assert "trimtab new vehicle boat_2, or --overwrite" in done.output
    assert [file.name for file in tmp_path.iterdir()] == ["boat.md"]
    make("vehicle", "boat_2", tmp_path)
    assert call("new", "law", "boat_2", "--out", tmp_path).exit_code == 2  # not even what was just made
    assert call("new", "vehicle", "boat", "--out", tmp_path, "--overwrite").exit_code == 0
    assert (tmp_path / "boat.md").read_text(encoding="utf-8").startswith("# Boat\n")


def test_rejects_unwritable_folder(tmp_path):
    (tmp_path / "file").write_text("")
    done = call("new", "law", "pid", "--out", tmp_path / "file")
    assert done.exit_code == 2
    assert "--out with a folder that you can write to" in done.output
    (tmp_path / "pid.py").mkdir()
    assert "is a folder" in call("new", "law", "pid", "--out", tmp_path, "--overwrite").output


def test_shell_completion_offers_the_kinds():
    words = ShellComplete(main, {}, "trimtab", "_TRIMTAB_COMPLETE").get_completions(["new"], "")
    assert [item.value for item in words] == list(KINDS)


@pytest.mark.parametrize("text", ["a b", "ÀÉ", "--", "x.y", "9", "None", "CamelCaseName", "a" * 99])
def test_nearest_name_is_a_valid_identifier(text):
    name = nearest_name(text)
    assert name.isidentifier()
    assert name == name.lower()
    assert len(name) <= LONGEST


@pytest.mark.thorough
@pytest.mark.timeout(1800)
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
@pytest.mark.parametrize("kind", KINDS)
def test_printed_commands_test_and_fly_generated_files(kind, tmp_path, monkeypatch):
    """Run each command that `new` prints in the folder of the generated files."""
    monkeypatch.chdir(tmp_path)
    said = json.loads(call("new", kind, "own", "--json").stdout)
    page = Path("own.md").read_text(encoding="utf-8")
    shown = {"run": [line.strip() for line in page.splitlines() if line.startswith("    ")]}
    for line in said["next"]:
        program, *words = shlex.split(line)
        words += ["--runs", "70"] if words[0] == "campaign" else []
        printed = run(program, tmp_path, *words, *(("-p", "no:cacheprovider") if program == "pytest" else ()))
        assert all(text in printed for text in shown.get(words[0], []))
    assert (tmp_path / "own.png").read_bytes()[:4] == b"\x89PNG"
    assert main_file(kind).removeprefix(f"my_{kind}") == Path(said["files"][0]).suffix


@pytest.mark.thorough
def test_generated_files_pass_the_type_checker(tmp_path):
    for kind in KINDS:
        make(kind, "my_own", tmp_path / kind)
    run("basedpyright", ROOT, "--pythonpath", sys.executable, "--project", ROOT / "pyproject.toml", tmp_path)
