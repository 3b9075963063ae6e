"""`trimtab replay`: exit codes, output, another estimator, and invalid choices."""

import json
import re

import numpy as np
import pytest
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.commands.foreign_logs import read_any_log, read_own_log
from trimtab.commands.replay import replace_parts
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.time import ms
from trimtab.estimators.passthrough import Passthrough
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap, write_mcap
from trimtab.logs.samples import SampleSeries, log_samples
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue
from trimtab.scenarios.recorded import rebuild_scenario

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")


def blind() -> Passthrough:
    """A user-defined estimator with the inputs of the recorded one."""
    return Passthrough("navigation")


def number() -> int:
    return 3


def call(*words):
    return CliRunner().invoke(main, ["replay", *map(str, words)])


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    scenario, _ = catalogue.load_scenario("hovercraft/spin")
    log = simulate(scenario, seed=2, duration=ms(400), log_period=ms(1), backend="c")
    return write_mcap(log, tmp_path_factory.mktemp("spin") / "run.mcap")


@pytest.fixture(scope="module")
def wrong(file):
    """The log with the last bit of one number changed."""
    log = read_mcap(file)
    values = log["law.demand.FY"].copy()
    values[250] = np.nextafter(values[250], np.inf)
    made = Log(log.t, log.ticks, {**log.signals, "law.demand.FY": values}, log.declarations, log.metadata, log.final)
    return write_mcap(made, file.with_name("wrong.mcap"))


@pytest.mark.thorough
def test_identical_replay_exits_with_0(file):
    done = call(file)
    assert (done.exit_code, done.stdout) == (0, "400 steps repeated, identical bit for bit, by backend c\n")
    found = json.loads(call(file, "--json").stdout)
    assert (found["exact"], found["equal"], found["first"], found["steps"]) == (True, True, None, 400)
    assert found["errors"]["yaw_rate"]["recorded"] == found["errors"]["yaw_rate"]["replayed"] > 0


def test_deviating_replay_exits_with_1_and_reports_first_difference(wrong):
    done = call(wrong)
    assert done.exit_code == 1
    assert "differs from 0.2500000 s on: law.demand.FY was" in done.stdout
    done = call(wrong, "--json")
    assert done.exit_code == 1
    first = json.loads(done.stdout)["first"]
    assert (first["t"], first["path"]) == (0.25, "law.demand.FY")
    assert first["recorded"] == np.nextafter(first["replayed"], np.inf)


@pytest.mark.thorough
def test_replays_with_another_estimator_and_gain_and_plots(file, tmp_path):
    picture = tmp_path / "made" / "replay.png"
    done = call(file, "--with", f"estimator={__name__}:blind", "--with", "law.spinning.k2=5", "--plot", picture)
    assert done.exit_code == 0, done.output
    assert "400 steps repeated with another autopilot" in done.stdout
    assert "yaw_rate: rms error" in done.stdout
    assert picture.stat().st_size > 5000


def test_replacement_parts_are_the_choices_of_the_scenario(file):
    log = read_mcap(file)
    scenario = rebuild_scenario(log)
    coupled, _ = catalogue.load_scenario("hovercraft/spin", {"navigation": "ins-coupled"})
    found = replace_parts(scenario, {"estimator": "ins-coupled"})
    assert type(found.estimator) is type(coupled.autopilot.estimator)
    assert type(found.law) is type(scenario.autopilot.law)


@pytest.mark.parametrize(
    ("choice", "said"),
    [
        ("estimator=gps", r"not a choice(.|\n)*ins-coupled"),
        ("estimator=nowhere:make", "nowhere"),
        ("estimator=here/mine.py:make", r"name the module, from the folder that contains it: mine:make"),
        (f"estimator={__name__}:number", "returns an object of type int, which is not a record"),
        ("law.spinning.k3=5", "unknown setting"),
        ("estimator=ins", r"reads sensor 'imu', but the recorded flight has only(.|\n)*--navigation ins"),
    ],
)
def test_rejects_unknown_replacement_parts(file, choice, said):
    done = call(file, "--with", choice)
    assert done.exit_code == 2
    assert re.search(said, done.stderr)


def looking() -> Passthrough:
    """An estimator for the log of another program."""
    return Passthrough("scale")


@pytest.fixture
def foreign(tmp_path):
    """A log of another vehicle's samples, with the truth."""
    ticks = np.arange(1, 51, dtype=np.int64) * 100_000
    weight = np.sin(np.arange(50) / 7)
    sensors = {"scale": SampleSeries(ticks, {"weight": weight})}
    return write_mcap(log_samples(sensors, SampleSeries(ticks, {"weight": weight + 0.5})), tmp_path / "mine.mcap")


def test_estimator_replay_works_without_scenario(foreign, tmp_path):
    done = call(foreign, "--estimator", "commands.test_replay:looking", "--out", tmp_path / "out.mcap")
    assert done.exit_code == 0, done.output
    assert "50 steps, 50 with a valid estimate" in done.stdout
    assert "weight: rms error 0.5" in done.stdout
    np.testing.assert_array_equal(read_mcap(tmp_path / "out.mcap")["estimate.valid"], True)
    found = json.loads(call(foreign, "--estimator", "commands.test_replay:looking", "--json").stdout)
    assert found["errors"]["weight"] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("words", "fix"),
    [(("--estimator", "planar"), "module:factory"), (("--out", "x.mcap"), "--estimator")],
)
def test_estimator_replay_requires_module_and_factory(foreign, words, fix):
    done = call(foreign, *words)
    assert done.exit_code == 2
    assert fix in done.output


def test_cut_log_and_rows_left_out_are_reported(foreign, tmp_path, capsys):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(foreign.read_bytes()[:-9])
    assert len(read_own_log(cut)) == 50
    assert capsys.readouterr().err == "warning: cut.mcap: the file is cut; 50 rows were read, the last at 0.490 s\n"
    (tmp_path / "a.csv").write_text("t,w\n0,1\n1,\n2,3\n")
    (tmp_path / "map.toml").write_text('[sensor.scale.fields]\nweight = {from = "w", unit = "kg"}\n')
    read_any_log(tmp_path / "a.csv", tmp_path / "map.toml")
    said = "warning: a.csv, scale: 1 of 3 rows are left out: weight is empty or not finite in line 3\n"
    assert capsys.readouterr().err == said


def test_mapping_with_the_unit_of_another_quantity_is_rejected(tmp_path):
    (tmp_path / "a.csv").write_text("t,x\n0,1\n1,2\n")
    fields = '[sensor.imu.fields]\nspecific_force = {from = ["x", "x", "x"], unit = "deg"}\n'
    (tmp_path / "map.toml").write_text(fields)
    done = call(tmp_path / "a.csv", "--map", tmp_path / "map.toml", "--scenario", "navigation/platform-square-wave")
    assert done.exit_code == 2, done.output
    assert "'specific_force' of sensor 'imu' must be in m/s^2, got the unit 'rad'" in done.output
