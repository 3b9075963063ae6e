"""Units of slug, foot and second in the SI: what a vehicle that was published in them shows at its boundary.

A record declares the unit of each of its quantities; `to_si` reads it and gives values and units in the SI, `from_si`
goes the other way. Quantities that are in the SI already, and those without unit, stay as they are.

Source: the international foot (0.3048 m) and pound-force (0.45359237 kg times 9.80665 m/s^2); the rest follows.
"""

import math
from typing import Any, TypeVar

from trimtab.core.errors import InputError
from trimtab.core.record import Quantity, declarations, is_record, replace

R = TypeVar("R")

FOOT = 0.3048
"""m."""
POUND_FORCE = 0.45359237 * 9.80665
"""N."""
SLUG = POUND_FORCE / FOOT
"""kg: one pound-force accelerates it by 1 ft/s^2."""
MODAL = math.sqrt(SLUG * FOOT)
"""(kg m)^1/2 in one (slug ft)^1/2."""

UNITS: dict[str, tuple[str, float]] = {
    "ft": ("m", FOOT),
    "1/ft": ("1/m", 1 / FOOT),
    "ft/s": ("m/s", FOOT),
    "ft/s^2": ("m/s^2", FOOT),
    "ft^2/ft": ("m^2/m", FOOT),
    "slug/ft": ("kg/m", SLUG / FOOT),
    "slug/ft^3": ("kg/m^3", SLUG / FOOT**3),
    "slug ft^2/ft": ("kg m^2/m", SLUG * FOOT),
    "lbf/ft": ("N/m", POUND_FORCE / FOOT),
    "lbf/ft^2": ("Pa", POUND_FORCE / FOOT**2),
    "lbf ft/ft": ("N m/m", POUND_FORCE),
    "(slug ft)^1/2": ("(kg m)^1/2", MODAL),
    "(slug ft)^1/2/s": ("(kg m)^1/2/s", MODAL),
    "(slug ft)^1/2/s^2": ("(kg m)^1/2/s^2", MODAL),
}
"""Unit of slug, foot and second -> unit of the SI, and how many of it make one."""


def factor(unit: str) -> float:
    """How many units of the SI make one of this unit; 1 where it is one."""
    return UNITS[unit][1] if unit in UNITS else 1.0


def si_unit(unit: str) -> str:
    """The unit of the SI for the same quantity."""
    return UNITS[unit][0] if unit in UNITS else unit


def to_si(r: Any) -> dict[str, Any]:
    """Field name -> value in the SI, for the quantities of a record, nested records as dictionaries."""
    found: dict[str, Any] = {}
    for name, declared in declarations(type(r)).items():
        value = getattr(r, name)
        if isinstance(declared, Quantity):
            found[name] = value * factor(declared.unit)
        elif is_record(value):
            found[name] = to_si(value)
    return found


def from_si(like: R, **values: Any) -> R:
    """A copy of a record with some quantities replaced, given in the SI.

    Args:
        like: record whose fields declare their units.
        values: field name -> value in the SI.
    """
    declared = {n: d for n, d in declarations(type(like)).items() if isinstance(d, Quantity)}
    for name in values:
        if name not in declared:
            problem = f"it has no quantity {name!r}"
            raise InputError(type(like).__name__, problem, choices=declared, fix="name one of these")
    return replace(like, **{n: v / factor(declared[n].unit) for n, v in values.items()})
