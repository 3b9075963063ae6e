"""A calibration applied to a scenario: world, autopilot, log and replay."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from trimtab.actuators.lookup import check_thrust_table
from trimtab.cli import main
from trimtab.core.errors import InputError
from trimtab.core.record import leaves
from trimtab.core.rotation import DEG
from trimtab.loop.calibrated import with_calibration
from trimtab.loop.calibration import Calibration, Covariance, Entry, format_calibration
from trimtab.run.replay import replay
from trimtab.run.simulate import simulate
from trimtab.scenarios.build import build
from trimtab.scenarios.recorded import rebuild_scenario

NAME = "hovercraft/forward"
ENTRIES = {
    "Hovercraft.inertia": Entry(0.11, "kg m^2", 0.002),
    "Thruster.coefficient": Entry(0.0125, "N/krpm^2", 1e-4),
    "RudderGeometry.ratio": Entry(1.3, "1", 0.01),
    "RudderGeometry.offset": Entry(0.02, "rad", 0.004),
    "Friction.torque_viscous": Entry(0.02, "N m s", 0.001),
    "IdentifiedGyro.b0": Entry(0.3, "1", 0.01),
}
BOAT = Calibration(
    ENTRIES,
    (Covariance(("RudderGeometry.ratio", "RudderGeometry.offset"), [[1e-4, 2e-5], [2e-5, 1.6e-5]]),),
)


def test_calibrated_value_reaches_every_copy_and_rebuilds_tables() -> None:
    calibrated = with_calibration(build(NAME), BOAT)
    values = {path: value for path, value, _ in leaves(calibrated.scenario)}
    assert values["world.vehicle.inertia"] == values["autopilot.law.model.inertia"] == 0.11
    assert (
        values["world.actuators.thruster.coefficient"] == values["autopilot.allocation.thruster.coefficient"] == 0.0125
    )
    assert values["world.vehicle.friction.torque_viscous"] == 0.02
    check_thrust_table(calibrated.scenario.world.actuators.table, calibrated.scenario.world.actuators.thruster)
    calibrated.scenario.check()
    assert calibrated.unused == ("IdentifiedGyro.b0",)


def test_thrust_by_rudder_angle_builds_both_thrust_tables() -> None:
    angles = np.arange(-40, 41, 10) * DEG
    entries = {
        "Thruster.coefficient": Entry(0.011, "N/krpm^2", 1e-4),
        "thrust.angles": Entry(angles.tolist(), "rad"),
        "thrust.by_angle": Entry((0.011 * (1 - 0.8 * angles**2)).tolist(), "N/krpm^2"),
    }
    scenario = with_calibration(build(NAME), Calibration(entries)).scenario
    drive, wanted = scenario.world.actuators.table, scenario.autopilot.allocation.table
    assert drive.origin == wanted.origin == "measured"
    thrust = float(drive.at(20 * DEG, 9000.0))
    np.testing.assert_allclose(thrust, 0.011 * (1 - 0.8 * (20 * DEG) ** 2) * 81, rtol=1e-3)
    np.testing.assert_allclose(float(wanted.at(20 * DEG, thrust)), 9000, rtol=3e-3)


@pytest.mark.parametrize(
    ("name", "entry", "words"),
    [
        ("Gyroscope.b0", Entry(1.0, "1"), "none of the 1 entries"),
        ("Hovercraft.mass", Entry(2600.0, "g"), "has the unit 'g'"),
        ("Hovercraft.masss", Entry(2.6, "kg"), "Choices: mass, inertia, arm.\nFix: write Hovercraft.mass"),
        ("Thruster.coefficient", Entry(0.0, "N/krpm^2"), "must be above 0 N/krpm^2, got 0"),
        ("Thruster.reverse_ratio", Entry([1.0, 2.0], "1"), "has shape (2,)"),
        ("Friction.torque_viscous", Entry(-0.1, "N m s"), "must be at least 0 N m s, got -0.1"),
        ("Thruster.deflection_max", Entry(1.5, "rad"), "must be at most 1.39626 rad, got 1.5"),
    ],
)
def test_rejects_calibration_entries_that_do_not_fit(name: str, entry: Entry, words: str) -> None:
    with pytest.raises(InputError) as refused:
        with_calibration(build(NAME), Calibration({name: entry}))
    assert words in str(refused.value)


def test_rejects_two_entries_for_one_setting() -> None:
    entries = {"Hovercraft.mass": Entry(2.6, "kg"), "world.vehicle.mass": Entry(2.7, "kg")}
    with pytest.raises(InputError, match=r"Hovercraft.mass and world.vehicle.mass both set world.vehicle.mass"):
        with_calibration(build(NAME), Calibration(entries))


@pytest.mark.parametrize(
    ("entries", "options", "said"),
    [
        ({"Hovercraft.mass": Entry(2.6, "kg", 0.2)}, (), "the values are identical; the standard errors differ"),
        ({"Hovercraft.inertia": Entry(0.1, "kg m^2", 0.2)}, (), "a.toml and b.toml have no parameter in common"),
        ({"Gyro.x": Entry(0.1, "1")}, ("--scenario", NAME), "b.toml': none of the 1 entries is a setting of"),
    ],
)
def test_comparison_reports_what_the_files_lack(
    tmp_path: Path, entries: dict[str, Entry], options: tuple[str, ...], said: str
) -> None:
    files = [tmp_path / "a.toml", tmp_path / "b.toml"]
    for file, one in zip(files, ({"Hovercraft.mass": Entry(2.6, "kg", 0.1)}, entries), strict=True):
        file.write_text(format_calibration(Calibration(one)), encoding="utf-8")
    done = CliRunner().invoke(main, ["calibrate", "compare", *map(str, files), *options])
    assert said in done.output


def test_campaign_rejects_two_calibrations(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / f"{name}.toml").write_text(format_calibration(BOAT), encoding="utf-8")
    words = [w for name in ("a", "b") for w in ("--spread", str(tmp_path / f"{name}.toml"))]
    done = CliRunner().invoke(main, ["campaign", NAME, *words])
    assert done.exit_code == 2, done.output
    assert "a campaign must use one calibration, got" in done.output


@pytest.mark.thorough
def test_log_stores_the_calibration_and_replays_without_the_file(tmp_path: Path) -> None:
    file = tmp_path / "boat.toml"
    file.write_text(format_calibration(BOAT), encoding="utf-8")
    log = simulate(build(NAME, {"calibration": str(file), "duration": "1 s"}))
    file.unlink()
    about = log.metadata["choices"]["calibration"]
    assert about["sha256"] == BOAT.content_hash()
    assert "autopilot.law.model.inertia" in about["used"]["Hovercraft.inertia"]
    scenario = rebuild_scenario(log)
    assert scenario.autopilot.law.model.inertia == 0.11
    assert replay(log, scenario).exact


@pytest.mark.thorough
def test_commands_accept_a_calibration_file(tmp_path: Path) -> None:
    file, runner = tmp_path / "boat.toml", CliRunner()
    file.write_text(format_calibration(BOAT), encoding="utf-8")
    common = ["--set", "duration=1 s"]
    flown = runner.invoke(main, ["run", NAME, "--calibration", str(file), "--json", *common])
    assert flown.exit_code == 0, flown.output
    spread = runner.invoke(main, ["campaign", NAME, "--runs", "16", "--spread", str(file), "--json", *common])
    assert spread.exit_code == 0, spread.output
    assert json.loads(spread.stdout)["notes"] == [
        "IdentifiedGyro.b0 is not varied: the world of this scenario has no such setting"
    ]
    compared = runner.invoke(main, ["calibrate", "compare", str(file), str(file)])
    assert compared.output.strip() == "the parameters are identical"
    missing = runner.invoke(main, ["run", NAME, "--calibration", str(tmp_path / "none.toml")])
    assert missing.exit_code == 2
    assert "trimtab calibrate" in missing.output
