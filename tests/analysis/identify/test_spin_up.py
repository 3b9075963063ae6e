"""Moment of inertia from spin-up trials: the published table."""

import numpy as np
from analysis.identify.bench_rows import rows

from trimtab.analysis.identify import spin_up
from trimtab.core.rotation import DEG


def test_published_trials_give_the_published_inertia() -> None:
    """[1] table 4.2: 0.0952 and 0.0967 from forces rounded to two digits; 0.0948 and 0.0982 without rounding."""
    geometry = spin_up.ForceGeometry(0.32, 1.40, 0.566 * DEG, np.zeros((2, 2)))
    data = rows(rudder=[-20 * DEG, 25 * DEG], force=[1.1, 1.05], slope=[0.9412, -1.026])
    found = spin_up.inertia_of_trials(data, geometry)
    np.testing.assert_allclose(found.each, [0.0948, 0.0982], atol=1e-4)
    assert abs(found.J - 0.096) < 6e-4
