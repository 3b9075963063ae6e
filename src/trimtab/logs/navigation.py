"""Consistency of the navigation in one run: errors of an aided INS compared with the sigmas that the filter computes.

Each update by a sensor is counted once. States that no sensor corrected are left out. The errors of one run are
correlated, so every average is judged by its effective number of independent draws (sources: `logs.consistency`). A
consistent filter is within all bounds simultaneously with the requested probability.
"""

from typing import Any, NamedTuple

import numpy as np

from trimtab.logs.consistency import (
    CONSISTENT,
    OPTIMISTIC,
    PESSIMISTIC,
    UNDECIDED,
    SingleRunConsistency,
    assess_average,
    effective_draws,
    whiteness,
)
from trimtab.logs.log import Log

BY_POSITION = ("surge_velocity", "sway_velocity", "north", "east", "forward_bias", "starboard_bias")
"""States that are corrected only by position or range measurements."""
BY_HEADING = ("heading", "gyro_bias")
"""States that are corrected directly by heading measurements and, if the vehicle moves, also by position
measurements."""


SETTLED = 1.5
"""Threshold below which a sigma counts as settled, as a multiple of its largest value in the second half of the run."""
LAGS = 20
GROUPS = {
    "heading": ("heading",),
    "yaw rate": ("yaw_rate",),
    "velocity": ("surge_velocity", "sway_velocity"),
    "position": ("north", "east"),
    "gyro bias": ("gyro_bias",),
    "force bias": ("forward_bias", "starboard_bias"),
}
"""Name of a group of states -> fields of a NavigationState. The errors of a group are judged together."""


class AidingUpdates(NamedTuple):
    """Updates of the filter by one aiding sensor.

    t: times of the updates (n,) (s).  nis: NIS of the updates (n,).  normalised_innovations: (n, dof).  refusals:
    number of updates that the gate rejected.  missed_updates: number of updates that are missing in the log, because
    another update followed before the next log row.
    """

    t: Any
    nis: Any
    normalised_innovations: Any
    refusals: int
    missed_updates: int


class Aiding(NamedTuple):
    """Verdict on the measurements of one aiding sensor.

    updates: number of measurements in the log, including rejected ones.  refused: number of rejected measurements.
    unseen: number of measurements that are missing in the log, because another measurement followed before the next log
    row.  nis: verdict on NIS.  white: True if the innovations are white, None if there are too few innovations.  p:
    probability that a white sequence is at least as correlated as the innovations.
    """

    updates: int
    refused: int
    unseen: int
    nis: SingleRunConsistency
    white: bool | None
    p: float | None


class SigmaConvergence(NamedTuple):
    """Convergence of a state's sigma in a run, which shows the state's observability along the trajectory.

    first: sigma at the first valid estimate.  last: largest sigma in the last quarter of the run.  settled_s: time (s)
    from which on sigma stays below 1.5 times its largest value in the second half of the run.  trend: converged,
    converging (still decreasing at the end of the run), unseen (hardly decreased during the run), or growing.
    """

    first: float
    last: float
    settled_s: float
    trend: str


class Navigation(NamedTuple):
    """Consistency of the navigation in a run.

    verdict: verdict on all sensors and states together.  probability: probability that a consistent filter is within
    all bounds.  since_s: time (s) at which the sigmas have settled. Only errors and innovations after this time are
    judged. where: path of the navigation state in the log.  aiding: aiding sensor -> verdict.  errors: group of states
    -> verdict.  learned: state -> convergence of its sigma.
    """

    verdict: str
    probability: float
    since_s: float
    where: str
    aiding: dict[str, Aiding]
    errors: dict[str, SingleRunConsistency]
    learned: dict[str, SigmaConvergence]

    def plain(self) -> dict[str, Any]:
        """Return the result as JSON-compatible dictionaries."""
        aiding = {name: a._asdict() | {"nis": a.nis._asdict()} for name, a in self.aiding.items()}
        rows = {part: {k: v._asdict() for k, v in getattr(self, part).items()} for part in ("errors", "learned")}
        return self._asdict() | {"aiding": aiding} | rows


class Series(NamedTuple):
    """Time series of one state.

    t: times (n,) (s).  estimate: estimate of the state (n,).  error: estimate minus truth (n,), or None if the truth is
    unknown.  sigma: standard deviation of the error according to the filter (n,).
    """

    t: Any
    estimate: Any
    error: Any
    sigma: Any


