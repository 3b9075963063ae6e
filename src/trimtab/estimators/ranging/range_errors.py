"""Error model of the ranges in a tightly coupled filter, and statistics of the range updates.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, option, quantity, record, replace

FORGIVENESS_FACTOR = 5
"""Number of consecutive agreeing ranges, as a multiple of the patience, after which a moved beacon is trusted again."""


@record
class RangeErrorModel:
    """Errors of ranges: white noise, a scale error of all ranges, and a constant error of each beacon.

        measured = (1 + scale) h(place) + error of the beacon + noise

    The scale error, caused by a wrong speed of sound, is estimated: 5 K cause 2.4 cm in 2.7 m, six times the noise. A
    beacon's survey error is considered, not estimated. A survey error can't be distinguished from a displacement of the
    vehicle, so a filter that averages survey errors is overconfident. For a beacon that was found moved, the range
    error is considered with the standard deviation `moved`. The ranges of this beacon then have almost no weight, until
    they have agreed with the survey for a long time. The range error of a moved beacon changes with the vehicle's
    position. A constant fitted to this error made the filter overconfident (NEES of 12 to 20 instead of 8, docs page).

    Source: [1] section 5.5; Schmidt 1966; values for the simulated network, docs page, Tightly coupled ranging.
    """

    noise: Scalar = quantity("m", "Standard deviation of a range's white noise.", default=0.004, above=0)
    scale: Scalar = quantity("1", "Standard deviation of the scale error: 0.0017 per kelvin.", default=0.003, low=0)
    scale_walk: Scalar = quantity("1/sqrt(s)", "Random walk of the ranges' scale error.", default=1e-5, low=0)
    survey: Scalar = quantity(
        "m", "Standard deviation of a beacon's survey error along the range.", default=0.005, low=0
    )
    moved: Scalar = quantity(
        "m", "Standard deviation of the range error of a beacon that was found moved.", default=1.0, above=0
    )
    gate: Scalar = quantity("1", "NIS gate for single ranges.", default=15.137, above=0)
    patience: Scalar = quantity(
        "1",
        "Number of consecutive rejections after which a beacon counts as moved, or the filter as lost; 0 for never.",
        default=8,
        kind="count",
    )
    wide: Scalar = quantity(
        "m",
        "Standard deviation of the position above which the ranges of a ping must agree with each other.",
        default=0.1,
        above=0,
    )
    residual: Scalar = quantity(
        "m", "Largest residual at which ranges count as agreeing with each other.", default=0.05, above=0
    )
    survey_errors: str = option(
        "Treatment of the beacons' survey errors: consider, estimate, or ignore them (overconfident).",
        default="consider",
        choices=("consider", "estimate", "ignore"),
    )
    second_order: bool = option(
        "True to include the curvature of a range, which matters while the position is uncertain.",
        default=True,
        choices=(True, False),
    )

    def variances(self, n: int) -> Any:
        """Return the initial variances of the scale error and of each beacon's error (1 + n,)."""
        survey = 0.0 if self.survey_errors == "ignore" else self.survey
        return jnp.concatenate([jnp.ones(1) * self.scale, jnp.ones(n) * survey]) ** 2


@record
class RangeFix:
    """Statistics of the range updates at the newest ping. Arrays have one entry for each beacon.

    Source: docs page, Tightly coupled ranging.
    """

    innovation: Any = quantity(
        "m", "Innovation of each beacon's range, measured minus predicted; 0 if no range arrived."
    )
    normalised: Any = quantity("1", "Range innovations divided by their standard deviations.")
    nis: Any = quantity("1", "NIS of each beacon's range.")
    accepted: Any = quantity("1", "True for each beacon whose range was used.", kind="flag")
    beacon_rejected_in_a_row: Any = quantity(
        "1", "Number of ranges of each beacon rejected since its last accepted range.", kind="count"
    )
    moved: Any = quantity("1", "True for each beacon found to have moved from its surveyed position.", kind="flag")
    error: Any = quantity("m", "Estimated error of each beacon's ranges.")
    sigma_error: Any = quantity("m", "Standard deviation of the range error of each beacon.")
    scale: Scalar = quantity("1", "Scale error common to all ranges, positive if they are too long.")
    sigma_scale: Scalar = quantity("1", "Standard deviation of the ranges' scale error.")
    unit: Scalar = quantity("1", "Index of the vehicle's ultrasonic unit that sent the ping.", kind="count")
    used: Scalar = quantity("1", "Number of ranges used so far.", kind="count")
    rejected: Scalar = quantity("1", "Number of ranges rejected so far.", kind="count")
    invalid: Scalar = quantity("1", "Number of received ranges that were not positive numbers.", kind="count")
    agreed_in_a_row: Any = quantity(
        "1", "Number of consecutive ranges of a moved beacon that agreed with its surveyed position.", kind="count"
    )
    rejected_pings_in_a_row: Scalar = quantity(
        "1", "Number of consecutive pings in which most ranges were rejected.", kind="count"
    )
    tracking: Scalar = quantity(
        "1", "True while the filter runs; False while it collects pings for a start.", kind="flag"
    )
    starts: Scalar = quantity("1", "Number of times the filter has started.", kind="count")


def no_range_fix(n: int) -> RangeFix:
    """Return the initial statistics for n beacons."""
    zero, none, no, o, one = np.zeros(n), np.zeros(n, np.int32), np.zeros(n, bool), np.float64(0), np.int32(0)
    return RangeFix(
        zero, zero, zero, no, none, no, zero, zero, o, o, one, one, one, one, none, one, np.bool_(False), one
    )


def count_ranges(fix: RangeFix, replies: Any, correction: Any, errors: RangeErrorModel) -> RangeFix:
    """Return the statistics after one more ping.

    replies: True for each range that arrived (n,).  correction: RangeUpdate of the ping.
    """
    refused = replies & ~correction.accepted
    sigma = jnp.sqrt(jnp.maximum(correction.variance, 1e-300))
    in_a_row = jnp.where(correction.accepted, 0, jnp.minimum(fix.beacon_rejected_in_a_row + refused, 2**30))
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
        beacon_rejected_in_a_row=in_a_row.astype(np.int32),
        agreed_in_a_row=agreed.astype(np.int32),
        used=(fix.used + jnp.sum(correction.accepted)).astype(np.int32),
        rejected=(fix.rejected + jnp.sum(refused)).astype(np.int32),
        rejected_pings_in_a_row=jnp.where(
            some, jnp.where(mostly, fix.rejected_pings_in_a_row + 1, 0), fix.rejected_pings_in_a_row
        ).astype(np.int32),
    )


def diagnose_beacons(fix: RangeFix, errors: RangeErrorModel) -> tuple[Any, Any, Any]:
    """Return flags of beacons newly found moved (n,) and of beacons trusted again (n,), and True if the filter is lost.

    A beacon has moved if its ranges are rejected repeatedly while those of other beacons are accepted. The filter is
    lost if most ranges are rejected for a long time, or if at least half of the beacons are rejected repeatedly.
    """
    asks = jnp.asarray(errors.patience) > 0
    long = fix.beacon_rejected_in_a_row >= errors.patience
    several = 2 * jnp.sum(2 * fix.beacon_rejected_in_a_row >= errors.patience) >= fix.accepted.shape[0]
    lost = asks & ((fix.rejected_pings_in_a_row >= errors.patience) | (jnp.any(long) & several))
    forgiven = fix.moved & (fix.agreed_in_a_row >= FORGIVENESS_FACTOR * errors.patience)
    return asks & long & ~several & ~fix.moved, forgiven, lost
