"""What is kept of each run: numbers of merit, computed for a block of runs at once, as `logs.metrics` does for one.

A metric is written KIND:SIGNAL, e.g. ``settling:yaw_rate`` or ``peak:truth.sway_velocity``, or is a function of a file,
``my_metrics.py:miss_distance``, of `Rows` to an array (n,). What never happens takes infinitely long: inf.

Source: docs pages, Metrics (logs) and Campaigns.
"""

import dataclasses
import importlib.util
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.campaign.grammar import parse_metric
from trimtab.core.errors import InputError, closest
from trimtab.logs.metrics import SHORT, Target, full_path


@dataclasses.dataclass(frozen=True)
class Rows:
    """The logged rows of a block of n runs.

    t: (m,), s.  signals: by path, (n, m, …).  targets: of the scenario.  angles: paths of signals that wrap.
    """

    t: Any
    signals: Mapping[str, Any]
    targets: tuple[Target, ...]
    angles: frozenset[str]
    _errors: dict[str, Any] = dataclasses.field(default_factory=dict, init=False, repr=False, compare=False)

    def __getitem__(self, path: str) -> Any:
        """A signal by its path or short name, (n, m, …)."""
        return self.signals[full_path(path)]

    def error(self, path: str) -> Any:
        """A signal less its target (n, m), read only; for an angle, less that equal nearest to where a run ends."""
        if path not in self._errors:
            error = self._errors[path] = self._error(path)
            error.setflags(write=False)
        return self._errors[path]

    def _error(self, path: str) -> Any:
        target = next(t for t in self.targets if full_path(t.path) == full_path(path))
        x = self[path].astype(np.float64)
        value = np.full(len(x), float(target.value))
        if full_path(path) in self.angles and x.shape[1]:
            last = _last_finite_value(x)
            value = value + np.where(np.isfinite(last), 2 * np.pi * np.round((last - value) / (2 * np.pi)), 0.0)
        return x - value[:, None]

    def band(self, path: str) -> float:
        """The absolute band of a signal's target."""
        return next(t for t in self.targets if full_path(t.path) == full_path(path)).band


class Metric(NamedTuple):
    """name: the column.  signals: what must be logged, by path.  of: rows to (n,).  unit: of the column."""

    name: str
    signals: tuple[str, ...]
    of: Callable[[Rows], Any]
    unit: str = ""

    @property
    def label(self) -> str:
        """Name and unit, as in "settling:yaw_rate (s)"."""
        return f"{self.name} ({self.unit})" if self.unit not in ("", "1") else self.name


def settling(rows: Rows, path: str) -> Any:
    """Time (s) from the first row to the first after which the signal stays in its target's band; inf if it doesn't."""
    error = rows.error(path)
    backwards = np.empty(error.shape)
    np.abs(error[:, ::-1], out=backwards)  # in the order that is searched, which ends the search early
    inside = backwards <= rows.band(path)
    first = inside.shape[1] - np.argmin(inside, axis=1)
    first[inside.all(axis=1)] = 0
    t = np.append(rows.t - rows.t[0], np.inf)
    return t[first]


def first_reach(rows: Rows, path: str) -> Any:
    """Time (s) to the first row in the band, or where two rows' straight line meets the target; inf if never."""
    error, t = rows.error(path), rows.t - rows.t[0]
    inside = np.abs(error) <= rows.band(path)
    crosses = np.sign(error[:, :-1]) * np.sign(error[:, 1:]) < 0
    everyone = np.arange(len(error))
    hit = np.where(inside.any(axis=1), np.argmax(inside, axis=1), len(t))
    cross = np.where(crosses.any(axis=1), np.argmax(crosses, axis=1), len(t))
    first_row = np.append(t, np.inf)[hit]
    sooner = cross + 1 < hit
    i = np.minimum(cross, len(t) - 2)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = error[everyone, i] / (error[everyone, i] - error[everyone, i + 1])
    return np.where(sooner, t[i] + share * (t[i + 1] - t[i]), first_row)


def overshoot(rows: Rows, path: str) -> Any:
    """How far the signal goes beyond its target, seen from where it starts; inf for a run that ran away."""
    error = rows.error(path)
    start = error[:, 0]
    beyond = np.where(start < 0, error.max(axis=1), -error.min(axis=1))
    excess = np.where(start == 0, np.abs(error).max(axis=1), np.maximum(0.0, beyond))
    return np.where(np.isfinite(error).all(axis=1), excess, np.inf)


def swing_amplitude(rows: Rows, path: str) -> Any:
    """Amplitude of what goes on swinging at a run's end, 0 where it dies away; inf for a run that ran away.

    The last third of the run is halved. In each half the amplitude is half of largest less smallest value; where that
    of the second half is below FADING times the first's, the swing dies away. Growth, a limit cycle and noise stay. A
    constant offset is no swing, and a period longer than a sixth of the run is not seen whole.
    """
    tail = _tail_errors(rows, path)
    half = tail.shape[1] // 2
    with np.errstate(invalid="ignore"):
        before, last = (np.ptp(part, axis=1) / 2 for part in (tail[:, :half], tail[:, half:]))
    return _or_inf(np.where(last < FADING * before, 0.0, last))


def error_rms(rows: Rows, path: str) -> Any:
    """Root mean square of what is left to the target over the second half of a run; inf for a run that ran away."""
    return _or_inf(np.sqrt(np.mean(rows.error(path)[:, _start_index(rows, 1 / 2) :] ** 2, axis=1)))


