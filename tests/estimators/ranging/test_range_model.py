"""Value and slope of a range against the simulated network and automatic derivatives."""

import jax
import numpy as np
import pytest

from trimtab.compiler.function import lower_function
from trimtab.core.signals import Motion
from trimtab.estimators.ranging.range_model import predict_range
from trimtab.sensors.ultrasonic_ranging import UltrasonicRanging

BEACON = np.array([1.5, -1.5, -2.7])


@pytest.mark.parametrize("cone", [True, False])
def test_it_is_what_the_sensor_measures(cone):
    """The simulated network's h(x), [1] section 5.5.4."""
    o = np.zeros(3)
    sensor = UltrasonicRanging(cone_error=cone)
    place = np.array([0.3, -0.2])
    want = sensor.measure(Motion(np.int64(0), np.append(place, 0.1), o, o, o, o, o)).range
    got = [predict_range(b, place, 0.1, cone=cone).range for b in np.asarray(sensor.beacons.map)]
    np.testing.assert_allclose(got, want, rtol=1e-13)


@pytest.mark.parametrize("cone", [True, False])
@pytest.mark.parametrize("place", [(0.3, -0.2), (1.5, -1.4), (1.2, -1.5)])
def test_its_slope_is_its_derivative(place, cone):
    place = np.array(place)
    at = predict_range(BEACON, place, 0.0, cone=cone)
    want = jax.grad(lambda p: predict_range(BEACON, p, 0.0, cone=cone).range)(place)
    np.testing.assert_allclose(at.slope, want, atol=1e-12)


def test_its_curvature_is_that_of_the_distance():
    place = np.array([0.3, -0.2])
    want = jax.hessian(lambda p: predict_range(BEACON, p, 0.0, cone=False).range)(place)
    np.testing.assert_allclose(predict_range(BEACON, place, 0.0, cone=False).curvature, want, atol=1e-12)
    with_cone = jax.hessian(lambda p: predict_range(BEACON, p, 0.0, cone=True).range)(place)
    np.testing.assert_allclose(predict_range(BEACON, place, 0.0, cone=True).curvature, with_cone, atol=0.05)


def test_under_a_beacon_all_is_finite():
    at = predict_range(BEACON, BEACON[:2], 0.0, cone=True)
    assert float(at.range) == pytest.approx(2.7)
    np.testing.assert_allclose(at.slope, 0.0, atol=1e-15)
    assert np.isfinite(at.curvature).all()


def test_it_exports():
    assert lower_function(lambda b, p: predict_range(b, p, 0.0, cone=True), (BEACON, np.zeros(2))).text("f")
