"""A gyro identified from a sweep, and the response after compensation by its inverse."""

import numpy as np
import pytest
from analysis.identify.bench_rows import rows
from scipy.signal import lfilter

from trimtab.analysis.identify import gyro_response
from trimtab.core.errors import InputError
from trimtab.logs.measurements import Measurements
from trimtab.sensors.gyro_dynamics import TICK, DelayedGyro, IdentifiedGyro, frequency_response

T = TICK * 1e-7


def sweep(gyro: DelayedGyro | IdentifiedGyro, highest: float) -> Measurements:
    """A swing that goes faster, to `highest` (Hz), as that gyro shows it; with 1 mrad/s of noise."""
    t = T * np.arange(4000)
    u = 2 * np.sin(np.pi * highest / t[-1] * t**2)
    if isinstance(gyro, IdentifiedGyro):
        y = lfilter([gyro.b0], [1.0, gyro.a1, gyro.a2], np.concatenate([[0.0, 0.0], u[:-2]]))
    else:
        b, a = gyro.coefficients()
        y = lfilter(b, [1.0, *a], u)
    noise = 1e-3 * np.random.default_rng(5).standard_normal(len(t))
    return rows(time=t, reference=u, gyro=np.asarray(y) + noise)


def test_published_gyro_is_recovered_from_a_sweep() -> None:
    """[1] eq. 6.2, behind a delay of two samples."""
    fit = gyro_response.fit_gyro(sweep(IdentifiedGyro(normalised=False), 40))
    assert fit.delay == 2
    error = np.sqrt(np.diagonal(fit.covariance))
    assert (np.abs(np.array([fit.b0, fit.a1, fit.a2]) - [0.3236, -0.9805, 0.2898]) < 4 * error).all()


def test_gyro_compensation_matches_the_published_table() -> None:
    """[1] table 6.5: compensated over uncompensated gain is 1/|H| at all its frequencies, as printed to two digits."""
    fit = gyro_response.fit_gyro(sweep(IdentifiedGyro(normalised=False), 50))
    f = np.array([5.0, 10, 15, 20, 30, 40, 50])
    uncompensated = np.array([1.05, 0.98, 0.93, 0.90, 0.67, 0.47, 0.33])
    compensated = np.array([1.03, 1.06, 1.20, 1.48, 1.80, 1.87, 1.74])
    rounding = 0.005 / uncompensated + 0.005 / compensated + 0.01
    assert (np.abs(1 / np.abs(fit.response(f)) / (compensated / uncompensated) - 1) < rounding).all()


@pytest.mark.thorough("10.0", "15.0")
@pytest.mark.parametrize("f", [5.0, 10.0, 15.0])
def test_inverse_of_a_delayed_gyro_gives_flat_response(f: float) -> None:
    """The gyro is a 30 Hz low-pass delayed by two samples, which is outside the model structure."""
    fit = gyro_response.fit_gyro(sweep(DelayedGyro(), 20))
    assert np.max(np.abs(np.roots([1, fit.a1, fit.a2]))) < 1
    flat = abs(frequency_response(*DelayedGyro().coefficients(), f, T)) / abs(fit.response(f))
    assert abs(flat - 1) < 0.02


def test_rejects_uneven_times() -> None:
    data = sweep(DelayedGyro(), 20)
    late = np.where(np.arange(4000) > 2000, 0.05, 0.0)
    with pytest.raises(InputError, match=r"comes 0\.056"):
        gyro_response.fit_gyro(Measurements("s.csv", data.lines, {**data.values, "time": data["time"] + late}))
