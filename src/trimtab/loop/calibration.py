"""Calibration files in TOML: measured parameters of a scenario with their units, uncertainties and sources.

    ["Thruster.coefficient"]
    value = 0.01112
    unit = "N/krpm^2"
    standard_error = 3.1e-05
    freedom = 58
    source = "thrust.csv: 60 readings, line 17 left out"
    procedure = "thrust"

    [[covariance]]
    procedure = "inertia"
    of = ["Hovercraft.inertia", "Hovercraft.arm"]
    matrix = [[…], […]]

The name of a parameter consists of its record class and field, so an entry sets this parameter in every record of the
class, in the world and in the autopilot's models. If two records of one class have different values, the entry is named
by the path of the setting instead, e.g. ``world.uplink.latency``. Logs identify a calibration by the SHA-256 of its
content.
"""

import hashlib
import itertools
import json
import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.special import stdtrit  # scipy.stats takes a second to import

from trimtab.core.errors import InputError
from trimtab.core.user_file import read_user_text

VERSION = 1
HUGE = 1e150
"""Limit of values and standard errors, whose squares must be finite."""
HEAD = "# trimtab calibration: numbers that were measured, each with unit, uncertainty and source"


def student_reach(freedom: float) -> float:
    """Return the half width of a 95 % confidence interval, in standard errors, for these degrees of freedom."""
    return float(stdtrit(freedom, 0.975)) if math.isfinite(freedom) else 1.959963984540054


class Entry(NamedTuple):
    """Measured parameter: a number, or an array of numbers.

    value: measured number, or nested lists of numbers.  standard_error: standard error of each number, in the shape of
    `value`, or None if unknown.  freedom: degrees of freedom of the standard errors.  source: name of the data file,
    and the lines of this file that were left out.  procedure: name of the calibration procedure.
    """

    value: Any
    unit: str
    standard_error: Any = None
    freedom: float = math.inf
    source: str = ""
    procedure: str = ""

    def interval(self) -> tuple[Any, Any]:
        """Return the lower and the upper limit of the 95 % confidence interval, in the shape of `value`.

        If the standard error is unknown, both limits equal the value.
        """
        value = np.asarray(self.value, np.float64)
        error = np.zeros_like(value) if self.standard_error is None else np.asarray(self.standard_error)
        reach = student_reach(self.freedom) * error
        return value - reach, value + reach


class Covariance(NamedTuple):
    """Covariance matrix of the parameters measured by one calibration procedure.

    of: names of the parameters in the order of the matrix rows, e.g. ``Thruster.reverse_ratio[2]`` for an element of an
    array.
    """

    of: tuple[str, ...]
    matrix: Any
    procedure: str = ""


class Calibration(NamedTuple):
    """Calibration: entries by name, and the covariances of correlated entries."""

    entries: Mapping[str, Entry]
    covariances: tuple[Covariance, ...] = ()

    def content_hash(self) -> str:
        """Return the SHA-256 of the entries' names, values, units and standard errors, and of the covariances.

        The names of data files and the comments of a calibration file do not change the hash.
        """
        plain = {
            "entries": {
                n: [_plain(e.value), e.unit, _plain(e.standard_error)] for n, e in sorted(self.entries.items())
            },
            "covariances": [[list(c.of), _plain(c.matrix)] for c in self.covariances],
        }
        return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()

    def merge(self, new: "Calibration") -> "Calibration":
        """Return this calibration with the entries and covariances of a new calibration added.

        Entries and covariances of this calibration that come from the same procedures as the new ones are removed.
        """
        names = {e.procedure for e in new.entries.values()}
        old = {n: e for n, e in self.entries.items() if e.procedure not in names and n not in new.entries}
        kept = tuple(c for c in self.covariances if all(_base(n) in old for n in c.of))
        return Calibration({**old, **new.entries}, (*kept, *new.covariances))


def read_calibration(path: str | Path) -> Calibration:
    """Read a calibration file.

    Raise InputError for an invalid file. The message names the faulty entry and says how to write it.
    """
    where = f"calibration '{path}'"
    try:
        text = read_user_text(path)
    except FileNotFoundError:
        fix = f"make a calibration file: trimtab calibrate thrust thrust.csv --out {path}"
        raise InputError(where, "the file does not exist", fix=fix) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(where, f"cannot be read: {error}", fix="use a file that trimtab calibrate wrote") from None
    return parse_calibration(where, text)


