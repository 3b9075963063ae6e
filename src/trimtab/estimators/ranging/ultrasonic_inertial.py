"""Inertial navigation aided by an ultrasonic network: each ping gives a position fix, which is passed to the INS.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, part, quantity, record, replace
from trimtab.core.rng import Key
from trimtab.core.rotation import planar
from trimtab.core.signals import Estimate, Frame, Sample
from trimtab.core.time import to_seconds
from trimtab.environment.magnetic import COLLEGE_PARK, magnetic_heading
from trimtab.estimators.inertial.aided import InertialState
from trimtab.estimators.inertial.feedback import AidedInertialFeedback
from trimtab.estimators.inertial.measurement_history import LONGEST, inertial_increment, node_before
from trimtab.estimators.inertial.sensor_watch import NEVER
from trimtab.estimators.ranging.multilateration import two_unit_heading
from trimtab.estimators.ranging.position import PAIR, RangingPosition, RangingPositionState

KNOWN = 0.3
"""Standard deviation of the INS's heading (rad) below which the heading counts as known. A known heading is used to
move fixes from an ultrasonic unit to the vehicle's reference point."""


@record
class HeadingMeasurement:
    """Measured heading with its variance. Source: [1] section 5.4."""

    heading: Scalar = quantity("rad", "Measured heading, from north to the body's x axis.", kind="angle")
    variance: Scalar = quantity("rad^2", "Variance of the heading; 0 to use the filter's noise.heading.")


@record
class PositionMeasurement:
    """Measured position of the vehicle's reference point, with its covariance. Source: [1] section 5.5."""

    north: Scalar = quantity("m", "Measured north position.", frame="W")
    east: Scalar = quantity("m", "Measured east position.", frame="W")
    variance: Any = quantity("m^2", "Covariance of north and east position (2, 2).", frame="W")


@record
class UltrasonicInertialState:
    """States of the positioning and of the INS. Source: docs page, Ultrasonic inertial navigation."""

    positioning: RangingPositionState = part("State of the positioning from ranges.")
    inertial: InertialState = part("State of the INS.")


class _Pose(NamedTuple):
    """Pose estimated by the INS: heading (rad), position of the reference point (2,), yaw rate (rad/s), variance of the
    heading, and True if the heading is known.
    """

    heading: Any
    place: Any
    rate: Any
    variance: Any
    known: Any


