"""Metrics of a campaign, computed for a block of runs together. `logs.metrics` computes the metrics of one run.

A metric is written as KIND:SIGNAL, e.g. ``settling:yaw_rate`` or ``peak:truth.sway_velocity``, as robustness:FORMULA,
or as a function in a file, ``my_metrics.py:miss_distance``. The function maps `Rows` of n runs to an array (n,).
A metric that is the time of an event is inf if the event never happens.

Source: docs pages, Metrics (logs) and Campaigns.
"""

import dataclasses
import importlib.util
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.analysis.campaign.grammar import ROBUSTNESS, parse_metric
from trimtab.core.errors import InputError, Spelling, argument, argument_name, spell_with
from trimtab.core.formula_units import fit_formula
from trimtab.core.quantity import component_paths, split_component
from trimtab.core.suggestions import closest
from trimtab.core.time import UNITS_PER_SECOND
from trimtab.logs.metrics import SHORT, Target, full_path
from trimtab.logs.robustness import check_length, robustness
from trimtab.logs.spatial import FLIGHT, FlightSource


@dataclasses.dataclass(frozen=True)
class Rows:
    """Logged rows of a block of n runs, with m rows in each run.

    t: times of the rows (m,), s.  signals: path -> values (n, m, …).  targets: targets of the scenario.
    angles: paths of the signals that are angles, which wrap.  final: path -> values after the last step (n, …). For a
    signal that is not in `final`, the last row is used.  flight: source of the derived signals `flight.roll` etc.,
    which are computed on request, as in a log.  end_time: time at which all runs end (s).  parameters: path -> values
    (n,) of the parameters needed to compute derived signals of a flight over the rotating earth.
    """

    t: Any
    signals: Mapping[str, Any]
    targets: tuple[Target, ...]
    angles: frozenset[str]
    final: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    flight: FlightSource | None = None
    end_time: float = np.nan
    parameters: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    _flights: dict[str, tuple[Any, Any]] = dataclasses.field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _errors: dict[str, Any] = dataclasses.field(default_factory=dict, init=False, repr=False, compare=False)

    def __getitem__(self, path: str) -> Any:
        """Return the values (n, m, …) of the signal with a path or short name.

        "truth.velocity[2]" selects one element of a vector; the values are then (n, m).
        """
        whole, index = split_component(full_path(path))
        signal = self._work_out(whole)[0] if self._is_derived(whole) else self.signals[whole]
        return signal if index is None else signal[:, :, index]

    def end(self, path: str) -> Any:
        """Return the values (n, …) of a signal at the end of each run."""
        whole, index = split_component(full_path(path))
        if self._is_derived(whole):
            return self._work_out(whole)[1]
        last = self.final[whole] if whole in self.final else self.signals[whole][:, -1]
        return last if index is None else last[:, index]

    def _is_derived(self, path: str) -> bool:
        return path.startswith(FLIGHT) and self.flight is not None and path not in self.signals

    def _work_out(self, path: str) -> tuple[Any, Any]:
        """Return logged values (n, m) and last values (n,) of a derived signal, e.g. "flight.roll"."""
        if not self._flights:
            flights = [self._work_out_run(i) for i in range(len(next(iter(self.signals.values()))))]
            for name in flights[0][0]:
                rows = np.stack([numbers[name] for numbers, _ in flights])
                rows.setflags(write=False)
                ends = [last.get(name, numbers[name][-1]) for numbers, last in flights]
                self._flights[name] = rows, np.array(ends)
        return self._flights[path]

    def _work_out_run(self, i: int) -> tuple[dict[str, Any], dict[str, Any]]:
        assert self.flight is not None
        paths, parameters = self.flight.paths, {p: float(v[i]) for p, v in self.parameters.items()}
        ends = {p: self.final[p][i] for p in paths if p in self.final}
        return self.flight.work_out(self.t, {p: self.signals[p][i] for p in paths}, ends, self.end_time, parameters)

    def error(self, path: str) -> Any:
        """Return the error (n, m) of a signal, i.e. signal minus target, as a read-only array.

        The target of an angle is shifted by full turns to be as near as possible to the last value of the run.
        """
        if path not in self._errors:
            error = self._errors[path] = self._error(path)
            error.setflags(write=False)
        return self._errors[path]

    def _error(self, path: str) -> Any:
        target = next(t for t in self.targets if full_path(t.path) == full_path(path))
        x = self[path].astype(np.float64)
        value = np.full(len(x), float(target.value))
        if split_component(full_path(path))[0] in self.angles and x.shape[1]:
            last = _last_finite_value(x)
            value = value + np.where(np.isfinite(last), 2 * np.pi * np.round((last - value) / (2 * np.pi)), 0.0)
        return x - value[:, None]

    def band(self, path: str) -> float:
        """Return the half-width of the band around a signal's target, in the unit of the signal."""
        return next(t for t in self.targets if full_path(t.path) == full_path(path)).band


