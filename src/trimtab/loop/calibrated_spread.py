"""Distributions of parameters and tables for a campaign, computed from the uncertainty of a calibration.

Correlated parameters are drawn together: the drawn values are the calibrated values plus, for each column of a square
root of their covariance, the column times a standard normal draw. The four coefficients of reverse thrust and a link's
latency table are drawn in this way. The latency table is linearised in its mean and standard deviation.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.actuators.drive import FanDrive
from trimtab.actuators.rudder import RudderServo
from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.quantity import Quantity, leaves, records, split_index
from trimtab.core.units import TURN
from trimtab.links.latency import gamma_table
from trimtab.loop.calibrated import NOTES, setting_paths
from trimtab.loop.calibration import Calibration, Entry, flat_entries, index_name, joint_covariance
from trimtab.loop.scenario import Scenario

CORRELATED = 0.02
"""Smallest magnitude of a correlation coefficient that a campaign uses. Smaller correlations are neglected."""
REVERSE = "Thruster.reverse_ratio"
LINKS = ("uplink", "downlink")
HALVINGS = 12
"""Number of bisection steps in the search for the largest fraction of a drawn change of the reverse thrust's
coefficients for which the thrust still rises with speed. They find this fraction with an accuracy of 1/4000."""


class CalibratedSpread(NamedTuple):
    """Distributions for a campaign. drawn: path of a parameter -> its distribution, as text.

    correlate: for each correlated pair of parameters, both paths and the correlation coefficient.  notes: for each
    calibrated parameter that is not drawn, or is drawn by another parameter, the reason.
    """

    drawn: dict[str, str]
    correlate: list[tuple[str, str, float]]
    notes: tuple[str, ...]


def calibrated_spread(scenario: Scenario, calibration: Calibration) -> CalibratedSpread:
    """Return the distributions of a scenario's settings that follow from the standard errors of a calibration.

    scenario: scenario to which the calibration was applied. Instead of a fan's thrust coefficient, the fan's
    effectiveness is drawn, so that the fan's tables do not change.

    Raises: InputError if the calibration contains no standard error for any setting of this scenario's world.
    """
    known = {path: (np.asarray(v, np.float64), d) for path, v, d in leaves(scenario) if isinstance(d, Quantity)}
    drawn, owner, notes = dict[str, str](), dict[str, str](), list[str]()
    for name, entry in calibration.entries.items():
        if entry.standard_error is None or not np.any(entry.standard_error) or name == REVERSE:
            continue
        _refuse_wide(scenario, name, entry)
        flat = {n: v for n, v in flat_entries(Calibration({name: entry})).items() if v[1] > 0}
        paths = [] if name in NOTES else [p for p in setting_paths(scenario, name) if p.startswith("world.")]
        if name.startswith("Thruster."):
            paths = _effectiveness(paths, known) if name == "Thruster.coefficient" else []
        if not paths:
            notes += _explain(name)
        for single, (value, error, _) in flat.items():
            index = single[len(name) :]
            for path in paths:
                own = float(known[path][0][split_index(path + index)[1] or ()])
                if name != "Thruster.coefficient" and not math.isclose(own, value, rel_tol=1e-9):
                    text = f"its value is {own:.6g}, not the calibrated {value:.6g}"
                    notes.append(f"{path + index} is not varied: {text}")
                    continue
                if name == "Thruster.coefficient":
                    text = f"normal({float(known[path][0])!r}, {error / abs(value)!r})"
                else:
                    text = _normal_text(value, error, known[path][1])
                drawn[path + index], owner[path + index] = text, single
    correlate = _correlations(calibration, owner)
    for directions, note in (_reverse(scenario, calibration), *(_latency(known, calibration, n) for n in LINKS)):
        drawn |= {f"{path}:{k}": text for path, texts in directions.items() for k, text in enumerate(texts, 1)}
        notes += [note] if note else []
    if not drawn:
        problem = "; ".join(
            ["the calibration contains no standard error for any setting in the world of this scenario", *notes]
        )
        raise InputError(
            argument_name("spread"), problem, fix=argument("spread", "normal(100%, 5%)", "world.vehicle.mass")
        )
    return CalibratedSpread(drawn, correlate, tuple(notes))


def follow_tables(scenario: Scenario, arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Return the drawn settings (n, …) of n runs, and all settings that depend on the drawn ones, e.g. a fan's table.

    A drawn cubic polynomial whose reverse thrust does not rise with fan speed has no inverse and describes no real fan.
    Therefore its coefficients are moved towards the scenario's coefficients until the thrust rises. Rudder stops
    outside the angle range of the rudder's table are moved to the limits of this range.
    """
    arrays = dict(arrays)
    for path, r in records(scenario):
        if isinstance(r, RudderServo) and f"{path}.angles" in arrays:
            low, high = (np.asarray(arrays[f"{path}.angles"])[:, k] for k in (0, -1))
            for field, limit, end in (("angle_min", np.maximum, low), ("angle_max", np.minimum, high)):
                own = arrays.get(f"{path}.{field}", np.full(len(end), float(getattr(r, field))))
                arrays[f"{path}.{field}"] = limit(own, end)
        if isinstance(r, FanDrive) and f"{path}.thruster.reverse_ratio" in arrays:
            arrays |= _follow_reverse(path, r, arrays[f"{path}.thruster.reverse_ratio"])
    return arrays


