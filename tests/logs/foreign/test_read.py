"""Detection of the format of a file; CSV files: units in the heading, gaps, and invalid files."""

import numpy as np
import pytest
from logs.foreign.ros_files import write_json_mcap
from logs.foreign.written import DEG, GYRO, mapping

from trimtab.core.errors import InputError
from trimtab.logs.foreign import is_own_log, list_topics, read_foreign
from trimtab.logs.foreign.mapping import parse_mapping
from trimtab.logs.foreign.tables import Table
from trimtab.logs.mcap import read_mcap, write_mcap

WRONG_FILES = {
    "empty": ("a.ulg", b"", "is empty"),
    "wrong content for its suffix": (
        "a.ulg",
        b"hello, world, hello",
        "is not a ULog file, although its name has that ending(.|\n)*Choices: ULog",
    ),
    "unknown format": ("a.dat", b"hello, world, hello", r"has an unknown format(.|\n)*\.csv"),
    "damaged ulog": ("a.ulg", b"ULog\x01\x12\x35\x01" + b"\xff" * 4, "a.ulg': looks like ULog by its first bytes"),
    "damaged mcap": ("a.mcap", b"\x89MCAP0\r\n" + b"\x07" * 90, "looks like MCAP by its first bytes"),
    "damaged bag": ("a.bag", b"#ROSBAG V2.0\n" + b"\x07" * 90, "looks like a ROS bag by its first bytes"),
    "part of a bag": ("a.db3", b"SQLite format 3\0" + b"\x07" * 90, "is one part of a rosbag2(.|\n)*give the folder"),
}


@pytest.mark.parametrize("name", WRONG_FILES)
def test_rejects_files_of_unknown_or_damaged_format(tmp_path, name):
    file, content, said = WRONG_FILES[name]
    (tmp_path / file).write_bytes(content)
    with pytest.raises(InputError, match=said):
        list_topics(tmp_path / file)