class Metric(NamedTuple):
    """Metric of a run.

    name: name of the metric in the results.  signals: paths of the signals that the metric needs.
    of: function from `Rows` to values (n,).  unit: unit of the values.
    """

    name: str
    signals: tuple[str, ...]
    of: Callable[[Rows], Any]
    unit: str = ""

    @property
    def label(self) -> str:
        """Return the name of the metric with its unit, as in "settling:yaw_rate (s)"."""
        return f"{self.name} ({self.unit})" if self.unit not in ("", "1") else self.name


def settling(rows: Rows, path: str) -> Any:
    """Return the settling time (s) after which a signal stays in its target band; inf if the signal never settles."""
    error = rows.error(path)
    backwards = np.empty(error.shape)
    np.abs(error[:, ::-1], out=backwards)  # in the order of the search, so that it ends early
    inside = backwards <= rows.band(path)
    first = inside.shape[1] - np.argmin(inside, axis=1)
    first[inside.all(axis=1)] = 0
    t = np.append(rows.t - rows.t[0], np.inf)
    return t[first]


def first_reach(rows: Rows, path: str) -> Any:
    """Return the time (s) at which a signal first reaches its target; inf if it never does.

    The target counts as reached at the first log row inside the target band. A crossing of the target between two rows
    is interpolated.
    """
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
    """Return the overshoot: largest distance of a signal beyond its target, on the side opposite to the initial value.

    The overshoot of a diverged run is inf.
    """
    error = rows.error(path)
    start = error[:, 0]
    beyond = np.where(start < 0, error.max(axis=1), -error.min(axis=1))
    excess = np.where(start == 0, np.abs(error).max(axis=1), np.maximum(0.0, beyond))
    return np.where(np.isfinite(error).all(axis=1), excess, np.inf)


def swing_amplitude(rows: Rows, path: str) -> Any:
    """Return the amplitude of the residual oscillation at the end of a run: 0 if it decays, inf for a diverged run.

    The last third of the run is divided into two halves. The amplitude of a half is (largest - smallest value)/2. If
    the amplitude of the second half is below FADING times that of the first half, the oscillation decays and counts as
    0. Otherwise the result is the amplitude of the second half: that of a growing oscillation, a limit cycle or noise.
    A constant offset is not an oscillation. If the period is longer than a sixth of the run, the amplitude is
    underestimated.
    """
    tail = _tail_errors(rows, path)
    half = tail.shape[1] // 2
    with np.errstate(invalid="ignore"):
        before, last = (np.ptp(part, axis=1) / 2 for part in (tail[:, :half], tail[:, half:]))
    return _or_inf(np.where(last < FADING * before, 0.0, last))


def error_rms(rows: Rows, path: str) -> Any:
    """Return the root mean square of a signal's error over the second half of a run, or inf for a diverged run."""
    return _or_inf(np.sqrt(np.mean(rows.error(path)[:, _start_index(rows, 1 / 2) :] ** 2, axis=1)))


