"""Columns of the CSV files that other loggers write: names, units, times, text, comments and quotes."""

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.logs.csv_table import read_table, split_heading, time_unit


@pytest.fixture
def read(tmp_path):
    def read_text(text, **options):
        (tmp_path / "log.csv").write_text(text, encoding="utf-8")
        return read_table(tmp_path / "log.csv", **options)

    return read_text


HEADINGS = {
    "gyro_rad[0]": ("gyro_rad[0]", ""),
    "gyro[2] [rad/s]": ("gyro[2]", "rad/s"),
    "force (m/s^2)": ("force", "m/s^2"),
    "time [ ms ]": ("time", "ms"),
    "covariance[12]": ("covariance[12]", ""),
    "x(1)": ("x(1)", ""),
    "x": ("x", ""),
    "acc [m/s^2] raw": ("acc", "m/s^2"),
}


@pytest.mark.parametrize("heading", HEADINGS)
def test_heading_brackets_are_read_as_index_or_unit(heading):
    assert split_heading(heading) == HEADINGS[heading]


TIMES = {
    "t": "",
    "Time": "",
    "timestamp": "",
    "timestamp_sample": "",
    "seconds": "s",
    "time_s": "s",
    "time_ms": "ms",
    "time_boot_ms": "ms",
    "millis": "ms",
    "TimeMS": "ms",
    "TimeUS": "us",
    "timestamp_us": "us",
    "time_usec": "us",
    "micros": "us",
    "t_ns": "ns",
    "%time": "ns",
    "times": None,
    "temperature": None,
    "x": None,
    "timeout_ms": None,
    "us": None,
}


@pytest.mark.parametrize("name", TIMES)
def test_time_unit_is_read_from_the_column_name(name):
    assert time_unit(name) == TIMES[name]


def test_line_numbers_count_comments_and_blank_lines(read):
    table = read('# made by a logger\n\n"t", "x, y" [m],note\n"0", "1.5","a, b"\n\n# pause\n1,2,c\n')
    assert [(c.name, c.unit) for c in table.columns] == [("t", ""), ("x, y", "m"), ("note", "")]
    assert table.lines == [4, 7]
    np.testing.assert_array_equal(table.columns[1].values, [1.5, 2.0])
    assert table.columns[2].problem == "line 4, column 'note': 'a, b' is not a number"


def test_column_names_are_read_from_the_last_comment(read):
    table = read("# of savetxt\n# t, x\n0,1\n1,2\n")
    assert [c.name for c in table.columns] == ["t", "x"]
    np.testing.assert_array_equal(table.columns[1].values, [1, 2])


def test_invalid_cells_are_reported_by_line_and_column(read):
    text = "t,a,b,c\n0,1,2,3\n1,,inf,on\n"
    assert [c.problem for c in read(text).columns] == [
        "",
        "line 3, column 'a': the cell is empty",
        "line 3, column 'b': 'inf' is not finite",
        "line 3, column 'c': 'on' is not a number",
    ]
    with_gaps = read(text, gaps=True)
    np.testing.assert_array_equal(with_gaps.column("a").values, [1, np.nan])
    assert [bool(c.problem) for c in with_gaps.columns] == [False, False, False, True]


def test_integer_times_stay_exact(read):
    first = 1_600_000_000_123_456_789
    times = read(f"%time,x\n{first},0\n{first + 100},1\n").columns[0].values
    assert times.dtype == np.int64
    assert int(times[1] - times[0]) == 100
    late = read(f"%time,x\n{2**63},0\n{2**63 + 2048},1\n").columns[0].values
    assert late[1] > late[0]


WRONG = {
    "rows of other lengths": ("t,x\n\n0,1\n1\n", "line 4 has 1 columns, but there are 2 names"),
    "decimal commas": ("t,x\n0,5,1,5\n", "decimal commas"),
    "semicolons": ("#\nt;x\n0;1\n", "line 2 has semicolons"),
    "tabs": ("#\nt\tx\n0\t1\n", "line 2 has tabs between its columns"),
    "heading only": ("t,x\n", "has no rows"),
    "comments only": ("# t,x\n", "has no rows"),
    "empty text": ("", "has no rows"),
}


@pytest.mark.parametrize("name", WRONG)
def test_invalid_tables_are_rejected(read, name):
    text, problem = WRONG[name]
    with pytest.raises(InputError, match=problem):
        read(text)
