"""Metrics of a run's signals relative to targets: settling, first reach, overshoot, tail (docs/logs/metrics.md)."""

import dataclasses
from collections.abc import Callable, Collection, Iterable
from typing import Any

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.explain_call import explain_call
from trimtab.core.quantity import component_paths, split_component
from trimtab.core.suggestions import closest
from trimtab.logs.log import Log

SHORT = {name: f"truth.{name}" for name in ("surge_velocity", "sway_velocity", "yaw_rate", "heading")}
"""Short name of a common signal -> its path in a log."""


@dataclasses.dataclass(frozen=True)
class Target:
    """Target of a signal. The signal is on target if |signal - value| <= band; `band` is in the signal's unit.

    >>> from trimtab import Target
    >>> Target("truth.yaw_rate", 3.0, band=0.15).band
    0.15
    """

    path: str
    value: float
    band: float

    def __post_init__(self) -> None:
        for name in ("value", "band"):
            if not isinstance(getattr(self, name), int | float | np.number | np.ndarray):
                problem = f"{name} must be a number in the signal's unit, got {getattr(self, name)!r}"
                raise InputError(
                    f"target of {self.path!r}", problem, fix="write e.g. Target('yaw_rate', 3.0, band=0.15)"
                )
        if not (np.isfinite(self.value) and np.isfinite(self.band) and self.band > 0):
            problem = f"value {self.value!r} must be finite, and band {self.band!r} must be above 0"
            raise InputError(f"target of {self.path!r}", problem, fix="write e.g. Target('yaw_rate', 3.0, band=0.15)")


def full_path(name: str) -> str:
    """Return the path of a signal from its short name, e.g. "truth.heading" from "heading", or from its path."""
    return SHORT.get(name, name)


def target_path(log: Log, target: Target) -> str:
    """Return the path of a target's signal. Raise InputError if the log lacks this signal."""
    check_targets([target], log.paths, lambda path: log[path].shape[1:])
    return full_path(target.path)


def check_targets(
    targets: Iterable[Target], paths: Collection[str], shape_of: Callable[[str], tuple[int, ...]]
) -> None:
    """Raise InputError for a target whose signal does not exist or is a vector, and for two targets of one signal.

    paths: paths of all signals.  shape_of: function that returns the shape of a signal at one instant.
    """
    seen = set[str]()
    for target in targets:
        path = full_path(target.path)
        whole = split_component(path)[0]
        whole = path if path in paths else whole  # a log may contain an element of a vector as a signal of its own
        numbers = component_paths(whole, shape_of(whole)) if whole in paths else []
        if path in seen:
            raise InputError("targets", f"there are two targets for {path!r}", fix="keep one target for each signal")
        seen.add(path)
        if path in numbers:
            continue
        problem = "no signal has this name"
        if numbers:
            problem = f"{whole!r} has shape {shape_of(whole)}, but a target needs one number"
        near = numbers or [p for p in paths if p.startswith(f"{path}.")] or closest(path, paths) or list(paths)
        near = near[:8] or ["truth.yaw_rate"]
        fix = f"Target({near[0]!r}, {target.value:g}, band={target.band:g})"
        raise InputError(f"target of {target.path!r}", problem, choices=near, fix=fix)


@explain_call()
def metrics(log: Log, targets: Iterable[Target], signals: Iterable[str]) -> dict[str, dict[str, float | None]]:
    """Return the metrics settling_s, first_reach_s, overshoot, tail_mean and tail_rms of each signal.

    A metric that is not defined is None.

    >>> from trimtab import Target, metrics, simulate
    >>> log = simulate("hovercraft/spin", duration="100 ms")
    >>> metrics(log, [Target("yaw_rate", 3.0, band=0.15)], ["yaw_rate"])["yaw_rate"]["settling_s"] is None
    True

    Args:
        log: log of the run.
        targets: at most one target for each signal. The first three metrics of a signal without a target are None.
        signals: paths or short names of the signals. They are also the keys of the result.
    """
    targets = tuple(targets)
    check_targets(targets, log.paths, lambda path: log[path].shape[1:])
    by_path = {full_path(target.path): target for target in targets}
    with np.errstate(over="ignore", invalid="ignore"):  # the metrics of a diverged run are None, without a warning
        return {name: _merits(log, full_path(name), by_path.get(full_path(name))) for name in signals}


def mode_switches(log: Log) -> int:
    """Return the number of mode switches of the law: the last value of ``law.switches`` if the law counts them, or the
    number of changes of ``law.mode``. It is 0 for a law without modes.
    """
    if "law.switches" in log and len(log):
        return int(log["law.switches"][-1])
    return int(np.count_nonzero(np.diff(log["law.mode"], axis=0))) if "law.mode" in log else 0


def nearest_target_value(log: Log, target: Target) -> float:
    """Return the value of a target. For an angle, return the equivalent angle nearest to the signal's last value."""
    path = full_path(target.path)
    x = log[path]
    ends = x[np.isfinite(x)]
    declared = log.declaration(path)
    is_angle = declared is not None and declared.kind == "angle"
    if is_angle and len(ends) and np.spacing(abs(ends[-1])) < target.band:  # not of a diverged run
        return float(target.value + 2 * np.pi * np.round((ends[-1] - target.value) / (2 * np.pi)))
    return float(target.value)


def _merits(log: Log, path: str, target: Target | None) -> dict[str, float | None]:
    if log[path].ndim != 1:
        problem = f"signal {path!r} has {log[path].shape[1]} components, but a metric needs one number"
        raise InputError("metrics", problem, choices=log.numbers(path), fix=f"use one component, e.g. {path}[0]")
    t, x = log.t, log[path].astype(np.float64)
    numbers: dict[str, float | None] = {"settling_s": None, "first_reach_s": None, "overshoot": None}
    if target is not None and len(t):
        error = x - nearest_target_value(log, target)
        numbers |= {
            "settling_s": _settling(t, error, target.band),
            "first_reach_s": _first_reach(t, error, target.band),
            "overshoot": _overshoot(error),
        }
    tail = x[t >= t[0] + (t[-1] - t[0]) * 2 / 3] if len(t) else x
    mean = _finite(tail.mean()) if np.isfinite(tail).all() and len(tail) else None
    rms = None if mean is None else _finite(np.sqrt(np.mean((tail - mean) ** 2)))
    return numbers | {"tail_mean": mean, "tail_rms": rms}


def _settling(t: Any, error: Any, band: float) -> float | None:
    outside = np.flatnonzero(~(np.abs(error) <= band))  # NaN is outside every band
    first = outside[-1] + 1 if len(outside) else 0
    return float(t[first] - t[0]) if first < len(t) else None


def _first_reach(t: Any, error: Any, band: float) -> float | None:
    """Return the time at which the signal first reaches the target: a sample within the band, or a crossing of the
    target's value, whose time is interpolated."""
    inside = np.flatnonzero(np.abs(error) <= band)
    finite = np.isfinite(error)
    across = np.flatnonzero((np.sign(error[:-1]) * np.sign(error[1:]) < 0) & finite[:-1] & finite[1:])
    if len(across) and (not len(inside) or across[0] + 1 < inside[0]):
        i = across[0]
        fraction = error[i] / (error[i] - error[i + 1])
        return float(t[i] + fraction * (t[i + 1] - t[i]) - t[0])
    return float(t[inside[0]] - t[0]) if len(inside) else None


def _overshoot(error: Any) -> float | None:
    if not np.isfinite(error).all():
        return None
    if error[0] == 0:
        return float(np.abs(error).max())
    beyond = error if error[0] < 0 else -error
    return float(max(0.0, beyond.max()))


def _finite(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