def _tail_errors(rows: Rows, path: str) -> Any:
    return rows[path][:, _start_index(rows, 2 / 3) :].astype(np.float64)


def _start_index(rows: Rows, share: float) -> int:
    """Return the index of the first log row after a share of the run's duration."""
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
    "final": lambda rows, path: rows.end(path).astype(np.float64),
    "least": lambda rows, path: rows[path].astype(np.float64).min(axis=1),
    "most": lambda rows, path: _or_inf(rows[path].astype(np.float64).max(axis=1)),
    "peak": lambda rows, path: _or_inf(np.abs(rows[path].astype(np.float64)).max(axis=1)),
    "mean": lambda rows, path: rows[path].astype(np.float64).mean(axis=1),
    "rms": lambda rows, path: _or_inf(np.sqrt(np.mean(rows[path].astype(np.float64) ** 2, axis=1))),
    "tail_mean": lambda rows, path: _tail_errors(rows, path).mean(axis=1),
    "sustained": swing_amplitude,
    "tail_rms": lambda rows, path: _or_inf(_tail_errors(rows, path).std(axis=1)),
    "changes": lambda rows, path: (np.diff(rows[path].astype(np.float64), axis=1) != 0).sum(axis=1).astype(np.float64),
}
FADING = 0.9
"""Ratio of the oscillation amplitudes in the last and the next-to-last sixth of a run below which they decay."""
TIMES = ("settling", "first_reach")
OF_A_LINE = ("loop.", "link.", "vehicle.")
"""Path prefixes of signals that occur only in the log of a real-time flight over a link."""
KINDS = (*OF_TARGETS, *OF_SIGNALS, ROBUSTNESS)


@contextmanager
def name_option(name: str, more: str = "") -> Iterator[None]:
    """Within a `with` block, make error messages name the argument `name` instead of the argument "metrics".

    more: text that follows the metric in the argument, e.g. " <= 10".
    """

    def spell(outer: Spelling, named: str, value: Any, of: str | None) -> str:
        if named != "metrics":
            return outer(named, value, of)
        texts = value if value is None else [f"{text}{more}" for text in value]
        return outer(name, texts[0] if texts and name == "cost" else texts, of)

    with spell_with(spell):
        yield


def find_metric(
    text: str,
    signals: Mapping[str, tuple[int, ...]],
    targets: Iterable[Target],
    units: Mapping[str, str] | None = None,
    duration: int | None = None,
) -> Metric:
    """Return the metric with a name, given as text. Raise InputError if the scenario does not have this metric.

    Args:
        text: KIND:SIGNAL, robustness:FORMULA, or file.py:function.
        signals: path -> shape of each signal of the scenario, including derived signals such as flight.roll.
        targets: targets of the scenario.
        units: path -> unit of each signal.
        duration: duration of a run (100 ns). A formula must not need signals after the run. None: no limit.
    """
    written = parse_metric(text)
    kind, name = written
    if kind == ROBUSTNESS and name:
        return _formula_metric(text, name, signals, units or {}, duration)
    if written.is_function:
        return _load_metric(text, Path(kind), name)
    part = argument_name("metrics", text)
    if kind not in KINDS or not name:
        near = closest(kind, KINDS, 3) or KINDS
        raise InputError(
            part,
            "is not a metric; write KIND:SIGNAL",
            choices=KINDS,
            fix=argument("metrics", [f"{near[0]}:{name or 'yaw_rate'}"]),
        )
    path, target_paths = full_path(name), [full_path(t.path) for t in targets]
    if kind in OF_TARGETS and path not in target_paths:
        short = [p.removeprefix("truth.") for p in target_paths]
        alone = f"{argument('metrics', [f'rms:{name}'])}, or give the scenario targets=(Target(…),)"
        near = closest(path.removeprefix("truth."), short, 1) or short
        fix = argument("metrics", [f"{kind}:{near[0]}"]) if near else alone
        raise InputError(part, f"the scenario has no target for {name!r}", choices=short, fix=fix)
    whole, _ = split_component(path)
    if whole not in signals:
        raise _unknown_signal(part, kind, name, signals)
    numbers = component_paths(whole, signals[whole])
    if path not in numbers:
        choices = numbers[:8]
        problem = f"{whole!r} has shape {signals[whole]}, but a metric needs one number"
        raise InputError(part, problem, choices=choices, fix=argument("metrics", [f"{kind}:{choices[0]}"]))
    of = OF_TARGETS.get(kind) or OF_SIGNALS[kind]
    unit = "s" if kind in TIMES else "1" if kind == "changes" else (units or {}).get(whole, "")
    return Metric(text, (whole,), lambda rows: of(rows, path), unit)