def assess_navigation(log: Log, probability: float = 0.95) -> Navigation | None:
    """Return the consistency of the navigation in a log, or None if the log contains no innovations or no sigmas.

    Args:
        log: log of a run, with the default signals.
        probability: probability that a consistent filter is within all bounds.
    """
    aids, states = fix_paths(log), state_series(log)
    if not aids or not states:
        return None
    learned = {name: _assess_convergence(s) for name, s in states.items() if len(s.t) > 3}
    known = [n for n in learned if states[n].error is not None] or list(learned)
    since = max((learned[n].settled_s for n in known), default=0.0)
    errors = {
        group: np.stack([_normalised_errors(states[n], since) for n in names], axis=1)
        for group, names in GROUPS.items()
        if all(n in states and states[n].error is not None for n in names)
    }
    errors = {group: z[np.isfinite(z).all(axis=1)] for group, z in errors.items()}
    errors = {group: z for group, z in errors.items() if len(z) > 3}
    came = {name: update for name, path in aids.items() if len((update := find_updates(log, path, since)).nis) > 3}
    tail = (1 - probability) / (2 * max(len(errors) + len(came), 1))
    aiding = {name: _assess_aiding(update, tail) for name, update in came.items()}
    judged = {
        group: assess_average(np.mean(np.sum(z * z, axis=1)), effective_draws(z), z.shape[1], tail)
        for group, z in errors.items()
    }
    verdict = _combine_verdicts([*(a.nis.verdict for a in aiding.values()), *(j.verdict for j in judged.values())])
    return Navigation(verdict, probability, since, state_path(log) or "", aiding, judged, learned)


def state_series(log: Log) -> dict[str, Series]:
    """Return the name of a state -> time series of the state at new estimates, for all states that have a sigma.

    The time series contain errors if the log contains the true state. States without aiding in this run are left out,
    see `unaided_states`. The result is empty if no estimate is valid. An estimate is compared with the truth at the
    time of its newest measurement or, while the filter predicts without measurements, at the time of the log row.
    """
    base = state_path(log)
    if base is None:
        return {}
    valid = flag_signal(log, "estimate.valid", True)
    fresh = valid & flag_signal(log, "estimate.fresh", True)
    rows = fresh if fresh.any() else valid
    alone = unaided_states(log)
    age = log["estimate.age"] if "estimate.age" in log else np.zeros(len(log))
    of = (log.t - np.where(flag_signal(log, f"{base}.coasting", False), 0.0, age))[rows]
    series = {}
    for path in log.paths:
        name = path.rpartition(".")[2].removeprefix("sigma_")
        if path == f"{base}.sigma_{name}" and f"{base}.{name}" in log and name not in alone:
            estimate, error = log[f"{base}.{name}"][rows], None
            if f"truth.{name}" in log:
                error = estimate - np.interp(of, log.t, log[f"truth.{name}"])
                error = np.angle(np.exp(1j * error)) if name == "heading" else error
            series[name] = Series(of, estimate, error, log[path][rows])
    return series


def innovations(log: Log) -> dict[str, tuple[Any, Any, int]]:
    """Return the name of an aiding sensor -> times of the updates (n,) (s), NIS (n,), and degrees of freedom.

    With ranging sensors, each single range is an update.
    """
    updates = {name: find_updates(log, path, -np.inf) for name, path in fix_paths(log).items()}
    return {name: (u.t, u.nis, u.normalised_innovations.shape[1]) for name, u in updates.items() if len(u.nis)}


def state_path(log: Log) -> str | None:
    """Return the path of the navigation state with sigmas in a log, or None if the log contains no such state."""
    sigmas = (p for p in log.paths if p.startswith("estimate.") and p.endswith(".sigma_heading"))
    return next((p.rpartition(".")[0] for p in sigmas), None)


def fix_paths(log: Log) -> dict[str, str]:
    """Return the name of an aiding sensor -> path of its statistics in the log.

    The name is "range" for statistics in which each single range is an update.
    """
    ends = ("nis", "normalised", "used", "rejected")
    fixes = [p[:-4] for p in log.paths if p.startswith("estimate.") and p.endswith(".nis")]
    whole = [p for p in fixes if all(f"{p}.{end}" in log for end in ends)]
    return {"range" if log[f"{p}.nis"].ndim > 1 else p.rpartition(".")[2].removesuffix("_fix"): p for p in whole}


def flag_signal(log: Log, path: str, otherwise: bool) -> Any:
    """Return a signal as booleans (rows,). If the log lacks the signal, all values are `otherwise`."""
    return log[path].astype(bool) if path in log else np.full(len(log), otherwise)


