"""Units that people and loggers write, in SI and radians."""

import math

import pytest

from trimtab.core.errors import InputError
from trimtab.core.quantity import quantity
from trimtab.core.units import NAMES, UNITS, check_kept, check_symbols, find_size, find_unit

DEG = math.pi / 180


@pytest.mark.parametrize(
    ("unit", "si", "size"),
    [
        ("deg", "rad", DEG),
        ("dps", "rad/s", DEG),
        ("rpm", "rad/s", 0.10471975511965977),
        ("g", "m/s^2", 9.80665),
        ("m/s/s", "m/s^2", 1),
        ("gauss", "T", 1e-4),
        ("mGauss", "T", 1e-7),
        ("mT", "T", 1e-3),
        ("cm", "m", 1e-2),
        ("mm", "m", 1e-3),
        ("us", "s", 1e-6),
        ("µs", "s", 1e-6),
        ("1e-7 deg", "rad", 1e-7 * DEG),
        ("°/s", "rad/s", DEG),
        ("gf", "N", 0.00980665),
        ("lbf", "N", 4.4482216152605),
    ],
)
def test_find_unit_gives_si_unit_and_scale(unit, si, size):
    found = find_unit("here", unit)
    assert found.name == si
    assert found.scale == pytest.approx(size, rel=1e-12)


@pytest.mark.parametrize(
    ("unit", "kept", "size"),
    [
        ("g", "kg", 1e-3),
        ("g", "m/s^2", 9.80665),
        ("krpm", "rpm", 1000),
        ("Hz", "rpm", 60),
        ("rad/s", "rpm", 9.549296585513721),
        ("", "1", 1),
        ("ozf", "N", 0.27801385095378125),
        ("kg", "N", None),
        ("", "N", None),
    ],
)
def test_find_size_converts_to_the_kept_unit(unit, kept, size):
    """Grams are accepted for a mass; a fan's speed stays in rpm; None where the unit is not of that quantity."""
    assert find_size(unit, kept) == (None if size is None else pytest.approx(size, rel=1e-12))


def test_every_kept_unit_has_scale_one():
    assert {kept: sizes.get(kept) for kept, sizes in UNITS.items()} == dict.fromkeys(UNITS, 1.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("furlong", "unknown unit(.|\n)*Choices: 1, %"),
        ("1e- m", "does not begin with a number"),
        ("0 m", "the factor must be finite and not 0, got '0 m'"),
        ("1e400 m", "must be finite"),
    ],
)
def test_rejects_unknown_unit(text, said):
    with pytest.raises(InputError, match=said):
        find_unit("here", text)


def test_unknown_unit_error_suggests_the_nearest():
    with pytest.raises(InputError, match='Fix: unit = "rad/s"'):
        find_unit("here", "rads/s")


@pytest.mark.parametrize(
    ("unit", "fix"), [("metre", '"m"'), ("Metres/s", '"m/s"'), ("kg/second^2", '"kg/s^2"'), ("N metres", '"N m"')]
)
def test_rejects_spelled_out_unit_in_a_declaration(unit, fix):
    with pytest.raises(InputError, match="the unit must be a symbol") as refused:
        quantity(unit, "Of a vehicle.")
    assert fix in refused.value.fix


def test_accepts_unit_symbols_in_declarations():
    for unit in [
        *(u for sizes in UNITS.values() for u in sizes),
        *NAMES.values(),
        "1",
        "(slug ft)^1/2/s",
        "N m s^2/rad",
    ]:
        check_symbols(unit)


@pytest.mark.parametrize(
    ("unit", "kept"), [("deg", "rad"), ("deg/s", "rad/s"), ("km/h", "m/s"), ("lb", "kg"), ("ms", "s")]
)
def test_rejects_declared_unit_that_is_not_kept(unit, kept):
    with pytest.raises(InputError, match=f"must be {kept}, in which the value is stored, got {unit}") as refused:
        quantity(unit, "Course.", default=90.0)
    assert f'quantity("{kept}"' in refused.value.fix


@pytest.mark.parametrize("unit", ["rad", "rpm", "ft/s", "N m/rad", "1"])
def test_accepts_units_of_a_publication(unit):
    check_kept(unit)
