"""The command line: output of list, run and demo, and errors with part, value, choices and fix."""

import json
import os
import re

import pytest
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.commands.verbs import SYNONYMS
from trimtab.logs.mcap import read_mcap

SIGNALS = {"surge_velocity", "sway_velocity", "yaw_rate", "heading"}
METRICS = {"settling_s", "first_reach_s", "overshoot", "tail_mean", "tail_rms"}
NAME = "hovercraft/zero-velocity"


@pytest.fixture(autouse=True)
def _no_cache(monkeypatch, tmp_path_factory):
    """Compiled programs of the tests stay out of the user's cache."""
    if "TRIMTAB_CACHE" not in os.environ:
        monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path_factory.getbasetemp() / "cache"))


def call(*words):
    return CliRunner().invoke(main, [str(w) for w in words])


def test_list_shows_every_scenario():
    done = call("list")
    assert done.exit_code == 0
    wanted = ("zero-velocity", "forward", "reverse", "spin", "heading-bang-bang", "heading-proportional")
    assert all(f"hovercraft/{name}" in done.stdout for name in wanted)


def test_list_of_a_scenario_shows_settings_with_units():
    done = call("list", NAME, "--json")
    found = json.loads(done.stdout)
    assert found["settings"]["world.vehicle.mass"]["unit"] == "kg"
    assert found["choices"]["links"] == ["chain", "measured", "none"]
    assert found["choices"]["predictor"] == ["off", "on"]
    assert "navigation-error" in found["imperfections"]


@pytest.mark.thorough
def test_friction_is_listed_and_set_by_its_path():
    assert "torque_viscous" in json.loads(call("list", NAME, "--json").stdout)["optional"]["world.vehicle.friction"]
    path = "world.vehicle.friction.torque_viscous"
    words = ("run", NAME, "--duration", "1", "--json", "--set")
    free, drag = (json.loads(call(*words, f"{path}={n}").stdout)["ideal"]["final"]["yaw_rate"] for n in (0, 0.05))
    assert drag < 0.8 * free
    assert path in call("run", NAME, "--set", "world.vehicle.friction.torque=1").output


@pytest.mark.thorough
def test_list_shows_numbers_vectors_and_tables():
    done = call("list", "hypersonic/impulse")
    assert done.exit_code == 0, done.output
    assert "[1e-05,500,1e-05,6]" in done.stdout  # Q of the filter
    assert "2x9 numbers" in done.stdout  # K
    assert "moment | normal-force" in done.stdout


def test_run_json_has_the_documented_keys():
    done = call("run", NAME, "--duration", "2", "--seed", "3", "--json")
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert set(result) >= {"scenario", "seed", "backend", "duration_s", "wall_s", "real", "ideal"}
    assert (result["scenario"], result["seed"], result["duration_s"]) == (NAME, 3, 2.0)
    for side in ("real", "ideal"):
        assert set(result[side]["metrics"]) == SIGNALS
        assert all(set(m) == METRICS for m in result[side]["metrics"].values())
        assert set(result[side]["final"]) >= SIGNALS
        assert result[side]["mode_switches"] == 0


def test_run_is_reproducible_and_depends_on_seed():
    one, again, other = (
        json.loads(call("run", NAME, "--duration", "1", "--no-ideal", "--seed", s, "--json").stdout)["real"]
        for s in (1, 1, 2)
    )
    assert one == again
    assert one != other


def test_setting_changes_flight_and_removing_noise_reduces_error():
    base = json.loads(call("run", NAME, "--json").stdout)
    heavy = json.loads(call("run", NAME, "--set", "world.vehicle.mass=5", "--json").stdout)
    quiet = json.loads(call("run", NAME, "--without", "navigation-error", "--json").stdout)
    assert heavy["real"]["final"] != base["real"]["final"]
    rms = [r["real"]["metrics"]["yaw_rate"]["tail_rms"] for r in (quiet, base)]
    assert rms[0] < rms[1]


