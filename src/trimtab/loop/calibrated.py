"""Application of a calibration to a scenario: the calibrated values are set in the world and in the autopilot's models.

Actuator tables that are computed from a formula are computed again with the calibrated values.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from trimtab.actuators.drive import FanDrive
from trimtab.actuators.lookup import BilinearTable
from trimtab.actuators.rudder import RudderServo
from trimtab.core.errors import InputError, argument_name
from trimtab.core.quantity import Quantity, absent_parts, declarations, leaves, records
from trimtab.core.record import replace, with_leaf, with_part_of
from trimtab.core.rotation import DEG
from trimtab.core.suggestions import closest
from trimtab.core.time import format_time, to_seconds
from trimtab.loop.calibration import Calibration
from trimtab.loop.scenario import Scenario

TABULATED = "thrust.angles", "thrust.by_angle"
"""Calibration entries with the measured thrust by rudder angle. If present, the fan's tables are computed from these
entries instead of the formula."""
STEPS = {
    "gyro.step": ("gyro", "gyro_walk"),
    "accelerometer.step": ("forward", "starboard", "force_walk"),
}
"""Calibration entry that contains a filter step (s) -> fields of InertialNoise whose calibrated values are valid for
this filter step only."""
NOTES = ("gyro.delay", *STEPS, *TABULATED)
"""Names of calibration entries that do not correspond to a parameter of the scenario."""


class CalibratedScenario(NamedTuple):
    """Scenario with the calibrated values.

    used: name of a calibration entry -> paths of the settings that the entry has set.  unused: names of the calibration
    entries that correspond to no setting of the scenario.
    """

    scenario: Scenario
    used: dict[str, list[str]]
    unused: tuple[str, ...]


def with_calibration(scenario: Scenario, calibration: Calibration) -> CalibratedScenario:
    """Return the scenario with the calibrated values of all its settings that have a calibration entry.

    Raises: InputError if no calibration entry corresponds to a setting of the scenario, if two entries set the same
        setting, if a class of the scenario has no parameter of an entry's name, or if unit, shape or value of an entry
        do not fit its setting.
    """
    used: dict[str, list[str]] = {}
    owner: dict[str, str] = {}
    for name, entry in calibration.entries.items():
        if name in NOTES:
            continue
        scenario = _with_absent_parts(scenario, name)
        paths = setting_paths(scenario, name)
        if not paths:
            _refuse_unknown_field(scenario, name)
        for path in paths:
            if owner.setdefault(path, name) != name:
                problem = f"{owner[path]} and {name} both set {path}"
                raise InputError("calibration", problem, fix="remove one of the two entries")
        declared = {path: (old, d) for path, old, d in leaves(scenario) if path in paths and isinstance(d, Quantity)}
        for path in paths:
            old, quantity = declared[path]
            value = _fitting_value(name, entry, path, old, quantity)
            scenario = with_leaf(scenario, path, lambda _old, _declared, value=value: value)
        if paths:
            used[name] = paths
    if not used:
        kinds = sorted({type(r).__name__ for _, r in records(scenario)})
        problem = f"none of the {len(calibration.entries)} entries is a setting of scenario {scenario.name!r}"
        near = closest(next(iter(calibration.entries), ""), kinds) or kinds[:8]
        raise InputError(
            argument_name("calibration"), problem, choices=near, fix="calibrate a part that this scenario has"
        )
    _refuse_other_step(scenario, calibration)
    scenario = _with_stops(scenario)
    scenario = _with_tables(scenario, calibration)
    return CalibratedScenario(scenario, used, tuple(n for n in calibration.entries if n not in used and n not in NOTES))


def setting_paths(scenario: Scenario, name: str) -> list[str]:
    """Return the paths of the settings that a calibration entry sets.

    The entry ``Thruster.coefficient``, for example, sets the coefficient of each Thruster in the scenario.
    """
    kind, _, field = name.rpartition(".")
    if "." in kind or kind in ("world", "autopilot"):
        return [path for path, _, declared in leaves(scenario) if path == name and isinstance(declared, Quantity)]
    owners = [(path, r) for path, r in records(scenario) if type(r).__name__ == kind]
    return [f"{path}.{field}" for path, r in owners if isinstance(declarations(type(r)).get(field), Quantity)]


def _refuse_unknown_field(scenario: Scenario, name: str) -> None:
    """Raise InputError if an entry names a class of the scenario, but not a parameter of this class."""
    kind, _, field = name.rpartition(".")
    for _, r in records(scenario):
        if type(r).__name__ == kind:
            known = [n for n, d in declarations(type(r)).items() if isinstance(d, Quantity)]
            near = closest(field, known, 1)
            fix = f"write {kind}.{near[0]}, or remove the entry" if near else "remove the entry"
            raise InputError(f"calibration, {name}", f"{kind} has no parameter {field!r}", choices=known, fix=fix)


def _with_absent_parts(scenario: Scenario, name: str) -> Scenario:
    """Return the scenario with each optional part added that an entry calibrates, e.g. the hovercraft's friction."""
    kind = name.rpartition(".")[0]
    for where, declared in absent_parts(scenario):
        if type(declared.optional).__name__ == kind and where.startswith(("world.", "autopilot.")):
            scenario = with_part_of(scenario, f"{where}.{name.rpartition('.')[2]}")
    return scenario


