"""Position, and heading from two ultrasonic units, from the ranges of an ultrasonic network, one ping at a time.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, part, period, quantity, record, replace, tree_where
from trimtab.core.rng import Key
from trimtab.core.rotation import planar
from trimtab.core.signals import Estimate, Frame
from trimtab.core.time import FOREVER, ms, to_seconds
from trimtab.estimators.ranging.multilateration import (
    Solution,
    intersect_circles,
    solve_bancroft,
    solve_least_squares,
    solve_leaving_one_out,
    two_unit_heading,
)
from trimtab.estimators.ranging.range_model import compensate_range

NONE, TWO, ALL, ONE_REJECTED, INCONSISTENT = range(5)
MODES = ("no fix", "two ranges", "all ranges", "one rejected", "inconsistent")
SQUARE = np.array([[1.5, 1.5, -2.7048], [1.5, -1.5, -2.7048], [-1.5, -1.5, -2.7048], [-1.5, 1.5, -2.7048]])
"""Default positions of the beacons in W (m): a square of four below a ceiling."""
PAIR = np.array([[0.2, 0.0, 0.0], [-0.2, 0.0, 0.0]])
"""Default positions of a vehicle's two ultrasonic units in B (m): on the x axis, fore and aft."""


def check_positions(name: str, form: Any) -> None:
    """Raise InputError if the positions of a filter's beacons or ultrasonic units are not of shape (n, 3).

    name: name of the filter.
    """
    for field, positions in (("beacons", form.beacons), ("units", form.units)):
        shape = np.shape(positions)
        if len(shape) != 2 or shape[1] != 3 or shape[0] < 1:
            raise InputError(
                f"{name}.{field}",
                f"the array must have shape (n, 3), got {shape}",
                fix="give one row of three coordinates for each position",
            )


@record
class RangingFix:
    """Position fix from the ranges of a ping, with its quality. Source: [1] section 5.5.3."""

    north: Scalar = quantity(
        "m", "North position of the vehicle's reference point, or of the ultrasonic unit while the heading is unknown."
    )
    east: Scalar = quantity(
        "m", "East position of the vehicle's reference point, or of the ultrasonic unit while the heading is unknown."
    )
    heading: Scalar = quantity("rad", "Heading from the positions of two ultrasonic units, in [-pi, pi).", kind="angle")
    heading_valid: Scalar = quantity("1", "True if both ultrasonic units have a recent fix.", kind="flag")
    unit: Scalar = quantity("1", "Index of the ultrasonic unit located last.", kind="count")
    unit_north: Scalar = quantity("m", "North position of the ultrasonic unit located last.")
    unit_east: Scalar = quantity("m", "East position of the ultrasonic unit located last.")
    residual: Scalar = quantity("m", "Root mean square of the residuals of the ranges used at the last ping.")
    bias: Scalar = quantity("m", "Range error common to all beacons; 0 if it is not estimated.")
    dilution: Scalar = quantity(
        "1", "Dilution of precision: error of the fix divided by error of a range; at most 1000."
    )
    used: Scalar = quantity("1", "Number of ranges used at the last ping.", kind="count")
    rejected: Scalar = quantity(
        "1", "Index of the beacon whose range was left out at the last ping; -1 if none was left out.", kind="count"
    )
    mode: Scalar = quantity("1", "Result of locating the ultrasonic unit at the last ping.", kind="mode", modes=MODES)
    frozen: Scalar = quantity(
        "1", "True if the ultrasonic unit is frozen: its ranges repeat exactly, and it gets no fix.", kind="flag"
    )
    out_of_time: Scalar = quantity(
        "1",
        "Number of pings not used because their time is in the future, or not later than the previous ping.",
        kind="count",
    )
    invalid: Scalar = quantity(
        "1", "Number of pings with a range that is not finite. Such a range is not used.", kind="count"
    )


