"""Conversion of slug, foot and second to SI units, for vehicles that were published in these units.

Each quantity of a record has a declared unit. `to_si` converts values from the declared units to SI units, and
`from_si` converts SI values to the declared units. Quantities in SI units or without unit are not changed.

Source: international foot (0.3048 m) and pound-force (0.45359237 kg times 9.80665 m/s^2). The other factors follow.
"""

import math
from typing import Any, TypeVar

from trimtab.core.errors import InputError
from trimtab.core.record import Quantity, children, declarations, is_record, replace

R = TypeVar("R")

FOOT = 0.3048
"""Length of one foot in metres."""
POUND_FORCE = 0.45359237 * 9.80665
"""Size of one pound-force in newtons."""
SLUG = POUND_FORCE / FOOT
"""Mass of one slug in kilograms. One pound-force accelerates one slug by 1 ft/s^2."""
MODAL = math.sqrt(SLUG * FOOT)
"""Size of one (slug ft)^1/2 in (kg m)^1/2."""

FACTORS: dict[str, float] = {
    "ft": FOOT,
    "1/ft": 1 / FOOT,
    "ft/s": FOOT,
    "ft/s^2": FOOT,
    "ft^2/ft": FOOT,
    "slug/ft": SLUG / FOOT,
    "slug/ft^3": SLUG / FOOT**3,
    "slug ft^2/ft": SLUG * FOOT,
    "lbf/ft": POUND_FORCE / FOOT,
    "lbf/ft^2": POUND_FORCE / FOOT**2,
    "lbf ft/ft": POUND_FORCE,
    "(slug ft)^1/2": MODAL,
    "(slug ft)^1/2/s": MODAL,
    "(slug ft)^1/2/s^2": MODAL,
}
"""Size of each slug-foot-second unit in the corresponding SI unit."""


def factor(unit: str) -> float:
    """Return the size of a unit in SI units; 1 for an SI unit."""
    return FACTORS.get(unit, 1.0)


def to_si(r: Any) -> dict[str, Any]:
    """Return the quantities of a record in SI units, by field name. Nested records become dictionaries."""
    values: dict[str, Any] = {}
    for name, value, declared in children(r):
        if isinstance(declared, Quantity):
            values[name] = value * factor(declared.unit)
        elif is_record(value):
            values[name] = to_si(value)
    return values


def from_si(like: R, **values: Any) -> R:
    """Return a copy of a record with some quantities replaced, given as name=value in SI units."""
    declared = {n: d for n, d in declarations(type(like)).items() if isinstance(d, Quantity)}
    for name in values:
        if name not in declared:
            problem = f"the record has no quantity {name!r}"
            raise InputError(type(like).__name__, problem, choices=declared, fix="use one of these names")
    return replace(like, **{n: v / factor(declared[n].unit) for n, v in values.items()})