def _fitting_value(name: str, entry: Any, path: str, old: Any, declared: Quantity) -> Any:
    where = f"calibration, {name}"
    if entry.unit != declared.unit:
        problem = f"has the unit {entry.unit!r}, but the setting {path} has the unit {declared.unit!r}"
        raise InputError(where, problem, fix=f'convert the value to unit = "{declared.unit}"')
    value = np.asarray(entry.value, declared.dtype())
    if value.shape != np.shape(old):
        problem = f"has shape {value.shape}, but the setting {path} has shape {np.shape(old)}"
        raise InputError(where, problem, fix="calibrate again with this version")
    for bound, wrong, text in (
        (declared.above, np.less_equal, "above"),
        (declared.low, np.less, "at least"),
        (declared.high, np.greater, "at most"),
    ):
        if bound is not None and wrong(value, bound).any():
            first = np.atleast_1d(value)[np.atleast_1d(wrong(value, bound))][0]
            problem = f"must be {text} {bound:g} {declared.unit}".removesuffix(" 1") + f", got {first:.6g}"
            raise InputError(where, problem, fix="correct the value, or calibrate again")
    return float(value) if value.ndim == 0 else value


def _refuse_other_step(scenario: Scenario, calibration: Calibration) -> None:
    """Raise InputError if noise variances were calibrated for another filter step than that of the scenario."""
    for name, fields in STEPS.items():
        mine = [f"InertialNoise.{f}" for f in fields if f"InertialNoise.{f}" in calibration.entries]
        if name not in calibration.entries or not mine:
            continue
        step = float(calibration.entries[name].value)
        for path, r in records(scenario):
            if type(r).__name__ == "InertialNoise" and not math.isclose(step, to_seconds(r.tick), rel_tol=1e-6):
                own = format_time(r.tick)
                problem = f"is calibrated for a filter step of {1e3 * step:.6g} ms, but {path}.tick is {own}"
                raise InputError(f"calibration, {mine[0]}", problem, fix=f"trimtab calibrate noise … --tick '{own}'")


def _with_stops(scenario: Scenario) -> Scenario:
    """Return the scenario with the rudder stops limited to the range of the rudder angles in the calibrated table."""
    for path, r in records(scenario):
        if isinstance(r, RudderServo):
            low, high = float(np.min(r.angles)), float(np.max(r.angles))
            stops = {"angle_min": max(float(r.angle_min), low), "angle_max": min(float(r.angle_max), high)}
            for field, stop in stops.items():
                scenario = with_leaf(scenario, f"{path}.{field}", lambda _old, _declared, stop=stop: stop)
    return scenario


def _with_tables(scenario: Scenario, calibration: Calibration) -> Scenario:
    """Return the scenario with new fan tables, computed from the thrust formula or from the measured thrust."""
    measured = [calibration.entries[n].value for n in TABULATED] if TABULATED[0] in calibration.entries else None
    for path, r in records(scenario):
        table, thruster = getattr(r, "table", None), getattr(r, "thruster", None)
        if not isinstance(table, BilinearTable) or thruster is None:
            continue
        rows = np.asarray(table.rows())
        eta = None if measured is None else tabulate_thrust(measured[0], measured[1], rows) / thruster.coefficient
        new = replace(table, **_table_changes(r, thruster, table, eta))
        for field in ("column_start", "column_step", "values", "origin"):
            value = getattr(new, field)
            scenario = with_leaf(scenario, f"{path}.table.{field}", lambda _old, _declared, value=value: value)
    return scenario


def _table_changes(owner: Any, thruster: Any, table: BilinearTable, eta: Any) -> dict[str, Any]:
    """Return the changed fields of a fan's table, which maps fan speed to thrust or thrust to fan speed.

    eta: thrust measured at each rudder angle, as a fraction of the thruster's coefficient. None: the thrust formula is
    used.
    """
    rows, origin = table.rows(), "formula" if eta is None else "measured"
    straight = np.full_like(rows, float(thruster.offset))
    scale: Any = 1.0 if eta is None else eta
    at = rows if eta is None else straight
    if isinstance(owner, FanDrive):
        last, n = float(thruster.speed_max_rpm), np.shape(table.values)[1]
        start, step = -last, 2 * last / (n - 1)
        columns = start + step * np.arange(n)[None]
        return {
            "column_start": start,
            "column_step": step,
            "values": np.asarray(thruster.force(columns, at) * scale),
            "origin": origin,
        }
    top = float(thruster.speed_max_rpm)
    speed = np.clip(thruster.speed_rpm(table.columns() / scale, at), -top, top)
    return {"values": np.asarray(speed), "origin": origin}


def tabulate_thrust(angles: Any, by_angle: Any, rows: Any) -> Any:
    """Return the thrust coefficient c eta at the rudder angles `rows` (m,), interpolated from measured coefficients.

    by_angle: thrust coefficient measured at each of the rudder angles `angles`. Raise InputError for a rudder angle
    outside the measured range.
    """
    low, high = float(np.min(angles)), float(np.max(angles))
    outside = (np.asarray(rows) < low - 1e-6) | (np.asarray(rows) > high + 1e-6)
    if outside.any():
        first = float(np.asarray(rows)[np.argmax(outside)]) / DEG
        problem = (
            f"the table needs the thrust at a rudder angle of {first:.1f}°, but thrust was measured from "
            f"{low / DEG:.1f}° to {high / DEG:.1f}°"
        )
        raise InputError(
            "thrust table", problem, fix="measure up to both stops of the rudder; the fit does not extrapolate"
        )
    return np.interp(rows, angles, by_angle)