def _follow_reverse(path: str, drive: FanDrive, drawn: Any) -> dict[str, Any]:
    """Return the reverse thrust coefficients (n, 4) of n runs, and the drive's tables computed from these coefficients.

    The coefficients are changed where necessary so that the reverse thrust rises with fan speed.
    """
    thruster, table = drive.thruster, drive.table
    low, high = float(thruster.reverse_low_rpm), float(thruster.speed_max_rpm)
    own = np.asarray(thruster.reverse_ratio, np.float64)
    ratio = own + _rising_share(own, drawn - own, low, high)[:, None] * (drawn - own)
    changed = {f"{path}.thruster.reverse_ratio": ratio}
    if table is not None:
        speed = np.asarray(table.columns())[0]
        n = np.clip(np.abs(speed), low, high) * 1e-3
        scale = np.where(speed < 0, _cubic(ratio, n) / _cubic(own[None], n), 1.0)
        changed[f"{path}.table.values"] = np.asarray(table.values)[None] * scale[:, None, :]
    return changed


def _effectiveness(paths: list[str], known: Mapping[str, Any]) -> list[str]:
    effects = [f"{path.rpartition('.thruster')[0]}.effectiveness" for path in paths]
    return [path for path in effects if path in known]


def _explain(name: str) -> list[str]:
    """Return the reason why a campaign does not vary a calibrated parameter that has a standard error.

    Return [] for the mean and the deviation of a link's latency, which are varied by varying the latency table.
    """
    if name in tuple(f"{link}.{what}" for link in LINKS for what in ("mean", "deviation")):
        return []
    if name == "Thruster.offset":
        return [f"{name} is not varied, because RudderGeometry.offset has the same value and is varied"]
    if name == "thrust.by_angle":
        return [
            f"{name} is not varied for each rudder angle: the fan's effectiveness is varied, equally for all angles"
        ]
    return [f"{name} is not varied: the world of this scenario has no such setting"]


def _refuse_wide(scenario: Scenario, name: str, entry: Entry) -> None:
    """Raise InputError if the 95 % interval of a number reaches values that are not valid, or a full turn."""
    declared = {path: d for path, _, d in leaves(scenario) if isinstance(d, Quantity)}
    for path in setting_paths(scenario, name):
        limit, unit = declared[path].above, declared[path].unit
        ends = np.stack(entry.interval())
        low, high, wide = ends[0].min(), ends[1].max(), (ends[1] - ends[0]).max()
        problem = f"the 95 % interval, {low:.6g} to {high:.6g} {unit}, "
        if limit is not None and low <= limit:
            problem += f"must be above {limit:g} {unit}"
        elif unit == "rad" and wide > TURN:
            problem += "must be less than a turn"
        else:
            continue
        raise InputError(f"calibration, {name}", problem, fix="correct standard_error, or calibrate again")


def _correlations(calibration: Calibration, owner: Mapping[str, str]) -> list[tuple[str, str, float]]:
    keys = sorted(owner)
    P = joint_covariance(calibration, [owner[k] for k in keys])
    sigma = np.sqrt(np.diagonal(P))
    pairs = [(a, b) for a in range(len(keys)) for b in range(a)]
    rho = {(a, b): float(np.clip(P[a, b] / (sigma[a] * sigma[b]), -0.9999, 0.9999)) for a, b in pairs}
    return [(keys[a], keys[b], r) for (a, b), r in rho.items() if abs(r) >= CORRELATED]


