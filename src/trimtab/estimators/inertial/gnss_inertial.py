"""Inertial navigation in space, aided by satellites: strapdown integration with a quaternion, and an error filter.

    step    receive: validate samples -> add_sample, add_fix (fusion_horizon)
            follow:  take_sample -> propagate (error_state) -> catch_up and correct, when a fix is due
            report:  propagate the filter's state over the window to the present

Source: docs page, Gnss and inertial.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core import quaternion
from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, part, quantity, record, replace, tree_where
from trimtab.core.rng import Key
from trimtab.core.rotation import to_euler
from trimtab.core.signals import Estimate, Frame
from trimtab.core.time import NEVER, ms, to_seconds
from trimtab.environment.geodetic import STANDARD
from trimtab.estimators.inertial.error_state import (
    ATTITUDE,
    ERRORS,
    FORCE_BIAS,
    GYRO_BIAS,
    POSITION,
    VELOCITY,
    Nominal,
    SpatialNoise,
    SpatialStart,
    carry_covariance,
    catch_up,
    first_nominal,
    fuse_scalars,
    kinematics_of,
    propagate,
    put_error_in,
)
from trimtab.estimators.inertial.fusion_horizon import (
    InertialWindow,
    WaitingFixes,
    add_fix,
    add_sample,
    correct_window,
    empty_window,
    is_due,
    next_fix,
    no_fixes,
    take_sample,
)
from trimtab.estimators.inertial.gnss_measurements import (
    FIX_NUMBERS,
    RANGE_NUMBERS,
    GnssNoise,
    expect_fix,
    expect_ranges,
    set_clock,
)
from trimtab.estimators.inertial.sensor_watch import SensorWatch, increment, initial_watch, validate_sample
from trimtab.estimators.inertial.strapdown import compose, move

IMU_WIDTH = 6
"""Number of values in an IMU sample: angular velocity and specific force."""


@record
class GnssFix:
    """Statistics of the updates with satellite measurements. Source: docs page, Gnss and inertial."""

    innovation: Any = quantity("1", "Innovations of the last measurement (measured minus predicted): m, then m/s.")
    normalised: Any = quantity("1", "Innovations of the last measurement, divided by their standard deviations.")
    nis: Scalar = quantity(
        "1", "NIS: sum of squared normalised innovations, chi-square with as many degrees of freedom as values."
    )
    numbers: Scalar = quantity("1", "Number of values in the newest satellite measurement.", kind="count")
    used: Scalar = quantity("1", "Number of satellite measurements used so far.", kind="count")
    rejected: Scalar = quantity(
        "1", "Number of rejected measurements. Raw ranges count as rejected if every range was rejected.", kind="count"
    )
    rejected_in_a_row: Scalar = quantity("1", "Number of measurements rejected since the last used one.", kind="count")
    forced: Scalar = quantity(
        "1", "Number of measurements accepted outside the gate after too many rejections in a row.", kind="count"
    )
    late: Scalar = quantity("1", "Number of measurements unused: too late, or the queue was full.", kind="count")


@record
class SpatialNavigationState:
    """Present motion of the IMU in space, with its uncertainty. Source: docs page, Gnss and inertial."""

    position: Any = quantity("m", "Position of the IMU: north, east, down.", frame="W", shape=(3,))
    velocity: Any = quantity("m/s", "Velocity of the IMU: north, east, down.", frame="W", shape=(3,))
    attitude: Any = quantity("1", "Quaternion q_WB, scalar first.", frame="WB", shape=(4,))
    angles: Any = quantity("rad", "Attitude: roll, pitch, yaw.", frame="WB", kind="angle", shape=(3,))
    angular_rate: Any = quantity("rad/s", "Angular velocity, corrected for the gyros' biases.", frame="B", shape=(3,))
    gyro_bias: Any = quantity("rad/s", "Estimated bias of the gyros.", frame="B", shape=(3,))
    force_bias: Any = quantity("m/s^2", "Estimated bias of the accelerometers.", frame="B", shape=(3,))
    sigma_position: Any = quantity("m", "Standard deviation of the position.", frame="W", shape=(3,))
    sigma_velocity: Any = quantity("m/s", "Standard deviation of the velocity.", frame="W", shape=(3,))
    sigma_attitude: Any = quantity(
        "rad", "Standard deviation of the attitude about each body axis.", frame="B", shape=(3,)
    )
    sigma_gyro_bias: Any = quantity("rad/s", "Standard deviation of the gyro biases.", frame="B", shape=(3,))
    sigma_force_bias: Any = quantity("m/s^2", "Standard deviation of the accelerometer biases.", frame="B", shape=(3,))
    clock: Any = quantity("1", "Bias (m) and drift (m/s) of the receiver's clock; 0 for aiding by fixes.", shape=(2,))
    gnss_fix: GnssFix = part("Statistics of the receiver's updates.")
    imu: SensorWatch = part("Checks of the IMU's samples.")
    gnss: SensorWatch = part("Checks of the receiver's samples.")
    horizon: Scalar = quantity("s", "Delay of the filter behind the present.")
    healthy: Scalar = quantity("1", "True if all variances are finite and above 0.", kind="flag")
    silent: Scalar = quantity("1", "True if no IMU data have arrived for too long.", kind="flag")


@record
class GnssInertialState:
    """State of the navigation aided by satellites. Source: this module."""

    nominal: Nominal = part("Estimate at the filter's time, which lags behind the present by `delay`.")
    t: Scalar = quantity("100 ns", "Time of the filter, up to which IMU samples have been used.", kind="time")
    since: Scalar = quantity("1", "Number of IMU samples since the covariance was last propagated.", kind="count")
    window: InertialWindow = part("IMU samples from the filter's time to the present.")
    fixes: WaitingFixes = part("Satellite measurements later than the filter's time, which wait to be used.")
    sigma: Any = quantity("1", "Last reported standard deviation of each error state (15,).")
    gnss_fix: GnssFix = part("Statistics of the updates with satellite measurements.")
    imu: SensorWatch = part("Checks of the IMU's samples.")
    gnss: SensorWatch = part("Checks of the receiver's samples.")


@record
class GnssInertial:
    """Strapdown navigation, aided by fixes of position and velocity, or by raw ranges and range rates.

    With `aiding` "fixes" the filter is loosely coupled and has 15 error states. With "ranges" it is tightly coupled and
    has 17, two of them for the clock. The tightly coupled filter also works with fewer than four satellites.
    Measurements up to `delay` old are fused at the time at which they were measured.

    The heading is only observable under lateral acceleration, e.g. in a turn. Until then, its uncertainty grows.

    Frames:  W north-east-down, flat and not rotating. The earth's rotation is estimated as a bias of the gyros.
    Not modelled: errors correlated in time, except receiver.constant; scale factors and misalignments.
    Source:  docs page, Gnss and inertial.
    """

    noise: SpatialNoise = part("Noise of the IMU and of the receiver's clock.", default=SpatialNoise())
    receiver: GnssNoise = part("Noise of the receiver's fixes or ranges.", default=GnssNoise())
    start: SpatialStart = part("Initial estimate and its uncertainty.", default=SpatialStart())
    lever_arm: Any = quantity("m", "Vector from IMU to GNSS antenna.", frame="B", default=(0.2, 0.0, -0.1), shape=(3,))
    gravity: Any = quantity("m/s^2", "Gravity vector.", frame="W", default=(0.0, 0.0, STANDARD), shape=(3,))
    gate: Scalar = quantity(
        "1", "NIS gate for fixes; default: 0.9999 quantile with 6 degrees of freedom.", default=27.856, above=0
    )
    gate_range: Scalar = quantity(
        "1", "NIS gate for a single range or range rate, with 1 degree of freedom.", default=15.137, above=0
    )
    patience: Scalar = quantity(
        "1",
        "Number of consecutive rejected measurements after which the next one is accepted anyway; 0 for never.",
        default=10,
        kind="count",
    )
    rate_range: Scalar = quantity(
        "rad/s", "Range of the gyros, used if the sensor does not report saturation.", default=35.0, above=0
    )
    force_range: Scalar = quantity(
        "m/s^2", "Range of the accelerometers, used if the sensor does not report saturation.", default=160.0, above=0
    )
    frozen_imu: Scalar = quantity(
        "1",
        "Number of consecutive equal IMU samples after which the IMU counts as frozen; 0 for never.",
        default=25,
        kind="count",
        off={"imu-noise": 0},
    )
    gap: Scalar = quantity(
        "100 ns", "Longest IMU gap for which the filter adds no extra uncertainty.", default=ms(40), kind="time"
    )
    delay: Scalar = quantity(
        "100 ns", "Delay of the filter behind the present: maximum age of a usable fix.", default=ms(150), kind="time"
    )
    imu: str = option("Name of the inertial sensor.", default="imu")
    gnss: str = option("Name of the satellite receiver.", default="gnss")
    aiding: str = option(
        "Type of the receiver's measurements: fixes or raw ranges.", default="fixes", choices=("fixes", "ranges")
    )
    satellites: int = option("Number of satellites in one measurement of raw ranges.", default=8)
    slots: int = option("Number of IMU samples stored. They must cover the delay, with a reserve.", default=176)
    samples_per_propagation: int = option("Number of IMU samples per propagation of the covariance.", default=20)

    @property
    def listens(self) -> tuple[str, ...]:
        """Return the names of the sensors that the navigation reads."""
        return self.imu, self.gnss

    @property
    def errors(self) -> int:
        """Return the number of error states, 15 or 17."""
        return ERRORS + 2 * (self.aiding == "ranges")

    def check(self) -> None:
        """Raise InputError if a number of samples is too small or a sensor name is used twice."""
        if self.slots < 2:
            raise InputError("slots", f"must be at least 2, got {self.slots}", fix="set slots above delay / IMU period")
        if self.samples_per_propagation < 1:
            raise InputError(
                "samples_per_propagation",
                f"the number of IMU samples must be at least 1, got {self.samples_per_propagation}",
                fix="give 1 or more, e.g. 20",
            )
        if self.imu == self.gnss:
            problem = f"the IMU and the receiver must have different names, got {self.imu!r} for both"
            raise InputError("gnss", problem, fix="give each sensor a name of its own")

    def init(self, key: Key) -> GnssInertialState:
        """Return the initial state of the navigation, before any measurement."""
        n = self.errors
        width, numbers = self._widths()
        none, some = np.int32(0), np.zeros(numbers)
        return GnssInertialState(
            nominal=first_nominal(self.start, n),
            t=np.int64(NEVER),
            since=none,
            window=empty_window(self.slots),
            fixes=no_fixes(width),
            sigma=self.start.sigmas(ERRORS),
            gnss_fix=GnssFix(some, some, np.float64(0), none, none, none, none, none, none),
            imu=initial_watch(IMU_WIDTH),
            gnss=initial_watch(numbers),
        )

    def step(self, t: Any, state: GnssInertialState, frame: Frame) -> tuple[GnssInertialState, Estimate]:
        """Return the new state and the estimate, a SpatialNavigationState, at integer time t."""
        state, fresh = _receive(self, t, state, frame)
        state = lax.while_loop(lambda s: is_due(s.window, self.delay), lambda s: _follow(self, s), state)
        tells = fresh & (state.since == self.samples_per_propagation // 2)
        state = lax.cond(tells, lambda: _tell_sigmas(self, state), lambda: state)
        begun = state.window.last > NEVER
        silent = begun & (t - state.window.last > self.gap)
        age = jnp.where(begun, to_seconds(t - state.window.last), 0.0)
        valid = begun & ~silent & (state.gnss_fix.used > 0)
        return state, Estimate(t=t, age=age, fresh=fresh, valid=valid, state=_navigation(self, state, silent))

    def _widths(self) -> tuple[int, int]:
        """Return the number of values in a satellite measurement, and the number of measured quantities among them."""
        if self.aiding == "ranges":
            return RANGE_NUMBERS * self.satellites, 2 * self.satellites
        return FIX_NUMBERS, FIX_NUMBERS


def _receive(form: GnssInertial, t: Any, state: GnssInertialState, frame: Frame) -> tuple[GnssInertialState, Any]:
    """Return the state with new samples queued, and a flag that is True if an IMU sample was usable."""
    sample, measured = frame.samples[form.imu], frame.samples[form.gnss]
    reading = sample.value
    imu_reading = *_three(reading.angular_rate), *_three(reading.specific_force)
    one = validate_sample(state.imu, t, sample, imu_reading, frozen_after=form.frozen_imu, ordered=True)
    full = (jnp.max(jnp.abs(one.value[:3])) >= form.rate_range * (1 - 1e-9)) | reading.gyro_saturated
    full = full | (jnp.max(jnp.abs(one.value[3:])) >= form.force_range * (1 - 1e-9)) | reading.accelerometer_saturated
    gap = (one.t - state.window.last > form.gap) & (state.window.last > NEVER)
    untrusted = (full | gap | one.watch.frozen).astype(np.float64)
    x = state.nominal
    bias = jnp.concatenate([x.gyro_bias, x.force_bias])
    window = lax.cond(
        one.usable, lambda: add_sample(state.window, one.t, one.value, bias, untrusted), lambda: state.window
    )
    value, numbers = _read_gnss(form, measured.value)
    fix = validate_sample(state.gnss, t, measured, numbers, frozen_after=0, ordered=True)
    fixes, room = lax.cond(
        fix.usable,
        lambda: add_fix(state.fixes, fix.t, value),
        lambda: (state.fixes, jnp.asarray(True)),
    )
    late = increment(state.gnss_fix.late, fix.usable & ~room)
    watch = replace(one.watch, saturated=jnp.where(one.usable, full, state.imu.saturated))
    return replace(
        state,
        t=jnp.where((state.t == NEVER) & one.usable, one.t, state.t),
        window=window,
        fixes=fixes,
        gnss_fix=replace(state.gnss_fix, late=late),
        imu=watch,
        gnss=fix.watch,
    ), one.usable


def _three(v: Any) -> tuple[Any, Any, Any]:
    return v[0], v[1], v[2]


def _read_gnss(form: GnssInertial, value: Any) -> tuple[Any, tuple[Any, ...]]:
    """Return a satellite measurement as one vector, and the values by which a repeated measurement is recognised."""
    if form.aiding == "fixes":
        whole = jnp.concatenate([value.position, value.velocity])
        return whole, tuple(whole[i] for i in range(FIX_NUMBERS))
    n = form.satellites
    parts = [value.pseudorange, value.range_rate, value.satellites, value.satellite_velocities]
    whole = jnp.concatenate([*parts, value.received.astype(np.float64)])
    return whole, tuple(whole[i] for i in range(2 * n))


def _follow(form: GnssInertial, state: GnssInertialState) -> GnssInertialState:
    """Return the state after the filter has used the next IMU sample and the measurements up to its time."""
    window, one = take_sample(state.window)
    gravity = jnp.asarray(form.gravity, float)
    x = propagate(state.nominal, one.imu_reading[:3], one.imu_reading[3:], one.dt, one.untrusted, gravity)
    since = (state.since + 1).astype(np.int32)
    comes = (state.fixes.count > 0) & (state.fixes.t[state.fixes.head] <= one.t)
    carries = comes | (since >= form.samples_per_propagation)
    x = lax.cond(carries, lambda: catch_up(x, form.noise), lambda: x)
    since = jnp.where(carries, 0, since).astype(np.int32)
    state = replace(state, nominal=x, t=one.t, since=since, window=window)
    return lax.cond(comes, lambda: _correct(form, state, one.dt), lambda: state)


def _correct(form: GnssInertial, state: GnssInertialState, longest: Any) -> GnssInertialState:
    """Fuse the oldest waiting measurement, unless it is older than the filter's time by more than `longest` (s)."""
    t, value, fixes = next_fix(state.fixes)
    x, fix = state.nominal, state.gnss_fix
    dt = to_seconds(t - state.t)
    arm = jnp.asarray(form.lever_arm, float)
    if form.aiding == "fixes":
        expected = expect_fix(x, value, dt, arm, form.receiver)
    else:
        expected = expect_ranges(x, value, dt, arm, form.receiver)
        x, expected = tree_where(fix.used > 0, (x, expected), set_clock(x, expected))
    y, H, R, wanted = expected
    gives = (form.patience > 0) & (fix.rejected_in_a_row >= form.patience)
    single = form.gate_range if form.aiding == "ranges" else jnp.inf
    widened = x.P + jnp.where(gives, 1.0, 0.0) * jnp.diag(_estimate_error(y, H, wanted))
    fusion = fuse_scalars(widened, y, H, R, wanted, jnp.where(gives, jnp.inf, single))
    nis = jnp.sum(fusion.nis)
    usable = dt >= -longest
    inside = jnp.isfinite(nis) & (gives | (nis <= form.gate)) if form.aiding == "fixes" else jnp.any(fusion.used)
    taken = usable & inside
    refused = usable & ~inside
    row = jnp.where(taken, 0, increment(fix.rejected_in_a_row, refused)).astype(np.int32)
    told = replace(
        fix,
        innovation=jnp.where(usable, fusion.innovation, fix.innovation),
        normalised=jnp.where(usable, fusion.innovation / jnp.sqrt(fusion.variance), fix.normalised),
        nis=jnp.where(usable, nis, fix.nis),
        numbers=jnp.where(usable, jnp.sum(wanted), fix.numbers).astype(np.int32),
        used=increment(fix.used, taken),
        rejected=increment(fix.rejected, refused),
        rejected_in_a_row=row,
        forced=increment(fix.forced, taken & gives),
        late=increment(fix.late, ~usable),
    )
    after = tree_where(taken, put_error_in(x, fusion.error, fusion.P), x)
    return replace(state, nominal=after, fixes=fixes, gnss_fix=told)


