"""Log of a run as arrays over time. Every signal has a dotted path, a unit and a meaning."""

import dataclasses
import json
import platform
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, Generic, TypeVar

import numpy as np

from trimtab import __version__
from trimtab.core.errors import InputError, install_command
from trimtab.core.html_table import html_table
from trimtab.core.quantity import Quantity, component_paths, split_component
from trimtab.core.suggestions import closest, missing_member
from trimtab.core.time import UNITS_PER_SECOND, to_seconds

SHOWN = 30
"""Maximum number of signals that a notebook shows of a log."""
HALF_TICK = 0.5 / UNITS_PER_SECOND
PLAIN = {float, int, str, bool}

T = TypeVar("T")


class LazyMapping(Mapping[str, T], Generic[T]):
    """Read-only mapping that computes each value when it is first read, and then stores it.

    Args:
        names: mapping with the same keys, in the same order.
        make: function that computes the value of a key. It is deleted when all values have been computed.
    """

    def __init__(self, names: Mapping[str, Any], make: Callable[[str], T]) -> None:
        self._names = names
        self._make: Callable[[str], T] | None = make
        self._values: dict[str, T] = {}

    def __getitem__(self, name: str) -> T:
        make = self._make
        if make is None or name in self._values:
            return self._values[name]
        if name not in self._names:
            raise KeyError(name)
        value = self._values.setdefault(name, make(name))
        if len(self._values) == len(self._names):
            self._make = None
        return value

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __repr__(self) -> str:
        return repr(dict(self))


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Log:
    """Log of a run: signals as read-only arrays over time. A log is immutable.

    A path consists of block and field, e.g. ``truth.heading`` or ``sensors.navigation.value.yaw_rate``.

    Args:
        t: instants in seconds, shape (n,).
        ticks: the same instants in units of 100 ns, int64 (n,), strictly increasing and not negative. t is computed
            from them: t = ``core.time.to_seconds(ticks)``.
        signals: path -> array (n,) or (n, k) of booleans, integers or floats. The type of each array is preserved.
        declarations: path -> declaration of the signal, with unit, meaning, frame, kind and names of modes.
        metadata: JSON-compatible values: version, scenario, seed, run, backend, duration_s, parameters, ...
        final: path -> value after the last step of the run, one step later than the last row.
    """

    t: np.ndarray
    ticks: np.ndarray
    signals: Mapping[str, np.ndarray]
    declarations: Mapping[str, Quantity] = dataclasses.field(default_factory=dict)
    metadata: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    final: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        ticks = _check_ticks(self.ticks)
        t = np.asarray(self.t, np.float64)
        if t.shape != ticks.shape or not (np.abs(t - to_seconds(ticks)) <= HALF_TICK).all():
            raise InputError(
                "log", "t and ticks must be the same instants", fix="pass t=to_seconds(ticks), from trimtab.core.time"
            )
        signals = {str(path): _check_signal(str(path), values, len(ticks)) for path, values in self.signals.items()}
        _check_paths(signals)
        for name, value in (
            ("ticks", ticks),
            ("t", _freeze(to_seconds(ticks))),
            ("signals", MappingProxyType(signals)),
            ("declarations", MappingProxyType(dict(self.declarations))),
            ("metadata", MappingProxyType(to_plain("log.metadata", dict(self.metadata)))),
            ("final", MappingProxyType({p: _check_value(p, v) for p, v in self.final.items()})),
        ):
            object.__setattr__(self, name, value)

    @classmethod
    def of_flight(
        cls,
        t: np.ndarray,
        ticks: np.ndarray,
        signals: LazyMapping[np.ndarray],
        declarations: Mapping[str, Quantity],
        metadata: LazyMapping[Any],
        final: Mapping[str, Any],
    ) -> "Log":
        """Return a log made from read-only arrays, without checks or copies. Used for compiled simulations."""
        log = object.__new__(cls)
        last = MappingProxyType({path: _check_value(path, value) for path, value in final.items()})
        for name, value in (
            ("t", t),
            ("ticks", ticks),
            ("signals", signals),
            ("declarations", MappingProxyType(declarations)),
            ("metadata", metadata),
            ("final", last),
        ):
            object.__setattr__(log, name, value)
        return log

    @property
    def paths(self) -> tuple[str, ...]:
        """Return the paths of all signals, in the order in which the loop recorded them."""
        return tuple(self.signals)

    def __reduce__(self) -> Any:
        return Log, (self.t, self.ticks, *map(dict, (self.signals, self.declarations, self.metadata, self.final)))

    def __len__(self) -> int:
        return len(self.ticks)

    def __iter__(self) -> Iterator[str]:
        return iter(self.signals)

    def __getattr__(self, name: str) -> Any:
        raise missing_member(self, name, _other_spelling(self, name))

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.signals)

    def __contains__(self, path: object) -> bool:
        return path in self.signals or (isinstance(path, str) and self._component(path) is not None)

    def _component(self, path: str) -> np.ndarray | None:
        whole, index = split_component(path)
        if index is None or whole not in self.signals:
            return None
        values = self.signals[whole]
        return values[:, index] if values.ndim == 2 and index < values.shape[1] else None

    def __getitem__(self, path: str) -> np.ndarray:
        """Return the signal with a path, as a read-only array (n,) or (n, k).

        The path "truth.velocity[2]" selects one element of a vector, (n,).
        """
        if not isinstance(path, str):  # pyright: ignore[reportUnnecessaryIsInstance]
            fix = f'write log["{self.paths[0]}"][:10]; for an interval of time, log.between(t0, t1)'
            raise InputError("log", f"a signal is read by its path, got {path!r}", fix=fix)
        if path not in self.signals:
            component = self._component(path)
            if component is not None:
                return component
            below = [p for p in self.signals if p.startswith(f"{path}.")]
            problem = "is a group of signals" if below else "is not in this log"
            choices = below or closest(path, self.signals) or list(self.signals)
            fix = f"write log[{choices[0]!r}], or print(log.paths) for all {len(self.signals)}"
            if path in ("t", "time"):
                fix = "write log.t, the time in seconds"
            raise InputError("log", f"signal {path!r} {problem}", choices=choices[:8], fix=fix)
        return self.signals[path]

    def declaration(self, path: str) -> Quantity | None:
        """Return the declaration of a signal, or of an element of a vector, or None if it has no declaration."""
        return self.declarations.get(split_component(path)[0] if path not in self.declarations else path)

    def unit(self, path: str) -> str:
        """Return the declared unit of a signal: "1" if it is dimensionless, "" without a declaration."""
        self[path]
        declared = self.declaration(path)
        return "" if declared is None else declared.unit

    def numbers(self, path: str) -> list[str]:
        """Return the path of each element of a signal: "truth.velocity[0]" etc. for a vector, else the path itself."""
        return component_paths(path, self[path].shape[1:])

    def between(self, t0: float, t1: float) -> "Log":
        """Return a log of the rows with t0 <= t < t1 (s). Metadata and final values are those of the complete run."""
        low, high = (float(np.clip(t, -1e11, 1e11)) for t in (t0, t1))
        first, last = (int(np.searchsorted(self.ticks, round(t * UNITS_PER_SECOND))) for t in (low, high))
        window = slice(first, max(first, last))
        signals = {path: values[window] for path, values in self.signals.items()}
        return dataclasses.replace(self, t=self.t[window], ticks=self.ticks[window], signals=signals)

    def to_xarray(self) -> Any:
        """Return an ``xarray.Dataset`` over ``time`` (s), with units, long_name, flag_meanings (CF convention)."""
        try:
            import xarray
        except ImportError:
            fix = install_command("xarray")
            raise InputError("log.to_xarray", "the package xarray is not installed", fix=fix) from None
        variables = {
            path: (("time", *(f"component_{k}" for k in values.shape[1:])), values, self._attributes(path))
            for path, values in self.signals.items()
        }
        attributes = {k: v if type(v) in (str, int, float) else json.dumps(v) for k, v in self.metadata.items()}
        time = ("time", self.t, {"units": "s", "long_name": "Time since the start of the run."})
        return xarray.Dataset(variables, coords={"time": time}, attrs=attributes)

    def to_dataframe(self) -> Any:
        """Return a ``pandas.DataFrame`` over time (s) with a column for each number, e.g. "truth.velocity[2]"."""
        try:
            import pandas
        except ImportError:
            fix = install_command("pandas")
            raise InputError("log.to_dataframe", "the package pandas is not installed", fix=fix) from None
        columns = {number: self[number] for path in self.paths for number in self.numbers(path)}
        return pandas.DataFrame(columns, index=pandas.Index(self.t, name="time"))

    def _repr_html_(self) -> str:
        lines = repr(self).splitlines()
        rows = [
            (p, self.unit(p), self._range(p), ((d := self.declaration(p)) and d.doc) or "") for p in self.paths[:SHOWN]
        ]
        more = len(self.paths) - SHOWN
        note = (f"{more} more in log.paths. " if more > 0 else "") + lines[-1]
        return html_table(lines[0], ("signal", "unit", "least … most", "meaning"), rows, note)

    def _range(self, path: str) -> str:
        """Return the minimum and the maximum of a signal, as text."""
        values = self[path]
        finite = values[np.isfinite(values)] if values.dtype.kind == "f" else values
        return f"{finite.min():.4g} … {finite.max():.4g}" if finite.size else ""

    def _attributes(self, path: str) -> dict[str, Any]:
        if path not in self.declarations:
            return {}
        declared = self.declarations[path]
        attributes: dict[str, Any] = {"units": declared.unit, "long_name": declared.doc}
        if declared.frame:
            attributes["frame"] = declared.frame
        if declared.modes:
            attributes["flag_values"] = np.arange(len(declared.modes), dtype=self.signals[path].dtype)
            attributes["flag_meanings"] = " ".join(mode.replace(" ", "_") for mode in declared.modes)
        return attributes

    def __repr__(self) -> str:
        n, count = len(self), len(self.signals)
        span = f", {self.t[0]:g} to {self.t[-1]:g} s" if n else ""
        name = f" of {self.metadata['scenario']}" if "scenario" in self.metadata else ""
        lines = [f"Log{name}: {n} samples{span}, {count} signals"]
        lines += [f"  {p}" + (f" [{self.unit(p)}]" if self.unit(p) not in ("", "1") else "") for p in self.paths[:6]]
        if count > 6:
            lines.append(f"  ... {count - 6} more in log.paths")
        lines.append(f'Read a signal: log["{self.paths[0]}"]; its times in s: log.t; an interval: log.between(t0, t1)')
        return "\n".join(lines)


