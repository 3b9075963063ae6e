"""What a tightly coupled filter believes of its ranges' errors, and how the ranges fared.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, option, quantity, record, replace

FORGIVENESS_FACTOR = 5
"""Times the patience that a moved beacon has to agree with its survey, until it is believed again."""


@record
class RangeErrorModel:
    """Errors of ranges: white noise, one scale for all, and a constant of each beacon.

        measured = (1 + scale) h(place) + error of the beacon + noise

    The scale, of a speed of sound taken wrongly, is estimated: it pays, as 5 K are 2.4 cm in 2.7 m, six times the
    noise. A beacon's error, of its survey, is considered: it can't be told from a vehicle elsewhere, so that a filter
    which averages it away is too sure. The error of a beacon that was found moved is considered with `moved`, which
    leaves its ranges next to no weight, until it agrees with its survey for long: that error changes with the place, so
    that a constant fitted to it made the filter too sure (NEES 12 to 20 of 8, docs page).

    Source: [1] section 5.5; Schmidt 1966; figures as of the simulated network, docs page.
    """

    noise: Scalar = quantity("m", "White noise.", default=0.004, above=0)
    scale: Scalar = quantity("1", "Of the scale: 0.0017 for each kelvin.", default=0.003, low=0)
    scale_walk: Scalar = quantity("1/sqrt(s)", "How it wanders.", default=1e-5, low=0)
    survey: Scalar = quantity("m", "Of a beacon's error along the range.", default=0.005, low=0)
    moved: Scalar = quantity("m", "Of the error of a beacon that was found moved.", default=1.0, above=0)
    gate: Scalar = quantity("1", "NIS gate for ranges.", default=15.137, above=0)
    patience: Scalar = quantity(
        "1", "Refusals in a row after which a beacon, or all, are doubted; 0: never.", default=8, kind="count"
    )
    wide: Scalar = quantity(
        "m", "With a position less sure than this, ranges must agree with each other first.", default=0.1, above=0
    )
    residual: Scalar = quantity("m", "How far they may disagree then.", default=0.05, above=0)
    survey_errors: str = option(
        "Beacons' errors are considered, estimated, or ignored: the filter then is too sure.",
        default="consider",
        choices=("consider", "estimate", "ignore"),
    )
    second_order: bool = option(
        "Whether the range's curvature counts, which matters while the filter is unsure.",
        default=True,
        choices=(True, False),
    )

    def variances(self, n: int) -> Any:
        """Of scale and beacons' errors (1 + n,)."""
        survey = 0.0 if self.survey_errors == "ignore" else self.survey
        return jnp.concatenate([jnp.ones(1) * self.scale, jnp.ones(n) * survey]) ** 2


@record
class RangeFix:
    """How ranges fared at the newest ping, in order of measurement; arrays have one entry for each beacon.

    Source: docs page, Tightly coupled ranging.
    """

    innovation: Any = quantity("m", "Innovations: measured minus predicted; 0 where no range arrived.")
    normalised: Any = quantity("1", "Innovation divided by its standard deviation.")
    nis: Any = quantity("1", "NIS: square of the normalised innovation.")
    accepted: Any = quantity("1", "True for each range that was used.", kind="flag")
    refused_in_a_row: Any = quantity("1", "Ranges of this beacon refused since one was used.", kind="count")
    moved: Any = quantity("1", "Which beacons were found to be elsewhere than surveyed.", kind="flag")
    error: Any = quantity("m", "Estimated error of each beacon's ranges.")
    sigma_error: Any = quantity("m", "Its standard deviation.")
    scale: Scalar = quantity("1", "Scale error common to all ranges; positive when they are too long.")
    sigma_scale: Scalar = quantity("1", "Its standard deviation.")
    unit: Scalar = quantity("1", "Index of the unit that pinged.", kind="count")
    used: Scalar = quantity("1", "Ranges used so far.", kind="count")
    rejected: Scalar = quantity("1", "Ranges refused so far.", kind="count")
    invalid: Scalar = quantity("1", "Ranges that were not positive numbers.", kind="count")
    agreed_in_a_row: Any = quantity("1", "Ranges of a moved beacon that fitted its survey, in a row.", kind="count")
    mostly_refused: Scalar = quantity("1", "Pings in a row of which most ranges were refused.", kind="count")
    tracking: Scalar = quantity("1", "Whether the filter runs; else it waits for a start.", kind="flag")
    starts: Scalar = quantity("1", "Number of starts of the filter.", kind="count")


def no_range_fix(n: int) -> RangeFix:
    """Before the first, of n beacons."""
    zero, none, no, o, one = np.zeros(n), np.zeros(n, np.int32), np.zeros(n, bool), np.float64(0), np.int32(0)
    return RangeFix(
        zero, zero, zero, no, none, no, zero, zero, o, o, one, one, one, one, none, one, np.bool_(False), one
    )


def count_ranges(fix: RangeFix, replies: Any, correction: Any, errors: RangeErrorModel) -> RangeFix:
    """After one more ping: replies (n,), which ranges came, and the RangeUpdate. Doubt is for `diagnose_beacons`."""
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
    """Which beacons (n,) are now found moved, which are forgiven, and whether the filter itself is lost.

    A beacon that is refused again and again while the others are believed has moved; a filter that most beacons
    contradict, or several for long, has only itself to doubt.
    """
    asks = jnp.asarray(errors.patience) > 0
    long = fix.refused_in_a_row >= errors.patience
    several = 2 * jnp.sum(2 * fix.refused_in_a_row >= errors.patience) >= fix.accepted.shape[0]
    lost = asks & ((fix.mostly_refused >= errors.patience) | (jnp.any(long) & several))
    forgiven = fix.moved & (fix.agreed_in_a_row >= FORGIVENESS_FACTOR * errors.patience)
    return asks & long & ~several & ~fix.moved, forgiven, lost
