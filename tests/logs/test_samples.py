"""Each sample of a sensor once, at its own time, out of rows that hold it."""

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.time import ms, to_seconds
from trimtab.logs.log import Log
from trimtab.logs.samples import sample_path, samples

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


def test_equal_values_of_two_samples_are_two():
    taken = np.arange(100) * TICK
    log = held(np.arange(0, taken[-1], ms(1)), taken, np.ones((100, 1)))
    assert len(samples(log, "sensors.imu.value.rate").values) >= 99


def test_rows_that_come_too_seldom_are_refused_with_the_reason():
    taken = np.arange(1000) * TICK
    log = held(np.arange(0, taken[-1], ms(10)), taken, np.zeros((1000, 1)))
    with pytest.raises(InputError, match=r"rows of the log come each 10 ms, so it misses samples(.|\n)*log_period"):
        samples(log, "sensors.imu.value.rate")


def test_a_run_whose_rows_hide_every_other_sample_is_refused_by_its_settings():
    """Each 20 ms of a 10 ms sensor looks even; the noise would be read too large."""
    taken = np.arange(1000) * ms(10)
    log = held(np.arange(0, taken[-1], ms(20)), taken, np.zeros((1000, 1)))
    assert samples(log, "sensors.imu.value.rate").period == pytest.approx(0.02)
    about = {"parameters": {"world.sensors.imu.period": ms(10)}}
    told = Log(t=log.t, ticks=log.ticks, signals=log.signals, metadata=about)
    with pytest.raises(InputError, match="misses samples"):
        samples(told, "sensors.imu.value.rate")


def test_a_gap_is_named_by_its_time():
    taken = np.delete(np.arange(1000) * TICK, [500, 501])
    log = held(np.arange(0, taken[-1], ms(1)), taken, np.zeros((998, 1)))
    with pytest.raises(InputError, match=r"usually 6\.5536 ms, but 19\.6608 ms at 3\.2702 s"):
        samples(log, "sensors.imu.value.rate")


def test_other_signals_are_sampled_by_the_rows_and_may_jitter():
    g = np.random.default_rng(0)
    rows = np.arange(500) * ms(10) + g.integers(0, ms(2), 500)
    log = Log(t=to_seconds(rows), ticks=rows, signals={"csv.gyro": np.arange(500.0)})
    assert sample_path(log, "csv.gyro") is None
    found = samples(log, "csv.gyro")
    assert (len(found.values), found.period) == (500, pytest.approx(0.01, rel=1e-3))
    with pytest.raises(InputError, match="2 samples"):
        samples(log.between(0, 0.015), "csv.gyro")
