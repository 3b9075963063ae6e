"""A single gust over the distance flown."""

import numpy as np

from trimtab.core.imperfections import without
from trimtab.environment.discrete_gust import DiscreteGust

GUST = DiscreteGust(velocity=(0.0, 0.0, -6.0), length=30.0, start=1.0)


def test_pulse_gust_decays_and_ramp_gust_persists():
    """Half the height at half the length, the top at the length."""
    s = np.array([-5.0, 0.0, 15.0, 30.0, 45.0, 60.0, 90.0])
    np.testing.assert_allclose([float(GUST.shape(x)) for x in s], [0, 0, 0.5, 1, 0.5, 0, 0], atol=1e-15)
    ramp = DiscreteGust(form="ramp", length=30.0)
    np.testing.assert_allclose([float(ramp.shape(x)) for x in s], [0, 0, 0.5, 1, 1, 1, 1], atol=1e-15)
    np.testing.assert_allclose(GUST.air(30.0), [0, 0, -6.0])


def test_distance_counts_from_onset_between_two_instants():
    assert float(GUST.advance(0.5, 0.0, 100.0, 0.25)) == 0.0
    np.testing.assert_allclose(GUST.advance(0.9, 0.0, 100.0, 0.25), 15.0)
    np.testing.assert_allclose(GUST.advance(2.0, 15.0, 100.0, 0.25), 40.0)


def test_gust_can_be_switched_off():
    assert not np.any(without(GUST, "discrete-gust").air(30.0))
    assert not np.any(DiscreteGust().air(30.0))
