"""Vehicle models in the autopilot: rejected if they differ from each other, reported if they differ from the world."""

import json

import pytest
from click.testing import CliRunner

from trimtab.analysis.campaign.campaign import Campaign
from trimtab.cli import main
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.loop.model_mismatch import check_models, describe_mismatches, model_mismatches, vehicle_copies
from trimtab.run.program import describe_scenario
from trimtab.scenarios.build import build

SPIN, CLIMB = "hovercraft/spin", "hypersonic/climb-small"
PREVIEW = {"internal": "preview"}


def mismatches(scenario):
    return model_mismatches(scenario.autopilot, scenario.world.vehicle)


@pytest.mark.thorough
def test_finds_every_copy_of_the_vehicle_model():
    for name, settings, copies in (
        ("hovercraft/forward", {}, ["law.model"]),
        ("hovercraft/heading-bang-bang", {}, ["law.damping.model", "law.turning.model"]),
        (SPIN, {}, ["law.braking.model", "law.spinning.model"]),
        (CLIMB, PREVIEW, ["estimator.craft", "law.internal.craft", "law.craft"]),
    ):
        scenario = build(name, settings)
        found = vehicle_copies(scenario.autopilot, scenario.world.vehicle)
        assert list(found) == [f"autopilot.{copy}" for copy in copies]
        assert mismatches(scenario) == []


@pytest.mark.thorough
@pytest.mark.parametrize("copy", ["estimator.craft", "law.craft", "law.internal.craft"])
def test_rejects_differing_autopilot_copies_with_values_and_fix(copy):
    path = f"autopilot.{copy}.m"
    alike = {f"autopilot.{c}.m": "301" for c in ("estimator.craft", "law.craft", "law.internal.craft")}
    with pytest.raises(InputError) as refused:
        build(CLIMB, {**PREVIEW, path: "301"})
    text = str(refused.value)
    assert path in text
    assert "301" in text
    assert "300" in text
    assert 'settings={"mismatch": "' in text
    reported, value = text.partition(":")[0], "300" if copy == "estimator.craft" else "301"
    assert all(f'settings={{"{p}": "{value}"}}' in text for p in {*alike, path} - {reported})
    assert [m.path for m in mismatches(build(CLIMB, {**PREVIEW, **alike}))] == ["m"]


@pytest.mark.thorough
def test_declared_mismatch_is_allowed_and_reported_with_its_path():
    path = "autopilot.law.internal.craft"
    scenario = build(CLIMB, {**PREVIEW, f"{path}.m": "301", "mismatch": path})
    assert describe_mismatches([m._asdict() for m in mismatches(scenario)]) == (
        f"model ≠ world: {path}.m 301 vs 300 (intended)"
    )
    for other in ("autopilot.law.craft", "autopilot.law.internal.craft.modes"):
        with pytest.raises(InputError, match="two parts have different models"):
            build(CLIMB, {**PREVIEW, f"{path}.m": "301", "mismatch": other})
    with pytest.raises(InputError, match="is not the path of a vehicle model"):
        build(CLIMB, {"mismatch": "autopilot.law.command"})


def test_laws_of_a_state_machine_share_one_vehicle_model():
    with pytest.raises(InputError, match=r"spinning\.model\.mass: .* is 3, but .*braking\.model\.mass is 2\.6"):
        build(SPIN, {"autopilot.law.spinning.model.mass": "3"})
    assert build(SPIN, {f"autopilot.law.{law}.model.mass": "3" for law in ("spinning", "braking")})


@pytest.mark.thorough
def test_differing_vehicle_is_allowed_and_reported():
    heavy = build(SPIN, {"world.vehicle.mass": "3", "world.vehicle.friction.torque_viscous": "0.02"})
    assert [tuple(m) for m in mismatches(heavy)] == [("friction", "none", "there"), ("mass", "2.6", "3")]
    assert describe_scenario(heavy)["mismatch"][1] == {"path": "mass", "assumed": "2.6", "actual": "3"}
    assert "mismatch" not in describe_scenario(build(SPIN))
    assert mismatches(build("hypersonic/mismatch"))
    Campaign(SPIN, runs=4, spread={"world.vehicle.mass": "normal(100%, 5%)"})


def test_campaign_rejects_spreading_an_undeclared_model_copy():
    spread = {"autopilot.law.spinning.model.mass": "uniform(90%, 110%)"}
    with pytest.raises(InputError, match="two parts have different models"):
        Campaign(SPIN, runs=4, spread=spread)
    Campaign(SPIN, runs=4, spread=spread, settings={"mismatch": "autopilot.law.spinning.model"})


def test_nan_model_value_is_reported_as_not_finite():
    with pytest.raises(InputError, match="not finite"):
        build(SPIN, {"autopilot.law.spinning.model.mass": "nan"})


def test_autopilot_without_model_copies_has_no_mismatch():
    scenario = build("navigation/still")
    check_models(scenario.autopilot, scenario.world.vehicle)
    assert describe_mismatches([]) == ""


@pytest.mark.thorough
def test_long_mismatch_list_is_shortened_with_a_count():
    craft = build(CLIMB).world.vehicle
    air = {name: 1.1 * getattr(craft.forces.aerodynamics, name) for name in ("CL_a", "CL_0", "CD_a", "CM_a", "CM_0")}
    modes = replace(craft.modes, w1=17.0, w2=19.0)
    plant = replace(
        craft, modes=modes, forces=replace(craft.forces, aerodynamics=replace(craft.forces.aerodynamics, **air))
    )
    scenario = build(CLIMB)
    line = describe_mismatches([m._asdict() for m in model_mismatches(scenario.autopilot, plant)])
    assert line.endswith(" and 1 more (intended)")


@pytest.mark.thorough
def test_command_line_reports_the_mismatch():
    words = ["run", SPIN, "--set", "world.vehicle.mass=3", "--set", "duration=1", "--no-ideal"]
    assert "model ≠ world: mass 2.6 vs 3 (intended)" in CliRunner().invoke(main, words).output
    printed = json.loads(CliRunner().invoke(main, [*words, "--json"]).output)
    assert printed["mismatch"] == [{"path": "mass", "assumed": "2.6", "actual": "3"}]
    listed = CliRunner().invoke(main, ["list", "hypersonic/mismatch", "--json"]).output
    assert {m["path"] for m in json.loads(listed)["mismatch"]} >= {"m", "forces.propulsion.b7"}
