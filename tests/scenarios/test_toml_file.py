"""Scenario files: their content sets the scenario, and errors name the line."""

import json
import re

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.record import leaves
from trimtab.laws.spin import ConstantSpin
from trimtab.laws.velocity import ForwardMomentum
from trimtab.links.wire import DelayChain, Wire
from trimtab.logs.metrics import Target
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue
from trimtab.scenarios.build import build
from trimtab.scenarios.recorded import rebuild_scenario
from trimtab.scenarios.toml_file import find_places, merge_settings
from trimtab.scenarios.toml_text import format_scenario, scenario_schema

SPIN = """
base = "hovercraft/spin"
name = "slow-spin"
duration = "2 s"
without = ["dead-zone"]
faults = ["downlink off @ 1 s for 200 ms"]

[choices]
navigation = "errors"
predictor = "on"

[world.vehicle]
mass = "3000 g"

[autopilot.law]
part = "ConstantSpin"
reference = "120 deg/s"

[[targets]]
signal = "yaw_rate"
value = "120 deg/s"
band = 0.15
"""
WHOLE = """
duration = "1 s"
world.vehicle.part = "Hovercraft"
world.actuators.part = "FanDrive"
world.sensors.navigation.part = "NavigationErrors"
world.uplink = { part = "DelayChain", period = "20 ms", steps = 2 }

[autopilot]
allocation.part = "ThrustVectorAllocation"
estimator = { part = "Passthrough", sensor = "navigation" }

[autopilot.law]
part = "ForwardMomentum"
reference = 2.8

[initial]
part = "HovercraftState"
yaw_rate = "20 deg/s"
"""


def write(folder, text, name="my.toml"):
    file = folder / name
    file.write_text(text, encoding="utf-8")
    return str(file)


def test_file_overrides_settings_of_its_base(tmp_path):
    scenario = build(write(tmp_path, SPIN), {"world.vehicle.arm": "30 cm"})
    by_hand = build(
        "hovercraft/spin",
        {
            "duration": "2 s",
            "predictor": "on",
            "world.vehicle.mass": "3",
            "world.vehicle.arm": "0.3",
            "autopilot.law": "ConstantSpin",
            "autopilot.law.reference": repr(120 * np.pi / 180),
        },
        ["dead-zone"],
        ["downlink off @ 1 s for 200 ms"],
    )
    assert isinstance(scenario.autopilot.law, ConstantSpin)
    assert scenario.name == "slow-spin"
    assert scenario.targets == (Target("truth.yaw_rate", 120 * np.pi / 180, 0.15),)
    assert_alike(scenario, by_hand)


def assert_alike(one, other):
    left, right = ({p: v for p, v, _ in leaves(s) if p != "name"} for s in (one, other))
    assert left.keys() == right.keys()
    for path, value in left.items():
        np.testing.assert_array_equal(value, right[path], err_msg=path)


def test_file_builds_a_scenario_from_parts(tmp_path):
    scenario = build(write(tmp_path, WHOLE))
    assert isinstance(scenario.autopilot.law, ForwardMomentum)
    assert isinstance(scenario.world.downlink, Wire)
    assert isinstance(scenario.world.uplink, DelayChain)
    assert (scenario.world.uplink.period, scenario.world.uplink.steps) == (200_000, 2)
    assert scenario.initial.yaw_rate == pytest.approx(np.radians(20))


@pytest.mark.thorough
@pytest.mark.parametrize("text", [SPIN, WHOLE])
def test_flight_log_is_rebuilt_without_the_file(tmp_path, text):
    name = write(tmp_path, text)
    log = simulate(build(name), seed=3)
    (tmp_path / "my.toml").unlink()
    assert_alike(rebuild_scenario(log), build(write(tmp_path, text)))


@pytest.mark.parametrize("name", ["hovercraft/spin", "quadrotor/track"])
def test_written_scenario_file_round_trips_bit_for_bit(tmp_path, name):
    scenario = catalogue.load_scenario(name)[0]
    text = format_scenario(name, scenario, catalogue.scenario_choices(name))
    again = build(write(tmp_path, text))
    assert_alike(again, scenario)
    assert again.targets == scenario.targets


@pytest.mark.thorough
@pytest.mark.parametrize("name", catalogue.scenario_names())
def test_every_scenario_file_round_trips_bit_for_bit(tmp_path, name):
    test_written_scenario_file_round_trips_bit_for_bit(tmp_path, name)


@pytest.mark.thorough
def test_schema_accepts_written_files_and_rejects_unknown_fields():
    import tomllib

    import jsonschema

    schema = json.loads(json.dumps(scenario_schema()))
    check = jsonschema.Draft202012Validator(schema)
    check.check_schema(schema)
    for name in catalogue.scenario_names():
        text = format_scenario(name, catalogue.load_scenario(name)[0], {})
        assert [e.message for e in check.iter_errors(tomllib.loads(text))] == [], name
    for text in (SPIN, WHOLE):
        assert check.is_valid(tomllib.loads(text))
        assert not check.is_valid(tomllib.loads(text.replace("reference =", "referenze =")))


def test_file_can_be_based_on_another_file(tmp_path):
    write(tmp_path, SPIN, "below.toml")
    law = '[autopilot.law]\npart = "ForwardMomentum"\nk1 = "2 kg/s"\n'
    scenario = build(write(tmp_path, f'base = "below.toml"\nduration = "3 s"\n{law}'))
    assert scenario.duration == 30_000_000
    assert scenario.world.vehicle.mass == 3
    assert scenario.autopilot.law.k1 == 2
    assert scenario.name == "slow-spin"


