"""Certificates as theorems: what coqc accepts, and what it does not."""

import re
import shutil
import subprocess

import numpy as np
import pytest
from click.testing import CliRunner
from design.systems import ball_system
from export.conftest import require

from trimtab.cli import main
from trimtab.design.certificate import design_certificate
from trimtab.design.coq import coq_text
from trimtab.scenarios.hypersonic import _design as hypersonic

AXIOMS = {"ClassicalDedekindReals.sig_forall_dec", "FunctionalExtensionality.functional_extensionality_dep"}
"""What Coq's real numbers rest on; nothing else is assumed."""
needs_coq = pytest.mark.usefixtures("coqc")


@pytest.fixture(scope="module")
def coqc():
    """The proof assistant, where it is installed or being installed."""
    require(lambda: [] if shutil.which("coqc") else ["coq"])


@pytest.fixture(scope="module")
def certificate():
    return design_certificate(ball_system())


def prove(text, folder):
    (folder / "certificate.v").write_text(text)
    return subprocess.run(["coqc", "certificate.v"], cwd=folder, capture_output=True, text=True, timeout=600)


def assumed(output):
    return set(re.findall(r"^([\w.]+)\s*:?$", output.replace("Axioms:", ""), re.MULTILINE))


def matrices(text):
    """The matrices of a file, as floats."""
    found = re.findall(r"\(\* (\w+), times 2\^(\d+) \*\)\nDefinition \w+ : list \(list Z\) := (.*?)%Z", text, re.DOTALL)
    rows = {name: eval(rows.replace(";", ","), {}) for name, _, rows in found}
    return {name: np.array([[v / 2 ** int(power) for v in row] for row in rows[name]]) for name, power, _ in found}


def test_coq_file_holds_exact_floats(certificate):
    written = matrices(coq_text(certificate))
    o = certificate.observer
    wanted = {n: getattr(certificate, n) for n in ("A", "B", "K", "P")} | {
        "A_eta": o.A,
        "C": o.C,
        "L": o.L,
        "P_eta": o.P,
    }
    assert written.keys() == wanted.keys()
    for name, M in wanted.items():
        assert np.array_equal(written[name], M), name
    assert "P_eta" not in coq_text(design_certificate(ball_system(observer=False)))


@pytest.mark.thorough
def test_summed_matrices_are_scaled_to_equal_powers():
    """A and B K are integers times different powers of two: each is raised to the greater."""
    text = coq_text(hypersonic.certificate())
    power = {name: int(p) for name, p in re.findall(r"\(\* (\w+), times 2\^(\d+) \*\)", text)}
    raised = {name: int(s) for s, name in re.findall(r"scaled \(2 \^ (\d+)\) \(?(\w+)", text)}
    whole = int(re.search(r"A \+ B K, times 2\^(\d+)", text)[1])
    assert power["A"] + raised["A"] == whole == max(power["A"], power["B"] + power["K"])
    shifts = [int(s) for s in re.findall(r"scaled \(2 \^ (\d+)\) \(times", text)]
    assert shifts[0] + power["B"] + power["K"] == whole
    assert power["A"] != power["B"] + power["K"]


def test_system_name_cannot_end_a_comment(certificate):
    text = coq_text(certificate._replace(system='x *) Axiom a : False. (* "'))
    assert text.index("*)") > text.index("states")


@pytest.mark.thorough
@needs_coq
def test_coqc_proves_valid_certificate(certificate, tmp_path):
    done = prove(coq_text(certificate), tmp_path)
    assert done.returncode == 0, done.stderr
    assert assumed(done.stdout) == AXIOMS


@pytest.mark.thorough("<lambda>-V_eta_falls", "<lambda>-P_is_positive_definite1", "<lambda>-P_eta_is_positive_definite")
@needs_coq
@pytest.mark.parametrize(
    ("change", "theorem"),
    [
        (lambda c: c._replace(K=-c.K), "V_falls"),
        (lambda c: c._replace(P=-c.P), "P_is_positive_definite"),
        (lambda c: c._replace(P=c.P + np.triu(np.full((4, 4), 2.0**-40), 1)), "P_is_positive_definite"),
        (lambda c: c._replace(observer=c.observer._replace(P=-c.observer.P)), "P_eta_is_positive_definite"),
        (lambda c: c._replace(observer=c.observer._replace(L=-c.observer.L)), "V_eta_falls"),
    ],
)
def test_coqc_rejects_false_theorem(certificate, change, theorem, tmp_path):
    text = coq_text(change(certificate))
    done = prove(text, tmp_path)
    assert done.returncode == 1
    line = int(re.search(r"line (\d+)", done.stderr)[1])
    assert f"Theorem {theorem} " in text.splitlines()[line - 2]


@pytest.mark.thorough
@needs_coq
def test_coqc_distinguishes_matrices_that_differ_by_rounding(certificate, tmp_path):
    """A matrix of determinant 2^-52, and one of determinant 0, which no float tells from it."""
    text = coq_text(certificate).partition("(* A, times")[0]
    good = "Theorem t : positive_definite 2 [[2 ^ 52; 2 ^ 52]; [2 ^ 52; 2 ^ 52 + 1]]."
    proof = " Proof. apply (checker_is_sound _ 1); [lia | vm_compute; reflexivity]. Qed.\n"
    assert prove(text + good + proof, tmp_path).returncode == 0
    assert prove(text + good.replace(" + 1", "") + proof, tmp_path).returncode == 1


@needs_coq
@pytest.mark.thorough
def test_coqc_proves_exported_hypersonic_certificate(tmp_path):
    """Through the command line, from the file: nine states, integers of thousands of bits; 20 s."""
    made, theorem = tmp_path / "gain.json", tmp_path / "certificate.v"
    assert CliRunner().invoke(main, ["design", "hypersonic", "--out", str(made)]).exit_code == 0
    done = CliRunner().invoke(main, ["design", "--check", str(made), "--export-coq", str(theorem)])
    assert done.exit_code == 0, done.output
    assert f"wrote {theorem}" in done.output
    assert np.array_equal(matrices(theorem.read_text())["P"], hypersonic.certificate().P)
    done = prove(theorem.read_text(), tmp_path)
    assert done.returncode == 0, done.stderr
    assert assumed(done.stdout) == AXIOMS