OTHER_SPELLINGS = {
    "plot": "plot_run(log)",
    "save": 'write_log(log, "run.mcap")',
    "write": 'write_log(log, "run.mcap")',
    "to_csv": 'log.to_dataframe().to_csv("run.csv")',
    "to_pandas": "log.to_dataframe()",
    "to_numpy": "log.to_dataframe().to_numpy()",
    "time": "log.t",
    "keys": "log.paths",
    "columns": "log.paths",
    "units": 'log.unit("PATH")',
    "metrics": 'metrics(log, build("SCENARIO").targets, log.paths)',
    "summary": "print(log)",
    "states": 'log["truth.NAME"]',
    "shape": "len(log), len(log.paths)",
}
"""Attribute that a log does not have, but users of other libraries expect -> expression to write instead."""


def _other_spelling(log: Log, name: str) -> str:
    """Return the expression to write instead of an attribute that a log does not have, or "" if unknown."""
    signals = log.__dict__.get("signals", {})
    below = [path for path in signals if path.startswith(f"{name}.")]
    if name in OTHER_SPELLINGS:
        return OTHER_SPELLINGS[name]
    if below:
        return f'log["{below[0]}"]'
    if name in log.__dict__.get("metadata", {}):
        return f'log.metadata["{name}"]'
    if f"{name}_s" in log.__dict__.get("metadata", {}):
        return f'log.metadata["{name}_s"]'
    ends = [path for path in signals if path.endswith(f".{name}")]
    if ends:
        return f'log["{ends[0]}"]'
    return "" if closest(name, vars(Log), 1) else "print(log.paths)"


