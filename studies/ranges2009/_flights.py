"""The filters stepped over the logs, their errors over the truth, and gtsam's batch solution."""

import functools
import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from studies.ranges2009._data import read_plaza, written_log
from studies.ranges2009._filters import lagged_filter, particle_filter, tight_filter
from trimtab.logs.consistency import SingleRunConsistency, assess_average, effective_draws
from trimtab.logs.log import Log
from trimtab.run.replay_estimator import replay_estimator

BATCH = Path(__file__).parent / "batch.json"
FILTERS = {"tight": tight_filter, "particle": particle_filter, "lagged": lagged_filter}
CAUSAL = ("tight", "particle")
"""Filters whose estimate is of now."""
TAIL = 0.025
"""Probability on each side of a band of 95 %."""


class Flight(NamedTuple):
    """A filter's run over a log, at the instants of the truth where it was valid.

    log: all of it.  rows: of the truth (n,), at which it came.  t: that it is of, s (n,).
    place: north, east (n, 2).  error: over the truth of t (n, 2).  P: its covariance (n, 2, 2).
    """

    log: Log
    rows: Any
    t: Any
    place: Any
    error: Any
    P: Any

    @property
    def rms(self) -> float:
        """Return the horizontal error (m)."""
        return float(np.sqrt(np.mean(np.sum(self.error**2, axis=1))))

    @property
    def sigma(self) -> float:
        """Return the filter's own standard deviation (m)."""
        return float(np.sqrt(np.mean(np.trace(self.P, axis1=1, axis2=2))))

    @property
    def normalised(self) -> Any:
        """Return the errors in sigmas, independent of each other if the filter is consistent (n, 2)."""
        half = np.linalg.cholesky(self.P)
        return np.linalg.solve(half, self.error[:, :, None])[:, :, 0]

    def consistency(self) -> SingleRunConsistency:
        """Return the average NEES and its band of 95 %, for the effective number of draws of the run."""
        z = self.normalised
        return assess_average(float(np.mean(np.sum(z * z, axis=1))), effective_draws(z), 2, TAIL)


@functools.cache
def fly(name: str, kind: str) -> Flight:
    """Run a filter, one of FILTERS, over a log, through its file."""
    with tempfile.TemporaryDirectory() as folder:
        log = replay_estimator(written_log(name, Path(folder)), FILTERS[kind](name), seed=1)
    of_truth = log["downlink.odometry.fresh"]
    rows = of_truth & log["estimate.valid"]
    t, p = (log.t - log["estimate.age"])[rows], read_plaza(name)
    place = np.stack([log["estimate.state.north"][rows], log["estimate.state.east"][rows]], axis=1)
    truth = np.stack([np.interp(t, p.t, p.north), np.interp(t, p.t, p.east)], axis=1)
    a, b, c = (log[f"estimate.state.{x}"] for x in ("sigma_north", "covariance_north_east", "sigma_east"))
    P = np.stack([np.stack([a * a, b], axis=1), np.stack([b, c * c], axis=1)], axis=1)
    return Flight(log, np.flatnonzero(rows[of_truth]), t, place, place - truth, P[rows])


@functools.cache
def read_batch() -> Mapping[str, Any]:
    """Return gtsam's solutions, from tests/oracles/ranges2009.py."""
    return json.loads(BATCH.read_text(encoding="utf-8"))


class CausalComparison(NamedTuple):
    """A filter beside batch solutions of all that had come by the same instants.

    filter_rms, batch_rms: over the truth (m).  difference: rms of one from the other (m).
    """

    filter_rms: float
    batch_rms: float
    difference: float


def compare_causal(name: str, flight: Flight) -> CausalComparison:
    """Evaluate at the ends of the batch solutions. Errors are NaN if the filter was not valid at one of them."""
    p, table = read_plaza(name), np.asarray(read_batch()[name]["causal"])
    rows, batch = table[:, 0].astype(int), table[:, 1:]
    truth = np.stack([p.north, p.east], axis=1)[rows]
    at = np.clip(np.searchsorted(flight.rows, rows), 0, len(flight.rows) - 1)
    own = np.where((flight.rows[at] == rows)[:, None], flight.place[at], np.nan)

    def rms(away: Any) -> float:
        return float(np.sqrt(np.mean(np.sum(away**2, axis=1))))

    return CausalComparison(rms(own - truth), rms(batch - truth), rms(own - batch))