@pytest.mark.thorough
def test_scenario_choice_is_a_setting():
    words = ("run", "hovercraft/heading-bang-bang", "--duration", "3", "--json")
    rest, moving = (json.loads(call(*words, *more).stdout)["ideal"] for more in ((), ("--set", "initial=moving")))
    assert rest["metrics"]["heading"]["first_reach_s"] < 2
    assert moving["metrics"]["heading"]["first_reach_s"] is None


@pytest.mark.thorough
def test_out_option_writes_readable_log_and_picture(tmp_path):
    out = tmp_path / "new" / "flight"
    done = call("run", NAME, "--duration", "1", "--out", out)
    assert done.exit_code == 0, done.output
    assert (out / "run.png").read_bytes().startswith(b"\x89PNG")
    log = read_mcap(out / "run.mcap")
    assert log.metadata["scenario"] == NAME
    assert log.metadata["parameters"]["world.vehicle.mass"] == 2.6
    assert log.unit("truth.yaw_rate") == "rad/s"
    twin = read_mcap(out / "ideal.mcap")
    assert len(twin) == len(log)
    assert "sensors.truth.value.yaw_rate" in twin.paths
    assert "sensors.navigation.value.yaw_rate" in log.paths


def test_run_depends_only_on_seed_and_run_number():
    flown = [call("run", NAME, "--duration", "1", "--no-ideal", "--seed", "3", "--run", k, "--json") for k in "0770"]
    numbers = [json.loads(one.stdout) for one in flown]
    assert [n["run"] for n in numbers] == [0, 7, 7, 0]
    metrics = [n["real"]["metrics"] for n in numbers]
    assert metrics[1] == metrics[2] != metrics[0] == metrics[3]


def test_demo_prints_path_of_its_picture(tmp_path, monkeypatch):
    """Uses a scenario that compiles quickly."""
    monkeypatch.setattr("trimtab.commands.demo.SCENARIO", NAME)
    done = call("demo", "--out", tmp_path)
    assert done.exit_code == 0, done.output
    assert str(tmp_path / "trimtab-demo.png") in done.stdout.replace("\n", "")
    assert (tmp_path / "trimtab-demo.png").stat().st_size > 20_000
    assert re.match(r"real:  not at rest: yaw_rate .*\nideal: at rest after \d+\.\d+ s\n", done.stdout)
    assert "The right side shows the path" in done.stdout


@pytest.mark.thorough
def test_demo_verdict_matches_settling_times(tmp_path):
    """Both flights reach the target, the real one later than the ideal one."""
    flown, latest = json.loads(call("demo", "--out", tmp_path, "--json").stdout), {}
    for side in ("real", "ideal"):
        settled = [m["settling_s"] for m in flown[side]["metrics"].values() if m["settling_s"] is not None]
        latest[side] = max(settled)
        assert flown[side]["verdict"] == {"on_target": True, "says": f"on target after {latest[side]:.3g} s"}
    assert latest["real"] > latest["ideal"]


