"""False theorem files: `trimtab design --check` rejects every one with the reason.

Each is a shipped certificate with one thing changed, the digest made anew where the file can still be read.
"""

import copy
import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.core.errors import InputError
from trimtab.design.theorem import FALLS, GROWS, prove_theorem
from trimtab.design.theorem_file import parse_theorem, theorem_digest, theorem_json
from trimtab.scenarios.hovercraft._theorems import THEOREMS

FILES = Path(__file__).parents[2] / "examples" / "certificates"
FORWARD, REVERSE, GATE, REFERENCE = "forward", "reverse", "spin-gate", "spin-reference"
ZERO, TIME = "zero-velocity", "zero-velocity-time"
EPS, LOWER = "V < eps implies W < W_bad", "a lower reference above the bound is safe"
GRAM, INSIDE = ("proofs", FALLS, "terms", 0), ("proofs", FALLS, "terms", 1)


def put(*path, value):
    def change(content):
        *inner, last = path
        for key in inner:
            content = content[key]
        content[last] = value(content[last]) if callable(value) else value

    return change


def drop(*path):
    def change(content):
        *inner, last = path
        for key in inner:
            content = content[key]
        del content[last]

    return change


def negate(text):
    return text.removeprefix("-") if text.startswith("-") else "-" + text


def swap_proofs(content):
    proofs = content["proofs"]
    proofs[GROWS], proofs[FALLS] = proofs[FALLS], proofs[GROWS]


def square(i, j, claim=FALLS):
    return ("proofs", claim, "terms", 0, "squares", i, j)


CHANGES = {
    # what the file speaks of
    "format": (FORWARD, put("format", value="trimtab theorem 2")),
    "scope": (FORWARD, put("scope", value=["everything"])),
    "another theorem": (FORWARD, put("theorem", value="hovercraft/zero-velocity")),
    "unknown theorem": (FORWARD, put("theorem", value="hovercraft/sideways")),
    "says more": (FORWARD, put("says", value=lambda s: s + ", with delay")),
    "says of reverse: from everywhere": (REVERSE, put("says", value=lambda s: s.replace(" with V <= c", ""))),
    "other gains": (REVERSE, put("about", "k2", value=1.5)),
    "theta below its bound": (REVERSE, put("about", "theta", value=0.36)),
    "forward instead of backward": (REVERSE, put("about", "reference", value=1.98)),
    "another mass": (GATE, put("about", "mass", value=1.6)),
    "a setting too many": (FORWARD, put("about", value={"k1": 1.0})),
    "boolean setting": (REVERSE, put("about", "k1", value=True)),
    # V and its level
    "V with another sign": (FORWARD, put("lyapunov", value=negate)),
    "V of zero-velocity": (FORWARD, put("lyapunov", value="1/2*J*r^2 + 1/2*m*u^2 + 1/2*m*v^2")),
    "no V": (FORWARD, put("lyapunov", value=None)),
    "V of reverse a little changed": (REVERSE, put("lyapunov", value=lambda s: s + " + 1/1000*r*v")),
    "V of reverse doubled": (REVERSE, put("lyapunov", value=lambda s: f"2*({s})")),
    "level of a global theorem": (ZERO, put("level", value="1")),
    "no level": (REVERSE, put("level", value=None)),
    "twice the level": (REVERSE, put("level", value="66")),
    "a little more level": (REVERSE, put("level", value="34")),
    "a negative level": (REVERSE, put("level", value="-1")),
    "a level that is a float": (REVERSE, put("level", value=33.0)),
    "level divided by zero": (REVERSE, put("level", value="33/0")),
    "a V where there is no motion": (GATE, put("lyapunov", value="u^2")),
    "a level where there is no motion": (GATE, put("level", value="1")),
    # squares
    "a weight without its sign": (FORWARD, put(*square(0, 0), value="-k1")),
    "a weight that may be negative": (FORWARD, put(*square(0, 0), value="k1 - k2")),
    "a weight with a state": (FORWARD, put(*square(0, 0), value="k1*u")),
    "a larger weight": (FORWARD, put(*square(1, 0), value="2*k2")),
    "a form with another sign": (FORWARD, put(*square(1, 1), value="v + d*r")),
    "a form with an unknown name": (FORWARD, put(*square(2, 1), value="r*p")),
    "a square left out": (FORWARD, drop(*square(2, 1)[:-1])),
    "no squares": (FORWARD, put("proofs", FALLS, "terms", 0, "squares", value=[])),
    "a square twice": (ZERO, put("proofs", FALLS, "terms", 0, "squares", value=lambda s: [*s, s[0]])),
    "a square of V left out": (ZERO, drop("proofs", GROWS, "terms", 0, "squares", 2)),
    "proofs exchanged": (ZERO, swap_proofs),
    "a proof left out": (ZERO, drop("proofs", GROWS)),
    "a proof too many": (ZERO, put("proofs", value=lambda p: {**p, "it flies": p[GROWS]})),
    "scale of zero": (FORWARD, put("proofs", FALLS, "scale", value="0")),
    "scale below zero": (FORWARD, put("proofs", FALLS, "scale", value="-1")),
    "scale of two": (FORWARD, put("proofs", FALLS, "scale", value="2")),
    # Gram matrices
    "an entry of G": (REVERSE, put(*GRAM, "gram", 0, 0, value=lambda v: v + "1")),
    "a sign in G": (REVERSE, put(*GRAM, "gram", 4, 4, value=negate)),
    "G not symmetric": (REVERSE, put(*GRAM, "gram", 0, 1, value="7")),
    "a row of G too short": (REVERSE, drop(*GRAM, "gram", 0, 0)),
    "a row of G left out": (REVERSE, drop(*GRAM, "gram", 0)),
    "G of floats": (REVERSE, put(*GRAM, "gram", 0, 0, value=0.5)),
    "a form of G": (REVERSE, put(*GRAM, "forms", 0, value=lambda f: f + " + v")),
    "S without its sign": (REVERSE, put(*INSIDE, "gram", value=lambda M: [[negate(v) for v in row] for row in M])),
    "S left out": (REVERSE, drop(*INSIDE)),
    "S without its hypothesis": (REVERSE, put(*INSIDE, "times", value="")),
    "S times an unknown hypothesis": (REVERSE, put(*INSIDE, "times", value="V - c")),
    # implications
    "hypothesis left out of a term": (GATE, put("proofs", EPS, "terms", 0, "times", value="")),
    "changed weight of the hypothesis": (GATE, put(*square(0, 0, EPS), value="1")),
    "negative weight of the hypothesis": (GATE, put(*square(0, 0, EPS), value="-3")),
    "term of the hypothesis left out": (GATE, drop("proofs", EPS, "terms", 0)),
    "a bound's weight": (REFERENCE, put(*square(0, 0, LOWER), value="h")),
    "a bound's scale": (REFERENCE, put("proofs", LOWER, "scale", value="g")),
    "a faster rate": (TIME, put("about", "rate", value=0.5)),
    "a larger level": (TIME, put("about", "level", value=2.0)),
    "less gain": (TIME, put("about", "k1", value=0.5)),
    # the text itself
    "code for a form": (FORWARD, put(*square(0, 1), value="__import__('os').getcwd()")),
    "huge power": (FORWARD, put(*square(0, 1), value="((u+v+r)^9)^9")),
    "a key left out": (FORWARD, drop("says")),
    "a key too many": (FORWARD, put("trust", value="me")),
    "a term that is a list": (FORWARD, put("proofs", FALLS, "terms", 0, value=["k1"])),
    "proofs that are a list": (FORWARD, put("proofs", value=[])),
    "a version that is a number": (FORWARD, put("version", value=1)),
    "null digest": (FORWARD, put("digest", value=None)),
}


