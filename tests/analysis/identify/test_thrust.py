"""Thrust and reverse thrust: the published cubic, and losses of another form."""

import numpy as np
import pytest
from analysis.identify.bench_rows import rows

from trimtab.analysis.identify import thrust
from trimtab.core.errors import InputError
from trimtab.core.rotation import DEG
from trimtab.loop.calibrated import tabulate_thrust


def test_published_reverse_thrust_cubic_is_recovered() -> None:
    """[1] eq. 4.4, from its own ratios."""
    n = np.arange(6000, 12001, 500.0)
    forward = 0.0111 * (n / 1000) ** 2
    y = np.polyval([9.734e-4, -3.277e-2, 3.833e-1, -1.099], n / 1000)
    fit = thrust.fit_reverse(rows(speed=n, forward=forward, reverse=forward * y), 0.03)
    np.testing.assert_allclose(fit.coefficients, [9.734e-4, -3.277e-2, 3.833e-1, -1.099], rtol=1e-6)


def test_rudder_thrust_loss_of_another_form_is_detected() -> None:
    g = np.random.default_rng(2)
    theta, n = (v.ravel() for v in np.meshgrid(np.arange(-40, 41, 10.0) * DEG, np.arange(6, 12.1, 1.0)))
    for loss, formula in ((np.cos(theta), True), (1 - 1.2 * theta**2, False)):
        F = 0.0111 * n**2 * loss + 0.02 * g.standard_normal(len(n))
        fit = thrust.fit_thrust(rows(rudder=theta, speed=1000 * n, force=F), 0.0)
        assert fit.follows_formula() is formula
    with pytest.raises(InputError, match="does not extrapolate"):
        tabulate_thrust(fit.angles, fit.by_angle, np.array([-45 * DEG]))
