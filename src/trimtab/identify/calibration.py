"""The calibration file: each number that a loop believes, with its unit, uncertainty and source, as TOML.

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

A number is named by the record that it belongs to and its field, as the reference names them, so that it reaches every
copy of that record, in the world and in what the autopilot believes. Where two parts of one kind differ, the path of
the setting names it: ``world.uplink.latency``. The content's SHA-256 names the calibration in logs.
"""

import hashlib
import json
import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.identify.regression import student_reach

VERSION = 1
HEAD = "# trimtab calibration: numbers that were measured, each with unit, uncertainty and source"


class Entry(NamedTuple):
    """A number, or an array of them, that was measured.

    value: number or nested lists.  standard_error: of the same shape; None where it isn't known.
    freedom: degrees of freedom of the standard errors.  source: data and what was left out of it.
    procedure: what found it.
    """

    value: Any
    unit: str
    standard_error: Any = None
    freedom: float = math.inf
    source: str = ""
    procedure: str = ""

    def interval(self) -> tuple[Any, Any]:
        """Lower and upper end of the 95 % interval, of the value's shape; the value itself where no error is known."""
        value = np.asarray(self.value, np.float64)
        error = np.zeros_like(value) if self.standard_error is None else np.asarray(self.standard_error)
        reach = student_reach(self.freedom) * error
        return value - reach, value + reach


class Covariance(NamedTuple):
    """Of numbers of one procedure. of: their names, ``Thruster.reverse_ratio[2]`` one of an array."""

    of: tuple[str, ...]
    matrix: Any
    procedure: str = ""


class Calibration(NamedTuple):
    """Entries by name, and covariances of those that are not independent."""

    entries: Mapping[str, Entry]
    covariances: tuple[Covariance, ...] = ()

    def content_hash(self) -> str:
        """SHA-256 of names, values, units, errors and covariances: the same numbers have the same hash."""
        plain = {
            "entries": {
                n: [_plain(e.value), e.unit, _plain(e.standard_error)] for n, e in sorted(self.entries.items())
            },
            "covariances": [[list(c.of), _plain(c.matrix)] for c in self.covariances],
        }
        return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()

    def merge(self, new: "Calibration") -> "Calibration":
        """This one with the new entries; those that the same procedures found before, and their covariances, go."""
        names = {e.procedure for e in new.entries.values()}
        old = {n: e for n, e in self.entries.items() if e.procedure not in names and n not in new.entries}
        kept = tuple(c for c in self.covariances if all(_base(n) in old for n in c.of))
        return Calibration({**old, **new.entries}, (*kept, *new.covariances))


def read_calibration(path: str | Path) -> Calibration:
    """Read a calibration file; refuses one that isn't, with the entry and what to write."""
    where = f"calibration '{path}'"
    try:
        text = Path(path).read_text(encoding="utf-8")
    except FileNotFoundError:
        fix = f"make one: trimtab calibrate thrust thrust.csv --out {path}"
        raise InputError(where, "there is no such file", fix=fix) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(where, f"cannot be read: {error}", fix="give a file that trimtab calibrate wrote") from None
    return parse_calibration(where, text)


def parse_calibration(where: str, text: str) -> Calibration:
    """The calibration of a file's text; where: what a refusal names."""
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(where, f"is no TOML: {error}", fix="give a file that trimtab calibrate wrote") from None
    if content.get("version") != VERSION:
        problem = f"says version {content.get('version')!r}, this trimtab reads {VERSION}"
        raise InputError(where, problem, fix="give a file that trimtab calibrate wrote")
    tables = {n: v for n, v in content.items() if n not in ("version", "covariance")}
    entries = {name: _read_entry(f"{where}, {name}", table) for name, table in tables.items()}
    covariances = tuple(_read_covariance(where, entries, table) for table in content.get("covariance", []))
    return Calibration(entries, covariances)


def format_calibration(calibration: Calibration) -> str:
    """The text of a calibration file."""
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
    """Every single number: name, ``Thruster.reverse_ratio[2]`` one of an array -> value, standard error, freedom."""
    flat: dict[str, tuple[float, float, float]] = {}
    for name, entry in calibration.entries.items():
        value = np.asarray(entry.value, np.float64)
        error = np.zeros_like(value) if entry.standard_error is None else np.asarray(entry.standard_error, np.float64)
        for index in np.ndindex(value.shape):
            flat[index_name(name, index)] = float(value[index]), float(error[index]), entry.freedom
    return flat


