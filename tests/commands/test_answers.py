"""JSON output of the verbs conforms to the published schema; tests/answers.py checks it in every other test."""

import json
import re
from pathlib import Path

import pytest
from answers import complaints, read_schema
from click.testing import CliRunner

import trimtab.commands
from trimtab.cli import VERBS, main

FOLDER = Path(trimtab.commands.__file__).parent
REST, SPIN = "hovercraft/zero-velocity", "hovercraft/spin"
MASS = ("--spread", "world.vehicle.mass=uniform(80%, 120%)")
BRIEF = ("--duration", "1")
PEAK = ("--success", "peak:yaw_rate <= 9")

QUICK = {
    "list": ("list",),
    "list of one": ("list", SPIN),
    "reproduce": ("reproduce",),
    "refused": ("run", "hovercraft/spinn"),
    "refused by click": ("run", SPIN, "--seed", "one"),
}
SLOW = {
    "trim": ("trim", "quadrotor/track"),
    "run": ("run", REST, "--navigation", "ins", *BRIEF, "--require", "always(abs(truth.yaw_rate) < 9 rad/s)"),
    "run in space": ("run", "quadrotor/track", *BRIEF, "--out", "{here}/flight"),
    "demo": ("demo", "--out", "{here}"),
    "budget": ("budget", REST, "--runs", "1", *BRIEF),
    "campaign": ("campaign", SPIN, *MASS, *PEAK, *BRIEF, "--runs", "70", "--require", "success >= 0.5 @ 95%"),
    "campaign again": ("campaign", SPIN, *MASS, *PEAK, *BRIEF, "--runs", "70", "--rerun", "3"),
    "falsify": ("falsify", SPIN, *MASS, *PEAK, *BRIEF, "--runs", "512", "--out", "{here}/worst.py"),
    "rare": (
        *("rare", SPIN, "--spread", "world.vehicle.mass=normal(100%, 5%)", "--set", "duration=3"),
        *("--success", "peak:yaw_rate <= 3.8", "--runs", "20000"),
    ),
    "map": ("map", REST, "--x", "delay=0:0.6:3", "--y", "loss=0:0.9:3", *PEAK, *BRIEF, "--runs", "2", "--depth", "0"),
    "tune": (
        *("tune", REST, "--gain", "autopilot.law.k1=0.5:3", "--cost", "rms:yaw_rate", *BRIEF),
        *("--runs", "8", "--judge-runs", "16", "--iterations", "2"),
    ),
    "linearise": ("linearise", "hypersonic", "--output", "h", "--output", "V"),
    "linearise a loop": ("linearise", REST, "--closed-loop", "--direct", "--without", "navigation-error"),
    "zeros": ("zeros", "hypersonic", "--input", "Phi", "--output", "h"),
    "design": ("design", "hypersonic"),
    "design by limits": (
        *("design", "examples/my_cart.py:scenario", "--lqr", "--limit", "force=5", "--limit", "lean=6 deg"),
        *("--limit", "position=30 cm", "--limit", "velocity=1", "--limit", "lean_rate=60 deg/s"),
    ),
    "design stabilisability": ("design", "hovercraft", "--stabilisability"),
    "design theorem": ("design", "hovercraft/forward"),
    "export": ("export", SPIN, "--steps", "100", "--out", "{here}/autopilot"),
    "plan": ("plan", "examples/hall.toml", "--out", "{here}/plan.csv"),
}


def call(*words):
    return CliRunner().invoke(main, [str(w) for w in words])


def answer(words, here):
    """Return the JSON that a command prints; fail only if the output violates the schema."""
    done = call(*(w.format(here=here) for w in words), "--json")
    assert not isinstance(done.exception, AssertionError), done.exception
    return json.loads(done.stdout)


@pytest.mark.parametrize("case", QUICK)
def test_answer_conforms_to_published_schema(case, tmp_path):
    given = answer(QUICK[case], tmp_path)
    assert not complaints(given)
    assert given["answer"] == ("error/1" if "refused" in case else f"{QUICK[case][0]}/1")


@pytest.mark.thorough
@pytest.mark.parametrize("case", SLOW)
def test_slow_answer_conforms_to_published_schema(case, tmp_path):
    given = answer(SLOW[case], tmp_path)
    assert not complaints(given)
    assert given["answer"] == f"{SLOW[case][0]}/1", given


def test_schema_is_valid_and_forbids_undeclared_properties():
    from jsonschema import Draft202012Validator

    schema = read_schema()
    Draft202012Validator.check_schema(schema)
    verbs = [one["$ref"].rpartition("/")[2] for one in schema["oneOf"]]
    for verb in verbs:
        given = schema["$defs"][verb]
        for one in given.get("anyOf", [given]):
            assert one["additionalProperties"] is False
            assert one["properties"]["answer"] == {"const": f"{verb}/1"}
            assert "answer" in one["required"]
            assert set(one["required"]) <= set(one["properties"])


def test_schema_covers_every_verb_with_json_option():
    taking = {
        verb
        for verb in VERBS
        for file in FOLDER.glob(f"{verb.replace('-', '_')}*.py")
        if re.search(r"^@JSON$|print_json\(", file.read_text("utf-8"), re.MULTILINE)
    }
    assert taking | {"demo", "error"} == {one["$ref"].rpartition("/")[2] for one in read_schema()["oneOf"]}
    assert taking >= {"run", "campaign", "link-test", "live-faults", "fly"}


SPOILT = {
    "a field too many": lambda a: a | {"colour": "red"},
    "a field too few": lambda a: {k: v for k, v in a.items() if k != "settings"},
    "another type": lambda a: a | {"scenario": 3},
    "deep within": lambda a: a | {"settings": {"x": {"value": 1, "unit": 2, "doc": ""}}},
}


@pytest.mark.parametrize("spoil", SPOILT.values(), ids=SPOILT)
def test_validation_detects_nonconforming_answer(spoil):
    good = json.loads(call("list", SPIN, "--json").stdout)
    assert not complaints(good)
    assert complaints(spoil(good))


def test_nonconforming_answer_of_a_verb_fails_its_test(monkeypatch):
    monkeypatch.setattr("trimtab.commands.list.catalogue.scenario_names", lambda: {"a": 1})
    assert "is not of type 'string'" in str(call("list", "--json").exception)


def test_answers_option_prints_the_schema():
    assert json.loads(call("list", "--answers").stdout) == read_schema()
