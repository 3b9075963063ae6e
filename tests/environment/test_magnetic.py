import builtins
import math
from datetime import date

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.environment.magnetic import COLLEGE_PARK, declination, earth_field, field_from_angles, inclination

DEG = math.pi / 180
PRINTED = (
    (80, 0, 0, 2020.0, 6570.4, -146.3, 54606.0),
    (0, 120, 0, 2020.0, 39624.3, 109.9, -10932.5),
    (-80, 240, 0, 2020.0, 5940.6, 15772.1, -52480.8),
)


@pytest.mark.parametrize(("latitude", "longitude", "height", "year", "north", "east", "down"), PRINTED)
def test_field_matches_published_wmm_test_values(latitude, longitude, height, year, north, east, down):
    """Test values of the WMM2020 report, to their 0.1 nT."""
    got = earth_field(latitude * DEG, longitude * DEG, height, year)
    np.testing.assert_allclose(got * 1e9, [north, east, down], atol=0.06)


def test_default_field_matches_college_park():
    """At College Park, 2010.0, as rounded in COLLEGE_PARK; angles there and back."""
    field = earth_field(38.99 * DEG, -76.94 * DEG, 50.0, date(2010, 1, 1))
    np.testing.assert_allclose(field, COLLEGE_PARK, atol=1e-8)
    assert declination(field) / DEG == pytest.approx(-10.86, abs=0.01)
    again = field_from_angles(float(np.linalg.norm(field)), declination(field), inclination(field))
    np.testing.assert_allclose(again, field, atol=1e-18)


def test_date_is_converted_to_fraction_of_year():
    first, middle, last = (
        earth_field(0.5, 0.1, 0.0, d) for d in (date(2024, 1, 1), date(2024, 7, 2), date(2025, 1, 1))
    )
    assert np.abs(middle - (first + earth_field(0.5, 0.1, 0.0, 2024.99999)) / 2).max() < 1e-10
    assert np.abs(last - first).max() > 1e-8


@pytest.mark.parametrize("year", [2006.0, 2030.0, math.nan])
def test_rejects_year_without_a_model(year):
    with pytest.raises(InputError, match="no installed World Magnetic Model") as error:
        earth_field(0.5, 0.1, 0.0, year)
    assert "field_from_angles" in error.value.fix


@pytest.mark.parametrize("place", [(39.0, 0.1, 0.0), (0.5, math.inf, 0.0), (0.5, 0.1, -5000.0), (math.nan, 0, 0)])
def test_rejects_positions_outside_the_model(place):
    with pytest.raises(InputError, match="does not cover"):
        earth_field(*place, 2020.0)


def test_missing_package_error_names_the_install_command(monkeypatch):
    real = builtins.__import__

    def without(name, *args, **kwargs):
        if name == "pygeomag":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match="pygeomag is not installed") as error:
        earth_field(0.5, 0.1, 0.0, 2020.0)
    assert error.value.fix.endswith('-m pip install "trimtab[nav]"')
