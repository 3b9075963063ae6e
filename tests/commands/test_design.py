"""`trimtab design`: a gain is designed, written, and proved without a solver; a modified gain is rejected."""

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
    assert "not valid while an input saturates" in done.output
    return made


@pytest.mark.thorough
def test_designed_gain_is_proved(file):
    done = call("--check", file)
    assert done.exit_code == 0, done.output
    assert ": proved" in done.output
    assert "FAILS" not in done.output
    plain = json.loads(call("--check", file, "--json").stdout)
    assert plain["holds"]
    assert {"name", "holds", "number", "meaning", "how", "why"} == set(plain["conditions"][0])
    assert plain["poles"][0][0] == pytest.approx(-0.2266, abs=1e-4)


@pytest.mark.thorough
def test_modified_file_fails_proof_and_reports_number(file, tmp_path):
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


@pytest.mark.thorough
def test_certificate_is_checked_against_named_system(file, tmp_path):
    for words in (("--check", file), ("hypersonic", "--check", file)):
        done = call(*words, "--json")
        assert done.exit_code == 0, done.output
        assert "A is that of hypersonic" in [c["name"] for c in json.loads(done.stdout)["conditions"]]
    content = json.loads(file.read_text())
    content["A"][4][3] *= 1.0001
    bad = tmp_path / "bad.json"
    bad.write_text(json.dumps(content))
    done = call("--check", bad)
    assert done.exit_code == 1
    assert "A is that of hypersonic: at q, alpha" in done.output


@pytest.mark.thorough
def test_design_applies_settings_at_another_operating_point(tmp_path):
    made = tmp_path / "gain.json"
    done = call("hypersonic", "--set", "h_ft=90000", "--set", "uncertainty=0.5", "--out", made, "--json")
    assert done.exit_code == 0, done.output
    about = json.loads(done.stdout)["about"]
    assert (about["h_ft"], about["uncertainty"]) == (90000.0, 0.5)
    kappa = next(c["number"] for c in json.loads(done.stdout)["conditions"] if c["name"] == "kappa_G")
    assert 0.03 < kappa < 0.06
    assert call("--check", made).exit_code == 0


OWN = """
from design.systems import ball_system

def certified_system(*, method: str = "lqr", beam_m: float = 1.0):
    return ball_system(method)._replace(about={"method": method, "beam_m": beam_m})
"""


@pytest.mark.thorough("my_ball/_design.py")
@pytest.mark.parametrize("place", ["my_ball.py", "my_ball/_design.py"])
def test_designs_for_user_defined_system(place, tmp_path):
    own, made = tmp_path / place, tmp_path / "gain.json"
    own.parent.mkdir(exist_ok=True)
    own.write_text(OWN)
    name = tmp_path / place.split("/")[0]
    done = call(name, "--out", made)
    assert done.exit_code == 0, done.output
    done = call(name, "--check", made)
    assert done.exit_code == 0, done.output
    alone = call("--check", made)
    assert alone.exit_code == 2
    assert "trimtab design my_boat.py --check FILE" in alone.output
    assert "the certificate is for 'ball and beam'" in call("hypersonic", "--check", made).output
    content = json.loads(made.read_text())
    content["B"][3][0] = 1.01
    made.write_text(json.dumps(content))
    done = call(name, "--check", made)
    assert done.exit_code == 1
    assert "B is that of ball and beam: at theta', w: 1.01, not 1.0" in done.output


@pytest.mark.thorough
def test_proof_does_not_import_solver(file):
    text = (
        "import sys; from click.testing import CliRunner; from trimtab.cli import main\n"
        f"done = CliRunner().invoke(main, ['design', '--check', {str(file)!r}])\n"
        "assert done.exit_code == 0, done.output\n"
        "assert 'clarabel' not in sys.modules"
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
        (("--check", "x.json", "--method", "lqr"), "--method: cannot be combined with --check"),
        (("--check", "x.json", "--integral"), "--integral: cannot be combined with --check"),
        (("--check", "x.json", "--set", "h_ft=90000"), "--set: cannot be combined with --check"),
        (("hypersonic", "--filter", "best"), "Choices: tuned, equal, accurate, printed, none"),
        (("hypersonic", "--set", "height=1"), "unknown setting 'height'"),
        (("hypersonic", "--set", "h_ft=high"), "must be a finite number, got 'high'"),
        (("my_boat.py",), "there is no file"),
        (("examples/my_boat.py",), "design examples/my_boat.py --lqr"),
    ],
)
def test_invalid_arguments_are_rejected_with_fix(words, problem):
    done = call(*words)
    assert done.exit_code == 2
    assert problem in done.output
