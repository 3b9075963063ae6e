"""Calibration of noise from still sensor triads: the true parameters lie inside their intervals."""

import math

import numpy as np
import pytest

from trimtab.analysis.identify.allan import filter_noise, fit_allan
from trimtab.analysis.identify.inertial_noise import noise_calibration

DT = 0.01
N, K = 2e-3, 4e-3


def log(rng, n, white=N, walk=K):
    return white * rng.standard_normal(n) / math.sqrt(DT) + np.cumsum(walk * math.sqrt(DT) * rng.standard_normal(n))


@pytest.fixture(scope="module")
def axes():
    rng = np.random.default_rng(4)
    return {i: fit_allan(log(rng, 60_000), DT) for i in range(3)}


def is_inside(entry, value):
    low, high = entry.interval()
    return low <= value <= high


def test_true_noise_parameters_lie_inside_their_intervals(axes):
    found, notes = noise_calibration("gyro", axes, "ten minutes")
    assert notes == ()
    e = found.entries
    assert set(e) == {
        "GyroErrors.noise",
        "GyroErrors.bias_walk",
        "InertialNoise.gyro",
        "InertialNoise.gyro_walk",
        "gyro.step",
    }
    assert is_inside(e["GyroErrors.noise"], N)
    assert is_inside(e["GyroErrors.bias_walk"], K)
    assert is_inside(e["InertialNoise.gyro"], N * N / DT)
    assert is_inside(e["InertialNoise.gyro_walk"], K * K)
    assert e["gyro.step"].value == DT
    assert {x.procedure for x in e.values()} == {"gyro noise"}


def test_three_axes_reduce_standard_error_and_set_filter_axes(axes):
    three = noise_calibration("accelerometer", axes, "").calibration.entries
    one = noise_calibration("accelerometer", {0: axes[0]}, "").calibration.entries
    assert three["AccelerometerErrors.noise"].standard_error == pytest.approx(
        one["AccelerometerErrors.noise"].standard_error / math.sqrt(3), rel=0.03
    )
    assert three["InertialNoise.forward"].value == pytest.approx(axes[0].white.value ** 2 / DT)
    assert three["InertialNoise.starboard"].value == pytest.approx(axes[1].white.value ** 2 / DT)
    assert "InertialNoise.starboard" not in one
    assert any("starboard is not written" in n for n in noise_calibration("accelerometer", {0: axes[0]}, "").notes)


def test_filter_noise_scales_with_the_filter_step(axes):
    own, other = (noise_calibration("gyro", axes, "", step).calibration.entries for step in (None, 4 * DT))
    assert other["InertialNoise.gyro"].value == pytest.approx(own["InertialNoise.gyro"].value / 4)
    assert other["InertialNoise.gyro_walk"] == own["InertialNoise.gyro_walk"]
    assert other["GyroErrors.noise"] == own["GyroErrors.noise"]
    assert other["gyro.step"].value == 4 * DT


def test_standard_errors_match_scatter_of_repeated_logs():
    """60 short logs: errors of white noise and of the filter's noise, computed by the delta method."""
    rng = np.random.default_rng(5)
    names = ("GyroErrors.noise", "InertialNoise.gyro")
    found = [noise_calibration("gyro", {2: fit_allan(log(rng, 4096), DT)}, "").calibration.entries for _ in range(60)]
    for name in names:
        scatter = np.std([e[name].value for e in found], ddof=1)
        said = np.mean([e[name].standard_error for e in found])
        assert said == pytest.approx(scatter, rel=0.3)  # 60 logs know a scatter to 9 %: three of these


def test_undetected_noise_terms_are_omitted_with_a_note():
    rng = np.random.default_rng(6)
    axes = {i: fit_allan(log(rng, 4096, walk=0.0), DT) for i in range(3)}
    found, notes = noise_calibration("gyro", axes, "")
    assert set(found.entries) == {"GyroErrors.noise", "InertialNoise.gyro", "gyro.step"}
    assert any(n.startswith("GyroErrors.bias_walk is not written") for n in notes)
    assert any(n.startswith("InertialNoise.gyro_walk is not written") for n in notes)


def test_flicker_noise_is_added_to_filter_walk_with_a_note():
    """The log contains flicker noise, approximated by a sum of step sequences of many periods."""
    rng = np.random.default_rng(7)
    n, y = 60_000, log(rng, 60_000, walk=0.0)
    for period in (2, 8, 32, 128, 512, 2048, 8192):
        y += 4e-3 * np.repeat(rng.standard_normal(n // period + 1), period)[:n]
    fit = fit_allan(y, DT)
    assert fit.flicker.low > 0
    found, notes = noise_calibration("gyro", {2: fit}, "")
    assert any("flicker" in note for note in notes)
    entry = found.entries["InertialNoise.gyro_walk"]
    assert entry.value == pytest.approx(filter_noise(fit).bias_variance / DT)
    assert entry.value > 1.2 * fit.walk.value**2


def test_differing_axes_are_noted():
    rng = np.random.default_rng(8)
    axes = {0: fit_allan(log(rng, 4096), DT), 2: fit_allan(log(rng, 4096, white=2 * N), DT)}
    notes = noise_calibration("gyro", axes, "").notes
    assert any("axes differ in white noise (x 0.00" in n for n in notes)