def index_name(name: str, index: Sequence[int]) -> str:
    """Name of one number of an array, e.g. ``Thruster.reverse_ratio[2]``; the name itself of a single one."""
    return name + (f"[{','.join(map(str, index))}]" if index else "")


def joint_covariance(calibration: Calibration, names: Iterable[str]) -> Any:
    """Covariance (k, k) of single numbers by their flat names: zero between those that were found apart."""
    names, flat = list(names), flat_entries(calibration)
    P = np.diag([flat[n][1] ** 2 for n in names])
    for c in calibration.covariances:
        at = [(i, c.of.index(n)) for i, n in enumerate(names) if n in c.of]
        for i, a in at:
            for j, b in at:
                P[i, j] = c.matrix[a][b]
    return P


def compare_calibrations(a: Calibration, b: Calibration) -> dict[str, tuple[float | None, float | None, float | None]]:
    """Single numbers that differ: name -> value in a, in b, and the difference in its own standard errors.

    None where one of them lacks the number, or neither knows an error.
    """
    one, two = flat_entries(a), flat_entries(b)
    changes: dict[str, tuple[float | None, float | None, float | None]] = {}
    for name in sorted({*one, *two}):
        if name not in one or name not in two:
            changes[name] = (one[name][0] if name in one else None, two[name][0] if name in two else None, None)
        elif one[name][0] != two[name][0]:
            error = math.hypot(one[name][1], two[name][1])
            apart = abs(two[name][0] - one[name][0]) / error if error > 0 else None
            changes[name] = one[name][0], two[name][0], apart
    return changes


def _base(name: str) -> str:
    return name.partition("[")[0]


def _plain(value: Any) -> Any:
    return None if value is None else np.asarray(value, np.float64).tolist()


def _toml(value: Any) -> str:
    """A number or nested lists, to the last bit."""
    plain = np.asarray(value, np.float64).tolist()
    return repr(plain) if not isinstance(plain, list) else "[" + ", ".join(_toml(v) for v in plain) + "]"


def _read_entry(where: str, table: Any) -> Entry:
    fix = 'write value, unit and, where it is known, standard_error, e.g.  value = 2.6  unit = "kg"'
    if not isinstance(table, dict) or "value" not in table or "unit" not in table:
        raise InputError(where, "has no value or no unit", fix=fix)
    unknown = set(table) - set(Entry._fields)
    if unknown:
        raise InputError(where, f"has {sorted(unknown)[0]!r}, which is not known", choices=Entry._fields, fix=fix)
    try:
        value = np.asarray(table["value"], np.float64)
        error = None if "standard_error" not in table else np.asarray(table["standard_error"], np.float64)
        freedom = float(table.get("freedom", math.inf))
    except (TypeError, ValueError):
        raise InputError(where, "holds what is no number", fix=fix) from None
    if not np.isfinite(value).all():
        raise InputError(where, "its value is not finite", fix=fix)
    if error is not None and (error.shape != value.shape or not (np.isfinite(error) & (error >= 0)).all()):
        problem = f"its standard_error is not one number of 0 or more for each of its value's {value.size}"
        raise InputError(where, problem, fix="leave standard_error out where it isn't known")
    texts = {n: str(table[n]) for n in ("unit", "source", "procedure") if n in table}
    return Entry(value.tolist(), standard_error=None if error is None else error.tolist(), freedom=freedom, **texts)


def _read_covariance(where: str, entries: Mapping[str, Entry], table: Any) -> Covariance:
    try:
        of, matrix = tuple(map(str, table["of"])), np.asarray(table["matrix"], np.float64)
    except (KeyError, TypeError, ValueError):
        fix = "write  of = [names]  and  matrix = [[…]]"
        raise InputError(where, "a covariance lacks `of` or `matrix`", fix=fix) from None
    missing = [n for n in of if _base(n) not in entries]
    if missing:
        raise InputError(
            where, f"a covariance is of {missing[0]!r}, which has no entry", choices=entries, fix="name one"
        )
    good = matrix.shape == (len(of),) * 2 and np.isfinite(matrix).all() and np.allclose(matrix, matrix.T)
    if not good or np.linalg.eigvalsh(matrix).min() < -1e-9 * max(np.trace(matrix), 1e-300):
        problem = f"the covariance of {', '.join(of)} is no symmetric, positive matrix of {len(of)} rows"
        raise InputError(where, problem, fix="let trimtab calibrate write it")
    return Covariance(of, matrix.tolist(), str(table.get("procedure", "")))