def _tail_errors(rows: Rows, path: str) -> Any:
    return rows[path][:, _start_index(rows, 2 / 3) :].astype(np.float64)


def _start_index(rows: Rows, share: float) -> int:
    """Index of the first row after a share of the run; a slice leaves rows as they lie, so that one run sums alike."""
    return int(np.searchsorted(rows.t, rows.t[0] + (rows.t[-1] - rows.t[0]) * share))


def _or_inf(x: Any) -> Any:
    return np.where(np.isfinite(x), x, np.inf)


def _last_finite_value(x: Any) -> Any:
    finite = np.isfinite(x)
    at = x.shape[1] - 1 - np.argmax(finite[:, ::-1], axis=1)
    return np.where(finite.any(axis=1), x[np.arange(len(x)), at], np.nan)


OF_TARGETS: Mapping[str, Callable[[Rows, str], Any]] = {
    "settling": settling,
    "first_reach": first_reach,
    "overshoot": overshoot,
    "error_rms": error_rms,
}
OF_SIGNALS: Mapping[str, Callable[[Rows, str], Any]] = {
    "final": lambda rows, path: rows[path][:, -1].astype(np.float64),
    "least": lambda rows, path: rows[path].astype(np.float64).min(axis=1),
    "most": lambda rows, path: _or_inf(rows[path].astype(np.float64).max(axis=1)),
    "peak": lambda rows, path: _or_inf(np.abs(rows[path].astype(np.float64)).max(axis=1)),
    "mean": lambda rows, path: rows[path].astype(np.float64).mean(axis=1),
    "rms": lambda rows, path: _or_inf(np.sqrt(np.mean(rows[path].astype(np.float64) ** 2, axis=1))),
    "tail_mean": lambda rows, path: _tail_errors(rows, path).mean(axis=1),
    "sustained": swing_amplitude,
    "tail_rms": lambda rows, path: _or_inf(_tail_errors(rows, path).std(axis=1)),
}
FADING = 0.9
"""A swing that is not smaller than so many parts of itself a sixth of the run before goes on."""
TIMES = ("settling", "first_reach")
KINDS = (*OF_TARGETS, *OF_SIGNALS)


def find_metric(
    text: str, signals: Mapping[str, tuple[int, ...]], targets: Iterable[Target], units: Mapping[str, str] | None = None
) -> Metric:
    """The metric that a text names; refuses what the scenario doesn't have.

    Args:
        text: KIND:SIGNAL, or file.py:function.
        signals: path -> shape of each signal of the scenario.
        targets: of the scenario.
        units: path -> unit of each signal.
    """
    written = parse_metric(text)
    kind, name = written
    if written.is_function:
        return _load_metric(text, Path(kind), name)
    part = f"--metric {text}"
    if kind not in KINDS or not name:
        near = closest(kind, KINDS, 3) or KINDS
        raise InputError(part, "is not KIND:SIGNAL", choices=KINDS, fix=f"--metric {near[0]}:{name or 'yaw_rate'}")
    path, target_paths = full_path(name), [full_path(t.path) for t in targets]
    if kind in OF_TARGETS and path not in target_paths:
        short = [p.removeprefix("truth.") for p in target_paths]
        alone = f"--metric rms:{name}, or give the scenario targets=(Target(…),)"
        fix = f"--metric {kind}:{short[0]}" if short else alone
        raise InputError(part, f"the scenario has no target for {name!r}", choices=short, fix=fix)
    if path not in signals:
        near = closest(path, signals, 6) or list(signals)[:6]
        raise InputError(part, f"there is no signal {name!r}", choices=near, fix=f"--metric {kind}:{near[0]}")
    if signals[path]:
        raise InputError(part, f"{name!r} has shape {signals[path]}", fix="ask for a signal of one number")
    of = OF_TARGETS.get(kind) or OF_SIGNALS[kind]
    unit = "s" if kind in TIMES else (units or {}).get(path, "")
    return Metric(text, (path,), lambda rows: of(rows, path), unit)


def default_metrics(targets: Iterable[Target]) -> list[str]:
    """What is kept where nothing was asked for: settling and the tail's rms of each target."""
    return [f"{kind}:{short_name(t.path)}" for t in targets for kind in ("settling", "error_rms")]


def short_name(path: str) -> str:
    """The short name of a signal that has one, else its path."""
    return next((short for short, full in SHORT.items() if full == path), path)


def function_metric(name: str, function: Callable[[Rows], Any]) -> Metric:
    """The metric that a function is; its attribute `signals`, where it has one, says what it reads."""
    return Metric(name, tuple(getattr(function, "signals", ("truth",))), function)


def _load_metric(text: str, file: Path, name: str) -> Metric:
    part = f"--metric {text}"
    spec = importlib.util.spec_from_file_location(file.stem, file)
    if spec is None or spec.loader is None or not file.is_file():
        raise InputError(part, f"there is no file {str(file)!r}", fix="--metric my_metrics.py:miss_distance")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    function = getattr(module, name, None)
    if not callable(function):
        known = [n for n, f in vars(module).items() if callable(f) and not n.startswith("_")]
        raise InputError(part, f"{file} has no function {name!r}", choices=known, fix=f"def {name or 'miss'}(rows): …")
    return function_metric(text, function)
