"""Flights with a gain of `trimtab design VEHICLE --lqr`: four vehicles, all commands, and invalid gains."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from trimtab import build, simulate
from trimtab.cli import main
from trimtab.core.errors import InputError
from trimtab.design.certificate_file import certificate_json, read_certificate
from trimtab.logs.mcap import read_mcap
from trimtab.loop.model_mismatch import model_mismatches
from trimtab.scenarios.catalogue import GAIN
from trimtab.scenarios.recorded import rebuild_scenario

CART = ("cart-pole/swing-up", {"start": "leaning"})
DESIGNS = {
    "cart-pole/swing-up": "--at angle=0 --limit position=1 --limit speed=1 --limit angle=0.2 --limit angle_rate=1"
    " --limit force=10",
    "quadrotor/track": "--set trajectory=place --limit position=0.5 --limit velocity=1 --limit attitude=0.2"
    " --limit rate=2 --limit rotor_speed=100 --limit speed=60",
    "vessel/path": "--set weather=calm --at surge_velocity=0.5 --at heading=0 --fast rudder --fast shaft_speed"
    " --limit surge_velocity=0.1 --limit sway_velocity=0.1 --limit yaw_rate=0.2 --limit heading=0.2"
    " --limit u.rudder=0.3 --limit u.shaft_speed=20",
    "f16/gcas": "--at speed=153.0096 --at roll=0 --at beta=0 --at yaw=0 --fast power --limit speed=5 --limit alpha=0.05"
    " --limit beta=0.05 --limit roll=0.3 --limit pitch=0.1 --limit roll_rate=0.5 --limit pitch_rate=0.2"
    " --limit yaw_rate=0.2 --limit altitude=20 --limit elevator=0.09 --limit aileron=0.09 --limit rudder=0.09"
    " --limit throttle=0.2",
}


def call(*words):
    return CliRunner().invoke(main, list(map(str, words)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("gains")


def design(folder, name, *more):
    """Return the file of a designed gain; cached per arguments."""
    file = folder / f"{name.replace('/', '-')}{'-'.join(more)}.json".replace(" ", "")
    if not file.exists():
        done = call("design", name, "--lqr", *DESIGNS[name].split(), *more, "--out", file)
        assert done.exit_code == 0, done.output
    return file


@pytest.mark.thorough
def test_gain_file_replaces_the_law_about_its_trim(folder):
    file = design(folder, CART[0])
    certificate, _ = read_certificate(file)
    name, settings = CART
    scenario = build(name, {**settings, GAIN: str(file)})
    law = scenario.autopilot.law
    assert law.reads == ("position", "speed", "angle", "angle_rate")
    np.testing.assert_array_equal(law.K, certificate.K)
    np.testing.assert_array_equal(law.x0, [0, 0, 0, 0])
    assert {t.path for t in scenario.targets} == {"truth.position", "truth.speed", "truth.angle"}
    log = simulate(scenario, duration="8 s")
    assert abs(log["truth.angle"][0]) == pytest.approx(0.2)
    assert np.abs(log["truth.position"][-100:]).max() < 0.02
    assert np.abs(log["truth.angle"][-100:]).max() < 0.01


@pytest.mark.thorough
def test_the_law_assumes_the_vehicle_of_its_design(folder):
    file = design(folder, CART[0], "--assume", "world.vehicle.pole_mass=0.15")
    name, settings = CART
    scenario = build(name, {**settings, GAIN: str(file), "world.vehicle.pole_mass": "0.2"})
    told = [m for m in model_mismatches(scenario.autopilot, scenario.world.vehicle) if m.path == "pole_mass"]
    assert [(m.assumed, m.actual) for m in told] == [("0.15", "0.2")]
    short = design(folder, CART[0], "--assume", "pole_mass=0.15")
    np.testing.assert_array_equal(read_certificate(file)[0].K, read_certificate(short)[0].K)
    assert not np.allclose(read_certificate(file)[0].K, read_certificate(design(folder, CART[0]))[0].K, rtol=1e-3)


@pytest.mark.thorough
def test_log_is_rebuilt_without_the_gain_file(folder, tmp_path):
    name, settings = CART
    file = tmp_path / "gone.json"
    file.write_text(design(folder, name).read_text(encoding="utf-8"), encoding="utf-8")
    scenario = build(name, {**settings, GAIN: str(file)})
    log = simulate(scenario, duration="100 ms")
    file.unlink()
    again = rebuild_scenario(log)
    np.testing.assert_array_equal(again.autopilot.law.K, scenario.autopilot.law.K)
    np.testing.assert_array_equal(simulate(again, duration="100 ms")["command.value.force"], log["command.value.force"])


def test_rejects_gains_that_do_not_fit(folder, tmp_path):
    name, settings = CART
    file = design(folder, name)
    certificate, _ = read_certificate(file)

    def written(**changes):
        new = tmp_path / "new.json"
        new.write_text(certificate_json(certificate._replace(**changes)), encoding="utf-8")
        return str(new)

    def refusal(scenario=name, **more):
        with pytest.raises(InputError) as refused:
            build(scenario, {**(settings if scenario == name else {}), **more})
        return str(refused.value)

    about = certificate.about
    text = refusal("quadrotor/track", gain=str(file))
    assert "for a CartPole (cart-pole/swing-up), but the scenario has a Multirotor" in text
    assert "trimtab design" in text
    units = about["units"].replace("position m", "position ft")
    assert "'position m' in this scenario" in refusal(gain=written(about={**about, "units": units}))
    plain = {n: v for n, v in about.items() if n != "vehicle"}
    assert "not a gain for the states of a vehicle" in refusal(gain=written(about=plain))
    assert "designed with a calibration" in refusal(gain=written(about={**about, "set": "calibration=boat.toml"}))
    states = ("position", "speed", "angle", "lean_rate")
    assert "'lean_rate', which is not a state of the vehicle" in refusal(gain=written(states=states))
    assert "cannot be read" in refusal(gain=str(tmp_path / "none.json"))
    changed = tmp_path / "changed.json"
    changed.write_text(file.read_text(encoding="utf-8").replace('"cart-pole/swing-up"', '"cart-pole/swing"'), "utf-8")
    assert "its digest does not match its content" in refusal(gain=str(changed))
    text = refusal(gain=str(file), **{"autopilot.period": "200 ms", "world.actuators.period": "200 ms"})
    assert "the loop is not stable with a control period of 200 ms" in text
    assert "keeps one trim" in refusal("hovercraft/track", gain=str(file), reference="circle(radius=1, period=20)")


@pytest.mark.thorough
def test_gain_on_unestimated_states_suggests_fast_states(folder):
    file = folder / "whole.json"
    words = DESIGNS["vessel/path"].replace(
        "--fast rudder --fast shaft_speed", "--limit rudder=1 --limit shaft_speed=90"
    )
    assert call("design", "vessel/path", "--lqr", *words.split(), "--out", file).exit_code == 0
    with pytest.raises(InputError, match="feeds back rudder, shaft_speed") as refused:
        build("vessel/path", {GAIN: str(file)})
    assert "--fast rudder --fast shaft_speed" in str(refused.value)


@pytest.mark.thorough
def test_rejects_unstable_or_unknown_fast_states():
    words = DESIGNS["cart-pole/swing-up"].split()
    done = call("design", "cart-pole/swing-up", "--lqr", "--fast", "angle", "--fast", "angle_rate", *words[:6])
    assert done.exit_code == 2
    assert "must be stable" in done.output
    done = call("design", "cart-pole/swing-up", "--lqr", "--fast", "engle", *words)
    assert done.exit_code == 2
    assert "no such state" in done.output


@pytest.mark.thorough
def test_certificate_proves_the_loop_with_fast_states(folder):
    """A gain designed without fast states is proved for the loop with them, or reported as not proved."""
    file = design(folder, "vessel/path")
    assert set(read_certificate(file)[0].recorded) == {"loop with fast states"}
    hasty = DESIGNS["vessel/path"].replace("heading=0.2", "heading=0.001").replace("yaw_rate=0.2", "yaw_rate=0.1")
    done = call("design", "vessel/path", "--lqr", *hasty.split())
    assert done.exit_code == 1
    assert "NOT proved: loop with fast states" in done.output


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "settings", "seconds", "within"),
    [
        ("quadrotor/track", {"trajectory": "place", "initial.position": "[0.8, -0.4, -3.2]"}, 10, 0.02),
        ("vessel/path", {"weather": "calm", "initial.heading": "0.3"}, 60, 0.04),
        ("f16/gcas", {"initial.pitch": "0.1", "initial.roll": "0.3", "initial.speed": "155"}, 15, 4.0),
    ],
)
def test_gain_brings_other_vehicles_to_their_trim(folder, name, settings, seconds, within):
    file = design(folder, name)
    assert call("design", name, "--lqr", "--check", file).exit_code == 0
    scenario = build(name, {**settings, GAIN: str(file)})
    log = simulate(scenario, duration=f"{seconds} s")
    state = {"quadrotor/track": "position", "vessel/path": "heading", "f16/gcas": "altitude"}[name]
    begin = {"position": [0.3, -0.4, -3.0], "heading": 0.0, "altitude": 304.8}[state]
    first, last = log[f"truth.{state}"][[0, -1]]
    assert np.abs(last - np.asarray(begin)).max() < within
    assert state == "altitude" or np.abs(first - np.asarray(begin)).max() > 5 * within


@pytest.mark.thorough
def test_wrong_mass_gives_the_documented_height_offset(folder):
    """With 20 % more mass than assumed, the hover is lower by the weight that the trim does not carry."""
    name, heavy = "quadrotor/track", {"trajectory": "place", "world.vehicle.mass": "5.208"}
    heights = {}
    for what, more in {
        "belief": (),
        "truth": ("--assume", "mass=5.208"),
        "integral": ("--integrate", "position.down=0.3"),
    }.items():
        log = simulate(build(name, {**heavy, GAIN: str(design(folder, name, *more))}), duration="10 s")
        heights[what] = float(log["truth.position"][-100:, 2].mean())
    assert heights["belief"] == pytest.approx(-2.29, abs=0.01)
    assert heights["truth"] == pytest.approx(-3.0, abs=0.005)
    assert heights["integral"] == pytest.approx(-3.0, abs=0.005)


@pytest.mark.thorough
def test_every_command_accepts_a_gain_file(folder):
    file, name = design(folder, CART[0]), CART[0]
    words = [name, "--set", "start=leaning", "--set", f"gain={file}"]
    done = call("run", *words, "--set", "duration=2", "--json", "--out", folder / "flown")
    assert done.exit_code == 0, done.output
    assert read_mcap(folder / "flown" / "run.mcap").metadata["choices"]["gain"]["system"] == name
    done = call("replay", folder / "flown" / "run.mcap")
    assert done.exit_code == 0, done.output
    spread = ["--spread", "world.vehicle.pole_mass=uniform(80%, 120%)"]
    done = call("campaign", *words, "--runs", "70", "--set", "duration=4", *spread, "--json")
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["success"]["share"] == 1.0
    for part in ((), ("--part", "loop")):
        out = folder / f"c{len(part)}"
        done = call("export", *words, "--set", "duration=2", *part, "--out", out)
        assert done.exit_code == 0, done.output
        done = call("export", "--verify", out)
        assert done.exit_code == 0, done.output
