import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.logs.samples import read_csv

GOOD = """time, gyro_z [rad/s], "force" (m/s^2)
10.00, 0.1, -9.8

10.01, 0.2, -9.7
10.02, -3e-1, -9.6
"""


@pytest.fixture
def write(tmp_path):
    def made(text):
        (tmp_path / "log.csv").write_text(text, encoding="utf-8")
        return tmp_path / "log.csv"

    return made


def test_columns_units_and_times(write):
    log = read_csv(write(GOOD))
    np.testing.assert_array_equal(log.ticks, [0, 100_000, 200_000])
    np.testing.assert_array_equal(log["csv.gyro_z"], [0.1, 0.2, -0.3])
    assert (log.unit("csv.gyro_z"), log.metadata["file"]) == ("rad/s", "log.csv")
    assert len(log.paths) == 2


def test_the_column_of_times_can_be_named(write):
    log = read_csv(write("stamp,x\n0,1\n0.5,2\n"), "stamp")
    np.testing.assert_array_equal(log.t, [0.0, 0.5])
    assert log.paths == ("csv.x",)


UNITS = {"": 1.0, "[s]": 1.0, "[ms]": 1e-3, "(us)": 1e-6, "[µs]": 1e-6, "[ns]": 1e-9}


@pytest.mark.parametrize("unit", UNITS)
def test_times_are_in_the_unit_that_their_column_says(write, unit):
    rows = [round((7.0 + 0.01 * i) / UNITS[unit]) if UNITS[unit] < 1 else 7.0 + 0.01 * i for i in range(3)]
    log = read_csv(write(f"time {unit},x\n" + "".join(f"{t},1\n" for t in rows)))
    np.testing.assert_array_equal(log.ticks, [0, 100_000, 200_000])


REFUSED = {
    "no time": ("a,b\n1,2\n", "no column of times"),
    "too few columns": ("t,x\n1,2\n3\n", "line 3 has 1 columns"),
    "text": ("t,x\n1,left\n", "no number"),
    "nan": ("t,x\n1,2\n2,nan\n", "line 3 is not finite"),
    "no rows": ("t,x\n", "no rows"),
    "backwards": ("t,x\n1,2\n3,4\n2,5\n", r"after line 3: 3\.0, then 2\.0"),
    "minutes": ("time [min],x\n0,1\n1,2\n", r"'time' is in 'min'(.|\n)*Choices: s, ms, us, ns(.|\n)*Fix: convert"),
    "one name twice": ("t,a,a\n0,1,2\n1,3,4\n", r"'a' and 'a' are one signal, csv\.a"),
    "times twice": ("t,t,a\n0,0,2\n1,1,4\n", r"'t' and 't' are one signal"),
    "names alike": ("t,gyro x,gyro-x\n0,1,2\n1,3,4\n", r"'gyro x' and 'gyro-x' are one signal, csv\.gyro_x"),
    "nothing": ("", "no column of times"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_log_is_refused(write, name):
    text, wanted = REFUSED[name]
    with pytest.raises(InputError, match=wanted):
        read_csv(write(text))


def test_a_missing_file_and_a_missing_name_are_refused(write, tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_csv(tmp_path / "none.csv")
    with pytest.raises(InputError, match=r"no column 'clock'(.|\n)*Choices: time, gyro_z"):
        read_csv(write(GOOD), "clock")
