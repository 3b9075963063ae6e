"""`trimtab calibrate noise`: a log written by `trimtab run`, or a CSV file, to the coefficients that made it."""

import json
import math

import numpy as np
import pytest
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.core.record import replace
from trimtab.core.time import ms, seconds
from trimtab.identify.allan import fit_allan
from trimtab.logs.mcap import write_mcap
from trimtab.logs.samples import samples
from trimtab.run.simulate import simulate
from trimtab.scenarios.navigation.still import scenario

GYRO_N, GYRO_K, FORCE_N, FORCE_K = math.radians(3.5) / 60, 1.0e-4, 0.4 / 60, 4.2e-4
"""Of Imu.microstrain_3dm_gx1."""
RATE, FORCE = "sensors.imu.value.angular_rate", "sensors.imu.value.specific_force"


def call(*words):
    return CliRunner().invoke(main, [str(w) for w in words])


@pytest.fixture(scope="module")
def still():
    """Twenty minutes at rest: the unit's samples only."""
    return simulate(scenario(), seed=1, duration=seconds(1200), signals=("sensors.imu",))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Twenty seconds flown and written by the command."""
    out = tmp_path_factory.mktemp("still")
    done = call("run", "navigation/still", "--duration", "20", "--no-ideal", "--out", out)
    assert done.exit_code == 0, done.output
    return out


def test_every_sample_of_the_unit_is_in_the_log(still):
    """Rows of 5 ms hold each sample of 6.5536 ms once or twice; none is missed but one after the last row."""
    found = samples(still, RATE)
    assert found.period == pytest.approx(0.0065536, rel=1e-12)
    assert (np.diff(found.ticks) == 65536).all()
    assert len(found.ticks) >= 1200 / 0.0065536 - 1


def test_coefficients_lie_in_their_intervals(still):
    """White noise and walk of each axis, and no flicker, as the unit has none; 95 % each, so 16 of 18 at least."""
    inside = []
    for path, N, K in ((RATE, GYRO_N, GYRO_K), (FORCE, FORCE_N, FORCE_K)):
        found = samples(still, path)
        for y in found.values.T:
            fit = fit_allan(y, found.period)
            inside += [fit.white.low <= N <= fit.white.high, fit.flicker.low == 0.0, fit.walk.low <= K <= fit.walk.high]
            assert fit.white.value == pytest.approx(N, rel=0.01)
    assert len(inside) == 18
    assert sum(inside) >= 16


def test_json_of_a_log_that_run_wrote(folder):
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


def test_table_picture_and_folder(folder, tmp_path):
    done = call(
        "calibrate", "noise", folder / "run.mcap", "--signal", RATE, "--tick", "10 ms", "--out", tmp_path / "new"
    )
    assert done.exit_code == 0, done.output
    assert f"{RATE}[2]" in done.stdout
    assert FORCE not in done.stdout
    assert (tmp_path / "new" / "noise.png").read_bytes().startswith(b"\x89PNG")
    axis = json.loads((tmp_path / "new" / "noise.json").read_text())["signals"][f"{RATE}[2]"]
    assert axis["noise"]["integral_variance"] == pytest.approx(axis["white"]["value"] ** 2 * 0.01)


def test_csv_of_another_logger(tmp_path):
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


def test_a_log_that_is_too_short_or_moves_or_has_gaps_is_refused(folder, tmp_path):
    from trimtab.logs.log import Log
    from trimtab.logs.mcap import read_mcap

    log = read_mcap(folder / "run.mcap")
    moved = {
        p: log[p] + (3.0 if p == "truth.yaw_rate" else 0.0) if log[p].dtype.kind == "f" else log[p] for p in log.paths
    }
    seldom = slice(None, None, 4)
    cases = {
        "short": (log.between(0, 5), "too short a log", "navigation/still"),
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
    "a flag": (("LOG", "--signal", "sensors.imu.fresh"), "no numbers that change"),
    "all too short": (("LOG", "--shortest", "50 s"), "--shortest"),
    "not a time": (("LOG", "--tick", "soon"), "not a time"),
    "a step of zero": (("LOG", "--tick", "0"), "--tick: '0' is not longer than 0"),
    "a step backwards": (("LOG", "--tick", "-5ms"), "--tick '5 ms'"),
    "averages below zero": (("LOG", "--shortest", "-1"), "--shortest: '-1' is below 0"),
    "no file, what writes one": (("nowhere.mcap",), "trimtab run SCENARIO --out DIR"),
    "no such signal, what is": (("LOG", "--signal", "nope"), "Fix: --signal sensors.imu.value."),
    "not a picture": (("LOG", "--plot", "a.txt"), "ending"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused(folder, name):
    words, wanted = REFUSED[name]
    done = call("calibrate", "noise", *(folder / "run.mcap" if w == "LOG" else w for w in words))
    assert done.exit_code == 2
    assert wanted in done.output
    assert "Traceback" not in done.output


def test_nothing_in_the_still_scenario_moves():
    log = simulate(replace(scenario(), duration=ms(500)), signals=("truth", "actuators"))
    assert all(not log[p].any() for p in log.paths)