REFUSED = {
    "unknown scenario": (("hovercraft/zero-velocty",), ("zero-velocty", "Choices", "hovercraft/zero-velocity", "Fix")),
    "no family": (("nowhere:scenario",), ("nowhere", "Fix")),
    "unknown path": ((NAME, "--set", "world.vehicle.mas=3"), ("world.vehicle.mas", "world.vehicle.mass", "Fix")),
    "path of a part": ((NAME, "--set", "world.vehicle=3"), ("world.vehicle", "world.vehicle.mass")),
    "no equals sign": ((NAME, "--set", "world.vehicle.mass"), ("path=value",)),
    "text for a number": ((NAME, "--set", "world.vehicle.mass=heavy"), ("world.vehicle.mass", "'heavy'", "kg")),
    "a list for a number": ((NAME, "--set", "world.vehicle.mass=[1,2]"), ("world.vehicle.mass", "shape")),
    "nan": ((NAME, "--set", "world.vehicle.mass=nan"), ("world.vehicle.mass", "not finite", "kg")),
    "infinity": ((NAME, "--set", "autopilot.law.k1=inf"), ("autopilot.law.k1", "not finite")),
    "negative mass": ((NAME, "--set", "world.vehicle.mass=-1"), ("world.vehicle.mass", "-1", "above 0", "Fix")),
    "zero mass": ((NAME, "--set", "world.vehicle.mass=0"), ("world.vehicle.mass", "above 0")),
    "period of zero": ((NAME, "--set", "autopilot.period=0"), ("autopilot.period", "too short", "Fix")),
    "sensor period of zero": ((NAME, "--set", "world.sensors.navigation.period=0"), ("navigation.period", "short")),
    "negative delay": ((NAME, "--set", "world.downlink.steps=-1"), ("world.downlink", "-1", "Fix")),
    "negative duration": ((NAME, "--duration", "-3"), ("duration", "short")),
    "duration in words": ((NAME, "--duration", "long"), ("duration", "'long'", "Fix")),
    "not a choice": (("hovercraft/heading-proportional", "--set", "initial=flying"), ("flying", "moving", "rest")),
    "not an option": (("hovercraft/heading-proportional", "--set", "autopilot.law.form=x"), ("floored", "literal")),
    "unknown fault": ((NAME, "--without", "gravity"), ("gravity", "navigation-error", "Fix")),
    "negative seed": ((NAME, "--seed", "-1"), ("-1", "seed")),
    "out is a file's child": ((NAME, "--out", "/dev/null/flight"), ("--out", "/dev/null", "Fix")),
    "plot without ending": ((NAME, "--plot", "picture"), ("--plot", ".png")),
}


@pytest.mark.parametrize(("words", "says"), REFUSED.values(), ids=REFUSED)
def test_refused_input_names_part_value_choices_and_fix(words, says, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = call("run", *words, "--json")
    assert done.exit_code == 2
    assert set(json.loads(done.stdout)["error"]) == {"part", "problem", "choices", "fix"}
    assert "Traceback" not in done.stderr
    for text in says:
        assert text in done.stderr
    assert list(tmp_path.iterdir()) == []  # nothing half-written


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["export"], "trimtab export hovercraft/zero-velocity --out DIR"),
        (["export", NAME], "--out autopilot"),
        (["export", NAME, "--fly", "--out", "x"], "--target cortex-m7 --fly"),
        (["export", "--verify", "nowhere"], "trimtab export SCENARIO --out DIR"),
        (["run", NAME, "--seed", "-1"], "--seed 0"),
    ],
)
def test_unsupported_commands_are_rejected_with_command_to_type(words, says):
    done = call(*words)
    assert done.exit_code == 2
    assert says in done.stderr


@pytest.mark.thorough
def test_backend_can_be_chosen():
    words = ("run", NAME, "--duration", "1", "--no-ideal", "--json")
    found = [json.loads(call(*words, "--backend", b).stdout) for b in ("c", "jax")]
    assert [f["backend"] for f in found] == ["c", "jax"]
    for path, value in found[0]["real"]["final"].items():
        assert value == pytest.approx(found[1]["real"]["final"][path], abs=1e-9)


def test_synonyms_point_to_existing_verbs():
    for words in SYNONYMS.values():
        verb = words.split()[0]
        assert verb in main.commands or verb in ("--help", "--version"), words


@pytest.mark.parametrize(
    ("line", "fix"),
    [
        ("tune hovercraft/zero-velocity", "Fix: trimtab tune hovercraft/"),
        ("run", "Fix: trimtab run hovercraft/"),
        ("map hovercraft/zero-velocity --y loss=0:0.9", "Fix: trimtab map "),
        ("calibrate thrust", "Fix: trimtab calibrate thrust "),
        ("run spin", "Fix: trimtab run hovercraft/spin"),
        ("run HOVERCRAFT/SPIN", "Fix: trimtab run hovercraft/spin"),
        ("run nothing.py", "file not found"),
        ("run hovercraft/spin --without navigation", "--without navigation-error"),
        ("run hovercraft/spin --seed", "Fix: trimtab run "),
        ("export --verify", "Fix: trimtab export "),
    ],
)
def test_errors_end_with_the_command_to_type(line, fix):
    said = CliRunner().invoke(main, line.split())
    assert said.exit_code == 2
    assert fix in said.stderr
