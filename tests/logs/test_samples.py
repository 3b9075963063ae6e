"""Extraction of each sensor sample once, at its own time, from rows that hold the newest sample."""

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.time import ms, to_seconds
from trimtab.logs.log import Log
from trimtab.logs.samples import SampleSeries, log_samples, read_csv, sample_path, samples

TICK = ms("6.5536")


def held(rows, taken, values):
    """A log with rows at these ticks that holds the newest sample; not valid before the first."""
    at = np.searchsorted(taken, rows, side="right") - 1
    seen = at >= 0
    signals = {
        "sensors.imu.value.rate": np.where(seen[:, None], values[at], 0.0),
        "sensors.imu.t": np.where(seen, taken[at], 0),
        "sensors.imu.valid": seen,
    }
    return Log(t=to_seconds(rows), ticks=rows, signals=signals)


@pytest.mark.parametrize("spacing", [ms(1), ms(5), ms("6.5")])
def test_every_sample_is_found_once(spacing):
    taken = np.arange(3, 1003) * TICK
    values = np.random.default_rng(0).standard_normal((1000, 3))
    log = held(np.arange(0, taken[-1] + spacing, spacing), taken, values)
    found = samples(log, "sensors.imu.value.rate")
    np.testing.assert_array_equal(found.values, values)
    np.testing.assert_array_equal(found.ticks, taken)
    assert found.period == pytest.approx(0.0065536, rel=1e-12)


def test_repeated_equal_values_are_separate_samples():
    taken = np.arange(100) * TICK
    log = held(np.arange(0, taken[-1], ms(1)), taken, np.ones((100, 1)))
    assert len(samples(log, "sensors.imu.value.rate").values) >= 99


def test_rejects_log_rows_slower_than_the_sensor():
    taken = np.arange(1000) * TICK
    log = held(np.arange(0, taken[-1], ms(10)), taken, np.zeros((1000, 1)))
    with pytest.raises(InputError, match=r"the log has a row only every 10 ms, so it misses samples(.|\n)*log_period"):
        samples(log, "sensors.imu.value.rate")


def test_rejects_rows_that_hide_every_second_sample():
    """Rows every 20 ms of a 10 ms sensor look evenly spaced, but the noise estimate would be too large."""
    taken = np.arange(1000) * ms(10)
    log = held(np.arange(0, taken[-1], ms(20)), taken, np.zeros((1000, 1)))
    assert samples(log, "sensors.imu.value.rate").period == pytest.approx(0.02)
    about = {"parameters": {"world.sensors.imu.period": ms(10)}}
    told = Log(t=log.t, ticks=log.ticks, signals=log.signals, metadata=about)
    with pytest.raises(InputError, match="misses samples"):
        samples(told, "sensors.imu.value.rate")


def test_gap_error_names_its_time():
    taken = np.delete(np.arange(1000) * TICK, [500, 501])
    log = held(np.arange(0, taken[-1], ms(1)), taken, np.zeros((998, 1)))
    with pytest.raises(InputError, match=r"usually every 6\.5536 ms, but 19\.6608 ms at 3\.2702 s"):
        samples(log, "sensors.imu.value.rate")


def test_signals_without_flags_are_sampled_at_jittered_rows():
    g = np.random.default_rng(0)
    rows = np.arange(500) * ms(10) + g.integers(0, ms(2), 500)
    log = Log(t=to_seconds(rows), ticks=rows, signals={"csv.gyro": np.arange(500.0)})
    assert sample_path(log, "csv.gyro") is None
    found = samples(log, "csv.gyro")
    assert (len(found.values), found.period) == (500, pytest.approx(0.01, rel=1e-3))
    with pytest.raises(InputError, match="2 samples"):
        samples(log.between(0, 0.015), "csv.gyro")


def test_longest_stretch_between_gaps_is_used_on_request():
    taken = np.delete(np.arange(2000) * ms(5), [700, 1500])
    log = Log(t=to_seconds(taken), ticks=taken, signals={"csv.gyro": np.arange(2000.0)[np.arange(1998)]})
    with pytest.raises(InputError, match="not evenly spaced"):
        samples(log, "csv.gyro")
    found = samples(log, "csv.gyro", longest=True)
    assert (len(found.values), found.values[0], found.period) == (799, 700.0, pytest.approx(0.005, rel=1e-12))
    assert found.left_out.startswith("2 gaps, the first at 3.4950 s: only its longest stretch")
    assert found.left_out.endswith("is used, 3.5050 to 7.4950 s")
    holes = np.delete(np.arange(2000) * ms(5), np.arange(10, 2000, 20))
    uneven = Log(t=to_seconds(holes), ticks=holes, signals={"csv.gyro": np.zeros(len(holes))})
    with pytest.raises(InputError, match="not evenly spaced"):
        samples(uneven, "csv.gyro", longest=True)


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