def _estimate_error(y: Any, H: Any, wanted: Any) -> Any:
    """Return the variances (n,) to add to P after too many rejections, computed from the innovations y (m,)."""
    squares = jnp.where(wanted & jnp.isfinite(y), y * y, 0.0)
    largest_place = jnp.max(squares * (jnp.abs(H[:, POSITION.start]) + jnp.abs(H[:, POSITION.start + 2]) > 0.1))
    largest_speed = jnp.max(squares * (jnp.abs(H[:, VELOCITY.start]) + jnp.abs(H[:, VELOCITY.start + 2]) > 0.1))
    none = jnp.zeros(H.shape[1])
    return none.at[POSITION].set(largest_place).at[VELOCITY].set(largest_speed)


def _tell_sigmas(form: GnssInertial, state: GnssInertialState) -> GnssInertialState:
    """Return the state with new standard deviations to report, from the covariance P propagated to the present."""
    x = state.nominal
    begin = quaternion.multiply(x.attitude, quaternion.conjugate(x.span.turn))
    whole = compose(x.span, correct_window(state.window, x.gyro_bias, x.force_bias))
    P = carry_covariance(x.P, quaternion.to_matrix(begin), whole, x.untrusted, form.noise)
    variances = jnp.diagonal(P)[:ERRORS].at[POSITION].add(form.receiver.constant**2)
    return replace(state, sigma=jnp.sqrt(jnp.maximum(variances, 0.0)))


