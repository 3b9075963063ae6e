"""Screening of many factors with few runs, by elementary effects along the trajectories of a Morris design.

An elementary effect is the change of a metric when a trajectory changes one factor, divided by the step of the factor.
The step is measured in the factor's probability, scaled so that 0 is the 5 % quantile and 1 the 95 % quantile. Over r
trajectories

    mu = mean of the effects    mu* = mean of their absolute values    sigma = standard deviation of the effects

A large mu* shows that a factor matters. A sigma near or above mu* shows a non-linear effect or an interaction with
other factors.

The random numbers of a run are an additional factor, the last one. Their effect is divided by 1/3, the mean distance of
two independent draws of a uniform factor, so that noise is comparable to a factor with the same spread. The sign of
this effect has no meaning, so its mu is about 0.

Source: [1] Morris, "Factorial sampling plans for preliminary computational experiments", Technometrics 33 (1991); mu*:
[2] Campolongo, Cariboni, Saltelli, "An effective screening design for sensitivity analysis of large models", Environ.
Model. Softw. 22 (2007); interval of sigma: [3] Miller, "Jackknifing variances", Ann. Math. Statist. 39 (1968).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from trimtab.analysis.campaign.sampling.points import (
    MORRIS_STEP,
    NOISE,
    check_factors,
    morris_trajectories,
    rows_per_trajectory,
)
from trimtab.analysis.campaign.statistics.intervals import as_column, check_level
from trimtab.analysis.campaign.statistics.sensitivity import explain_no_variance, rank_values
from trimtab.core.errors import InputError

NOISE_STEP = 1 / 3
TRAJECTORIES_MIN = 4
"""Minimum number of trajectories for an estimate of sigma."""


class Morris(NamedTuple):
    """Elementary effects of each factor. Arrays have shape (factors,), and are NaN if the effects cannot be computed.

    factors: names of the factors. The noise, if it is a factor, is the last.  mu, mu_star, sigma: statistics of the
    effects in the metric's unit, for a change over the factor's whole range.  *_low, *_high: limits of the confidence
    intervals.  trajectories: number of trajectories used.  rows: number of runs in these trajectories.  note: reason if
    the effects are missing, otherwise empty.
    """

    factors: tuple[str, ...]
    mu: Any
    mu_low: Any
    mu_high: Any
    mu_star: Any
    mu_star_low: Any
    mu_star_high: Any
    sigma: Any
    sigma_low: Any
    sigma_high: Any
    trajectories: int
    rows: int
    level: float
    note: str

    @property
    def order(self) -> tuple[str, ...]:
        """Return the names of the factors, sorted by mu*, the largest first."""
        return tuple(self.factors[i] for i in np.argsort(-self.mu_star, kind="stable"))


def morris(
    values: Any,
    seed: int,
    parameters: Sequence[str],
    *,
    noise: bool = True,
    level: float = 0.95,
    by_rank: bool = False,
) -> Morris:
    """Compute elementary effects of a metric over the rows of `morris_rows(seed, 0, rows, len(parameters))`.

    Args:
        values: metric of rows 0 to n - 1, shape (n,). Only complete trajectories are used.
        seed: seed of the design, which determines the factor that changes in each row.
        parameters: names of the parameters, in the order of the design's columns, without the noise.
        noise: True if the random numbers of the runs are a factor of the design.
        level: confidence of the intervals.
        by_rank: True to use the metric's rank among these rows. Runs without a finite value then have the highest
            ranks.
    """
    check_factors(parameters)
    check_level("morris", level)
    size = rows_per_trajectory(len(parameters), noise=noise)
    x = as_column(values, "morris")
    count = len(x) // size
    if count < TRAJECTORIES_MIN:
        fix = f"fly at least {TRAJECTORIES_MIN * size} runs; 20 trajectories are {20 * size} runs"
        raise InputError("morris", f"got {len(x)} rows, i.e. {count} trajectories of {size} rows", fix=fix)
    x = x[: count * size]
    names = (*parameters, NOISE) if noise else tuple(parameters)
    x, note = rank_values(x) if by_rank else (x, explain_no_variance(x))
    if note:
        v = np.full(len(names), np.nan)
        return Morris(names, v, v, v, v, v, v, v, v, v, count, count * size, level, note)
    effects = _elementary_effects(x.reshape(count, size), seed, len(parameters), noise)
    mu, size_of = _mean_interval(effects, level), _mean_interval(np.abs(effects), level)
    return Morris(names, *mu, *size_of, *_deviation_interval(effects, level), count, count * size, level, "")


def _elementary_effects(table: Any, seed: int, parameters: int, noise: bool) -> Any:
    """Return elementary effects, shape (trajectories, factors)."""
    _, when, up = morris_trajectories(seed, np.arange(len(table)), parameters + int(noise))
    change = np.take_along_axis(np.diff(table, axis=1), when, axis=1)
    step = np.where(up, MORRIS_STEP, -MORRIS_STEP)
    if noise:
        step[:, -1] = NOISE_STEP
    return change / step


def _mean_interval(x: Any, level: float) -> tuple[Any, Any, Any]:
    """Return the mean of each column, i.e. factor, and the lower and upper bounds of Student's interval."""
    width = stats.t.ppf((1 + level) / 2, len(x) - 1) * x.std(axis=0, ddof=1) / np.sqrt(len(x))
    return x.mean(axis=0), x.mean(axis=0) - width, x.mean(axis=0) + width


def _deviation_interval(x: Any, level: float) -> tuple[Any, Any, Any]:
    """Return the standard deviation of each column, i.e. factor, with an interval by jackknife of the log variance."""
    n = len(x)
    apart = (x - x.mean(axis=0)) ** 2
    whole = apart.sum(axis=0) / (n - 1)
    without = (apart.sum(axis=0) - apart * n / (n - 1)) / (n - 2)
    certain = whole <= 1e-20 * np.square(x).mean(axis=0)  # a linear factor: the scatter is only rounding
    log = np.log(np.where(certain, 1.0, np.maximum(without, 1e-12 * whole)))
    pseudo = n * np.log(np.where(certain, 1.0, whole)) - (n - 1) * log
    _, low, high = _mean_interval(pseudo, level)
    low, high = (np.where(certain, 0.0, np.exp(np.minimum(v, 700) / 2)) for v in (low, high))
    sigma = np.sqrt(whole)
    return sigma, np.minimum(low, sigma), np.maximum(high, sigma)
