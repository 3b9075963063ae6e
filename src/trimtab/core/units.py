"""Units that users and logs may use, and their sizes in SI and radians.

Quantities are stored in SI and radians, except for fan speeds in rpm.
"""

import math
import re
from collections.abc import Mapping
from typing import NamedTuple

from trimtab.core.errors import InputError
from trimtab.core.suggestions import closest

DEGREE = math.pi / 180
FREE_FALL = 9.80665
"""Standard gravity, m/s^2."""
FLAG, COUNT = "flag", "count"
TURN = 2 * math.pi
POUND = 0.45359237
"""One pound (kg)."""

RATES: Mapping[str, float] = {
    "rad/s": 1.0,
    "mrad/s": 1e-3,
    "deg/s": DEGREE,
    "rpm": TURN / 60,
    "krpm": 1e3 * TURN / 60,
}
UNITS: Mapping[str, Mapping[str, float]] = {
    "1": {"1": 1.0, "%": 0.01},
    FLAG: {FLAG: 1.0},
    COUNT: {COUNT: 1.0},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": DEGREE, "cdeg": 0.01 * DEGREE, "turn": TURN},
    "rad/s": RATES,
    "rad/s^2": {"rad/s^2": 1.0, "deg/s^2": DEGREE},
    "m/s^2": {"m/s^2": 1.0, "cm/s^2": 0.01, "g": FREE_FALL, "mg": 1e-3 * FREE_FALL},
    "m": {"m": 1.0, "km": 1e3, "cm": 0.01, "mm": 1e-3, "ft": 0.3048, "in": 0.0254},
    "m^2": {"m^2": 1.0},
    "m/s": {
        "m/s": 1.0,
        "cm/s": 0.01,
        "mm/s": 1e-3,
        "km/h": 1 / 3.6,
        "kn": 1852 / 3600,
        "ft/s": 0.3048,
    },
    "T": {"T": 1.0, "mT": 1e-3, "uT": 1e-6, "nT": 1e-9, "gauss": 1e-4, "mgauss": 1e-7},
    "Pa": {"Pa": 1.0, "hPa": 100.0, "mbar": 100.0, "kPa": 1e3, "bar": 1e5},
    "K": {"K": 1.0},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "N": {
        "N": 1.0,
        "mN": 1e-3,
        "gf": 1e-3 * FREE_FALL,
        "kgf": FREE_FALL,
        "ozf": POUND / 16 * FREE_FALL,
        "lbf": POUND * FREE_FALL,
    },
    "kg": {"kg": 1.0, "g": 1e-3, "lb": POUND},
    "V": {"V": 1.0, "mV": 1e-3},
    "A": {"A": 1.0, "mA": 1e-3},
    "Hz": {"Hz": 1.0},
    "rpm": {"rpm": 1.0, "krpm": 1e3, "rad/s": 60 / TURN, "Hz": 60.0},
}
"""Units in which a quantity may be written, with their sizes in the unit of storage, keyed by unit of storage.

If the quantity is unknown, a symbol with two meanings, such as g, has the meaning that is listed first.
"""
SPELLINGS = {
    "": "1",
    "degrees": "deg",
    "degree": "deg",
    "radians": "rad",
    "dps": "deg/s",
    "degps": "deg/s",
    "radps": "rad/s",
    "m/s/s": "m/s^2",
    "m/s2": "m/s^2",
    "m/s**2": "m/s^2",
    "rad/s/s": "rad/s^2",
    "deg/s/s": "deg/s^2",
    "g0": "g",
    "G": "gauss",
    "Gs": "gauss",
    "Gauss": "gauss",
    "mG": "mgauss",
    "mGauss": "mgauss",
    "kt": "kn",
    "knots": "kn",
    "degheading": "deg",
    "deglatitude": "deg",
    "deglongitude": "deg",
    "bool": FLAG,
}
"""Symbols of units, keyed by other spellings of the units."""

NAMES = {
    "metre": "m",
    "meter": "m",
    "kilogram": "kg",
    "gram": "g",
    "second": "s",
    "sec": "s",
    "newton": "N",
    "radian": "rad",
    "degree": "deg",
    "pascal": "Pa",
    "kelvin": "K",
    "volt": "V",
    "ampere": "A",
    "hertz": "Hz",
    "foot": "ft",
    "inch": "in",
    "pound": "lb",
}
"""Symbols to use in declarations, keyed by the spelled-out names of units."""

IMPERIAL = ("ft", "in", "lbf", "ft/s")
"""Non-SI units that a declaration may use, for vehicles from publications such as the hypersonic vehicle."""

NUMBER = re.compile(r"\s*([-+]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|nan|inf))\s*(.*?)\s*", re.IGNORECASE)


class Unit(NamedTuple):
    """Unit read from a text. scale: size of this unit in the SI unit `name`. kind: "real", "flag" or "count"."""

    scale: float
    name: str
    kind: str = "real"


