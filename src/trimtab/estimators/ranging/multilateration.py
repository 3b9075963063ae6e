"""Position from ranges, on the floor or in space, and heading from the positions of two ultrasonic units.

Every function takes all n beacons and a mask of the beacons to use, so that shapes never depend on the number of
replies. Heights are those of the beacons above the ultrasonic unit. A position that cannot be found is NaN or has a
large residual.

The ultrasonic units of one vehicle can't be located at the same time: the second unit is polled one time slot after the
first. The vehicle's motion in between causes a heading error, unless inertial navigation measures the motion.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from trimtab.core.linalg import solve_spd
from trimtab.core.record import Scalar, quantity, record
from trimtab.core.rotation import wrap

ITERATIONS = 5


def two_unit_heading(place_a: Any, place_b: Any, lever_a: Any, lever_b: Any) -> Any:
    """Return the vehicle's heading (rad, in [-pi, pi)) from the positions of two ultrasonic units at the same time.

    place_a, place_b: north and east of the units (m), shape (2,).
    lever_a, lever_b: x and y of the units in B (m), shape (2,); on the body's x axis in [1].
    Source: [1] section 5.4.
    """
    W, B = place_a - place_b, lever_a - lever_b
    return wrap(jnp.arctan2(W[1], W[0]) - jnp.arctan2(B[1], B[0]))


def assisted_heading(place_a: Any, place_b: Any, displacement: Any, lever_a: Any, lever_b: Any) -> Any:
    """Return the heading from the positions of ultrasonic unit a at t_a and unit b at t_b, and unit a's displacement.

        r_a' = r_a + [r_ins(t_b) - r_ins(t_a)]

    displacement: displacement of unit a from t_a to t_b (the bracket), north and east (m), shape (2,). Other arguments
    are as in `two_unit_heading`. The result is exact if r_ins is the position of unit a. If r_ins is another point of
    the vehicle, the motion of unit a due to turning is missing.

    Source: [1] section 5.4.
    """
    return two_unit_heading(place_a + displacement, place_b, lever_a, lever_b)


@record
class Solution:
    """Position found from ranges, with the ranges' residual. Source: this module."""

    place: Any = quantity("m", "Position: north and east (2,).", frame="W")
    bias: Scalar = quantity("m", "Range error common to all beacons; 0 if it is not estimated.")
    residual: Scalar = quantity("m", "Root mean square of the residuals of all used ranges.")


def _mean_of_used(values: Any, used: Any) -> Any:
    return jnp.sum(jnp.where(used, values, 0.0)) / jnp.maximum(jnp.sum(used), 1)


def residuals(plan: Any, height: Any, ranges: Any, used: Any, place: Any, bias: Any = 0.0) -> Any:
    """Return the residuals, range minus distance minus bias (n,) (m); 0 for beacons that are not used."""
    away = plan - place
    distance = jnp.sqrt(away[:, 0] ** 2 + away[:, 1] ** 2 + height**2)
    return jnp.where(used, ranges - distance - bias, 0.0)


def root_mean_square(values: Any, used: Any) -> Any:
    """Return the root mean square of the used values (n,), or 0 if no value is used."""
    return jnp.sqrt(_mean_of_used(values * values, used))


def solve_bancroft(plan: Any, height: Any, ranges: Any, used: Any) -> Solution:
    """Return position and common range error in closed form, from three ranges or more.

        a_i = (x_i, y_i, rho_i),   alpha_i = <a_i, a_i>/2 + h^2/2,   <,> = diag(1, 1, -1)
        p = A^+ alpha,  q = A^+ 1;   <q,q> L^2 + 2 (<p,q> - 1) L + <p,p> = 0;   (x, y, b) = diag(1, 1, -1)(p + L q)

    with the beacons' centre as origin. Of the two roots L, the root with the smaller residual is chosen. With three
    ranges both residuals are zero, and the root with the smaller common error is chosen.

    Args:
        plan: north and east of the beacons (m), shape (n, 2).
        height: heights of the beacons above the unit (m), shape (n,).
        ranges: ranges without cone error (m), shape (n,).
        used: True for each range to use, shape (n,).

    Source: S. Bancroft, "An algebraic solution of the GPS equations", IEEE Trans. AES-21, 1985; [1] section 5.5.3.
    """
    centre = jnp.stack([_mean_of_used(plan[:, 0], used), _mean_of_used(plan[:, 1], used)])
    xy = jnp.where(used[:, None], plan - centre, 0.0)
    rho, h = jnp.where(used, ranges, 0.0), jnp.where(used, height, 0.0)
    A = jnp.concatenate([xy, rho[:, None]], axis=1)
    alpha = (xy[:, 0] ** 2 + xy[:, 1] ** 2 - rho**2 + h**2) / 2
    normal = jnp.stack([jnp.stack([jnp.sum(A[:, i] * A[:, j]) for j in range(3)]) for i in range(3)])
    right = jnp.stack(
        [
            jnp.stack([jnp.sum(A[:, i] * alpha) for i in range(3)]),
            jnp.stack([jnp.sum(jnp.where(used, A[:, i], 0.0)) for i in range(3)]),
        ],
        axis=1,
    )
    solution = solve_spd(normal, right)
    p, q = solution[:, 0], solution[:, 1]

    def inner(a: Any, b: Any) -> Any:
        return a[0] * b[0] + a[1] * b[1] - a[2] * b[2]

    a, b, c = inner(q, q), inner(p, q) - 1.0, inner(p, p)
    s = -(b + jnp.where(b < 0, -1.0, 1.0) * jnp.sqrt(jnp.maximum(b * b - a * c, 0.0)))
    few = jnp.sum(used) <= 3

    def at(root: Any) -> tuple[Any, Any, Any, Any]:
        u = p + root * q
        place, bias = centre + u[:2], -u[2]
        rms = root_mean_square(residuals(plan, height, ranges, used, place, bias), used)
        cost = jnp.where(few, jnp.abs(bias), rms)
        return place, bias, rms, jnp.where(jnp.isfinite(cost), cost, jnp.inf)

    first, second = at(c / s), at(s / a)
    better = first[3] <= second[3]
    place, bias, rms = (jnp.where(better, x, y) for x, y in zip(first[:3], second[:3], strict=True))
    return Solution(place=place, bias=bias, residual=rms)


