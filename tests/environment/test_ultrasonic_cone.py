import numpy as np
import pytest

from studies.hovercraft2006.ultrasonic_cone import TABLE_5_2
from trimtab.environment.acoustics import LINEAR, QUADRATIC, fit_range_ratio, off_axis_angle, range_ratio

TABLE = np.array(TABLE_5_2)
"""Angle (deg), true and measured range (cm), their ratio: [1] table 5.2, height 270.48 cm."""


def test_range_ratio_matches_table_5_2():
    """Table 5.2 of [1] within 1.2e-4, the ratio as printed and as the quotient of the printed ranges."""
    beta = np.radians(TABLE[:, 0])
    assert abs(range_ratio(beta) - TABLE[:, 3]).max() < 1.2e-4
    assert abs(range_ratio(beta) - TABLE[:, 1] / TABLE[:, 2]).max() < 1.2e-4
    np.testing.assert_allclose(off_axis_angle(270.48, TABLE[:, 1]), beta, atol=2e-4)


def test_refit_recovers_the_coefficients():
    """-0.03765 and 0.00313, correlation 0.99996, largest residual 1.05e-4 for the source's own rounded ones."""
    beta, ratio = np.radians(TABLE[:, 0]), TABLE[:, 3]
    quadratic, linear = fit_range_ratio(beta, ratio)
    assert quadratic == pytest.approx(-0.03765, abs=5e-6)
    assert linear == pytest.approx(0.00313, abs=5e-6)
    assert np.corrcoef(quadratic * beta**2 + linear * beta, ratio)[0, 1] == pytest.approx(0.99996, abs=1e-5)
    assert abs(range_ratio(beta) - ratio).max() == pytest.approx(1.05e-4, abs=1e-6)
    assert (quadratic, linear) == pytest.approx((QUADRATIC, LINEAR), rel=0.03)


def test_range_ratio_peak_is_off_axis():
    beta = np.linspace(0, 0.2, 20001)
    assert beta[np.argmax(range_ratio(beta))] == pytest.approx(-LINEAR / (2 * QUADRATIC), abs=1e-5)
    assert off_axis_angle(1.0, 0.0) == 0
    assert off_axis_angle(2.0, 1.0) == 0
