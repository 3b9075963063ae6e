"""`trimtab design VEHICLE --stabilisability`: verdicts on vehicles of the package and on user files."""

import json

import pytest
from click.testing import CliRunner

from trimtab.cli import main

OWN = """
import jax.numpy as jnp
from trimtab.design.model import model_of_functions

def rates(x, FX, FY, N):
    c, s = jnp.cos(x[5]), jnp.sin(x[5])
    return jnp.stack([x[1] * x[2] + FX, -x[0] * x[2] + FY, N, c * x[0] - s * x[1], s * x[0] + c * x[1], x[2]])

STATES = ("u", "v", "r", "north", "east", "heading")

def system():
    return model_of_functions(lambda x, u: rates(x, u[0], u[1], u[2]), STATES, ("FX", "FY", "N"))

def tail():
    return model_of_functions(lambda x, u: rates(x, u[0], u[1], -3 * u[1]), STATES, ("FX", "FY"))

def moving():
    return model_of_functions(lambda x, u: rates(x, u[0], u[1], u[2]), STATES, ("FX", "FY", "N"), x0=[1, 0, 0, 0, 0, 0])

def three():
    return 3
"""


@pytest.fixture
def own(tmp_path):
    file = tmp_path / "my_boat.py"
    file.write_text(OWN, encoding="utf-8")
    return file


def call(*words):
    return CliRunner().invoke(main, ["design", *map(str, words), "--stabilisability"])


def verdicts(*words):
    done = call(*words, "--json")
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


@pytest.mark.thorough
def test_hovercraft_fails_both_conditions_but_is_accessible():
    found = verdicts("hovercraft")
    assert found["is_excluded"]
    assert found["brockett"]["is_excluded"]
    ranks = found["byrnes_isidori"]
    assert (ranks["is_excluded"], ranks["rank_inputs"], ranks["n1"], ranks["rank_f2"]) == (True, 2, 3, 3)
    assert ranks["cascade"]["x1"] == ["surge_velocity", "sway_velocity", "yaw_rate"]
    assert found["brockett"]["controllability_rank"] == 4
    reach = found["accessibility"]
    assert (reach["rank"], reach["is_accessible"], reach["is_stlc"]) == (6, True, True)


@pytest.mark.thorough
def test_user_file_without_yaw_actuator_is_excluded(own):
    text = call(f"{own}:tail").output
    for word in (
        "EXCLUDED",
        "[FY, [f, FX]]",
        "6 of 6 directions",
        "2 independent inputs for the 3 states x1",
        "Sussmann",
    ):
        assert word in text


@pytest.mark.thorough
def test_fully_actuated_vehicle_is_not_excluded(own):
    found = verdicts(own)
    assert not found["is_excluded"]
    assert not found["brockett"]["is_excluded"]
    assert not found["byrnes_isidori"]["is_excluded"]
    assert found["byrnes_isidori"]["rank_inputs"] == 3
    assert found["accessibility"]["is_linear"]
    assert "EXCLUDED" not in call(own).output


@pytest.mark.thorough
def test_hypersonic_vehicle_is_not_excluded():
    found = verdicts("hypersonic")
    assert not found["is_excluded"]
    assert found["byrnes_isidori"] is None
    assert found["brockett"]["controllability_rank"] == 9
    assert found["accessibility"]["is_linear"]


def test_invalid_arguments_are_rejected_with_command_to_type(own):
    for words, wanted in (
        ((), "trimtab design hovercraft --stabilisability"),
        (("hoverkraft",), "trimtab design hovercraft --stabilisability"),
        ((f"{own}:moving",), "trimtab.design.trim finds one"),
        ((f"{own}:three",), "model_of_functions"),
        (("hovercraft", "--set", "k=1"), "leave --set out"),
        (("hovercraft", "--out", "x.json"), "leave --out out"),
    ):
        done = call(*words)
        assert done.exit_code == 2, done.output
        assert wanted in done.output