def test_csv_columns_units_and_times_are_read(write):
    log = read_csv(write(GOOD))
    np.testing.assert_array_equal(log.ticks, [0, 100_000, 200_000])
    np.testing.assert_array_equal(log["csv.gyro_z"], [0.1, 0.2, -0.3])
    assert (log.unit("csv.gyro_z"), log.metadata["file"]) == ("rad/s", "log.csv")
    assert len(log.paths) == 2


def test_time_column_can_be_selected_by_name(write):
    log = read_csv(write("stamp,x\n0,1\n0.5,2\n"), "stamp")
    np.testing.assert_array_equal(log.t, [0.0, 0.5])
    assert log.paths == ("csv.x",)


UNITS = {"": 1.0, "[s]": 1.0, "[ms]": 1e-3, "(us)": 1e-6, "[µs]": 1e-6, "[ns]": 1e-9}


@pytest.mark.parametrize("unit", UNITS)
def test_time_unit_is_read_from_the_csv_heading(write, unit):
    rows = [round((7.0 + 0.01 * i) / UNITS[unit]) if UNITS[unit] < 1 else 7.0 + 0.01 * i for i in range(3)]
    log = read_csv(write(f"time {unit},x\n" + "".join(f"{t},1\n" for t in rows)))
    np.testing.assert_array_equal(log.ticks, [0, 100_000, 200_000])


@pytest.mark.parametrize("name", ["time_ms", "TimeUS", "%time", "timestamp_us", "time_s"])
def test_time_unit_is_read_from_the_column_name(write, name):
    scale = {"time_ms": 1e-3, "TimeUS": 1e-6, "%time": 1e-9, "timestamp_us": 1e-6, "time_s": 1.0}[name]
    rows = [f"{1000 + 0.01 * i:.2f}" if scale == 1 else str(round((1000 + 0.01 * i) / scale)) for i in range(3)]
    log = read_csv(write(f"{name},x\n" + "".join(f"{t},1\n" for t in rows)))
    np.testing.assert_array_equal(log.ticks, [0, 100_000, 200_000])


def test_other_columns_of_times_are_no_signals(write):
    log = read_csv(write("t [s],time_us [us],x\n0,0,1\n1,1000000,2\n"))
    assert log.paths == ("csv.x",)


def test_rejects_times_that_are_equal_after_rounding(write):
    with pytest.raises(InputError, match=r"the times must rise, but after line 3(.|\n)*resolution of at least 100 ns"):
        read_csv(write("t [s],x\n0,1\n0.001,2\n0.00100001,3\n0.002,3\n0.003,4\n"))


def test_time_unit_can_be_given_with_the_column_name(write):
    text = "timestamp,x\n1000000000,1\n1000005000,2\n"
    np.testing.assert_array_equal(read_csv(write(text), "timestamp [us]").ticks, [0, 50_000])
    slow = read_csv(write("t [s],x\n0,1\n60,2\n"))
    assert slow.t[1] == 60


def test_numbered_columns_are_separate_signals(write):
    log = read_csv(write("t,gyro_rad[0],gyro_rad[1] [rad/s],gyro_rad[2]\n0,1,2,3\n1,4,5,6\n"))
    assert log.paths == ("csv.gyro_rad[0]", "csv.gyro_rad[1]", "csv.gyro_rad[2]")
    assert [log.unit(path) for path in log.paths] == ["1", "rad/s", "1"]
    np.testing.assert_array_equal(log["csv.gyro_rad[2]"], [3, 6])


def test_columns_with_text_or_empty_cells_are_omitted_with_reason(write):
    log = read_csv(write('# logger 2\nt,mode,x,battery\n0,"AUTO, 1",1,\n1,HOLD,2,12\n'))
    assert log.paths == ("csv.x",)
    assert log.metadata["left_out"] == {
        "mode": "line 3, column 'mode': 'AUTO, 1' is not a number",
        "battery": "line 3, column 'battery': the cell is empty",
    }