def unaided_states(log: Log) -> frozenset[str]:
    """Return the states that no measurement corrected, although the estimate was valid.

    Without a position sensor, the error of the position grows. The result is empty for a run without a valid estimate,
    because an expected sensor may have failed there.
    """
    base = state_path(log)
    if not flag_signal(log, "estimate.valid", True).any():
        return frozenset()
    counts = {n: f"{base}.{n}_fix.used" for n in ("position", "heading") if f"{base}.{n}_fix.used" in log}
    never = {n for n, path in counts.items() if not log[path].any()}
    alone = BY_POSITION if "position" in never else ()
    return frozenset((*alone, *BY_HEADING) if never and never == set(counts) else alone)


def find_updates(log: Log, path: str, since: float) -> AidingUpdates:
    """Return the updates by a sensor, at the rows in which its number of used or rejected measurements increases.

    path: path of the sensor's statistics.  since: time (s) before which updates are left out.
    """
    refused = log[f"{path}.rejected"].astype(np.int64)
    more = np.diff(log[f"{path}.used"].astype(np.int64) + refused, prepend=0)
    new, nis = np.diff(refused, prepend=0), log[f"{path}.nis"]
    rows = (more > 0) & (log.t >= since)
    if nis.ndim > 1:
        return _find_range_updates(log, path, rows, more, new)
    rows &= np.isfinite(nis)
    values = log[f"{path}.normalised"][rows]
    values = values[:, None] if values.ndim == 1 else values
    return AidingUpdates(log.t[rows], nis[rows], values, int(new[rows].sum()), int((more[rows] - 1).sum()))


def _find_range_updates(log: Log, path: str, rows: Any, more: Any, new: Any) -> AidingUpdates:
    """Return the updates by single ranges. Each predicted range is an update with one degree of freedom.

    A range is not predicted if it disagrees with the other ranges, or if the filter has not started. The row then
    repeats the last innovations, so it is left out.
    """
    nis, ran = log[f"{path}.nis"], flag_signal(log, f"{path}.tracking", True)
    rows = rows & np.append(ran[:1], ran[:-1])
    came = rows[:, None] & np.isfinite(nis) & (log[f"{path}.innovation"] != 0)
    refusals = np.diff(log[f"{path}.beacon_rejected_in_a_row"].astype(np.int64), axis=0, prepend=0) > 0
    shown = np.sum(came | log[f"{path}.accepted"].astype(bool) | refusals, axis=1)
    unseen = int(np.maximum(more - shown, 0)[rows].sum())
    t = np.broadcast_to(log.t[:, None], nis.shape)
    return AidingUpdates(t[came], nis[came], log[f"{path}.normalised"][came][:, None], int(new[rows].sum()), unseen)


def _assess_aiding(u: AidingUpdates, tail: float) -> Aiding:
    z = u.normalised_innovations
    dof = z.shape[1]
    draws = np.mean(effective_draws(z)) * np.ones(dof)
    nis = assess_average(float(np.mean(u.nis)), draws, dof, tail)
    white, p = None, None
    if len(u.nis) > 3 * LAGS and z.any():
        test = whiteness(z, LAGS, 1 - 2 * tail)
        white, p = test.white, test.p
    return Aiding(len(u.nis), u.refusals, u.missed_updates, nis, white, p)


def _normalised_errors(s: Series, since: float) -> Any:
    """Return the errors divided by the sigmas. The result is NaN where an error is not finite or a sigma is 0."""
    ok = (s.t >= since) & np.isfinite(s.error) & (s.sigma > 0)
    return np.where(ok, s.error / np.where(s.sigma > 0, s.sigma, 1.0), np.nan)[s.t >= since]


def _assess_convergence(s: Series) -> SigmaConvergence:
    n = len(s.t)
    late, third = np.max(s.sigma[3 * n // 4 :]), np.max(s.sigma[n // 2 : 3 * n // 4])
    above = np.flatnonzero(~(s.sigma <= SETTLED * np.max(s.sigma[n // 2 :])))
    settled = s.t[min(above[-1] + 1, n - 1) if len(above) else 0]
    first = s.sigma[0]
    trend = "growing" if late > 1.1 * third else "converging" if late < 0.9 * third else "converged"
    trend = "unseen" if trend == "converged" and late > 0.8 * first else trend
    return SigmaConvergence(float(first), float(late), float(settled), trend)


def _combine_verdicts(verdicts: list[str]) -> str:
    """Return a common verdict: the first of optimistic, pessimistic, consistent that occurs in the verdicts.

    Return undecided if none of these occurs.
    """
    return next((v for v in (OPTIMISTIC, PESSIMISTIC, CONSISTENT) if v in verdicts), UNDECIDED)