def parse_calibration(where: str, text: str) -> Calibration:
    """Parse the text of a calibration file. where: name of the file in error messages."""
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(where, f"is not valid TOML: {error}", fix="use a file that trimtab calibrate wrote") from None
    if content.get("version") != VERSION:
        problem = f"has version {content.get('version')!r}, but this trimtab reads version {VERSION}"
        raise InputError(where, problem, fix="use a file that trimtab calibrate wrote")
    tables = {n: v for n, v in content.items() if n not in ("version", "covariance")}
    entries = {name: _read_entry(f"{where}, {name}", table) for name, table in tables.items()}
    listed = content.get("covariance", [])
    covariances = tuple(
        _read_covariance(where, entries, table) for table in (listed if isinstance(listed, list) else [listed])
    )
    seen: set[frozenset[str]] = set()
    for pairs in ({frozenset(pair) for pair in itertools.combinations(c.of, 2)} for c in covariances):
        if pairs & seen:
            problem = f"two [[covariance]] tables name {' and '.join(sorted(min(pairs & seen, key=sorted)))}"
            raise InputError(where, problem, fix="remove one of the tables")
        seen |= pairs
    return Calibration(entries, covariances)


def format_calibration(calibration: Calibration) -> str:
    """Return the text of a calibration file."""
    lines = [HEAD, f"version = {VERSION}", ""]
    for name, entry in sorted(calibration.entries.items()):
        lines += [f"[{json.dumps(name)}]", f"value = {_toml(entry.value)}", f"unit = {json.dumps(entry.unit)}"]
        if entry.standard_error is not None:
            lines.append(f"standard_error = {_toml(entry.standard_error)}")
        if math.isfinite(entry.freedom):
            lines.append(f"freedom = {_toml(entry.freedom)}")
        texts = (("source", entry.source), ("procedure", entry.procedure))
        lines += [f"{what} = {json.dumps(text, ensure_ascii=False)}" for what, text in texts if text]
        lines.append("")
    for c in calibration.covariances:
        lines += ["[[covariance]]", f"procedure = {json.dumps(c.procedure)}", f"of = {json.dumps(list(c.of))}"]
        lines += [f"matrix = {_toml(c.matrix)}", ""]
    return "\n".join(lines)


def flat_entries(calibration: Calibration) -> dict[str, tuple[float, float, float]]:
    """Return the value, standard error and degrees of freedom of each calibrated number, by name.

    An element of an array has a name such as ``Thruster.reverse_ratio[2]``.
    """
    flat: dict[str, tuple[float, float, float]] = {}
    for name, entry in calibration.entries.items():
        value = np.asarray(entry.value, np.float64)
        error = np.zeros_like(value) if entry.standard_error is None else np.asarray(entry.standard_error, np.float64)
        for index in np.ndindex(value.shape):
            flat[index_name(name, index)] = float(value[index]), float(error[index]), entry.freedom
    return flat


def index_name(name: str, index: Sequence[int]) -> str:
    """Return the name of a calibrated number: the name of its entry, followed by the index for an element of an array,
    e.g. ``Thruster.reverse_ratio[2]``."""
    return name + (f"[{','.join(map(str, index))}]" if index else "")


def joint_covariance(calibration: Calibration, names: Iterable[str]) -> Any:
    """Return the covariance (k, k) of the k calibrated numbers with these names.

    Numbers from different calibration procedures have covariance zero.
    """
    names, flat = list(names), flat_entries(calibration)
    P = np.diag([flat[n][1] ** 2 for n in names])
    for c in calibration.covariances:
        at = [(i, c.of.index(n)) for i, n in enumerate(names) if n in c.of]
        for i, a in at:
            for j, b in at:
                P[i, j] = c.matrix[a][b]
    return P


def compare_calibrations(a: Calibration, b: Calibration) -> dict[str, tuple[float | None, float | None, float | None]]:
    """Return the calibrated numbers that differ: name -> value in a, value in b, and difference in standard errors.

    A value is None if the number is missing in that calibration. The difference is None if no standard error is known.
    """
    one, two = flat_entries(a), flat_entries(b)
    changes: dict[str, tuple[float | None, float | None, float | None]] = {}
    for name in sorted({*one, *two}):
        if name not in one or name not in two:
            changes[name] = (one[name][0] if name in one else None, two[name][0] if name in two else None, None)
        elif (units := (a.entries[_base(name)].unit, b.entries[_base(name)].unit))[0] != units[1]:
            problem = f"has the unit {units[0]!r} in the first calibration, and {units[1]!r} in the second"
            fix = f'write the second value in {units[0]}, and  unit = "{units[0]}"'
            raise InputError(f"calibration, {name}", problem, fix=fix)
        elif one[name][0] != two[name][0]:
            error = math.hypot(one[name][1], two[name][1])
            apart = abs(two[name][0] - one[name][0]) / error if error > 0 else None
            changes[name] = one[name][0], two[name][0], apart
    return changes


def _base(name: str) -> str:
    return name.partition("[")[0]


