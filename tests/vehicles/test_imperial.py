"""Slug, foot and second in the SI: the factors, there and back, and refusals."""

import pytest

from trimtab.core.errors import InputError
from trimtab.core.record import Quantity, leaves
from trimtab.vehicles import imperial
from trimtab.vehicles.hypersonic import Disturbance, Hypersonic, HypersonicInput, HypersonicState

SI_ALREADY = {"1", "s", "rad", "rad/s", "rad/s^2", "1/rad", "1/rad^2"}


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        ("ft", 0.3048),
        ("ft/s^2", 0.3048),
        ("slug/ft^3", 515.378818),
        ("slug/ft", 47.880259),
        ("lbf/ft", 14.593903),
        ("slug ft^2/ft", 4.448222),
        ("lbf ft/ft", 4.448222),
        ("ft^2/ft", 0.3048),
        ("(slug ft)^1/2", 2.109081),
    ],
)
def test_factors_match_published_values(unit, factor):
    """Specification section 1, table of conversion factors, all digits that it prints."""
    assert imperial.factor(unit) == pytest.approx(factor, rel=3e-7)


def test_si_conversion_round_trip():
    x = HypersonicState(85000.0, 7702.0, 0.03, 0.04, 0.001, 0.9, 0.1, 0.7, -0.2)
    view = imperial.to_si(x)
    assert view["h"] == pytest.approx(25908.0)
    assert view["V"] == pytest.approx(2347.5696)
    assert view["alpha"] == 0.03
    back = imperial.from_si(x, **view)
    for name in view:
        assert getattr(back, name) == pytest.approx(getattr(x, name), rel=1e-15)


def test_nested_records_become_nested_views():
    view = imperial.to_si(Hypersonic())
    assert view["m"] == pytest.approx(300 * 47.880259, rel=1e-7)
    assert view["forces"]["atmosphere"]["rho0"] == pytest.approx(6.7429e-5 * 515.378818, rel=1e-8)
    assert "kmode" not in view["modes"]


def test_rejects_unknown_field_name():
    with pytest.raises(InputError, match="altitude"):
        imperial.from_si(HypersonicState(*[0.0] * 9), altitude=3.0)


def test_every_unit_of_the_vehicle_is_known():
    """A unit with a misprint would pass unconverted."""
    records = (Hypersonic(disturbance=Disturbance()), HypersonicState(*[0.0] * 9), HypersonicInput(0.0, 0.0))
    units = {d.unit for r in records for _, _, d in leaves(r) if isinstance(d, Quantity)}
    assert {"ft", "lbf ft/ft", "(slug ft)^1/2/s^2"} <= units
    assert units <= SI_ALREADY | set(imperial.FACTORS)