def solve_least_squares(plan: Any, height: Any, ranges: Any, used: Any, start: Any) -> Solution:
    """Return the position with the least sum of squared residuals, without a common range error, by Gauss-Newton.

    Args: as in `solve_bancroft`; start: north and east of the first guess (m), shape (2,). Source: [1] section 5.5.3.
    """

    def closer(_: Any, place: Any) -> Any:
        away = jnp.where(used[:, None], place - plan, 0.0)
        distance = jnp.sqrt(away[:, 0] ** 2 + away[:, 1] ** 2 + height**2)
        H = away / jnp.where(distance > 0, distance, 1.0)[:, None]
        r = residuals(plan, height, ranges, used, place)
        xx, xy, yy = (jnp.sum(H[:, i] * H[:, j]) for i, j in ((0, 0), (0, 1), (1, 1)))
        gx, gy = jnp.sum(H[:, 0] * r), jnp.sum(H[:, 1] * r)
        determinant = xx * yy - xy * xy
        return place + jnp.stack([yy * gx - xy * gy, xx * gy - xy * gx]) / determinant

    place = lax.fori_loop(0, ITERATIONS, closer, start)
    rms = root_mean_square(residuals(plan, height, ranges, used, place), used)
    return Solution(place=place, bias=jnp.zeros_like(rms), residual=rms)


def solve_in_space(anchors: Any, ranges: Any, used: Any, start: Any) -> tuple[Any, Any]:
    """Return the position (3,) (m) in space with the least sum of squared residuals, and the residuals' RMS (m).

    Args:
        anchors: positions of the anchors (n, 3) (m); they must not lie in one plane with the position.
        ranges: range to each anchor (n,) (m).
        used: True for each range to use (n,); at least three.
        start: first guess (3,) (m). If all anchors lie in one plane, it must be on the correct side of the plane.

    Source: [1] section 5.5.3, in three dimensions.
    """

    def residual(place: Any) -> tuple[Any, Any]:
        away = jnp.where(used[:, None], place - anchors, 0.0)
        distance = jnp.sqrt(jnp.sum(away * away, axis=1))
        return jnp.where(used, ranges - distance, 0.0), away / jnp.where(distance > 0, distance, 1.0)[:, None]

    def closer(_: Any, place: Any) -> Any:
        r, H = residual(place)
        return place + solve_spd(H.T @ H, H.T @ r)

    place = lax.fori_loop(0, 2 * ITERATIONS, closer, start)
    return place, root_mean_square(residual(place)[0], used)


def solve_leaving_one_out(
    solve: Callable[..., Solution], plan: Any, height: Any, ranges: Any, used: Any, suffices: Callable[[Solution], Any]
) -> Solution:
    """Return the solution with all beacons, and the n solutions that each leave out one beacon.

    The fields have a leading axis (n + 1,). If the solution with all beacons is good enough, the other solutions are
    not computed, and are 0.

    Args:
        solve: function of (plan, height, ranges, used) that returns a Solution.
        plan, height, ranges, used: as in `solve_bancroft`.
        suffices: returns True for a Solution that is good enough.
    """
    n = used.shape[0]

    def solve_next(carry: Any) -> Any:
        i, end, solutions = carry
        one = solve(plan, height, ranges, used & (jnp.arange(n) != i - 1))
        end = jnp.where((i == 0) & suffices(one), 1, end)
        solutions = jax.tree.map(lambda a, b: lax.dynamic_update_index_in_dim(a, b, i, 0), solutions, one)
        return i + 1, end, solutions

    none = Solution(jnp.zeros((n + 1, 2)), jnp.zeros(n + 1), jnp.zeros(n + 1))
    return lax.while_loop(lambda carry: carry[0] < carry[1], solve_next, (jnp.int32(0), jnp.int32(n + 1), none))[2]


def intersect_circles(plan: Any, height: Any, ranges: Any, used: Any, near: Any) -> Solution:
    """Return the intersection of the circles around the first two used beacons, on the side of a previous position.

    If the circles do not intersect because of noise, the result is the point between them. If one beacon is above the
    other, the result is NaN.

    Args: as in `solve_bancroft`; near: north and east of the previous fix (m), shape (2,). Source: [1] section 5.5.3.
    """
    plan, order = jnp.asarray(plan), jnp.arange(used.shape[0])
    i = jnp.argmax(used)
    j = jnp.argmax(used & (order != i))
    radii = jnp.sqrt(jnp.maximum(ranges**2 - height**2, 0.0))
    A, B, ra, rb = plan[i], plan[j], radii[i], radii[j]
    line = B - A
    apart = jnp.sqrt(line[0] ** 2 + line[1] ** 2)
    along = (apart + (ra - rb) * (ra + rb) / apart) / 2
    aside = jnp.sqrt(jnp.maximum((ra - along) * (ra + along), 0.0))
    e = line / apart
    normal = jnp.stack([-e[1], e[0]])
    foot = A + along * e
    side = jnp.where(jnp.sum((near - foot) * normal) < 0, -1.0, 1.0)
    place = foot + side * aside * normal
    rms = root_mean_square(residuals(plan, height, ranges, used, place), used)
    return Solution(place=place, bias=jnp.zeros_like(rms), residual=rms)