def find_unit(where: str, text: str) -> Unit:
    """Return the unit written in a text, which may begin with a factor, e.g. ``1e-7 deg``.

    Raises:
        InputError: if the unit is unknown.
    """
    plain = _spell_plainly(text)
    match = re.fullmatch(r"([-+0-9.eE]+)\s+(\S.*)", plain)
    factor, name = (_parse_factor(where, text, match[1]), match[2].strip()) if match else (1.0, plain)
    name = SPELLINGS.get(name, name)
    kept = next((kept for kept, sizes in UNITS.items() if name in sizes), None)
    if kept is None:
        known = list(dict.fromkeys(unit for sizes in UNITS.values() for unit in sizes))
        near = closest(name, known, 1)
        fix = f'unit = "{near[0]}"' if near else 'write one of the choices, after a factor if needed: "1e-3 m"'
        raise InputError(where, f"unknown unit {text!r}", choices=known, fix=fix)
    return Unit(factor * UNITS[kept][name], kept, kept if kept in (FLAG, COUNT) else "real")


def find_size(text: str, kept: str) -> float | None:
    """Return the size of a written unit in the unit of storage, or None if it is a unit of another quantity."""
    return find_sizes(text).get(kept)


def find_sizes(text: str) -> dict[str, float]:
    """Return the size of a written unit in each unit of storage to which it can be converted, keyed by unit of
    storage."""
    plain = _spell_plainly(text)
    name = SPELLINGS.get(plain, plain)
    return {kept: sizes[name] for kept, sizes in UNITS.items() if name in sizes}


def check_symbols(unit: str) -> None:
    """Raise InputError if a declared unit is spelled out, because conversion needs the symbol.

    Raises:
        InputError: if the unit is spelled out. The error names the symbol.
    """
    for word in re.findall("[A-Za-z]+", unit):
        symbol = NAMES.get(word.lower(), NAMES.get(word.lower().removesuffix("s")))
        if symbol is not None:
            problem = f"the unit must be a symbol, got {unit!r}"
            raise InputError("quantity", problem, fix=f'quantity("{unit.replace(word, symbol)}", …)')


def check_kept(unit: str) -> None:
    """Raise InputError if a declared unit is not a unit of storage, such as deg.

    Raises:
        InputError: if values are not stored in this unit. The error names the unit to declare.
    """
    kept = next((kept for kept, sizes in UNITS.items() if unit in sizes), unit)
    if unit not in (*UNITS, *IMPERIAL) and kept != unit:
        problem = f"the unit must be {kept}, in which the value is stored, got {unit}"
        raise InputError("quantity", problem, fix=f'quantity("{kept}", …, default="1 {unit}")')


def parse_unit(part: str, text: str, kept: str) -> float:
    """Return the size of the unit written after a number, in the unit of storage; 1 if no unit is written.

    Raises:
        InputError: if the written unit belongs to another quantity.
    """
    if not text or text == kept:
        return 1.0
    sizes, own = find_sizes(text), find_sizes(kept)
    common = next((unit for unit in (kept, *own) if unit in sizes and unit in own), None)
    if common is None:
        choices = list(dict.fromkeys([kept, *(u for unit in own for u in UNITS[unit])]))
        raise InputError(
            part,
            f"{text!r} is not a unit of this quantity, whose unit is {kept}",
            choices=choices,
            fix=f"give the value in {kept}",
        )
    return sizes[common] / own[common]


def parse_amount(part: str, text: str, kept: str) -> float:
    """Return the number in a text such as ``3 kg``, ``3000 g`` or ``3``, in the unit of storage. ``nan`` and ``inf``
    are numbers.

    Raises:
        InputError: if the text is not a number, or the unit belongs to another quantity.
    """
    match = NUMBER.fullmatch(text)
    if match is None:
        raise InputError(part, f"{text!r} is not a number", fix=f"a number{f', in {kept}' if kept != '1' else ''}")
    try:
        return float(match[1]) * parse_unit(part, match[2], kept)
    except InputError as error:
        fix = f"{match[1]} {kept}" if kept != "1" else match[1]
        raise InputError(part, error.problem, choices=error.choices, fix=fix) from None


def _spell_plainly(text: str) -> str:
    plain = text.strip().replace("µ", "u").replace("μ", "u")
    return plain.replace("°", "deg").replace("²", "^2")


def _parse_factor(where: str, text: str, factor: str) -> float:
    try:
        size = float(factor)
    except ValueError:
        raise InputError(where, f"{text!r} does not begin with a number", fix='write e.g. "1e-7 deg"') from None
    if size == 0 or not math.isfinite(size):
        raise InputError(where, f"the factor must be finite and not 0, got {text!r}", fix='write e.g. "1e-7 deg"')
    return size