def check_log(log: Any, call: str) -> None:
    """Raise InputError if a value is not a log. call: function call to suggest, with {} in place of the log."""
    if not isinstance(log, Log):
        source = "read_log({!r})" if str(log).endswith(".mcap") else "simulate({!r})"
        own = source.format(log) if isinstance(log, str) else 'read_log("run.mcap")'
        raise InputError("log", f"a {type(log).__name__} is not a log", fix=call.format(own))


def provenance() -> dict[str, str]:
    """Return the version of the package, and the type of machine (processor, operating system).

    Compiled code computes the same results, bit for bit, on machines of the same type.
    """
    return {"version": __version__, "machine": f"{platform.machine()} {platform.system()}"}


def to_plain(part: str, value: Any) -> Any:
    """Convert a value to plain Python types (dict, list, str, float, int, bool, None).

    Raise InputError if this is not possible.
    """
    if isinstance(value, Mapping):
        return {_check_key(part, k): to_plain(f"{part}.{k}", v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        if set(map(type, value)) <= PLAIN:  # quick path for a long table of numbers
            return list(value)
        return [to_plain(f"{part}[{i}]", v) for i, v in enumerate(value)]
    if value is None or (isinstance(value, str | bool | int | float) and not isinstance(value, np.generic)):
        return value
    if isinstance(value, np.generic | np.ndarray) or hasattr(value, "__array__"):
        array = np.asarray(value)
        if array.dtype.kind in "biufU":
            return array.tolist()
    choices = ("str", "float", "int", "bool", "None", "list", "dict", "array of numbers")
    problem = f"{value!r} of type {type(value).__name__} cannot be written as JSON"
    raise InputError(part, problem, choices=choices, fix="pass numbers or a name instead of the object")


def _check_key(part: str, key: Any) -> str:
    if not isinstance(key, str):
        raise InputError(part, f"the key {key!r} is not text", fix=f"write {str(key)!r}")
    return key


def _freeze(array: np.ndarray) -> np.ndarray:
    copy = np.array(array)
    copy.setflags(write=False)
    return copy


def _check_ticks(ticks: Any) -> np.ndarray:
    values = np.asarray(ticks)
    if values.ndim != 1 or values.dtype.kind not in "iu":
        problem = f"ticks must be integers of shape (n,), got shape {values.shape} and type {values.dtype}"
        raise InputError("log", problem, fix="pass whole numbers of 100 ns, int64, shape (n,)")
    array = _freeze(values.astype(np.int64))
    if len(array) and (array[0] < 0 or (np.diff(array) <= 0).any()):
        raise InputError("log", "ticks must rise strictly, from 0 on", fix="pass each instant once, in order of time")
    return array


def _check_numbers(part: str, values: Any) -> np.ndarray:
    array = _freeze(np.asarray(values))
    if array.dtype.kind not in "biuf" or array.dtype.itemsize > 8:
        choices = ("bool", "int8..int64", "uint8..uint64", "float16..float64")
        raise InputError(
            part, f"has values of type {array.dtype}", choices=choices, fix="convert the values to one of these types"
        )
    return array


def _check_signal(path: str, values: Any, n: int) -> np.ndarray:
    array = _check_numbers(f"log signal {path!r}", values)
    if array.ndim not in (1, 2) or len(array) != n:
        problem = f"has shape {array.shape}, but the log has {n} instants"
        raise InputError(f"log signal {path!r}", problem, fix=f"give the array the shape ({n},) or ({n}, k)")
    return array


def _check_value(path: str, value: Any) -> Any:
    array = _check_numbers(f"log final value {path!r}", value)
    return array[()] if array.ndim == 0 else array


def _check_paths(signals: Mapping[str, Any]) -> None:
    if not signals:
        raise InputError("log", "the log has no signal", fix="pass at least one, e.g. {'truth.heading': heading}")
    for path in signals:
        names = path.split(".")
        if len(names) < 2 or not all(names):
            fix = "write block and field, e.g. 'truth.heading'"
            raise InputError("log", f"the path {path!r} does not name a block and a field", fix=fix)
        above = [".".join(names[:i]) for i in range(1, len(names))]
        clash = next((p for p in above if p in signals), None)
        if clash:
            problem = f"{clash!r} is a signal, and also the group of {path!r}"
            raise InputError("log", problem, fix=f"rename one of the two signals, e.g. '{clash}.value'")
