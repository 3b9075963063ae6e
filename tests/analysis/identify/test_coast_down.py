"""Friction from coast-downs."""

from typing import Any

import numpy as np
import pytest

from trimtab.analysis.identify import coast_down
from trimtab.core.errors import InputError


def test_coast_down_separates_the_friction_terms() -> None:
    g = np.random.default_rng(4)
    t = 0.05 * np.arange(200)

    def coast(v: float) -> Any:
        out = [v]
        for _ in range(199):
            for _ in range(50):
                v -= 0.001 * (0.03 * np.tanh(v / 0.01) + 0.1 * v + 0.05 * abs(v) * v)
            out.append(v)
        return np.array(out)

    trials = [(t, coast(v) + 0.005 * g.standard_normal(200)) for v in (5.0, -3.0)]
    fit = coast_down.fit_coast_down(trials, 0.1, "torque", 0.01)
    error = fit.standard_errors()
    assert (np.abs(fit.coefficients - 0.1 * np.array([0.03, 0.1, 0.05])) < 4 * error).all(), (fit.coefficients, error)
    with pytest.raises(InputError, match="not a coast-down"):
        coast_down.fit_coast_down([(t, np.full(200, 3.0))], 0.1, "torque", 0.01)