@record
class RangingPositionState:
    """State of the positioning from ranges: newest fix, and last position of each ultrasonic unit. Source: this
    module."""

    fix: RangingFix = part("Newest position fix.")
    places: Any = quantity("m", "Last position fix of each ultrasonic unit (m, 2), north and east.", frame="W")
    gains: Any = quantity(
        "1", "Sensitivity of each ultrasonic unit's last fix to an error of each range (m, n, 2).", frame="W"
    )
    times: Any = quantity(
        "100 ns",
        "Time at which each ultrasonic unit was last located (m,); NEVER for a unit without a fix.",
        kind="time",
    )
    measured: Scalar = quantity("100 ns", "Time at which the newest ping with a fix was sent.", kind="time")
    seen: Scalar = quantity("100 ns", "Time at which the newest ping, with or without a fix, was sent.", kind="time")
    ranges: Any = quantity("m", "Last ranges of each ultrasonic unit (m, n).")
    repeats: Any = quantity(
        "1", "Number of consecutive pings of each ultrasonic unit that repeated the ranges exactly (m,).", kind="count"
    )
    any: Scalar = quantity("1", "True once any ultrasonic unit has had a fix.", kind="flag")


class _UnitLocation(NamedTuple):
    place: Any
    bias: Any
    residual: Any
    used: Any
    rejected: Any
    mode: Any


