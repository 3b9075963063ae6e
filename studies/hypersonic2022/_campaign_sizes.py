"""Campaigns by the size of the parameter errors: flights of one size, and their share of success."""

from functools import cache

import numpy as np

from studies.hypersonic2022._campaign import KINDS, FlightOutcomes, draw_factors, fly_plants
from trimtab.analysis.campaign.statistics.intervals import Proportion, proportion
from trimtab.estimators.flexible.discrete import EQUAL_Q

SIZES = (0.05, 0.10, 0.15, 0.20, 0.25, 0.30)
EACH = 100
"""Number of runs for each size and disturbance."""
RANKED = {True: 0.30, False: 0.10}
"""Integral action on or off -> size of the errors at which coefficients are ranked, where success is least certain."""
SEED = 1000


@cache
def fly_size(size: float, integral: bool, each: int = EACH, Q: tuple[float, ...] = EQUAL_Q) -> FlightOutcomes:
    """Return the flights with parameter errors of this size, `each` per disturbance.

    All laws and filters get equal plants and noise.
    """
    first = SEED + round(1000 * size)
    factors = np.concatenate([draw_factors(size, each, first + 10_000 * k) for k in range(len(KINDS))])
    return fly_plants(factors, np.repeat(np.arange(len(KINDS)), each), integral=integral, Q=Q)


def success_proportion(found: FlightOutcomes) -> Proportion:
    """Return the share of successful flights among the plants that have a trim."""
    fair = ~found.lacks_trim
    return proportion(int((found.is_success & fair).sum()), int(fair.sum()))