def _navigation(form: GnssInertial, state: GnssInertialState, silent: Any) -> SpatialNavigationState:
    """Return the navigation state to report: the filter's state, propagated over the window to the present."""
    x, window, sigma = state.nominal, state.window, state.sigma
    one = correct_window(window, x.gyro_bias, x.force_bias)
    now = move(kinematics_of(x), one, jnp.asarray(form.gravity, float))
    variances = jnp.diagonal(x.P)
    return SpatialNavigationState(
        position=now.position,
        velocity=now.velocity,
        attitude=now.attitude,
        angles=to_euler(quaternion.to_matrix(now.attitude)),
        angular_rate=window.imu_reading[:3] - x.gyro_bias,
        gyro_bias=x.gyro_bias,
        force_bias=x.force_bias,
        sigma_position=sigma[POSITION],
        sigma_velocity=sigma[VELOCITY],
        sigma_attitude=sigma[ATTITUDE],
        sigma_gyro_bias=sigma[GYRO_BIAS],
        sigma_force_bias=sigma[FORCE_BIAS],
        clock=x.clock,
        gnss_fix=state.gnss_fix,
        imu=state.imu,
        gnss=state.gnss,
        horizon=one.time,
        healthy=jnp.all(variances > 0) & jnp.all(jnp.isfinite(variances)),
        silent=silent,
    )
