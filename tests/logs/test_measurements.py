"""Implausible measurements are rejected by line and column, with a suggested fix."""

from pathlib import Path

import numpy as np
import pytest

from trimtab.analysis.identify import coast_down, gyro_response, rudder, spin_up, thrust
from trimtab.core.errors import InputError
from trimtab.core.rotation import DEG
from trimtab.logs.measurements import read_measurements

GOOD = "rudder [deg],speed [rpm],force [N]\n0,6000,0.4\n0,8000,0.7\n10,9000,0.9\n"
BAD = {
    "empty file": ("", "is empty"),
    "headings only": ("rudder [deg],speed [rpm],force [N]\n", "no measurement"),
    "missing column": ("rudder [deg],force [N]\n0,1\n", "no column 'speed'"),
    "no unit": ("rudder,speed [rpm],force [N]\n0,6000,1\n", "has no unit"),
    "unknown unit": ("rudder [deg],speed [knots],force [N]\n0,6000,1\n", "not a unit of this quantity"),
    "wrong unit": ("rudder [deg],speed [rpm],force [N]\n0,6000,40\n0,8000,720\n", "line 3"),
    "degrees as radians": ("rudder [rad],speed [rpm],force [N]\n20,6000,1\n", "1145.92 deg is outside -60 to 60 deg"),
    "swapped axes": ("rudder [deg],force [N],speed [rpm]\n0,6000,0.4\n0,8000,0.7\n", "column 'force'"),
    "krpm as rpm": ("rudder [deg],speed [rpm],force [N]\n0,6,0.4\n0,8,0.7\n", "no value is above"),
    "decimal commas": ("rudder [deg];speed [rpm];force [N]\n0;6000;0,4\n", "semicolons"),
    "decimal commas between commas": ("rudder [deg],speed [rpm],force [N]\n0,6000,0,4\n", "line 2 has 4 cells"),
    "quoted decimal comma": ('rudder [deg],speed [rpm],force [N]\n0,6000,"0,4"\n', "'0,4' is not a number"),
    "no number": ("rudder [deg],speed [rpm],force [N]\n0,6000,abc\n", "column 'force': 'abc'"),
    "not finite": ("rudder [deg],speed [rpm],force [N]\n0,6000,nan\n", "not finite"),
    "repeated rows": ("rudder [deg],speed [rpm],force [N]\n0,6000,1\n0,7000,1\n0,6000,1\n", "lines 2 and 4"),
    "repeated column name": ("speed [rpm],speed [rpm],force [N],rudder [deg]\n1,2,3,4\n", "has column"),
}


@pytest.mark.parametrize("what", BAD)
def test_invalid_data_error_names_the_place_and_fix(what: str, tmp_path: Path) -> None:
    text, words = BAD[what]
    file = tmp_path / "thrust.csv"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        read_measurements(file, thrust.THRUST_COLUMNS)
    assert words in str(refused.value)
    assert "Fix: " in str(refused.value)


def test_units_are_converted_and_line_numbers_kept(tmp_path: Path) -> None:
    file = tmp_path / "thrust.csv"
    file.write_text(
        "# an afternoon\nforce [gf], Rudder [deg] ,speed [krpm]\n\n102,-20,8\n153,10,9.5\n", encoding="utf-8"
    )
    data = read_measurements(file, thrust.THRUST_COLUMNS)
    assert data.lines.tolist() == [4, 5]
    np.testing.assert_allclose(data["force"], [1.0003, 1.5004], rtol=1e-3)
    np.testing.assert_allclose(data["rudder"], [-20 * DEG, 10 * DEG])
    np.testing.assert_allclose(data["speed"], [8000, 9500])


def test_missing_file_error_shows_the_expected_header(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"pulse \[us\],angle \[deg\]"):
        read_measurements(tmp_path / "none.csv", rudder.SERVO_COLUMNS)


def test_rejects_times_that_do_not_increase(tmp_path: Path) -> None:
    file = tmp_path / "spin.csv"
    file.write_text("time [s],yaw_rate [rad/s]\n0,0\n0.1,0.2\n0.1,0.3\n", encoding="utf-8")
    with pytest.raises(InputError, match="line 4, column 'time'"):
        read_measurements(file, spin_up.SPIN_UP_COLUMNS, series=True)


def test_trial_column_allows_repeated_times(tmp_path: Path) -> None:
    file = tmp_path / "coast.csv"
    file.write_text("time [s],yaw_rate [deg/s],trial\n0,90,a\n0,90,b\n", encoding="utf-8")
    assert read_measurements(file, coast_down.SPIN_COLUMNS)["trial"].tolist() == ["a", "b"]


def test_rejects_too_few_points_for_a_cubic(tmp_path: Path) -> None:
    file = tmp_path / "reverse.csv"
    file.write_text("speed [rpm],forward [N],reverse [N]\n6000,.4,.1\n8000,.7,.2\n9000,.9,.3\n", encoding="utf-8")
    with pytest.raises(InputError, match="3 readings for a cubic of 4 coefficients"):
        thrust.fit_reverse(read_measurements(file, thrust.REVERSE_COLUMNS), 0.03)


def test_saturated_force_gauge_is_rejected(tmp_path: Path) -> None:
    file, rows = tmp_path / "thrust.csv", ["rudder [deg],speed [rpm],force [N]"]
    rows += [f"0,{n},{min(1e-8 * n * n, 0.8):.2f}" for n in range(5000, 12001, 500)]
    file.write_text("\n".join(rows), encoding="utf-8")
    with pytest.raises(InputError, match=r"the gauge is saturated"):
        thrust.fit_thrust(read_measurements(file, thrust.THRUST_COLUMNS), 0.01)


def test_equal_forces_within_gauge_resolution_are_accepted(tmp_path: Path) -> None:
    file, rows = tmp_path / "reverse.csv", ["speed [rpm],forward [N],reverse [N],trial"]
    forces = (0.1, 0.1, 0.15, 0.15, 0.25, 0.25, 0.35, 0.35, 0.4, 0.45, 0.55, 0.65, 0.65)
    for trial in range(3):
        reverse = [F - 0.05 * (trial == 2 and i == 11) for i, F in enumerate(forces)]
        rows += [f"{n},{1e-8 * n * n:.2f},{F},{trial}" for n, F in zip(range(6000, 12001, 500), reverse, strict=True)]
    file.write_text("\n".join(rows), encoding="utf-8")
    assert thrust.fit_reverse(read_measurements(file, thrust.REVERSE_COLUMNS), 0.03).slowest == 6000


@pytest.mark.thorough
def test_rejects_gyro_of_another_axis(tmp_path: Path) -> None:
    g, file = np.random.default_rng(0), tmp_path / "sweep.csv"
    t = 0.01 * np.arange(400)
    rows = [f"{a},{np.sin(3 * a)},{b}" for a, b in zip(t, g.standard_normal(400), strict=True)]
    file.write_text("time [s],reference [rad/s],gyro [rad/s]\n" + "\n".join(rows), encoding="utf-8")
    with pytest.raises(InputError, match="the same axis"):
        gyro_response.fit_gyro(read_measurements(file, gyro_response.COLUMNS, series=True))