@record
class UltrasonicInertial:
    """Loosely coupled navigation: RangingPosition computes positions from ranges, and an INS fuses positions and
    headings.

        position   r = position of the ultrasonic unit - B(phi) lever,  phi the INS's heading at the ping
        heading    from a magnetometer, or from the positions of two ultrasonic units; the older position is first
                   moved by the displacement of the INS since then

    g (n, 2) is the effect of an error of each of n ranges on a unit's position, e is the unit vector perpendicular to
    the line through the units, and base is the distance between the units. The variances are

        position   R = s^2 g'g,                                          s   range_noise
        heading    R = (s^2 sum (g_1 e)^2 + (g_2 e)^2                    s_b survey_error
                        + s_b^2 sum ((g_1 - g_2) e)^2) / base^2

    because the noise of each range is independent, while a displaced beacon displaces the positions of both units that
    receive it in the same way. The uncertainty of B(phi) lever is added to the error of the position. Until the heading
    of the INS is known, the possible motion of a unit between two pings is added to the error of the heading. A single
    unit is at `inertial.arms.aiding`. Its position is passed to the INS unchanged, because the INS applies the lever
    arm itself.

    `state.position_sensor` also includes checks of the pings: frozen ranges, non-finite ranges, pings out of time.

    Frames:  beacons in W, levers in B.
    Valid:   for one or two ultrasonic units. Two units provide a heading.
    Not modelled: correlation of heading and position of a ping.
    Source:  [1] sections 5.4 and 5.5.
    """

    positioning: RangingPosition = part(
        "Positioning, which computes fixes from ranges.", default=RangingPosition(units=PAIR)
    )
    inertial: Any = part("Inertial navigation that fuses the fixes.", default=AidedInertialFeedback())
    range_noise: Scalar = quantity("m", "Standard deviation of a range's noise.", default=0.0045, above=0)
    survey_error: Scalar = quantity(
        "m",
        "Standard deviation of a beacon's position. Affects a heading if the units received different beacons.",
        default=0.005,
        low=0,
    )
    unknown_speed: Scalar = quantity(
        "m/s", "Speed assumed for the vehicle before its motion is known.", default=1.0, above=0
    )
    field: Any = quantity(
        "T", "Earth's magnetic field, for the magnetometer.", frame="W", default=COLLEGE_PARK, shape=(3,)
    )
    magnetometer: str = option(
        "Name of the magnetometer. Empty: the heading is computed from the positions of two ultrasonic units.",
        default="",
    )

    @property
    def listens(self) -> tuple[str, ...]:
        """Return the names of the IMU, the ranging sensor, and the magnetometer if it has a name."""
        extra = (self.magnetometer,) if self.magnetometer else ()
        return (self.inertial.intake.imu, self.positioning.sensor, *extra)

    def check(self) -> None:
        """Raise InputError if the number of ultrasonic units is not 1 or 2, if the INS reads headings but none are
        measured, if it reads no positions, or if its lever arm is wrong."""
        self.positioning.check()
        self.inertial.check()
        units = np.shape(self.positioning.units)[0]
        if units not in (1, 2):
            fix = "set positioning.units to one or two rows (x, y, z), or use another estimator for ranges"
            raise InputError(
                "UltrasonicInertial", f"the number of ultrasonic units must be 1 or 2, got {units}", fix=fix
            )
        if self.inertial.intake.heading and not self.magnetometer and units < 2:
            problem = "the INS reads headings, but there is only one ultrasonic unit and no magnetometer"
            fix = "add an ultrasonic unit, name a magnetometer, or use AidedInertialCoupled with intake.heading empty"
            raise InputError("UltrasonicInertial", problem, fix=fix)
        lever = np.asarray(self.positioning.units)[0, :2] if units == 1 else np.zeros(2)
        if not np.allclose(self.inertial.arms.aiding, lever):
            problem = (
                f"inertial.arms.aiding must be {lever} with {units} ultrasonic unit{'s' * (units != 1)}, got "
                f"{np.asarray(self.inertial.arms.aiding)}"
            )
            fix = (
                "set it to x, y of a single ultrasonic unit, or to 0 for two units: their lever arms are "
                "subtracted from the fixes"
            )
            raise InputError("UltrasonicInertial", problem, fix=fix)
        if not self.inertial.intake.position:
            raise InputError(
                "UltrasonicInertial", "the INS must read positions", fix="give inertial.intake.position a name"
            )

    def init(self, key: Key) -> UltrasonicInertialState:
        """Return the initial states of positioning and INS, before any measurement."""
        return UltrasonicInertialState(self.positioning.init(key), self.inertial.init(key))

    def step(self, t: Any, state: UltrasonicInertialState, frame: Frame) -> tuple[UltrasonicInertialState, Estimate]:
        """Return the new state and the estimate, a NavigationState, at integer time t."""
        ranging, fix = self.positioning.step(t, state.positioning, frame)
        position, heading = lax.cond(
            fix.fresh, lambda: self._locate_vehicle(ranging, fix, state.inertial), _empty_measurements
        )
        intake = self.inertial.intake

        def fix_sample(value: Any, fresh: Any) -> Sample:
            return Sample(value=value, t=ranging.measured, age=fix.age, fresh=fresh, valid=fix.valid)

        samples = {intake.imu: frame.samples[intake.imu], intake.position: fix_sample(position, fix.fresh)}
        if intake.heading and self.magnetometer:
            samples[intake.heading] = self._compass_sample(frame.samples[self.magnetometer])
        elif intake.heading:
            samples[intake.heading] = fix_sample(heading, fix.fresh & fix.state.heading_valid)
        inertial, estimate = self.inertial.step(t, state.inertial, Frame(t, samples))
        watch, pings = estimate.state.position_sensor, fix.state
        watch = replace(
            watch,
            frozen=watch.frozen | pings.frozen,
            invalid=watch.invalid + pings.invalid,
            disordered=watch.disordered + pings.out_of_time,
        )
        navigation = replace(estimate.state, position_sensor=watch)
        return UltrasonicInertialState(ranging, inertial), replace(estimate, state=navigation)

    def _pose(self, inertial: InertialState, t: Any) -> _Pose:
        """Return the INS's estimate at integer time t, extrapolated at constant velocity from the last event before
        t."""
        node = node_before(inertial.history, t)
        belief = self.inertial.belief(node)
        x, rate = belief.x, node.imu_reading[0] - belief.x[5]
        dt = jnp.clip(to_seconds(t - node.t), 0.0, LONGEST)
        heading = x[0] + dt * rate
        place = x[3:5] + dt * x[1:3] - planar(heading) @ self.inertial.arms.imu
        variance = jnp.where(node.t > NEVER, belief.P[0, 0], np.inf)
        return _Pose(heading, place, rate, variance, variance < KNOWN**2)

    def _locate_vehicle(
        self, s: RangingPositionState, fix: Estimate, inertial: InertialState
    ) -> tuple[PositionMeasurement, HeadingMeasurement]:
        """Return the vehicle's position, from the position of the ultrasonic unit that pinged, and the vehicle's
        heading, from the positions of two units."""
        levers = jnp.asarray(self.positioning.units)[:, :2]
        new = fix.state.unit
        now, lever = self._pose(inertial, s.measured), levers[new]
        gain = s.gains[new]
        variance = self.range_noise**2 * _products(gain, gain)
        unit = jnp.stack([fix.state.unit_north, fix.state.unit_east])
        if levers.shape[0] < 2:  # the INS applies the lever arm itself, and may correct its heading by it
            return PositionMeasurement(unit[0], unit[1], variance), HeadingMeasurement(jnp.zeros(()), jnp.zeros(()))
        place = unit - jnp.where(now.known, planar(now.heading) @ lever, 0.0)
        slope = planar(now.heading) @ jnp.stack([-lever[1], lever[0]])
        unknown = jnp.sum(lever * lever) * jnp.eye(2) / 2
        spread = jnp.where(now.known, now.variance * slope[:, None] * slope[None, :], unknown)
        position = PositionMeasurement(place[0], place[1], variance + spread)
        old = 1 - new
        then, lever = self._pose(inertial, s.times[old]), levers[old]
        known = now.known & then.known
        increment, turn = inertial_increment(self.inertial, inertial.history, s.times[old], s.times[new])
        swept = planar(now.heading) - planar(now.heading - turn)
        displacement = increment + swept @ (lever - self.inertial.arms.imu)
        places = s.places + jnp.where((jnp.arange(2) == old)[:, None] & known, displacement, 0.0)
        heading = two_unit_heading(places[0], places[1], levers[0], levers[1])
        base = levers[0] - levers[1]
        swing = jnp.sqrt(jnp.sum(lever * lever)) * jnp.abs(now.rate)
        gap = to_seconds(s.times[new] - s.times[old])
        wandered = jnp.where(known, 0.0, (gap * (self.unknown_speed + swing)) ** 2)
        line = places[0] - places[1]
        across = jnp.stack([-line[1], line[0]]) / jnp.sqrt(jnp.maximum(jnp.sum(line * line), 1e-12))
        noise = self.range_noise**2 * jnp.sum((s.gains @ across) ** 2)
        survey = self.survey_error**2 * jnp.sum(((s.gains[0] - s.gains[1]) @ across) ** 2)
        return position, HeadingMeasurement(heading, (noise + survey + wandered) / jnp.sum(base * base))

    def _compass_sample(self, sample: Sample) -> Sample:
        """Return the magnetometer's sample converted to a heading."""
        heading = magnetic_heading(sample.value.field, jnp.asarray(self.field))
        return replace(sample, value=HeadingMeasurement(heading, jnp.zeros(())))


def _products(a: Any, b: Any) -> Any:
    """Return the product a'b (2, 2) of two matrices a, b (n, 2)."""
    return jnp.stack([jnp.stack([jnp.sum(a[:, i] * b[:, j]) for j in range(2)]) for i in range(2)])


def _empty_measurements() -> tuple[PositionMeasurement, HeadingMeasurement]:
    o = jnp.zeros(())
    return PositionMeasurement(o, o, jnp.zeros((2, 2))), HeadingMeasurement(o, o)
