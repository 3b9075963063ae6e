"""Inputs of a bench calibration besides its data: numbers with units in options, and results of earlier procedures."""

import math
from pathlib import Path

import click
import numpy as np

from trimtab.actuators.rudder import RudderGeometry
from trimtab.actuators.thruster import Thruster
from trimtab.analysis.identify import spin_up
from trimtab.analysis.identify.rudder import RUDDER_MAX
from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity, declarations
from trimtab.core.units import UNITS, find_size
from trimtab.loop.calibration import Calibration, flat_entries, joint_covariance, read_calibration
from trimtab.vehicles.hovercraft import Hovercraft

ASSUMED = (Hovercraft(), RudderGeometry(), Thruster())
"""Hovercraft, rudder and thruster of the thesis, used for each parameter that no option and no file sets."""


def parse_amount(context: click.Context, parameter: click.Parameter, text: str | None) -> float | None:
    """Parse a number with its unit, e.g. '1.1 N', and return the SI value. The option's name sets the quantity."""
    if text is None:
        return None
    where = f"--{parameter.name}"
    kept, example = AMOUNTS[str(parameter.name)]
    number, _, unit = text.strip().partition(" ")
    size = find_size(unit, kept)
    try:
        amount = float(number) * (math.nan if size is None else size)
    except ValueError:
        amount = math.nan
    if not math.isfinite(amount):
        problem = f"{text!r} is not a number with a unit"
        raise InputError(where, problem, choices=UNITS[kept], fix=f"{where} '{example}'")
    if parameter.name == "rudder" and abs(amount) > RUDDER_MAX:
        raise InputError(where, f"must be between -60 and 60 deg, got {text}", fix=f"{where} '{example}'")
    if parameter.name in ("arm", "mass", "division") and amount <= 0:
        raise InputError(where, f"must be above 0, got {text}", fix=f"{where} '{example}'")
    if parameter.name == "force" and amount == 0:
        raise InputError(where, f"must not be 0, got {text}", fix=f"{where} '{example}'")
    return amount


AMOUNTS = {
    "force": ("N", "1.1 N"),
    "rudder": ("rad", "-20 deg"),
    "arm": ("m", "0.32 m"),
    "mass": ("kg", "2.6 kg"),
    "division": ("N", "0.1 N"),
}
"""Unit and example of each option that is a number with a unit."""


def find_number(out: Path | None, name: str) -> float:
    """Return a parameter's value from the calibration file of --out. A missing parameter has the thesis's value.

    Raises: InputError for an entry that is not a valid number in the unit of the parameter.
    """
    kind, _, field = name.partition(".")
    thesis = next(r for r in ASSUMED if type(r).__name__ == kind)
    entry = read_calibration(out).entries.get(name) if out is not None and out.exists() else None
    if entry is None:
        return float(getattr(thesis, field))
    declared = declarations(type(thesis))[field]
    assert isinstance(declared, Quantity)
    if entry.unit != declared.unit or np.ndim(entry.value):
        problem = f"must be a number with the unit {declared.unit!r}, got {entry.value} with the unit {entry.unit!r}"
        fix = f'write the value in {declared.unit}, and  unit = "{declared.unit}"'
        raise InputError(f"calibration '{out}', {name}", problem, fix=fix)
    value = float(entry.value)
    if declared.above is not None and value <= declared.above:
        problem = f"must be above {declared.above:g} {declared.unit}".removesuffix(" 1") + f", got {value:.6g}"
        raise InputError(f"calibration '{out}', {name}", problem, fix="correct the value, or calibrate again")
    return value


def describe_assumed(out: Path | None, *names: str) -> tuple[str, ...]:
    """Return a note for each parameter that is taken from the thesis because the file of --out does not contain it."""
    known = read_calibration(out).entries if out is not None and out.exists() else {}
    return tuple(
        f"{name} is not calibrated; the fit uses the value of the thesis, {find_number(None, name):.6g}"
        for name in names
        if name not in known
    )


def find_error(out: Path | None, name: str) -> float:
    """Return the standard error of a parameter in the calibration file of --out; 0 if the parameter is missing."""
    flat = flat_entries(read_calibration(out)) if out is not None and out.exists() else {}
    return flat[name][1] if name in flat else 0.0


def find_geometry(out: Path | None, arm: float | None) -> spin_up.ForceGeometry:
    """Return the direction of the thrust at each rudder angle, with the covariance of the rudder's ratio and offset."""
    names = ("RudderGeometry.ratio", "RudderGeometry.offset")
    known = read_calibration(out) if out is not None and out.exists() else Calibration({})
    covariance = joint_covariance(known, names) if set(names) <= known.entries.keys() else np.zeros((2, 2))
    arm = find_number(out, "Hovercraft.arm") if arm is None else arm
    return spin_up.ForceGeometry(arm, find_number(out, names[0]), find_number(out, names[1]), covariance)
