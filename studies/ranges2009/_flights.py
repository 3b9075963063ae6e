"""Runs of the filters on the logs, with their errors, and gtsam's batch solution."""

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
"""Filters that estimate the present position."""
TAIL = 0.025
"""Probability beyond each side of a 95 % band."""


class Flight(NamedTuple):
    """Run of a filter on a log, at those instants of the truth where its estimate was valid.

    log: complete log of the run.  rows: indices of the truth at which an estimate came (n,).
    t: time for which each estimate is valid, s (n,).  place: north, east (n, 2).
    error: estimate minus truth at t (n, 2).  P: covariance of the position (n, 2, 2).
    """

    log: Log
    rows: Any
    t: Any
    place: Any
    error: Any
    P: Any

    @property
    def rms(self) -> float:
        """Return the rms of the horizontal error (m)."""
        return float(np.sqrt(np.mean(np.sum(self.error**2, axis=1))))

    @property
    def sigma(self) -> float:
        """Return the rms of the filter's own horizontal standard deviation (m)."""
        return float(np.sqrt(np.mean(np.trace(self.P, axis1=1, axis2=2))))

    @property
    def normalised(self) -> Any:
        """Return the normalised errors (n, 2), uncorrelated with unit variance if the filter is consistent."""
        half = np.linalg.cholesky(self.P)
        return np.linalg.solve(half, self.error[:, :, None])[:, :, 0]

    def consistency(self) -> SingleRunConsistency:
        """Return the average NEES and its band of 95 %, for the effective number of draws of the run."""
        z = self.normalised
        return assess_average(float(np.mean(np.sum(z * z, axis=1))), effective_draws(z), 2, TAIL)


@functools.cache
def fly(name: str, kind: str) -> Flight:
    """Run a filter, one of FILTERS, on a log that is written to a file and read back."""
    with tempfile.TemporaryDirectory() as folder:
        log = replay_estimator(written_log(name, Path(folder)), FILTERS[kind](name), seed=1)
    of_truth = log["downlink.odometry.fresh"]
    rows = of_truth & np.maximum.accumulate(log["estimate.valid"])  # a filter may doubt itself later, and is judged
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
    """Comparison of a filter with batch solutions from all data up to the same instants.

    filter_rms, batch_rms: rms errors (m).  difference: rms difference of the filter from the batch (m).
    """

    filter_rms: float
    batch_rms: float
    difference: float


def compare_causal(name: str, flight: Flight) -> CausalComparison:
    """Compare a filter with the ends of the batch solutions.

    Errors are NaN if the filter was invalid at any of them.
    """
    p, table = read_plaza(name), np.asarray(read_batch()[name]["causal"])
    rows, batch = table[:, 0].astype(int), table[:, 1:]
    truth = np.stack([p.north, p.east], axis=1)[rows]
    at = np.clip(np.searchsorted(flight.rows, rows), 0, len(flight.rows) - 1)
    own = np.where((flight.rows[at] == rows)[:, None], flight.place[at], np.nan)

    def rms(away: Any) -> float:
        return float(np.sqrt(np.mean(np.sum(away**2, axis=1))))

    return CausalComparison(rms(own - truth), rms(batch - truth), rms(own - batch))
