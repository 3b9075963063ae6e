"""`trimtab design`: designed, written, proved again without solver, and refused where it was changed."""

import json
import os
import subprocess
import sys

import pytest
from click.testing import CliRunner

from trimtab.cli import main


def call(*words):
    return CliRunner().invoke(main, ["design", *map(str, words)])


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    made = tmp_path_factory.mktemp("design") / "new" / "gain.json"
    done = call("hypersonic", "--out", made)
    assert done.exit_code == 0, done.output
    assert f"wrote {made}" in done.output
    assert "void while an input saturates" in done.output
    return made


def test_designed_and_proved(file):
    done = call("--check", file)
    assert done.exit_code == 0, done.output
    assert ": proved" in done.output
    assert "FAILS" not in done.output
    plain = json.loads(call("--check", file, "--json").stdout)
    assert plain["holds"]
    assert {"name", "holds", "number", "meaning", "how", "why"} == set(plain["conditions"][0])
    assert plain["poles"][0][0] == pytest.approx(-0.2266, abs=1e-4)


def test_a_changed_file_fails_with_the_number(file, tmp_path):
    content = json.loads(file.read_text())
    content["K"][0][4] *= -1
    bad = tmp_path / "bad.json"
    bad.write_text(json.dumps(content))
    done = call("--check", bad)
    assert done.exit_code == 1
    assert "NOT proved" in done.output
    assert "FAILS  A + B K Hurwitz: pivot at" in done.output
    plain = json.loads(call("--check", bad, "--json").stdout)
    broken = {c["name"]: c["number"] for c in plain["conditions"] if not c["holds"]}
    assert broken["A + B K Hurwitz"] < 0


def test_compared_with_the_system(file, tmp_path):
    done = call("hypersonic", "--check", file, "--json")
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["conditions"][-1]["name"] == "B is that of hypersonic"
    content = json.loads(file.read_text())
    content["A"][4][3] *= 1.0001
    bad = tmp_path / "bad.json"
    bad.write_text(json.dumps(content))
    done = call("hypersonic", "--check", bad)
    assert done.exit_code == 1
    assert "A is that of hypersonic: at q, alpha" in done.output


def test_the_proof_needs_neither_solver_nor_jax(file):
    text = (
        "import sys; from click.testing import CliRunner; from trimtab.cli import main\n"
        f"done = CliRunner().invoke(main, ['design', '--check', {str(file)!r}])\n"
        "assert done.exit_code == 0, done.output\n"
        "assert not {'clarabel', 'jax'} & set(sys.modules)"
    )
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("COV_", "COVERAGE"))}
    done = subprocess.run([sys.executable, "-c", text], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ((), "Choices: hypersonic"),
        (("hypersonc",), "Fix: trimtab design hypersonic"),
        (("--check", "nothing.json"), "cannot be read"),
        (("--check", "x.json", "--method", "lqr"), "--method: a file is checked as it is"),
        (("--check", "x.json", "--integral"), "--integral: a file is checked as it is"),
        (("hypersonic", "--filter", "none"), "Choices: tuned, accurate, printed"),
    ],
)
def test_refused_with_the_fix(words, problem):
    done = call(*words)
    assert done.exit_code == 2
    assert problem in done.output
