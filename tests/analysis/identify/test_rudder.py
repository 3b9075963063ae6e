"""The rudder: servo and hull angles from simulated readings, and the published regression."""

import numpy as np
import pytest
from analysis.identify.bench_rows import rows

from trimtab.analysis.identify import rudder
from trimtab.core.errors import InputError
from trimtab.core.rotation import DEG


def test_published_hull_angle_regression_is_recovered() -> None:
    """[1] eq. 4.3, from readings to half a degree."""
    g = np.random.default_rng(0)
    theta = np.repeat(np.arange(-30, 31, 5.0), 3)
    psi = np.round(2 * ((0.566 - theta) / 1.40 + 0.3 * g.standard_normal(len(theta)))) / 2
    hull = rudder.fit_hull_angle(rows(rudder=theta * DEG, hull=psi * DEG))
    assert abs(hull.ratio - 1.40) < 3 * np.sqrt(hull.covariance[0, 0])
    assert abs(hull.offset - 0.566 * DEG) < 3 * np.sqrt(hull.covariance[1, 1])
    assert hull.correlation < -0.99


def test_rejects_hull_angle_of_the_wrong_sign() -> None:
    theta = np.arange(-30, 31, 10.0) * DEG
    with pytest.raises(InputError, match="turns with the rudder"):
        rudder.fit_hull_angle(rows(rudder=theta, hull=theta / 1.4))


def test_unmeasured_servo_pulses_are_named() -> None:
    pulse = np.repeat(1e-3 + 50e-6 * np.arange(18), 2)
    with pytest.raises(InputError, match=r"1\.90, 1\.95, 2\.00 ms"):
        rudder.fit_servo(rows(pulse=pulse, angle=pulse * 100))


def test_rejects_decreasing_servo_angles() -> None:
    pulse = np.repeat(1e-3 + 50e-6 * np.arange(21), 2)
    with pytest.raises(InputError, match="does not rise"):
        rudder.fit_servo(rows(pulse=pulse, angle=-pulse * 1000 + 1.5))


def test_servo_play_is_estimated_apart_from_scatter() -> None:
    g = np.random.default_rng(1)
    pulse, way = np.tile(1e-3 + 50e-6 * np.arange(21), 4), np.repeat([1.0, -1.0, 1.0, -1.0], 21)
    angle = (pulse - 1.5e-3) * 1200 - way * 1 * DEG + 0.1 * DEG * g.standard_normal(84)
    servo = rudder.fit_servo(rows(pulse=pulse, angle=angle, way=way))
    assert servo.play is not None
    assert abs(servo.play - 1 * DEG) < 0.05 * DEG
    assert servo.errors.max() < 0.08 * DEG