def tamper(name, change):
    """The changed text, with a digest of its own where it can be read."""
    content = json.loads((FILES / f"{name}.json").read_text(encoding="utf-8"))
    change(content)
    text = json.dumps(content)
    try:
        certificate, _ = parse_theorem(text, name)
    except InputError:
        return text
    return theorem_json(certificate)


def run_check(text, tmp_path):
    """The result of `trimtab design --check` for a text."""
    file = tmp_path / "file.json"
    file.write_text(text, encoding="utf-8")
    return CliRunner().invoke(main, ["design", "--check", str(file)])


@pytest.mark.thorough(
    "scope",
    "another theorem",
    "says more",
    "other gains",
    "forward instead of backward",
    "a setting too many",
    "V with another sign",
    "V of zero-velocity",
    "V of reverse doubled",
    "twice the level",
    "a negative level",
    "level divided by zero",
    "a level where there is no motion",
    "a weight with a state",
    "a form with another sign",
    "a square left out",
    "a square twice",
    "proofs exchanged",
    "a proof too many",
    "scale below zero",
    "scale of two",
    "an entry of G",
    "a row of G too short",
    "G of floats",
    "a form of G",
    "S left out",
    "S times an unknown hypothesis",
    "negative weight of the hypothesis",
    "a bound's scale",
    "a larger level",
    "less gain",
    "a term that is a list",
    "a version that is a number",
)
@pytest.mark.parametrize("change", CHANGES)
def test_rejects_tampered_theorem(change, tmp_path):
    name, apply = CHANGES[change]
    done = run_check(tamper(name, apply), tmp_path)
    assert done.exit_code in (1, 2), done.output
    if done.exit_code == 1:
        assert "NOT proved" in done.output
        assert "FAILS" in done.output
        assert "the file was changed after it was written" not in done.output  # seen without the digest
    else:
        assert "Fix:" in done.output


def test_at_least_50_cases_and_unmodified_theorems_pass(tmp_path):
    assert len(CHANGES) >= 50
    for name in (FORWARD, REVERSE, GATE, REFERENCE, ZERO, TIME):
        done = run_check(tamper(name, lambda content: None), tmp_path)
        assert done.exit_code == 0, done.output


def test_rejects_truncated_and_malformed_files(tmp_path):
    text = (FILES / "forward.json").read_text(encoding="utf-8")
    double = text.replace('"says":', '"level": "1",\n "says":', 1)
    for broken in (text[:-30], text.replace('"level": null', '"level": NaN'), double, "[]", ""):
        done = run_check(broken, tmp_path)
        assert done.exit_code == 2, done.output


def test_digest_reports_accidental_change(tmp_path):
    text = (FILES / "forward.json").read_text(encoding="utf-8")
    done = run_check(text.replace('"version": "0', '"version": "1'), tmp_path)
    assert done.exit_code == 1
    assert "the file was changed after it was written" in done.output


def test_every_changed_gram_matrix_entry_fails():
    """An entry and its mirror image moved by a millionth: the two sides are no longer one polynomial."""
    text = (FILES / "reverse.json").read_text(encoding="utf-8")
    honest, _ = parse_theorem(text, "reverse")
    theorem = THEOREMS["hovercraft/reverse"]()
    for at, term in enumerate(honest.proofs[FALLS].terms):
        for i in range(len(term.forms)):
            certificate = copy.deepcopy(honest)
            moved = certificate.proofs[FALLS].terms[at].matrix
            for a, b in {(0, i), (i, 0)}:
                moved[a, b] = moved[a, b] * 1000001 / 1000000 + (moved[a, b] == 0)
            assert not prove_theorem(certificate, theorem).holds
            assert theorem_digest(certificate) != theorem_digest(honest)
