"""Flights of other systems: commands and motion capture in separate files, read with one mapping."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analysis.identify.motion_capture import NAME, capture_flight
from click.testing import CliRunner

from trimtab.analysis.identify.flight_data import (
    FlightData,
    _refuse_jumps,
    actuate,
    find_grid,
    lay_on_grid,
    read_flight,
    refuse_copies,
)
from trimtab.cli import main
from trimtab.commands.identify import _read
from trimtab.core.errors import InputError
from trimtab.core.quantity import leaves
from trimtab.core.time import ms, to_seconds
from trimtab.logs.foreign.read import read_foreign
from trimtab.logs.log import Log
from trimtab.run.simulate import simulate
from trimtab.scenarios.build import build

MAPPING = """
[sensor.command]
topic = "radio.csv"
time = { field = "t", unit = "s" }
[sensor.command.fields]
rudder_pulse = { from = "steering", unit = "us" }
speed_rpm    = { from = "rpm", unit = "rpm" }

[sensor.mocap]
topic = "capture.csv"
time = { field = "stamp", unit = "ms" }
[sensor.mocap.fields]
north   = { from = "x", unit = "mm" }
east    = { from = "z", unit = "mm", sign = -1 }
heading = { from = "yaw", unit = "deg", sign = -1, offset = 90 }
"""


@pytest.mark.thorough
def test_actuator_replay_matches_flight_before_first_command() -> None:
    """The first command arrives after 80 ms; until then the fan stands still, in the flight and in the fit."""
    scenario = build(NAME)
    log, actuators = simulate(scenario, seed=1, duration="4 s", log_period=ms(10)), scenario.world.actuators
    assert not log["uplink.valid"][:8].any()
    assert log["uplink.valid"][8:].all()
    assert np.abs(log["actuators.u.FX"][8]) > 0.1
    grid = find_grid(actuators)
    assert grid == ms(10)
    name = "uplink.value.speed_rpm"  # what stands there before one came is no command
    signals = {p: np.where(log["uplink.valid"], log[p], 9000.0) if p == name else log[p] for p in log.paths}
    flight = read_flight(Log(log.t, log.ticks, signals, log.declarations), scenario, name="flight.mcap")
    commands = lay_on_grid(grid, flight)
    assert commands.t[0] == 0
    integral = actuate(actuators, grid, commands)
    for axis in ("FX", "FY"):
        given = np.diff(np.asarray(getattr(integral, axis))) / to_seconds(grid)
        np.testing.assert_allclose(given, log[f"actuators.u.{axis}"], rtol=0, atol=1e-12)


@pytest.mark.thorough
def test_motion_capture_flight_is_identified(tmp_path: Path) -> None:
    log = capture_flight({"world.vehicle.inertia": "0.12"}, 1, 6.0)
    rows = zip(log.t, 1e6 * log["uplink.value.rudder_pulse"], log["uplink.value.speed_rpm"], strict=True)
    text = "\n".join(f"{t:.4f},{a:.6f},{b:.6f}" for t, a, b in rows)
    (tmp_path / "radio.csv").write_text(f"t,steering,rpm\n{text}\n")
    first = np.flatnonzero(np.diff(log["sensors.mocap.t"], prepend=-1) > 0)
    first = first[log["sensors.mocap.valid"][first]]
    pose = [log[f"sensors.mocap.value.{n}"][first] for n in ("north", "east", "heading")]
    lines = [
        f"{1e-4 * t:.4f},{1e3 * n:.5f},0,{-1e3 * e:.5f},{90 - np.degrees(h):.6f}"
        for t, n, e, h in zip(log["sensors.mocap.t"][first], *pose, strict=True)
    ]
    (tmp_path / "capture.csv").write_text("\n".join(["stamp [ms],x,y,z,yaw", *lines]) + "\n")
    (tmp_path / "flight.toml").write_text(MAPPING)
    words = ["identify", NAME, str(tmp_path / "capture.csv"), "--fit", "world.vehicle.inertia", "--fit", "delay"]
    shown = CliRunner().invoke(main, [*words, "--map", str(tmp_path / "flight.toml"), "--json"])
    assert shown.exit_code == 0, shown.output
    assert '"converged": true' in shown.output
    found = json.loads(shown.output)["parameters"]["world.vehicle.inertia"]
    assert abs(found["value"] - 0.12) < 5 * found["standard_error"] + 2e-5


def test_measurements_before_first_command_are_omitted(tmp_path: Path) -> None:
    (tmp_path / "radio.csv").write_text(
        "t,steering,rpm\n" + "".join(f"{0.5 + 0.1 * k:.1f},1500,0\n" for k in range(25))
    )
    rows = "".join(f"{100 * k},{10 * k},0,{k}\n" for k in range(30))
    (tmp_path / "capture.csv").write_text(f"stamp [ms],x,z,yaw\n{rows}")
    (tmp_path / "flight.toml").write_text(MAPPING)
    flight = read_flight(read_foreign(tmp_path / "capture.csv", tmp_path / "flight.toml"), build(NAME))
    np.testing.assert_array_equal(flight.ticks, ms(100) * np.arange(5, 30))
    assert len(flight.command_ticks) == len(flight.valid)


TENTHS = tuple(0.1 * k for k in range(30))


def read_changed(
    folder: Path, *changes: tuple[str, str], last: str = "{1}", sent: Any = TENTHS, measured: Any = TENTHS
) -> FlightData:
    """Read a flight with replacements in the mapping.

    last: measured x (mm).  sent: times of the commands (s).  measured: times of the measurements (s).
    """
    (folder / "radio.csv").write_text(
        "t,steering,rpm\n" + "".join(f"{t:.3f},1500,{9000 + k}\n" for k, t in enumerate(sent))
    )
    rows = "".join(f"{{0:.0f}},{last},0,{k}\n".format(1000 * t, 10 * k) for k, t in enumerate(measured))
    (folder / "capture.csv").write_text(f"stamp [ms],x,z,yaw\n{rows}")
    text = MAPPING
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "flight.toml").write_text(text)
    return read_flight(read_foreign(folder / "capture.csv", folder / "flight.toml"), build(NAME), name="capture.csv")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"x", unit = "mm"', '"x", unit = "deg"', r"'north' must be in m, got the unit 'rad'(.|\n)*Choices: m, km, cm"),
        ('"x", unit = "mm"', '"x", unit = "1"', "'north' must be in m, got the unit '1'"),
        ('unit = "us"', 'unit = "deg"', "'rudder_pulse' must be in s, got the unit 'rad'"),
        ('from = "x"', 'from = ["x", "z"]', "the count of numbers of 'north' in each row must be 1, got 2"),
        ("north ", "nrth ", r"'nrth' is not a field of the vehicle's state(.|\n)*Fix: write north"),
        (
            '"stamp", unit = "ms"',
            '"stamp", unit = "us"',
            r"the measurements from 0 to 0.0029 s; they must have at least",
        ),
        ('unit = "s" }', 'unit = "s", offset = "1000 s" }', r"the commands are from 1000 to 1002.9 s"),
    ],
)
def test_rejects_wrong_units_names_and_times_of_a_mapping(tmp_path: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_changed(tmp_path, (old, new))


def test_fan_speed_may_be_in_any_unit_of_speed(tmp_path: Path) -> None:
    flight = read_changed(tmp_path, ('"rpm", unit = "rpm"', '"rpm", unit = "rad/s"'))
    assert flight.commands.speed_rpm[0] == pytest.approx(9000 * 30 / np.pi)


@pytest.mark.parametrize(
    ("sent", "measured", "said"),
    [
        (TENTHS, TENTHS[:19], "at least 20 measurements of the vehicle's state are needed, got 19"),
        (TENTHS, TENTHS[:20], ""),
        ([*TENTHS, 100.0], [2.1 * k for k in range(30)], "the measurements must be at most 2 s apart, got 2.1 s"),
        (TENTHS, [2.0 + 0.02 * k for k in range(100)], "they must have at least 1 s in common, got 0.9 s"),
        (TENTHS, [1.8 + 0.02 * k for k in range(100)], ""),
        ([0.0, 0.3], [0.1 * k for k in range(100)], ""),  # commands that are logged only when they change
        ([20.0, 20.3], [0.1 * k for k in range(100)], "they must have at least 1 s in common, got 0 s"),
    ],
)
def test_measurements_must_be_enough_and_in_time_with_commands(
    tmp_path: Path, sent: Any, measured: Any, said: str
) -> None:
    if not said:
        assert len(read_changed(tmp_path, sent=sent, measured=measured).ticks)
        return
    with pytest.raises(InputError, match=said):
        read_changed(tmp_path, sent=sent, measured=measured)


def test_mapping_may_contain_other_quantities(tmp_path: Path) -> None:
    """A GPS receiver reports velocities to north and east, which are no states of the craft."""
    new = 'north_velocity = { from = "z", unit = "m/s" }\neast_velocity = { from = "z", unit = "m/s" }\n'
    new += 'heading_std = { from = "z", unit = "deg" }\nnorth2 = { from = "x", unit = "mm" }\nnorth '
    read_changed(tmp_path, ("north ", new))


def test_rejects_log_in_which_nothing_moves(tmp_path: Path) -> None:
    still = 'heading = { from = "z", unit = "deg" }'
    heading = 'heading = { from = "yaw", unit = "deg", sign = -1, offset = 90 }'
    with pytest.raises(InputError, match="north, east, heading never change in this log"):
        read_changed(tmp_path, (heading, still), last="3")


def test_rejects_vehicle_whose_state_has_vectors() -> None:
    with pytest.raises(InputError, match="these are vectors: position, velocity, attitude, rate, rotor_speed"):
        read_flight(Log(np.zeros(1), np.zeros(1, np.int64), {"truth.x": np.zeros(1)}, {}), build("quadrotor/track"))


def test_rejects_the_same_flight_twice() -> None:
    ticks, y = np.arange(30), np.random.default_rng(0).standard_normal((30, 6))
    one, other = (FlightData(name, None, ticks, ticks, y + k) for k, name in enumerate(("a", "b")))
    cut = one._replace(name="cut", ticks=ticks[:20], y=y[:20])
    refuse_copies([one, other], [])
    with pytest.raises(InputError, match=r"log 'cut': the log has the same measurements as log 'a'\.\nFix"):
        refuse_copies([one, cut], [other])
    with pytest.raises(InputError, match=r"log 'cut': .* as log 'a', so it does not test the fit"):
        refuse_copies([one, other], [cut])


def test_outlier_in_a_short_log_is_rejected() -> None:
    ticks, y = ms(100) * np.arange(20), np.full((20, 6), np.nan)
    y[:, 0] = 0.01 * np.arange(20) + 1e-3 * np.random.default_rng(0).standard_normal(20)
    states = [path for path, _, _ in leaves(build(NAME).initial)]
    _refuse_jumps("log 'a'", build(NAME), states, ticks, y)
    y[12, 0] = 3.0
    with pytest.raises(InputError, match="outlier"):
        _refuse_jumps("log 'a'", build(NAME), states, ticks, y)


def test_command_rejects_the_same_log_twice(tmp_path: Path) -> None:
    read_changed(tmp_path)
    log, words = str(tmp_path / "capture.csv"), ["--fit", "delay", "--map", str(tmp_path / "flight.toml")]
    (tmp_path / "copy").mkdir()
    for name in ("capture.csv", "radio.csv"):
        (tmp_path / "copy" / name).write_bytes((tmp_path / name).read_bytes())
    copy = str(tmp_path / "copy" / "capture.csv")
    shown = CliRunner().invoke(main, ["identify", NAME, log, copy, *words])
    assert shown.exit_code == 2
    assert f"log '{copy}': the log has the same measurements as log '{log}'" in " ".join(shown.output.split())


def test_measurements_left_out_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    read_changed(tmp_path)
    file = tmp_path / "capture.csv"
    file.write_text(file.read_text() + "3000,,0,30\n")
    _read(file, "capture.csv", build(NAME), None, tmp_path / "flight.toml")
    assert "capture.csv, mocap: 1 of 31 rows are left out: north is empty" in capsys.readouterr().err


def test_rejects_empty_log() -> None:
    with pytest.raises(InputError, match="contains no rows"):
        read_flight(Log(np.zeros(0), np.zeros(0, np.int64), {"truth.x": np.zeros(0)}, {}), build(NAME), name="cut.mcap")


def test_missing_mapping_error_suggests_the_map_option(tmp_path: Path) -> None:
    (tmp_path / "capture.csv").write_text("stamp [ms],x\n1,2\n2,3\n")
    shown = CliRunner().invoke(main, ["identify", NAME, str(tmp_path / "capture.csv"), "--fit", "delay"])
    assert shown.exit_code == 2
    assert "Fix: --map MAP.toml" in shown.output