def _plain(value: Any) -> Any:
    return None if value is None else np.asarray(value, np.float64).tolist()


def _numbers(value: Any) -> Any:
    """Return an array of a number or of nested lists of numbers. Raise TypeError for text, true or false."""
    values = np.asarray(value)
    if values.dtype.kind in "USbMm":
        raise TypeError(f"not a number: {value!r}")
    return values.astype(np.float64)


def _toml(value: Any) -> str:
    """Format a number or nested lists with all digits."""
    plain = np.asarray(value, np.float64).tolist()
    return repr(plain) if not isinstance(plain, list) else "[" + ", ".join(_toml(v) for v in plain) + "]"


def _read_entry(where: str, table: Any) -> Entry:
    fix = 'write value, unit and, if known, standard_error, e.g.  value = 2.6  unit = "kg"'
    if not isinstance(table, dict) or "value" not in table or "unit" not in table:
        raise InputError(where, "has no value or no unit", fix=fix)
    unknown = set(table) - set(Entry._fields)
    if unknown:
        raise InputError(where, f"has the unknown key {sorted(unknown)[0]!r}", choices=Entry._fields, fix=fix)
    try:
        value = _numbers(table["value"])
        error = None if "standard_error" not in table else _numbers(table["standard_error"])
        freedom = float(_numbers(table.get("freedom", math.inf)))
    except (TypeError, ValueError, OverflowError):
        raise InputError(where, "contains values that are not numbers", fix=fix) from None
    if not isinstance(table["unit"], str):
        raise InputError(where, f"the unit must be a text, got {table['unit']!r}", fix=fix)
    if not value.size:
        raise InputError(where, "the value is an empty list", fix=fix)
    if not freedom > 0:
        problem = f"freedom must be above 0, got {freedom:g}"
        raise InputError(where, problem, fix="leave freedom out if it is unknown")
    if not (np.abs(value) < HUGE).all():
        raise InputError(where, "the value is not finite", fix=fix)
    if error is not None and (error.shape != value.shape or not ((error >= 0) & (error < HUGE)).all()):
        problem = "standard_error must have the shape of value, with finite numbers that are not negative"
        raise InputError(where, problem, fix="leave standard_error out if it is unknown")
    texts = {n: str(table[n]) for n in ("unit", "source", "procedure") if n in table}
    return Entry(value.tolist(), standard_error=None if error is None else error.tolist(), freedom=freedom, **texts)


def _read_covariance(where: str, entries: Mapping[str, Entry], table: Any) -> Covariance:
    try:
        of, matrix = tuple(map(str, table["of"])), _numbers(table["matrix"])
        if not of:
            raise ValueError
    except (KeyError, TypeError, ValueError, OverflowError):
        fix = "write  of = [names of parameters]  and  matrix = [[…]]"
        raise InputError(where, "a [[covariance]] table lacks `of` or `matrix`", fix=fix) from None
    flat = flat_entries(Calibration(entries))
    missing = [n for n in of if n not in flat]
    unknown = [n for n in of if n in flat and entries[_base(n)].standard_error is None]
    if unknown:
        problem = f"a [[covariance]] table names {unknown[0]!r}, which has no standard_error"
        raise InputError(where, problem, fix="write standard_error in this entry, or remove the name from the table")
    if missing:
        raise InputError(
            where,
            f"a [[covariance]] table names {missing[0]!r}, but the file has no number of this name",
            choices=flat,
            fix="use only names of entries in this file, with an index for a number of a list",
        )
    if twice := [n for n in of if of.count(n) > 1]:
        fix = "name each number once, and give the matrix one row for each name"
        raise InputError(where, f"a [[covariance]] table names {twice[0]!r} twice", fix=fix)
    good = matrix.shape == (len(of),) * 2 and np.isfinite(matrix).all() and np.allclose(matrix, matrix.T)
    if not good or np.linalg.eigvalsh(matrix).min() < -1e-9 * max(np.trace(matrix), 1e-300):
        problem = (
            f"the covariance of {', '.join(of)} must be a symmetric, positive semidefinite matrix with {len(of)} rows"
        )
        raise InputError(where, problem, fix="use the covariance that trimtab calibrate writes")
    for name, variance in zip(of, np.diagonal(matrix), strict=True):
        stated, error = flat[name][1], math.sqrt(max(float(variance), 0.0))
        if not math.isclose(stated, error, rel_tol=1e-3):
            problem = f"the standard error of {name} is {stated:.6g}, but its variance in [[covariance]] gives"
            fix = "calibrate again, or remove this [[covariance]] table if you have changed the standard error"
            raise InputError(where, f"{problem} {error:.6g}", fix=fix)
    return Covariance(of, matrix.tolist(), str(table.get("procedure", "")))