def _reverse(scenario: Scenario, calibration: Calibration) -> tuple[dict[str, list[str]], str]:
    """Return the distributions of the coefficients of reverse thrust, by path, and a note for the user or ""."""
    entry = calibration.entries.get(REVERSE)
    if entry is None or entry.standard_error is None:
        return {}, ""
    drives = [path for path, r in records(scenario) if isinstance(r, FanDrive) and path.startswith("world.")]
    if not drives:
        return {}, f"{REVERSE} is not varied: the world of this scenario has no such setting"
    names = [index_name(REVERSE, (i,)) for i in range(len(entry.value))]
    if not any(names[0] in c.of for c in calibration.covariances):
        return {}, f"{REVERSE} is not varied: the file has no [[covariance]] of its coefficients. Calibrate it again"
    P = joint_covariance(calibration, names)
    texts = _along(_square_root(P))
    note = (
        f"{REVERSE} is varied along the eigenvectors of its covariance ({len(texts)} of them); if the thrust does not "
        "rise with fan speed, its coefficients are moved towards the calibrated values"
    )
    return {f"{path}.thruster.reverse_ratio": texts for path in drives}, note


def _latency(known: Mapping[str, Any], calibration: Calibration, link: str) -> tuple[dict[str, list[str]], str]:
    """Return the distributions of a link's latency table, by path, and a note for the user or "".

    The distributions follow from the standard errors of the table's mean and standard deviation.
    """
    names, path, entries = (f"{link}.mean", f"{link}.deviation"), f"world.{link}.latency", calibration.entries
    if names[0] not in entries or path not in entries:
        return {}, ""
    if path not in known:
        measured = argument("settings", "measured", "links")
        return {}, f"{names[0]} and {names[1]} are not varied: this scenario has no {path}. Try {measured}"
    if names[1] not in entries or f"{link}.shift" not in entries:
        return {}, f"{path} is not varied: the calibration file has no {link}.shift. Calibrate the link again"
    mean, sd, shift = (float(entries[n].value) for n in (*names, f"{link}.shift"))
    if not np.allclose(known[path][0], gamma_table(mean, sd, shift), rtol=1e-6):
        return {}, f"{path} is not varied: it differs from the table for {names[0]} and {names[1]} of the calibration"
    h = 1e-4 * sd
    toward_mean = (gamma_table(mean + h, sd, shift) - gamma_table(mean - h, sd, shift)) / (2 * h)
    toward_sd = (gamma_table(mean, sd + h, shift) - gamma_table(mean, sd - h, shift)) / (2 * h)
    L = _square_root(joint_covariance(calibration, names))
    return {path: _along(np.stack([toward_mean, toward_sd], 1) @ L)}, ""


def _square_root(P: Any) -> Any:
    """Return a square root L of a covariance P, with L L' = P. The columns are sorted by length, longest first."""
    values, vectors = np.linalg.eigh(np.asarray(P))
    order = np.argsort(values)[::-1]
    return vectors[:, order] * np.sqrt(np.maximum(values[order], 0.0))


def _along(directions: Any) -> list[str]:
    """Return, for each non-zero column of a matrix (m, k), the distribution along this column as text, "along(…)"."""
    return [f"along({', '.join(repr(float(v)) for v in d)})" for d in np.asarray(directions).T if np.any(d)]


def _cubic(y: Any, n: Any) -> Any:
    """Return the values (runs, k) of cubic polynomials with coefficients y (runs, 4) at the speeds n (k,)."""
    return np.asarray(y) @ np.stack([n**3, n**2, n, np.ones_like(n)])


def _rising_share(own: Any, change: Any, low: float, high: float) -> Any:
    """Return the largest fraction of each run's change (runs, 4) for which the thrust is positive and rises with speed.

    own: unchanged coefficients of the cubic polynomial.  change: change of these coefficients in each run.
    """
    n = np.linspace(low, high, 200) * 1e-3

    def rises(share: Any) -> Any:
        thrust = n**2 * _cubic(own + share[:, None] * change, n)
        return (thrust[:, 0] > 0) & (np.diff(thrust) > 0).all(axis=1)

    share = np.ones(len(change))
    bad = np.flatnonzero(~rises(share))
    good, wrong = np.zeros(len(bad)), np.ones(len(bad))
    for _ in range(HALVINGS if len(bad) else 0):
        middle = share.copy()
        middle[bad] = (good + wrong) / 2
        fits = rises(middle)[bad]
        good, wrong = np.where(fits, middle[bad], good), np.where(fits, wrong, middle[bad])
    share[bad] = good
    return share


def _normal_text(value: float, error: float, declared: Any) -> str:
    """Return the text of a normal distribution.

    The distribution is truncated if a limit of the setting is less than 6 standard errors from the mean.
    """
    low = declared.low if declared.low is not None else declared.above
    low = -math.inf if low is None else float(low)
    high = math.inf if declared.high is None else float(declared.high)
    if value - 6 * error > low and value + 6 * error < high:
        return f"normal({value!r}, {error!r})"
    low, high = max(low, value - 8 * error), min(high, value + 8 * error)
    return f"truncated({value!r}, {error!r}, {low!r}, {high!r})"
