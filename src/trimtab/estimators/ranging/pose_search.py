"""Pose of a vehicle from its newest ranges and the odometry between them, and a test that these ranges agree.

If the vehicle has moved since a range was measured, the range is equivalent to a present range to a beacon moved by the
same displacement. Ranges measured at different times therefore determine one position. The heading of the odometry and
the scale error of the ranges are found together with the position. Gauss-Newton starts from several headings.

Source: docs page, Odometry and ranges; S. Bancroft, IEEE Trans. AES-21, 1985, for the first position.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.linalg import inverse_spd, solve_spd
from trimtab.core.record import quantity, record, replace
from trimtab.core.rotation import planar
from trimtab.estimators.ranging.multilateration import solve_bancroft

KEPT = 16
"""Number of newest ranges that are stored, and maximum number of ranges that must agree for a restart."""
FEWEST = 6
"""Minimum number of ranges that must agree for a restart. Three ranges would determine the pose without a check."""
POSE = 3
"""Number of unknowns of the pose: heading, north, east. The scale error does not count, because its standard deviation
is known."""
HEADINGS = 8
"""Number of initial headings from which the search for a pose starts."""
ITERATIONS = 10
SIGMA_TURN = 1.0
"""Prior standard deviation of the heading correction (rad). It only matters if ranges do not determine the heading."""


@record
class RecentRanges:
    """Newest ranges, the last one first. Source: docs page, Odometry and ranges."""

    beacon: Any = quantity("1", "Index of the beacon of each range (k,).", kind="count")
    range: Any = quantity("m", "Measured ranges (k,); 0 in an unused entry.")
    since: Any = quantity("m", "Displacement since each range was measured, north and east (k, 2).", frame="W")
    rejected: Any = quantity("1", "True for each range that the filter rejected (k,).", kind="flag")


class PoseFit(NamedTuple):
    """Pose that fits a number of ranges best.

    q: correction of the heading (rad), north, east (m), scale error (4,).  P: covariance of q (4, 4).  chi_square: sum
    of squared residuals over their variance; infinite if there are too few ranges.  freedom: degrees of freedom of
    chi_square.
    """

    q: Any
    P: Any
    chi_square: Any
    freedom: Any


def no_recent_ranges() -> RecentRanges:
    """Return an empty list of newest ranges."""
    return RecentRanges(np.zeros(KEPT, np.int32), np.zeros(KEPT), np.zeros((KEPT, 2)), np.zeros(KEPT, bool))


def remember_range(recent: RecentRanges, i: Any, z: Any, since: Any, rejected: Any) -> RecentRanges:
    """Return the newest ranges with a range z (m) to beacon i added and the oldest removed.

    since: displacement since the range was measured (2,) (m).
    """

    def push(new: Any, old: Any) -> Any:
        return jnp.concatenate([jnp.asarray(new, old.dtype)[None], old[:-1]])

    return RecentRanges(
        push(i, recent.beacon), push(z, recent.range), push(since, recent.since), push(rejected, recent.rejected)
    )


def move_ranges(recent: RecentRanges, along: Any) -> RecentRanges:
    """Return the newest ranges after the vehicle has moved by `along` (2,) (m)."""
    return replace(recent, since=recent.since + along)


def fit_pose(recent: RecentRanges, number: Any, beacons: Any, down: Any, scale: tuple[Any, Any], sigma: Any) -> PoseFit:
    """Return the pose that fits the newest ranges best.

    Args:
        recent: the newest ranges.
        number: number of newest ranges to use.
        beacons: surveyed positions of the beacons (n, 3) (m).
        down: down coordinate of the vehicle (m).
        scale: expected scale error of the ranges, and its standard deviation.
        sigma: standard deviation of a range (m).
    """
    used = (jnp.arange(KEPT) < number) & (recent.range > 0)
    at, z = jnp.asarray(beacons)[recent.beacon], recent.range
    plan, height = at[:, :2], down - at[:, 2]
    expected = jnp.stack([jnp.zeros(()), jnp.zeros(()), jnp.zeros(()), jnp.asarray(scale[0], float)])
    prior = jnp.diag(
        jnp.stack([1 / SIGMA_TURN**2 + 0 * z[0], 0 * z[0], 0 * z[0], 1 / jnp.maximum(scale[1], 1e-6) ** 2])
    )

    def residuals(q: Any) -> tuple[Any, Any]:
        moved = recent.since @ planar(q[0]).T
        away = q[1:3] - moved - plan
        distance = jnp.maximum(jnp.sqrt(away[:, 0] ** 2 + away[:, 1] ** 2 + height**2), 1e-6)
        u = away / distance[:, None]
        swing = u[:, 0] * moved[:, 1] - u[:, 1] * moved[:, 0]
        long = 1 + q[3]
        H = jnp.stack([long * swing, long * u[:, 0], long * u[:, 1], distance], axis=1)
        return jnp.where(used, z - long * distance, 0.0) / sigma, jnp.where(used[:, None], H, 0.0) / sigma

    def closer(_: Any, q: Any) -> Any:
        r, H = residuals(q)
        return q + solve_spd(H.T @ H + prior, H.T @ r - prior @ (q - expected))

    def search(turn: Any) -> tuple[Any, Any, Any]:
        moved = recent.since @ planar(turn).T
        first = solve_bancroft(plan + moved, height, z / (1 + expected[3]), used).place
        first = jnp.where(jnp.all(jnp.isfinite(first)), first, jnp.mean(plan, axis=0))
        q = jnp.stack([turn, first[0], first[1], expected[3]])
        q = lax.fori_loop(0, ITERATIONS, closer, q)
        r, _ = residuals(q)
        off = q - expected
        chi_square = jnp.sum(r * r) + prior[3, 3] * off[3] ** 2
        cost = chi_square + prior[0, 0] * off[0] ** 2
        return q, chi_square, jnp.where(jnp.isfinite(cost), cost, jnp.inf)

    q, chi_square, cost = lax.map(search, jnp.asarray(2 * np.pi * (np.arange(HEADINGS) / HEADINGS - 0.5)))
    best = jnp.argmin(cost)
    _, H = residuals(q[best])
    enough = (jnp.sum(used) >= number) & jnp.isfinite(cost[best])
    return PoseFit(q[best], inverse_spd(H.T @ H + prior), jnp.where(enough, chi_square[best], jnp.inf), number - POSE)