def _unknown_signal(part: str, kind: str, name: str, signals: Iterable[str]) -> InputError:
    """Return an InputError for a signal that a simulated run does not have."""
    problem, near = f"there is no signal {name!r}", closest(full_path(name), signals, 6) or list(signals)[:6]
    fix = argument("metrics", [f"{kind}:{near[0]}"])
    if name.startswith(OF_A_LINE):
        problem += "; only the log of a flight over a link contains it, not a simulated run"
        fix = "trimtab fly SCENARIO --link … --out DIR  writes this signal to its log"
    elif name.startswith(FLIGHT):
        flown = [path for path in signals if path.startswith(FLIGHT)]
        near = flown or near
        problem += "" if flown else "; this vehicle has no three-dimensional attitude"
        fix = argument("metrics", [f"{kind}:{(closest(name, flown, 1) or near)[0]}"])
    return InputError(part, problem, choices=near, fix=fix)


def _formula_metric(
    text: str, formula: str, signals: Mapping[str, tuple[int, ...]], units: Mapping[str, str], duration: int | None
) -> Metric:
    """Return the metric of a formula: its robustness at the first log row, above 0 if the run satisfies the formula."""
    fitted = fit_formula(formula, signals, units, full_path)
    if duration is not None:
        check_length(fitted, duration)

    def of(rows: Rows) -> Any:
        ticks = np.rint(np.asarray(rows.t) * UNITS_PER_SECOND).astype(np.int64)
        return robustness(fitted, ticks, rows.__getitem__)[:, 0]

    return Metric(text, fitted.paths, of, fitted.unit)


def default_metrics(targets: Iterable[Target]) -> list[str]:
    """Return the default metrics: settling and error_rms of each target."""
    return [f"{kind}:{short_name(t.path)}" for t in targets for kind in ("settling", "error_rms")]


def short_name(path: str) -> str:
    """Return the short name of a signal, or its path if it has none."""
    return next((short for short, full in SHORT.items() if full == path), path)


def function_metric(name: str, function: Callable[[Rows], Any]) -> Metric:
    """Return the metric of a user's function.

    The optional attribute `signals` of the function lists the signals needed.
    """
    return Metric(name, tuple(getattr(function, "signals", ("truth",))), function)


def _load_metric(text: str, file: Path, name: str) -> Metric:
    part = argument_name("metrics", text)
    spec = importlib.util.spec_from_file_location(file.stem, file)
    if spec is None or spec.loader is None or not file.is_file():
        raise InputError(
            part, f"there is no file {str(file)!r}", fix=argument("metrics", ["my_metrics.py:miss_distance"])
        )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    function = getattr(module, name, None)
    if not callable(function):
        known = [n for n, f in vars(module).items() if callable(f) and not n.startswith("_")]
        raise InputError(part, f"{file} has no function {name!r}", choices=known, fix=f"def {name or 'miss'}(rows): …")
    return function_metric(text, function)