REFUSED = {
    "no time": ("a,b\n1,2\n", "no column of times"),
    "too few columns": ("t,x\n1,2\n3\n", "line 3 has 1 columns"),
    "text": ("t,x\n1,left\n", "line 2, column 'x': 'left' is not a number"),
    "nan": ("t,x\n1,2\n2,nan\n", "line 3, column 'x': 'nan' is not finite"),
    "empty time cell": ("t,x\n1,2\n,3\n", "line 3, column 't': the cell is empty"),
    "microseconds": ("timestamp,x\n1000000000,1\n1000005000,2\n", r"every 5000 s(.|\n)*timestamp \[us\]"),
    "milliseconds": ("t,x\n0,1\n10,2\n", r"every 10 s(.|\n)*t \[ms\]"),
    "nanoseconds": ("t,x\n0,1\n10000000,2\n", r"no unit is given(.|\n)*t \[ns\]"),
    "seconds as milliseconds": ("time_ms,x\n0,1\n0.005,2\n", "every 0.005 ms, as written; no sensor has"),
    "no rows": ("t,x\n", "no rows"),
    "backwards": ("t,x\n1,2\n3,4\n2,5\n", r"after line 3: 3, then 2"),
    "hours": ("time [h],x\n0,1\n1,2\n", r"'time' is in 'h'(.|\n)*Choices: s, ms, us, ns, min(.|\n)*Fix: convert"),
    "one name twice": ("t,a,a\n0,1,2\n1,3,4\n", r"'a' and 'a' have the same signal, csv\.a"),
    "times twice": ("t,t,a\n0,0,2\n1,1,4\n", r"'t' and 't' have the same signal"),
    "names alike": ("t,gyro x,gyro-x\n0,1,2\n1,3,4\n", r"'gyro x' and 'gyro-x' have the same signal, csv\.gyro_x"),
    "nothing": ("", "has no rows"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_rejects_invalid_csv_logs(write, name):
    text, wanted = REFUSED[name]
    with pytest.raises(InputError, match=wanted):
        read_csv(write(text))


def test_rejects_missing_file_and_unknown_time_column(write, tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_csv(tmp_path / "none.csv")
    with pytest.raises(InputError, match=r"no column 'clock'(.|\n)*Choices: time, gyro_z"):
        read_csv(write(GOOD), "clock")


def test_sample_series_become_rows_holding_the_newest_sample():
    slow = SampleSeries(np.array([20, 60]), {"x": np.array([1.0, 2.0])})
    quick = SampleSeries(
        np.array([10, 30, 60]), {"v": np.arange(6.0).reshape(3, 2), "on": np.array([True, False, True])}
    )
    truth = SampleSeries(np.array([0, 100]), {"north": np.array([0.0, 10.0])})
    log = log_samples({"slow": slow, "quick": quick}, truth, {"name": "mine"})
    np.testing.assert_array_equal(log.ticks, [0, 10, 20, 50])
    np.testing.assert_array_equal(log["downlink.slow.value.x"], [0, 1, 1, 2])
    np.testing.assert_array_equal(log["downlink.slow.valid"], [False, True, True, True])
    np.testing.assert_array_equal(log["downlink.slow.fresh"], [False, True, False, True])
    np.testing.assert_array_equal(log["downlink.quick.value.v"], [[0, 1], [0, 1], [2, 3], [4, 5]])
    np.testing.assert_array_equal(log["downlink.quick.value.on"], [True, True, False, True])
    np.testing.assert_array_equal(log["downlink.quick.t"], [0, 0, 20, 50])
    np.testing.assert_allclose(log["downlink.quick.age"], [0, 1e-6, 0, 0], atol=1e-15)
    np.testing.assert_allclose(log["truth.north"], [1, 2, 3, 6])
    np.testing.assert_array_equal(log["log.dropped"], 0)


@pytest.mark.parametrize(
    ("sensors", "what"),
    [
        ({}, "no sensor"),
        ({"a": SampleSeries(np.array([2, 1]), {"x": np.zeros(2)})}, "do not rise"),
        ({"a": SampleSeries(np.array([0.5, 1.0]), {"x": np.zeros(2)})}, "whole numbers"),
        ({"a": SampleSeries(np.array([1, 2]), {"x": np.zeros(3)})}, "3 values"),
    ],
)
def test_rejects_invalid_sample_series(sensors, what):
    with pytest.raises(InputError, match=what):
        log_samples(sensors)
