"""`trimtab replay` over logs of other systems: estimators of the catalogue, and errors without a mapping."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from logs.foreign.written import DEG

from trimtab.cli import main
from trimtab.core.time import ms
from trimtab.logs.mcap import read_mcap
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue

COPTER = Path(__file__).parent / "data" / "arducopter.bin"


def call(*words):
    return CliRunner().invoke(main, ["replay", *map(str, words)])


COPTER_MAP = """
[sensor.imu]
topic = "IMU"
where = {I = 0}
[sensor.imu.fields]
specific_force = {from = ["AccX", "AccY", "AccZ"]}
angular_rate = {from = ["GyrX", "GyrY", "GyrZ"], SIGN}
gyro_saturated = {constant = false}
accelerometer_saturated = {constant = false}
[sensor.heading]
topic = "XKF1"
[sensor.heading.fields]
heading = {from = "Yaw"}
[truth]
topic = "XKF1"
[truth.fields]
heading = {from = "Yaw", unwrap = true}
"""


@pytest.mark.thorough
def test_catalogue_estimator_replays_a_public_log(tmp_path):
    """A quadrotor turns by most of a circle; with a reversed gyro axis, the filter's NIS shows it."""
    scenario = ("--scenario", "navigation/platform-square-wave", "--set", "compensated=no", "--json")
    found = {}
    for name, sign in {"right": "sign = 1", "wrong": "sign = [1, 1, -1]"}.items():
        file = tmp_path / f"{name}.toml"
        file.write_text(COPTER_MAP.replace("SIGN", sign))
        done = call(COPTER, "--map", file, *scenario, "--out", tmp_path / f"{name}.mcap")
        assert done.exit_code == 0, done.output
        found[name] = json.loads(done.stdout)
    assert found["right"]["steps"] == found["wrong"]["steps"] > 600
    nis = {name: result["navigation"]["aiding"]["heading"]["nis"]["mean"] for name, result in found.items()}
    assert nis["wrong"] > 10 * nis["right"]
    log = read_mcap(tmp_path / "right.mcap")
    assert np.ptp(log["truth.heading"]) > 4
    assert found["right"]["errors"]["heading"] < 3 * DEG


def test_foreign_log_without_mapping_lists_its_topics(ulog):
    done = call(ulog)
    assert done.exit_code == 2
    assert "sensor_gyro[1]" in done.stdout
    assert "gyro[2]" in done.stdout
    assert f"trimtab replay {ulog} --map MAP.toml --scenario" in done.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "one must be given"),
        (("--scenario", "navigation/platform-encoder"), "no samples of 'heading'"),
        (("--scenario", "hovercraft/forward", "--with", "law=x"), "cannot be combined with --map"),
        (("--estimator", "a:b", "--set", "navigation=ins"), "needs a scenario"),
        (("--estimator", "a:b", "--scenario", "hovercraft/forward"), "exclude each other"),
    ],
)
def test_rejects_incompatible_options(bins, tmp_path, words, said):
    file = tmp_path / "map.toml"
    text = '[sensor.imu]\ntopic = "IMU"\nwhere = {I = 0}\n[sensor.imu.fields]\n'
    file.write_text(text + 'angular_rate = {from = ["GyrX", "GyrY", "GyrZ"], unit = "rad/s"}\n')
    done = call(bins, "--map", file, *words)
    assert done.exit_code == 2
    assert said in done.stderr


def test_error_names_a_missing_field_of_the_estimator(bins, tmp_path):
    file = tmp_path / "map.toml"
    text = COPTER_MAP.replace(", SIGN", "").replace("gyro_saturated = {constant = false}\n", "")
    file.write_text(text)
    done = call(COPTER, "--map", file, "--scenario", "navigation/platform-square-wave", "--set", "compensated=no")
    assert done.exit_code == 2
    assert "'imu' have no field 'gyro_saturated'" in done.stderr
    assert "gyro_saturated = {from = …}" in done.stderr


UNITS = {
    "imu": {"specific_force": ("g", 9.80665), "angular_rate": ("deg/s", DEG), "gyro_saturated": ("flag", 1)}
    | {"accelerometer_saturated": ("flag", 1)},
    "ranging": {"range": ("cm", 0.01), "arrived": ("flag", 1), "unit": ("count", 1)},
}


@pytest.mark.thorough
def test_csv_recording_replays_through_hovercraft_ins(tmp_path):
    """Simulated measurements as a CSV file in other units: the INS of hovercraft/forward finds the same path."""
    scenario, _ = catalogue.load_scenario("hovercraft/forward", {"navigation": "ins"})
    log = simulate(scenario, seed=1, duration=ms(3000), log_period=scenario.autopilot.period, backend="jax")
    heads, columns, lines = ["time [ms]", "north"], [log.t * 1e3, log["truth.north"]], []
    for sensor, fields in UNITS.items():
        lines.append(f"[sensor.{sensor}.fields]")
        for field, (unit, size) in fields.items():
            values = log[f"downlink.{sensor}.value.{field}"] / size
            several = np.where(log[f"downlink.{sensor}.fresh"], values.reshape(len(log), -1).T, np.nan)
            names = [f"{field}_{i}" for i in range(len(several))]
            heads, columns = heads + names, [*columns, *several]
            source = json.dumps(names if values.ndim > 1 else names[0])
            lines.append(f'{field} = {{from = {source}, unit = "{unit}"}}')
    (tmp_path / "map.toml").write_text("\n".join([*lines, "[truth.fields]", 'north = {from = "north", unit = "m"}']))
    rows = [",".join("" if np.isnan(x) else repr(float(x)) for x in row) for row in zip(*columns, strict=True)]
    (tmp_path / "hover.csv").write_text("\n".join([",".join(heads), *rows]))
    words = ("--map", tmp_path / "map.toml", "--scenario", "hovercraft/forward", "--set", "navigation=ins", "--json")
    done = call(tmp_path / "hover.csv", *words)
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["errors"]["north"] < 0.1
