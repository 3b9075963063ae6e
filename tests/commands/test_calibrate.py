"""`trimtab calibrate noise`: the noise coefficients of a simulated log or a CSV file are identified."""

import json
import math

import numpy as np
import pytest
from click.testing import CliRunner

from trimtab.analysis.identify.allan import fit_allan
from trimtab.cli import main
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import ms, seconds
from trimtab.logs.mcap import read_mcap, write_mcap
from trimtab.logs.samples import samples
from trimtab.loop.calibration import read_calibration
from trimtab.run.simulate import simulate
from trimtab.scenarios.build import build
from trimtab.scenarios.navigation.still import scenario

GYRO_N, GYRO_K, FORCE_N, FORCE_K = math.radians(3.5) / 60, 1.0e-4, 0.4 / 60, 4.2e-4
"""Of Imu.microstrain_3dm_gx1."""
TICK_S = 0.0065536
RATE, FORCE = "sensors.imu.value.angular_rate", "sensors.imu.value.specific_force"


def call(*words):
    return CliRunner().invoke(main, [str(w) for w in words])


@pytest.fixture(scope="module")
def still():
    """Log of 20 minutes at rest with the samples of the inertial unit only."""
    return simulate(scenario(), seed=1, duration=seconds(1200), signals=("sensors.imu",))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder with a flight of 20 s, written by `trimtab run`."""
    out = tmp_path_factory.mktemp("still")
    done = call("run", "navigation/still", "--duration", "20", "--no-ideal", "--out", out)
    assert done.exit_code == 0, done.output
    return out


@pytest.mark.thorough
def test_log_contains_every_sensor_sample(still):
    """Rows every 5 ms hold each sample of 6.5536 ms once or twice; only a sample after the last row is missing."""
    found = samples(still, RATE)
    assert found.period == pytest.approx(0.0065536, rel=1e-12)
    assert (np.diff(found.ticks) == 65536).all()
    assert len(found.ticks) >= 1200 / 0.0065536 - 1


@pytest.mark.thorough
def test_true_coefficients_lie_in_confidence_intervals(still):
    """White noise, walk and zero flicker of each axis. At 95 % confidence each, at least 16 of 18 must hold."""
    inside = []
    for path, N, K in ((RATE, GYRO_N, GYRO_K), (FORCE, FORCE_N, FORCE_K)):
        found = samples(still, path)
        for y in found.values.T:
            fit = fit_allan(y, found.period)
            inside += [fit.white.low <= N <= fit.white.high, fit.flicker.low == 0.0, fit.walk.low <= K <= fit.walk.high]
            assert fit.white.value == pytest.approx(N, rel=0.01)
    assert len(inside) == 18
    assert sum(inside) >= 16


@pytest.mark.thorough
def test_calibration_file_contains_true_sensor_noise(folder, tmp_path):
    """True values lie within three standard errors. The walk cannot be determined; the command reports this."""
    file = tmp_path / "boat.toml"
    done = call("calibrate", "noise", folder / "run.mcap", "--out", file)
    assert done.exit_code == 0, done.output
    assert "GyroErrors.bias_walk is not written" in done.output
    entries = read_calibration(file).entries
    for name, value in {
        "GyroErrors.noise": GYRO_N,
        "AccelerometerErrors.noise": FORCE_N,
        "InertialNoise.gyro": GYRO_N**2 / TICK_S,
        "InertialNoise.forward": FORCE_N**2 / TICK_S,
        "InertialNoise.starboard": FORCE_N**2 / TICK_S,
    }.items():
        assert abs(entries[name].value - value) < 3 * entries[name].standard_error, name
    believes = build("navigation/platform-magnetometer", {"calibration": str(file)})
    assert believes.world.sensors["imu"].gyro.noise == entries["GyroErrors.noise"].value
    assert believes.autopilot.estimator.noise.gyro == entries["InertialNoise.gyro"].value
    assert believes.autopilot.estimator.noise.starboard == entries["InertialNoise.starboard"].value


@pytest.mark.thorough
def test_flight_has_calibrated_noise_and_rejects_filter_with_other_step(tmp_path):
    """A CSV of a gyro with three times the noise, in deg/s, sets the noise of a flight."""
    g, n = np.random.default_rng(2), 8192
    noisy = np.degrees(3 * GYRO_N / math.sqrt(0.01)) * g.standard_normal((n, 3))
    rows = "\n".join(f"{i * 0.01:.2f}," + ",".join(f"{v:.9g}" for v in row) for i, row in enumerate(noisy))
    (tmp_path / "still.csv").write_text(f"t [s],gx [deg/s],gy [deg/s],gz [deg/s]\n{rows}\n")
    file = tmp_path / "boat.toml"
    done = call("calibrate", "noise", tmp_path / "still.csv", "--out", file)
    assert done.exit_code == 0, done.output
    flown = call(
        "run", "navigation/still", "--duration", "8", "--calibration", file, "--no-ideal", "--out", tmp_path / "f"
    )
    assert flown.exit_code == 0, flown.output
    again = samples(read_mcap(tmp_path / "f" / "run.mcap"), RATE)
    scatter = np.std(np.diff(again.values, axis=0)) / math.sqrt(2)
    assert scatter == pytest.approx(3 * GYRO_N / math.sqrt(again.period), rel=0.05)
    with pytest.raises(InputError, match=r"filter step of 10 ms, but .*\.tick is 6\.5536 ms(.|\n)*--tick '6\.5536 ms'"):
        build("navigation/platform-magnetometer", {"calibration": str(file)})
    done = call("calibrate", "noise", tmp_path / "still.csv", "--out", file, "--tick", "6.5536 ms")
    assert done.exit_code == 0, done.output
    noise = build("navigation/platform-magnetometer", {"calibration": str(file)}).autopilot.estimator.noise
    assert noise.gyro == pytest.approx((3 * GYRO_N) ** 2 / TICK_S, rel=0.06)


@pytest.mark.thorough
def test_json_reports_noise_of_simulated_log(folder):
    done = call("calibrate", "noise", folder / "run.mcap", "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)["signals"]
    assert set(found) == {f"{path}[{i}]" for path in (RATE, FORCE) for i in range(3)}
    for name, axis in found.items():
        N, unit = (GYRO_N, "rad/s") if name.startswith(RATE) else (FORCE_N, "m/s^2")
        assert axis["unit"] == unit
        assert abs(axis["white"]["value"] - N) < 3 * axis["white"]["standard_error"]
        assert axis["walk"]["low"] <= (GYRO_K if unit == "rad/s" else FORCE_K) <= axis["walk"]["high"]
        dt = axis["period_s"]
        assert axis["noise"]["sample_variance"] == pytest.approx(axis["white"]["value"] ** 2 / dt)
        assert axis["noise"]["integral_variance"] == pytest.approx(axis["white"]["value"] ** 2 * dt)


@pytest.mark.thorough
def test_prints_table_and_writes_plot(folder, tmp_path):
    words = ("--signal", RATE, "--tick", "10 ms", "--plot", tmp_path / "noise.png")
    done = call("calibrate", "noise", folder / "run.mcap", *words)
    assert done.exit_code == 0, done.output
    assert f"{RATE}[2]" in done.stdout
    assert FORCE not in done.stdout
    assert (tmp_path / "noise.png").read_bytes().startswith(b"\x89PNG")
    found = json.loads(call("calibrate", "noise", folder / "run.mcap", *words[:4], "--json").stdout)
    axis = found["signals"][f"{RATE}[2]"]
    assert axis["noise"]["integral_variance"] == pytest.approx(axis["white"]["value"] ** 2 * 0.01)
    assert found["entries"]["InertialNoise.gyro"]["value"] == pytest.approx(axis["white"]["value"] ** 2 / 0.01)


def test_reads_csv_of_another_logger(tmp_path):
    g, n, dt = np.random.default_rng(0), 8000, 0.01
    y = g.standard_normal(n) * GYRO_N / math.sqrt(dt)
    rows = "\n".join(f"{5 + i * dt:.4f},{v:.9g},21.5" for i, v in enumerate(y))
    (tmp_path / "bench.csv").write_text(f"time,gyro_z [rad/s],temperature [degC]\n{rows}\n")
    done = call("calibrate", "noise", tmp_path / "bench.csv", "--signal", "gyro_z", "--shortest", "20 ms", "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)["signals"]
    assert list(found) == ["csv.gyro_z"]
    every = json.loads(call("calibrate", "noise", tmp_path / "bench.csv", "--json").stdout)["signals"]
    assert list(every) == ["csv.gyro_z"]  # the temperature does not change
    assert found["csv.gyro_z"]["white"]["value"] == pytest.approx(GYRO_N, rel=0.05)
    assert found["csv.gyro_z"]["tau_s"][0] == pytest.approx(0.02)


@pytest.mark.thorough
def test_rejects_log_that_is_short_moving_or_has_gaps(folder, tmp_path):
    from trimtab.logs.log import Log

    log = read_mcap(folder / "run.mcap")
    moved = {
        p: log[p] + (3.0 if p == "truth.yaw_rate" else 0.0) if log[p].dtype.kind == "f" else log[p] for p in log.paths
    }
    seldom = slice(None, None, 4)
    cases = {
        "short": (log.between(0, 5), "the log is too short", "navigation/still"),
        "moving": (Log(log.t, log.ticks, moved, log.declarations), "truth.yaw_rate reaches 3 rad/s", "at rest"),
        "gaps": (
            Log(log.t[seldom], log.ticks[seldom], {p: log[p][seldom] for p in log.paths}, log.declarations),
            "misses samples",
            "log_period",
        ),
    }
    for name, (bad, wanted, fix) in cases.items():
        write_mcap(bad, tmp_path / f"{name}.mcap")
        done = call("calibrate", "noise", tmp_path / f"{name}.mcap")
        assert done.exit_code == 2, name
        assert wanted in done.output
        assert fix in done.output.partition("Fix:")[2]


REFUSED = {
    "no file": (("nowhere.mcap",), "nowhere.mcap"),
    "no such signal": (("LOG", "--signal", "sensors.imu.value.rate"), "sensors.imu.value.angular_rate"),
    "a flag": (("LOG", "--signal", "sensors.imu.fresh"), "contains no changing numbers"),
    "all too short": (("LOG", "--shortest", "50 s"), "--shortest"),
    "not a time": (("LOG", "--tick", "soon"), "--tick: 'soon' is not a time"),
    "a step too long": (("LOG", "--tick", "3 s"), "--tick: must be above 0 and at most 2 s, got '3 s'"),
    "a step of zero": (("LOG", "--tick", "0"), "--tick: must be above 0 and at most 2 s, got '0'"),
    "a step backwards": (("LOG", "--tick", "-5ms"), "--tick '5 ms'"),
    "averages below zero": (("LOG", "--shortest", "-1"), "--shortest: must be at least 0, got '-1'"),
    "no file, command that writes one": (("nowhere.mcap",), "trimtab run SCENARIO --out DIR"),
    "no such signal, existing signals": (("LOG", "--signal", "nope"), "Fix: --signal sensors.imu.value."),
    "not a calibration": (("LOG", "--out", "folder"), "Fix: --out folder.toml"),
    "not a picture": (("LOG", "--plot", "a.txt"), "supported picture format"),
}


@pytest.mark.thorough(
    "no file, command that writes one",
    "no such signal, existing signals",
    "averages below zero",
    "a step backwards",
    "not a picture",
    "a flag",
)
@pytest.mark.parametrize("name", REFUSED)
def test_invalid_arguments_are_rejected(folder, name):
    words, wanted = REFUSED[name]
    done = call("calibrate", "noise", *(folder / "run.mcap" if w == "LOG" else w for w in words))
    assert done.exit_code == 2
    assert wanted in done.output
    assert "Traceback" not in done.output


@pytest.mark.thorough
def test_still_scenario_has_no_motion():
    log = simulate(replace(scenario(), duration=ms(500)), signals=("truth", "actuators"))
    assert all(not log[p].any() for p in log.paths)


@pytest.mark.parametrize(
    ("head", "step", "said"),
    [
        ("t [s],accel_z [deg/s]", 0.01, "is in rad/s, the unit of the gyro, but has the name of the accelerometer"),
        ("t [s],gyro_z [g]", 0.01, "is in m/s^2, the unit of the accelerometer, but has the name of the gyro"),
        ("t [s],gyro_z [deg/s]", 10, "has a sample every 10 s; an inertial unit has one at least every 2 s"),
        ("t [s],gyro_z [deg/s]", -0.01, "the times must rise, but after line 2"),
        ("t [s],gyro_z [deg/s],gyro_x [deg/s]", 0.01, "csv.gyro_z and csv.gyro_x have the same samples"),
    ],
)
def test_csv_of_noise_with_wrong_units_times_or_copies_is_rejected(head, step, said, tmp_path):
    g = np.random.default_rng(1).standard_normal(1100) * 1e-3
    rows = [",".join([f"{step * i:.6g}", *[f"{v:.9f}"] * head.count("_")]) for i, v in enumerate(g)]
    (tmp_path / "still.csv").write_text("\n".join([head, *rows]) + "\n")
    done = call("calibrate", "noise", tmp_path / "still.csv")
    assert done.exit_code == 2, done.output
    assert said in done.output


def test_csv_of_noise_names_constant_columns_and_accepts_names_of_boards(tmp_path):
    rows = np.random.default_rng(1).standard_normal((1100, 2)) * 1e-3
    head = "t [s],imu_calibrated_x [m/s^2],acc_gyro_board_z [deg/s],spare [m]"
    lines = [f"{0.01 * i:.2f},{a:.9f},{b:.9f},7" for i, (a, b) in enumerate(rows)]
    (tmp_path / "still.csv").write_text("\n".join([head, *lines]) + "\n")
    done = call("calibrate", "noise", tmp_path / "still.csv")
    assert done.exit_code == 0, done.output
    assert "left out, because the values never change: csv.spare" in done.output
    lines[200:300] = [line.replace(line.split(",")[1], "0.001") for line in lines[200:300]]
    (tmp_path / "still.csv").write_text("\n".join([head, *lines]) + "\n")
    done = call("calibrate", "noise", tmp_path / "still.csv")
    assert "'csv.imu_calibrated_x': is 0.001 in 100 successive samples from 2.00 s on" in done.output


def test_csv_gaps_and_text_columns_are_reported(tmp_path):
    """One sample of 3000 is lost, one column is text: both are reported."""
    g = np.random.default_rng(1).standard_normal((3000, 3)) * 1e-3
    rows = [f"{10**9 + 5000 * i},{v[0]:.9f},{v[1]:.9f},{v[2]:.9f},AUTO" for i, v in enumerate(g) if i != 1000]
    file = tmp_path / "px4.csv"
    head = "timestamp_us," + ",".join(f"gyro_rad[{i}] [rad/s]" for i in range(3)) + ",mode"
    file.write_text("\n".join([head, *rows]) + "\n")
    done = call("calibrate", "noise", file, "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert list(found["signals"]) == [f"csv.gyro_rad[{i}]" for i in range(3)]
    axis = found["signals"]["csv.gyro_rad[0]"]
    assert (axis["samples"], axis["period_s"]) == (1999, pytest.approx(0.005))
    assert axis["white"]["value"] == pytest.approx(1e-3 * math.sqrt(0.005), rel=0.1)
    assert any("1 gap, the first at 4.9950 s" in note for note in found["notes"])
    assert "left out: line 2, column 'mode': 'AUTO' is not a number" in found["notes"]
    asked = call("calibrate", "noise", file, "--signal", "mode")
    assert asked.exit_code == 2
    assert "line 2, column 'mode'" in asked.output


def test_rejects_csv_columns_without_axis_or_with_duplicate_axis(tmp_path):
    g = np.random.default_rng(0).standard_normal((2048, 2))
    rows = "\n".join(f"{i * 0.01:.2f},{a:.6f},{b:.6f}" for i, (a, b) in enumerate(g))
    file = tmp_path / "a.csv"
    file.write_text(f"t,rate [rad/s],heat [degC]\n{rows}\n")
    done = call("calibrate", "noise", file, "--out", tmp_path / "boat.toml")
    assert done.exit_code == 2
    assert "csv.rate, csv.heat is an axis" in done.output
    assert "gyro_z [rad/s]" in done.output
    assert not (tmp_path / "boat.toml").exists()
    file.write_text(f"t,left_z [rad/s],right_z [rad/s]\n{rows}\n")
    done = call("calibrate", "noise", file)
    assert done.exit_code == 2
    assert "csv.left_z and csv.right_z both claim to be the gyro's z axis" in done.output
