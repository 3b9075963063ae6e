"""Wind over the height."""

import numpy as np

from trimtab.environment.wind import Wind


def test_wind_is_linear_in_height():
    wind = Wind(north=1.0, east=-6.0, north_shear=0.01, east_shear=0.003)
    np.testing.assert_allclose(wind.velocity(0.0), [1.0, -6.0, 0.0])
    np.testing.assert_allclose(wind.velocity(1000.0), [11.0, -3.0, 0.0])


def test_default_wind_is_zero():
    assert not np.any(Wind().velocity(500.0))