@pytest.mark.thorough
def test_relative_paths_are_resolved_beside_the_file(tmp_path, monkeypatch):
    (tmp_path / "path.csv").write_text(
        "\n".join(["time [s],north [m],east [m]", *(f"{2 * k},{0.6 * k},0" for k in range(6))])
    )
    name = write(tmp_path, 'base = "hovercraft/track"\n[choices]\nreference = "path.csv"\n')
    monkeypatch.chdir(tmp_path.parent)
    assert float(build(name).autopilot.law.reference.at(10.0).place[0]) == pytest.approx(3)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            'base = "hovercraft/spin"\n[world.vehicle]\nmass = "3 m"',
            r"my.toml:3:1: world.vehicle.mass: 'm' is not a unit",
        ),
        ('base = "hovercraft/spin"\n[world.vehicle]\n  mas = 3', r"my.toml:3:3: world.vehicle.mas: unknown setting"),
        ('base = "hovercraft/spin"\n[world.vehicle]\nmass = -1', r"my.toml:3:1: world.vehicle.mass: -1 kg is out of"),
        ("[world.vehicle\nmass = 3", r"my.toml:1:15: Expected ']'"),
        ("a = 1\na = 2", r"my.toml:2:6: Cannot overwrite"),
        ('base = "hovercraft/spn"', r"my.toml:1:1: scenario 'hovercraft/spn'"),
        ('base = "my_boat.py:scenario"', r"my.toml:1:1: base: .* must not run code"),
        ('base = "my.toml"', r"my.toml:1:1: base: .* itself based on this file"),
        ('base = "hovercraft/spin"\n[choices]\nlinks = "chan"', r"my.toml:3:1: links: 'chan' is not a choice"),
        ('base = "hovercraft/spin"\nwithout = ["x"]', r"my.toml:2:1: .*no imperfection 'x'"),
        ('base = "hovercraft/spin"\nfaults = ["downlink of"]', r"my.toml:2:1: "),
        ('base = "hovercraft/spin"\nfaults = "downlink off"', r"my.toml:2:1: faults: .* is not a list of texts"),
        ('base = "hovercraft/spin"\nduration = 1979-05-27', r"my.toml:2:1: duration: .* is a date"),
        ('base = "hovercraft/spin"\n[[targets]]\nsignal = "yaw_rate"', r"my.toml:2:1: targets: 'value' is missing"),
        (
            'base = "hovercraft/spin"\n[[targets]]\nsignal = "yaw_rate"\nvalue = "3 m"\nband = 1',
            r"my.toml:2:1: targets.value: 'm' is not a unit",
        ),
        ('base = "hovercraft/spin"\n[autopilot.law]\npart = "Spni"', r"my.toml:3:1: autopilot.law: unknown part"),
        ('base = "hovercraft/spin"\n[world.actuators]\npart = "none"', r"my.toml:3:1: world.actuators: .*be left out"),
        ('[world.vehicle]\npart = "Hovercraft"', r"my.toml: world.actuators: this part of the scenario is missing"),
    ],
)
def test_invalid_file_error_names_the_line(tmp_path, text, said):
    with pytest.raises(InputError, match=said) as refused:
        build(write(tmp_path, text))
    assert refused.value.fix
    assert "settings=" not in refused.value.fix


def test_late_fault_is_accepted_only_outside_virtual_time(tmp_path):
    file = tmp_path / "slow.toml"
    file.write_text(SPIN)
    late = ["uplink off @ 500 s"]
    with pytest.raises(InputError, match="the flight ends at 2 s"):
        build(str(file), faults=late)
    assert late[0] in build(str(file), faults=late, in_virtual_time=False).choices["faults"]


def test_wrong_command_line_setting_names_no_file_line(tmp_path):
    with pytest.raises(InputError, match=r"^settings world.vehicle.mass"):
        build(write(tmp_path, SPIN), {"world.vehicle.mass": "3 m"})


def test_rejects_missing_and_non_utf8_files(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        build(str(tmp_path / "none.toml"))
    (tmp_path / "odd.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="not UTF-8"):
        build(str(tmp_path / "odd.toml"))


def test_finds_line_and_column_of_each_key():
    text = 'a = 1\n[t]\n  b.c = [\n  1, # [x]\n]\n["q".r]\nd = """\ne = 1\n"""\nf = "[" # ]\n[[u]]\ng = 2\n'
    assert find_places(text) == {
        "a": (1, 1),
        "t": (2, 1),
        "t.b.c": (3, 3),
        "q.r": (6, 1),
        "q.r.d": (7, 1),
        "q.r.f": (10, 1),
        "u": (11, 1),
        "u.g": (12, 1),
    }


def test_replacing_a_part_drops_its_inherited_settings():
    below = {"autopilot.law": "ConstantSpin", "autopilot.law.k1": "1", "autopilot.lawn": "2"}
    assert merge_settings(below, {"autopilot.law": "ForwardMomentum"}) == {
        "autopilot.law": "ForwardMomentum",
        "autopilot.lawn": "2",
    }
    assert merge_settings(below, {"autopilot.law": "ConstantSpin"}) == below


def test_fix_is_written_in_toml_syntax(tmp_path):
    with pytest.raises(InputError) as refused:
        build(write(tmp_path, 'base = "hovercraft/spin"\n[world.vehicle]\nmass = "3 m"'))
    assert re.search(r'\[world\.vehicle\] mass = "3 kg"', refused.value.fix)