@record
class RangingPosition:
    """Estimator that locates an ultrasonic unit from each ping. It corrects the cone error of ranges, and rejects one
    outlier.

    From three or more ranges, the position is found by Bancroft's closed form, followed by least squares. If the
    residual is above its limit and there are enough ranges, one range is left out. Without this range, the residual
    must be below the limit, and the fix must lie within the cones of the other received beacons. If several ranges
    qualify, the residual and the distance from the previous fix decide. If no range qualifies, there is no fix. From
    two ranges, the intersection nearer to the previous fix is taken.

    Frames:  beacons in W, ultrasonic units in B; level vehicle on a flat floor.
    Not modelled: motion between the pings of two units, see docs page; correlation of fixes in time.
    Source:  [1] sections 5.4, 5.5.3 and 5.5.4; the rejection of an outlier is added, see docs page.
    """

    beacons: Any = quantity("m", "Surveyed positions of the beacons (n, 3).", default=SQUARE, frame="W")
    units: Any = quantity(
        "m", "Positions of the vehicle's ultrasonic units (m, 3).", default=np.zeros((1, 3)), frame="B"
    )
    down: Scalar = quantity("m", "Down coordinate of the vehicle's reference point.", default=0.0, frame="W")
    residual_limit: Scalar = quantity(
        "m", "Largest accepted root mean square of the ranges' residuals.", default=0.02, above=0
    )
    cone_limit: Scalar = quantity(
        "rad",
        "Largest accepted angle of the ultrasonic unit off a beacon's axis.",
        default=0.9,
        kind="angle",
        above=0,
        high=1.5,
    )
    typical_step: Scalar = quantity("m", "Typical distance between consecutive fixes.", default=0.2, above=0)
    dilution_limit: Scalar = quantity("1", "Largest accepted dilution of precision.", default=10.0, above=0)
    frozen_after: Scalar = quantity(
        "1",
        "Number of pings in a row with exactly equal ranges after which an ultrasonic unit is frozen; 0 for never.",
        default=3,
        kind="count",
        off={"range-noise": 0},
    )
    pair_time: int = period(
        "Longest time between the fixes of two ultrasonic units from which a heading is computed.", default=ms(200)
    )
    cone: bool = option(
        "True to compensate the cone error, which makes ranges off a beacon's axis too long.",
        default=True,
        choices=(True, False),
        off={"cone-error": False},
    )
    solver: str = option(
        'Solver: "least squares", without a common range error, or "closed form", with a common range error.',
        default="least squares",
        choices=("least squares", "closed form"),
    )
    sensor: str = option("Name of the ranging sensor.", default="ranging")

    def check(self) -> None:
        """Raise InputError if the positions of beacons or ultrasonic units are invalid, or one unit is above the
        other."""
        check_positions("RangingPosition", self)
        plan = np.asarray(self.units)[:2, :2]
        if len(plan) == 2 and np.allclose(plan[0], plan[1]):
            raise InputError(
                "RangingPosition.units",
                "the second ultrasonic unit must not be directly above or below the first",
                fix="give the two units different x or y",
            )

    @property
    def listens(self) -> tuple[str, ...]:
        """Return the name of the ranging sensor."""
        return (self.sensor,)

    def init(self, key: Key) -> RangingPositionState:
        """Return the initial state of the positioning, without a fix."""
        m, o, never = np.shape(self.units)[0], np.float64(0), np.int64(-FOREVER)
        no, none = np.bool_(False), np.int32(0)
        fix = RangingFix(o, o, o, no, none, o, o, o, o, o, none, np.int32(-1), np.int32(NONE), no, none, none)
        return RangingPositionState(
            fix=fix,
            places=jnp.zeros((m, 2)),
            gains=jnp.zeros((m, np.shape(self.beacons)[0], 2)),
            times=jnp.full(m, never),
            measured=np.int64(0),
            seen=never,
            ranges=jnp.zeros((m, np.shape(self.beacons)[0])),
            repeats=jnp.zeros(m, np.int32),
            any=no,
        )

    def locate(self, ranges: Any, arrived: Any, unit: Any, near: Any, known: Any) -> _UnitLocation:
        """Return an ultrasonic unit's position (2,), and the quality of this position, from measured ranges.

        ranges: measured ranges (m), shape (n,).  arrived: True for each range that arrived, shape (n,).  unit: index of
        the unit.  near: position of the previous fix (m), shape (2,).  known: True if there was a previous fix.
        """
        beacons = jnp.asarray(self.beacons)
        plan, height = beacons[:, :2], self.down + jnp.asarray(self.units)[unit, 2] - beacons[:, 2]
        usable = arrived & jnp.isfinite(ranges) & (ranges > 0)
        ranges = jnp.where(usable, ranges, 1.0)
        if self.cone:
            ranges, _, _ = compensate_range(ranges, height)
        count = jnp.sum(usable)
        pair = intersect_circles(plan, height, ranges, usable, near)
        every, rejected = self._reject_outlier(plan, height, ranges, usable, near, known)
        agrees = every.residual <= self.residual_limit
        mode = jnp.where(agrees, jnp.where(rejected >= 0, ONE_REJECTED, ALL), INCONSISTENT)
        two = count == 2
        mode = jnp.where(two, jnp.where(known & (pair.residual <= self.residual_limit), TWO, INCONSISTENT), mode)
        mode = jnp.where(count < 2, NONE, jnp.where(two & ~known, NONE, mode))
        best = tree_where(two, pair, every)
        used = count - ((mode == ONE_REJECTED) & ~two)
        rejected = jnp.where(mode == ONE_REJECTED, rejected, -1)
        return _UnitLocation(best.place, best.bias, best.residual, used, rejected, mode)

    def _solve(self, plan: Any, height: Any, ranges: Any, used: Any, near: Any, known: Any) -> Solution:
        """Return the position from all used ranges.

        If the beacons lie on a line, two positions fit. The position nearer to the last fix is returned.
        """
        first = solve_bancroft(plan, height, ranges, used)
        if self.solver == "closed form":
            return first
        alone = solve_least_squares(plan, height, ranges, used, first.place)
        beside = solve_least_squares(plan, height, ranges, used, near)
        off, aside = jnp.sum((alone.place - near) ** 2), jnp.sum((beside.place - near) ** 2)
        other = jnp.sum((alone.place - beside.place) ** 2) > self.residual_limit**2
        unfit = ~(alone.residual <= self.residual_limit)
        fits = known & (beside.residual <= self.residual_limit) & (jnp.sum(used) >= 3)
        return tree_where(fits & (unfit | (other & (aside < off))), beside, alone)

    def _reject_outlier(
        self, plan: Any, height: Any, ranges: Any, usable: Any, near: Any, known: Any
    ) -> tuple[Solution, Any]:
        """Return the solution and the index of the range left out as an outlier, -1 if all ranges are used."""
        fewest = 5 if self.solver == "closed form" else 4
        if np.shape(self.beacons)[0] < fewest:
            return self._solve(plan, height, ranges, usable, near, known), jnp.asarray(-1)
        enough = jnp.sum(usable) >= fewest

        def suffices(one: Solution) -> Any:
            return (one.residual <= self.residual_limit) | ~enough

        def solve(plan: Any, height: Any, ranges: Any, used: Any) -> Solution:
            return self._solve(plan, height, ranges, used, near, known)

        solved = solve_leaving_one_out(solve, plan, height, ranges, usable, suffices)
        every, without = jax.tree.map(lambda a: a[0], solved), jax.tree.map(lambda a: a[1:], solved)
        rest = usable[None, :] & ~jnp.eye(usable.shape[0], dtype=np.bool_)
        away = without.place[:, None, :] - plan
        wide = away[:, :, 0] ** 2 + away[:, :, 1] ** 2 > (height * jnp.tan(self.cone_limit)) ** 2
        fits = usable & (without.residual <= self.residual_limit) & ~jnp.any(rest & wide, axis=1)
        jump = ((without.place[:, 0] - near[0]) ** 2 + (without.place[:, 1] - near[1]) ** 2) / self.typical_step**2
        cost = (4.0 * without.residual / self.residual_limit) ** 2 + jnp.where(known, jump, 0.0)
        wrong = jnp.argmin(jnp.where(fits, cost, jnp.inf))
        agrees = every.residual <= self.residual_limit
        drop = enough & ~agrees & jnp.any(fits) & (known | (jnp.sum(fits) == 1))
        chosen = jax.tree.map(lambda a, b: jnp.where(drop, a[wrong], b), without, every)
        return chosen, jnp.where(drop, wrong, -1)

    def _gain(self, place: Any, unit: Any, arrived: Any, rejected: Any) -> tuple[Any, Any]:
        """Return the effect of each range's error on the fix, north and east: H (H'H)^-1 (n, 2), and the dilution.

        H (n, 2): horizontal directions from the beacons to the ultrasonic unit. Dilution: error of the fix over error
        of a range, i.e. the square root of the gain's sum of squares. It is at most 1000, also if all beacons lie on a
        line with the unit.
        """
        beacons = jnp.asarray(self.beacons)
        height = self.down + jnp.asarray(self.units)[unit, 2] - beacons[:, 2]
        away = beacons[:, :2] - place
        used = arrived & (jnp.arange(away.shape[0]) != rejected)
        square = away[:, 0] ** 2 + away[:, 1] ** 2 + height**2
        w = jnp.where(used & (square > 0), 1.0 / jnp.where(square > 0, square, 1.0), 0.0)
        xx, xy, yy = (jnp.sum(w * away[:, i] * away[:, j]) for i, j in ((0, 0), (0, 1), (1, 1)))
        determinant = jnp.maximum(xx * yy - xy * xy, 1e-12)
        weights = jnp.sqrt(w) / determinant
        dilution = jnp.minimum(jnp.sqrt((xx + yy) / determinant), 1000.0)
        north, east = -away[:, 0], -away[:, 1]
        gain = jnp.stack([weights * (yy * north - xy * east), weights * (xx * east - xy * north)], axis=1)
        return gain, dilution

    def _update(self, s: RangingPositionState, t: Any, value: Any) -> RangingPositionState:
        """Return the state after a ping that was sent at integer time t."""
        unit = jnp.clip(value.unit, 0, np.shape(self.units)[0] - 1)
        own = jnp.arange(s.times.shape[0]) == unit
        ranges, repeats = self._count_repeats(s, own, value)
        frozen = (repeats[unit] >= self.frozen_after) & (jnp.asarray(self.frozen_after) > 0)
        near = s.places[unit]
        known = s.times[unit] > -FOREVER
        r = self.locate(value.range, value.arrived, unit, near, known)
        place = jnp.where(jnp.isfinite(r.place), r.place, near)
        gain, dilution = self._gain(place, unit, value.arrived, r.rejected)
        good = (r.mode != NONE) & (r.mode != INCONSISTENT) & jnp.all(jnp.isfinite(r.place))
        good = good & (dilution <= self.dilution_limit)
        mode = jnp.where(good | (r.mode == NONE), r.mode, INCONSISTENT)
        good = good & ~frozen
        place = jnp.where(good, place, near)
        places, times = jnp.where(own[:, None], place, s.places), jnp.where(own & good, t, s.times)
        gains = jnp.where((own & good)[:, None, None], gain, s.gains)
        residual, bias = (jnp.where(jnp.isfinite(x), x, 0.0) for x in (r.residual, r.bias))
        fix = replace(s.fix, residual=residual, bias=bias, dilution=dilution, mode=mode.astype(np.int32), frozen=frozen)
        fix = replace(fix, used=r.used.astype(np.int32), rejected=r.rejected.astype(np.int32))
        vehicle = self._vehicle_fix(fix, place, unit, places, times)
        fix = tree_where(good, vehicle, fix)
        measured = jnp.where(good, t, s.measured)
        return RangingPositionState(fix, places, gains, times, measured, t, ranges, repeats, s.any | good)

    def _count_repeats(self, s: RangingPositionState, own: Any, value: Any) -> tuple[Any, Any]:
        """Return the last ranges (m, n) and the repeat counts (m,) of all ultrasonic units after a ping.

        own: True for the unit that pinged (m,). A ping without any range does not count as a repetition.
        """
        now = jnp.where(value.arrived & jnp.isfinite(value.range), value.range, 0.0)
        same = jnp.all(now == s.ranges, axis=1) & jnp.any(now > 0)
        repeats = jnp.where(own, jnp.where(same, s.repeats + 1, 0), s.repeats).astype(np.int32)
        return jnp.where(own[:, None], now, s.ranges), jnp.minimum(repeats, np.int32(2**30))

    def _vehicle_fix(self, fix: RangingFix, place: Any, unit: Any, places: Any, times: Any) -> RangingFix:
        """Return the vehicle's fix from the position of one ultrasonic unit, with a heading if both ultrasonic units
        have a recent fix."""
        heading, paired, at = fix.heading, fix.heading_valid, place
        if np.shape(self.units)[0] >= 2:
            levers = jnp.asarray(self.units)[:, :2]
            paired = jnp.abs(times[0] - times[1]) <= self.pair_time
            line = places[0] - places[1]
            paired = paired & (jnp.sum(line * line) > 0)
            heading = jnp.where(paired, two_unit_heading(places[0], places[1], levers[0], levers[1]), heading)
            at = jnp.where(paired, place - planar(heading) @ levers[unit], place)
        unit = unit.astype(np.int32)
        return replace(
            fix,
            north=at[0],
            east=at[1],
            heading=heading,
            heading_valid=paired,
            unit=unit,
            unit_north=place[0],
            unit_east=place[1],
        )

    def step(self, t: Any, state: RangingPositionState, frame: Frame) -> tuple[RangingPositionState, Estimate]:
        """Return the new state and the newest fix at integer time t. A repeated or older ping is not used."""
        sample = frame.samples[self.sensor]
        arrived = sample.fresh & sample.valid
        new = arrived & (sample.t > state.seen) & (sample.t <= t)
        refused = jnp.where(arrived & ~new, state.fix.out_of_time + 1, state.fix.out_of_time).astype(np.int32)
        after = jax.lax.cond(new, lambda: self._update(state, sample.t, sample.value), lambda: state)
        wrong = arrived & jnp.any(sample.value.arrived & ~jnp.isfinite(sample.value.range))
        invalid = jnp.where(wrong, state.fix.invalid + 1, state.fix.invalid).astype(np.int32)
        after = replace(after, fix=replace(after.fix, out_of_time=refused, invalid=invalid))
        age = to_seconds(t - after.measured)
        fresh = new & (after.measured == sample.t)
        return after, Estimate(t=t, age=age, fresh=fresh, valid=after.any, state=after.fix)