def test_rejects_missing_file_and_plain_folder(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        list_topics(tmp_path / "none.ulg")
    with pytest.raises(InputError, match=r"without metadata\.yaml"):
        list_topics(tmp_path)


def test_recognises_logs_written_by_trimtab(tmp_path, ulog, write):
    own = write_mcap(read_foreign(ulog, mapping("sensor_gyro", angular_rate=GYRO)), tmp_path / "own.mcap")
    assert is_own_log(own)
    assert is_own_log(tmp_path / "none.mcap")
    assert not is_own_log(ulog)
    assert not is_own_log(write("t,x\n0,1\n"))
    assert not is_own_log(write_json_mcap(tmp_path / "a.mcap", "/gyro", [(0, 1)]))
    assert len(read_mcap(own)) == 50
    for size in (8, 30, 100):
        (tmp_path / "cut.mcap").write_bytes(own.read_bytes()[:size])
        assert is_own_log(tmp_path / "cut.mcap")
        with pytest.raises(InputError, match=r"is cut before the first sample(.|\n)*copy the file again"):
            read_mcap(tmp_path / "cut.mcap")


def test_csv_units_are_read_and_two_sensors_share_a_file(write):
    file = write("time [ms],gyro (deg/s),field_x,range\n0,90,1,\n10,,3,250\n20,45,5,\n")
    content = {
        "imu": {"fields": {"yaw_rate": {"from": "gyro"}}},
        "depth": {"fields": {"range": {"from": "range", "unit": "cm"}}},
        "compass": {"fields": {"field": {"from": ["field_x"], "unit": "mT", "offset": -1}}},
    }
    log = read_foreign(file, parse_mapping({"sensor": content}))
    np.testing.assert_array_equal(log.ticks, [0, 100_000, 200_000])
    np.testing.assert_allclose(log["downlink.imu.value.yaw_rate"], np.array([90, 90, 45]) * DEG)
    assert log["downlink.imu.fresh"].tolist() == [True, False, True]
    assert log["downlink.depth.valid"].tolist() == [False, True, True]
    assert log["downlink.depth.value.range"][1] == pytest.approx(2.5)
    np.testing.assert_allclose(log["downlink.compass.value.field"], [[0], [0.002], [0.004]])


def test_rows_left_out_are_described_by_line(write):
    file = write("t,x\n# a comment\n0,1\n1,\n2,nan\n3,4\n3,4\n")
    log = read_foreign(file, mapping(x={"from": "x", "unit": "m"}))
    text = "3 of 5 rows are left out: x is empty or not finite in lines 4 and 5; a row is repeated in line 7"
    assert log.metadata["left_out"] == {"imu": text}
    assert log.metadata["converted"]["imu"] == {"rows": 5, "not_finite": 2, "out_of_order": 0, "duplicates": 1}


def test_rows_are_named_in_the_order_of_the_file(write):
    """The file is not sorted, and has an empty cell before the rows that are named."""
    log = read_foreign(write("t,x\n0,1\n0.02,\n0.03,3\n0.03,3\n0.01,5\n"), mapping(x={"from": "x", "unit": "m"}))
    assert log.metadata["left_out"]["imu"].endswith("in line 3; a row is repeated in line 5")
    with pytest.raises(InputError, match=r"the times jump back by 8 s at line 5"):
        read_foreign(write("t,x\n7,1\n8,\n9,2\n1,3\n"), mapping(x={"from": "x", "unit": "m"}))


def test_rows_of_a_log_without_lines_are_counted_from_one():
    assert Table({"x": np.zeros(3)}).name_rows([0, 2]) == "rows 1 and 3"
    assert Table({"x": np.zeros(3)}, lines=(4, 6, 9)).name_rows([0, 2]) == "lines 4 and 9"


def test_csv_ignores_text_columns_and_reads_time_unit_from_name(write):
    log = read_foreign(write("# a\nTimeUS,mode,x\n1000000,AUTO,1\n1005000,,2\n"), mapping(x={"from": "x", "unit": "1"}))
    np.testing.assert_array_equal(log.ticks, [0, 50_000])


WRONG_CSV = {
    "microseconds without a unit": ("timestamp,x\n1000000,1\n1005000,2\n", r"time has no unit(.|\n)*unit = \"us\""),
    "semicolons": ("t;x\n0,5;1,5\n", r"semicolons(.|\n)*decimal point"),
    "decimal commas": (
        "t,x\n0,5,1,5\n",
        r"line 2 has 4 columns, but there are 2 names: the file seems to have decimal commas",
    ),
    "text value": ("t,x\n0,up\n", r"line 2, column 'x': 'up' is not a number"),
    "decimal comma in one column": ("t,x\n0.5,1,5\n", r"line 2 has 3 columns(.|\n)*a decimal point \(1.5, not 1,5\)"),
    "quoted decimal comma": ('t,x\n0.5,"1,5"\n', "line 2, column 'x': '1,5' is not a number; write a decimal point"),
    "no rows": ("t,x\n", r"has no rows"),
    "no time": ("when,x\n0,1\n", r"does not name the column of times(.|\n)*Choices: when, x(.|\n)*time = \{field"),
    "all gaps": ("t,x\n0,\n1,\n", r"no row has only finite values: x"),
    "duplicate time": (
        "t,x\n0,1\n1,2\n1,3\n",
        r"another(.|\n)*1\.0000000 s \(lines 3 and 4\): 2\.0, then 3\.0",
    ),
    "clock restarts": ("t,x\n7,1\n8,2\n0,3\n", r"jump back by 8 s at line 4"),
    "nan time": ("t,x\n0,1\n,3\n", r"line 3, column 't': the time is nan"),
    "huge time": ("t [s],x\n0,1\n1e300,3\n", r"line 3, column 't': the time is 1e\+300 s"),
    "huge whole time": ("t [s],x\n0,1\n9000000000000000000,3\n", r"line 3, column 't': the time is 9e\+18 s"),
}


@pytest.mark.parametrize("name", WRONG_CSV)
def test_rejects_invalid_csv_logs(write, name):
    text, said = WRONG_CSV[name]
    with pytest.raises(InputError, match=said):
        read_foreign(write(text), mapping(x={"from": "x", "unit": "1"}))
