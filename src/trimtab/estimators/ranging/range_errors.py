"""Error model of the ranges in a tightly coupled filter, and statistics of the range updates.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, option, quantity, record, replace

FORGIVENESS_FACTOR = 5
"""Multiple of the patience during which a moved beacon has to agree with its survey before it is trusted again."""


@record
class RangeErrorModel:
    """Errors of ranges: white noise, one scale for all, and a constant of each beacon.

        measured = (1 + scale) h(place) + error of the beacon + noise

    The scale, due to a wrong speed of sound, is estimated: 5 K are 2.4 cm in 2.7 m, six times the noise. A beacon's
    survey error is considered: it can't be distinguished from a displaced vehicle, so a filter that averages it away
    is overconfident. The error of a beacon that was found moved is considered with `moved`, which leaves its ranges
    almost no weight, until it agrees with its survey for long. That error changes with the place, so a constant fitted
    to it made the filter overconfident (NEES 12 to 20 of 8, docs page).

    Source: [1] section 5.5; Schmidt 1966; figures as of the simulated network, docs page.
    """

    noise: Scalar = quantity("m", "White noise of a range.", default=0.004, above=0)
    scale: Scalar = quantity("1", "Standard deviation of the scale: 0.0017 for each kelvin.", default=0.003, low=0)
    scale_walk: Scalar = quantity("1/sqrt(s)", "Random walk of the scale.", default=1e-5, low=0)
    survey: Scalar = quantity(
        "m", "Standard deviation of a beacon's survey error along the range.", default=0.005, low=0
    )
    moved: Scalar = quantity(
        "m", "Standard deviation of the error of a beacon that was found moved.", default=1.0, above=0
    )
    gate: Scalar = quantity("1", "NIS gate for ranges.", default=15.137, above=0)
    patience: Scalar = quantity(
        "1",
        "Number of consecutive rejections after which a beacon, or the filter, is doubted; 0: never.",
        default=8,
        kind="count",
    )
    wide: Scalar = quantity(
        "m", "Position sigma above which ranges must first agree with each other.", default=0.1, above=0
    )
    residual: Scalar = quantity(
        "m", "Largest residual at which ranges count as agreeing with each other.", default=0.05, above=0
    )
    survey_errors: str = option(
        "Treatment of the beacons' errors: considered, estimated, or ignored (overconfident).",
        default="consider",
        choices=("consider", "estimate", "ignore"),
    )
    second_order: bool = option(
        "True to include the range's curvature, which matters while the position is uncertain.",
        default=True,
        choices=(True, False),
    )

    def variances(self, n: int) -> Any:
        """Return the initial variances of scale and beacons' errors (1 + n,)."""
        survey = 0.0 if self.survey_errors == "ignore" else self.survey
        return jnp.concatenate([jnp.ones(1) * self.scale, jnp.ones(n) * survey]) ** 2


@record
class RangeFix:
    """Statistics of the newest ping's range updates, in order of measurement; arrays have one entry per beacon.

    Source: docs page, Tightly coupled ranging.
    """

    innovation: Any = quantity("m", "Innovations: measured minus predicted; 0 where no range arrived.")
    normalised: Any = quantity("1", "Innovations divided by their standard deviations.")
    nis: Any = quantity("1", "NIS of each range.")
    accepted: Any = quantity("1", "True for each range that was used.", kind="flag")
    refused_in_a_row: Any = quantity(
        "1", "Number of ranges of each beacon rejected since its last accepted range.", kind="count"
    )
    moved: Any = quantity("1", "True for each beacon found away from its surveyed position.", kind="flag")
    error: Any = quantity("m", "Estimated error of each beacon's ranges.")
    sigma_error: Any = quantity("m", "Standard deviation of the range error of each beacon.")
    scale: Scalar = quantity("1", "Scale error common to all ranges; positive when they are too long.")
    sigma_scale: Scalar = quantity("1", "Standard deviation of the scale error.")
    unit: Scalar = quantity("1", "Index of the unit that pinged.", kind="count")
    used: Scalar = quantity("1", "Number of ranges used so far.", kind="count")
    rejected: Scalar = quantity("1", "Number of ranges rejected so far.", kind="count")
    invalid: Scalar = quantity("1", "Number of received ranges that were not positive numbers.", kind="count")
    agreed_in_a_row: Any = quantity(
        "1", "Number of consecutive ranges of a moved beacon that agreed with its surveyed position.", kind="count"
    )
    mostly_refused: Scalar = quantity(
        "1", "Number of consecutive pings in which most ranges were rejected.", kind="count"
    )
    tracking: Scalar = quantity("1", "True while the filter runs; otherwise it waits for a start.", kind="flag")
    starts: Scalar = quantity("1", "Number of starts of the filter.", kind="count")


def no_range_fix(n: int) -> RangeFix:
    """Return the initial value for n beacons."""
    zero, none, no, o, one = np.zeros(n), np.zeros(n, np.int32), np.zeros(n, bool), np.float64(0), np.int32(0)
    return RangeFix(
        zero, zero, zero, no, none, no, zero, zero, o, o, one, one, one, one, none, one, np.bool_(False), one
    )


def count_ranges(fix: RangeFix, replies: Any, correction: Any, errors: RangeErrorModel) -> RangeFix:
    """Return the statistics after one more ping: replies (n,), which ranges came, and the RangeUpdate."""
    refused = replies & ~correction.accepted
    sigma = jnp.sqrt(jnp.maximum(correction.variance, 1e-300))
    in_a_row = jnp.where(correction.accepted, 0, jnp.minimum(fix.refused_in_a_row + refused, 2**30))
    surveyed = jnp.maximum(correction.variance - errors.moved**2, errors.noise**2)
    fits = correction.innovation**2 <= errors.gate * surveyed
    agreed = jnp.where(replies & fix.moved, jnp.where(fits, fix.agreed_in_a_row + 1, 0), fix.agreed_in_a_row)
    counts = replies & ~fix.moved
    mostly = 2 * jnp.sum(refused & counts) > jnp.sum(counts)
    some = jnp.any(counts)
    return replace(
        fix,
        innovation=correction.innovation,
        normalised=correction.innovation / sigma,
        nis=correction.nis,
        accepted=correction.accepted,
        refused_in_a_row=in_a_row.astype(np.int32),
        agreed_in_a_row=agreed.astype(np.int32),
        used=(fix.used + jnp.sum(correction.accepted)).astype(np.int32),
        rejected=(fix.rejected + jnp.sum(refused)).astype(np.int32),
        mostly_refused=jnp.where(some, jnp.where(mostly, fix.mostly_refused + 1, 0), fix.mostly_refused).astype(
            np.int32
        ),
    )


def diagnose_beacons(fix: RangeFix, errors: RangeErrorModel) -> tuple[Any, Any, Any]:
    """Return which beacons (n,) are now found moved, which are trusted again, and whether the filter itself is lost.

    A beacon whose ranges are rejected repeatedly while the others are accepted has moved. If most beacons contradict
    the filter, or several do for long, the filter itself is wrong.
    """
    asks = jnp.asarray(errors.patience) > 0
    long = fix.refused_in_a_row >= errors.patience
    several = 2 * jnp.sum(2 * fix.refused_in_a_row >= errors.patience) >= fix.accepted.shape[0]
    lost = asks & ((fix.mostly_refused >= errors.patience) | (jnp.any(long) & several))
    forgiven = fix.moved & (fix.agreed_in_a_row >= FORGIVENESS_FACTOR * errors.patience)
    return asks & long & ~several & ~fix.moved, forgiven, lost
