"""The functions trim and linearise of the package."""

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.scenarios.build import build
from trimtab.vehicle_model import linearise, trim

pytestmark = pytest.mark.thorough


def test_trim_by_name_equals_trim_of_scenario():
    at = {"surge_velocity": "3.6 km/h", "yaw_rate": 0}
    named, given = trim("hovercraft/forward", at), trim(build("hovercraft/forward"), at)
    assert named.is_found
    np.testing.assert_allclose(named.x[:3], [1, 0, 0], atol=1e-9)
    np.testing.assert_array_equal(named.x, given.x)


def test_linear_model_matches_analytic_jacobian():
    """u' = v r + FX/m, v' = -u r + FY/m, r' = -d FY/J about u = 1 m/s."""
    m, J, d = 2.6, 0.096, 0.32
    own = ["surge_velocity", "sway_velocity", "yaw_rate"]
    linear = linearise("hovercraft/forward", {"surge_velocity": 1}, states=own, outputs=["yaw_rate"])
    np.testing.assert_allclose(linear.A, [[0, 0, 0], [0, 0, -1], [0, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(linear.B, [[1 / m, 0], [0, 1 / m], [0, -d / J]], atol=1e-9)
    assert linear.outputs == ("yaw_rate",)


def test_rejects_unit_of_another_quantity():
    with pytest.raises(InputError, match="does not measure"):
        trim("hovercraft/forward", {"surge_velocity": "1 kg"})
