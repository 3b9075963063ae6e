"""Inertial navigation in space, aided by satellites: strapdown on a quaternion, and a filter of its 15 errors.

    step    receive: samples validated -> add_sample, add_fix (fusion_horizon)
            follow:  take_sample -> propagate (error_state) -> catch_up and correct, where a fix or its time has come
            tell:    the filter's state, carried over the window to now

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
"""Numbers of a sample of the IMU."""


@record
class GnssFix:
    """How the receiver's measurements fared, up to the newest that was fused. Source: docs page, Gnss and inertial."""

    innovation: Any = quantity("1", "Measured less predicted, given the numbers before: m, then m/s.")
    normalised: Any = quantity("1", "The same in its own sigma.")
    nis: Scalar = quantity("1", "Sum of their squares; chi-square with as many degrees of freedom as numbers.")
    numbers: Scalar = quantity("1", "How many numbers that measurement had.", kind="count")
    used: Scalar = quantity("1", "How many measurements were used.", kind="count")
    rejected: Scalar = quantity("1", "How many were outside the gate; of ranges, all of one.", kind="count")
    rejected_in_a_row: Scalar = quantity("1", "How many since the last that was used.", kind="count")
    given_in: Scalar = quantity("1", "How often so many in a row were refused that the filter gave in.", kind="count")
    late: Scalar = quantity("1", "How many came when the filter was past them, or found no room.", kind="count")


@record
class SpatialNavigationState:
    """Motion in space with its uncertainty, now, at the vehicle's reference point. Source: docs page."""

    position: Any = quantity("m", "North, east, down.", frame="W", shape=(3,))
    velocity: Any = quantity("m/s", "North, east, down.", frame="W", shape=(3,))
    attitude: Any = quantity("1", "Quaternion q_WB, scalar first.", frame="WB", shape=(4,))
    angles: Any = quantity("rad", "Roll, pitch, yaw.", frame="WB", kind="angle", shape=(3,))
    angular_rate: Any = quantity("rad/s", "Without the gyros' biases.", frame="B", shape=(3,))
    gyro_bias: Any = quantity("rad/s", "What the gyros read too much.", frame="B", shape=(3,))
    force_bias: Any = quantity("m/s^2", "What the accelerometers read too much.", frame="B", shape=(3,))
    sigma_position: Any = quantity("m", "Standard deviation.", frame="W", shape=(3,))
    sigma_velocity: Any = quantity("m/s", "Standard deviation.", frame="W", shape=(3,))
    sigma_attitude: Any = quantity("rad", "Of a turn about each body axis.", frame="B", shape=(3,))
    sigma_gyro_bias: Any = quantity("rad/s", "Standard deviation.", frame="B", shape=(3,))
    sigma_force_bias: Any = quantity("m/s^2", "Standard deviation.", frame="B", shape=(3,))
    clock: Any = quantity("1", "Bias (m) and drift (m/s) of the receiver's clock; 0 without raw ranges.", shape=(2,))
    gnss_fix: GnssFix = part("How the receiver's measurements fared.")
    imu: SensorWatch = part("What the IMU has done.")
    gnss: SensorWatch = part("What the receiver has done.")
    horizon: Scalar = quantity("s", "How far the filter stands behind.")
    healthy: Scalar = quantity("1", "Whether all variances are finite and above 0.", kind="flag")
    silent: Scalar = quantity("1", "Whether the IMU has been silent for too long.", kind="flag")


@record
class GnssInertialState:
    """All that changes. Source: this module."""

    nominal: Nominal = part("What is believed, at the horizon.")
    t: Scalar = quantity("100 ns", "The horizon: up to when samples were taken.", kind="time")
    since: Scalar = quantity("1", "Samples since the covariance was carried on.", kind="count")
    window: InertialWindow = part("From there to now.")
    fixes: WaitingFixes = part("Measurements that the filter has not come to.")
    sigma: Any = quantity("1", "Standard deviations now, of each error (15,), when they were told last.")
    gnss_fix: GnssFix = part("How measurements fared.")
    imu: SensorWatch = part("What the IMU has done.")
    gnss: SensorWatch = part("What the receiver has done.")


@record
class GnssInertial:
    """Strapdown navigation, aided by fixes of position and velocity, or by raw ranges and their rates.

    `aiding` "fixes" (loosely coupled, 15 numbers) or "ranges" (tightly coupled, 17: the clock's two), which goes on
    with fewer than four satellites. Fixes are fused at the time at which they were made, up to `delay` old.

    Heading is not seen by a vehicle that flies straight: it takes acceleration across, a turn for example, and until
    then its sigma grows.

    Frames:  W north-east-down, flat and at rest: the turning of the earth is taken for a bias of the gyros.
    Not modelled: errors that hang together in time, but for noise.constant; scale factors and misalignments.
    Source:  docs page, Gnss and inertial.
    """

    noise: SpatialNoise = part("Of IMU and clock.", default=SpatialNoise())
    receiver: GnssNoise = part("Of fixes or ranges.", default=GnssNoise())
    start: SpatialStart = part("What is believed at first.", default=SpatialStart())
    lever_arm: Any = quantity("m", "The antenna's place.", frame="B", default=(0.2, 0.0, -0.1), shape=(3,))
    gravity: Any = quantity("m/s^2", "Gravity.", frame="W", default=(0.0, 0.0, STANDARD), shape=(3,))
    gate: Scalar = quantity(
        "1", "Largest NIS that is believed: of a fix, 0.9999 with 6 degrees of freedom.", default=27.856, above=0
    )
    gate_range: Scalar = quantity("1", "The same of one range or rate, with 1.", default=15.137, above=0)
    patience: Scalar = quantity(
        "1", "Measurements refused in a row after which the filter gives in; 0: never.", default=10, kind="count"
    )
    rate_range: Scalar = quantity("rad/s", "Where the gyros saturate, if they don't say so.", default=35.0, above=0)
    force_range: Scalar = quantity("m/s^2", "The same of the accelerometers.", default=160.0, above=0)
    frozen_imu: Scalar = quantity(
        "1", "Equal samples in a row that mean frozen; 0: never.", default=25, kind="count", off={"imu-noise": 0}
    )
    gap: Scalar = quantity("100 ns", "Longest silence of the IMU bridged in trust.", default=ms(40), kind="time")
    delay: Scalar = quantity(
        "100 ns", "How far the filter stands behind: the oldest fix that it uses.", default=ms(150), kind="time"
    )
    imu: str = option("Name of the inertial sensor.", default="imu")
    gnss: str = option("Name of the receiver.", default="gnss")
    aiding: str = option("What the receiver gives.", default="fixes", choices=("fixes", "ranges"))
    satellites: int = option("How many the receiver knows; for ranges.", default=8)
    slots: int = option("Samples of the IMU that are kept: those of the delay, and some.", default=176)
    carried: int = option("Samples of the IMU after which the covariance is carried on.", default=20)

    @property
    def listens(self) -> tuple[str, ...]:
        """The names of what is read."""
        return self.imu, self.gnss

    @property
    def errors(self) -> int:
        """Numbers of the error."""
        return ERRORS + 2 * (self.aiding == "ranges")

    def check(self) -> None:
        """Refuse a window without room, and one name for two things."""
        if self.slots < 2:
            raise InputError("slots", f"{self.slots} samples are too few", fix="keep delay over period and some more")
        if self.carried < 1:
            raise InputError("carried", f"{self.carried} is no number of samples", fix="give 1 or more, e.g. 20")
        if self.imu == self.gnss:
            problem = f"IMU and receiver are both named {self.imu!r}"
            raise InputError("gnss", problem, fix="give each sensor its own name")

    def init(self, key: Key) -> GnssInertialState:
        """Nothing measured yet."""
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
        """The estimate at integer time t; its state is a SpatialNavigationState."""
        state, fresh = _receive(self, t, state, frame)
        state = lax.while_loop(lambda s: is_due(s.window, self.delay), lambda s: _follow(self, s), state)
        state = lax.cond(fresh & (state.since == self.carried // 2), lambda: _tell_sigmas(self, state), lambda: state)
        begun = state.window.last > NEVER
        silent = begun & (t - state.window.last > self.gap)
        age = jnp.where(begun, to_seconds(t - state.window.last), 0.0)
        valid = begun & ~silent & (state.gnss_fix.used > 0)
        return state, Estimate(t=t, age=age, fresh=fresh, valid=valid, state=_navigation(self, state, silent))

    def _widths(self) -> tuple[int, int]:
        """Numbers of a measurement, and how many of them are measured rather than told along."""
        if self.aiding == "ranges":
            return RANGE_NUMBERS * self.satellites, 2 * self.satellites
        return FIX_NUMBERS, FIX_NUMBERS


def _receive(form: GnssInertial, t: Any, state: GnssInertialState, frame: Frame) -> tuple[GnssInertialState, Any]:
    """With what has arrived put in order, and whether a sample of the IMU was usable."""
    sample, measured = frame.samples[form.imu], frame.samples[form.gnss]
    reading = sample.value
    felt = *_three(reading.angular_rate), *_three(reading.specific_force)
    one = validate_sample(state.imu, t, sample, felt, frozen_after=form.frozen_imu, ordered=True)
    full = (jnp.max(jnp.abs(one.value[:3])) >= form.rate_range * (1 - 1e-9)) | reading.gyro_saturated
    full = full | (jnp.max(jnp.abs(one.value[3:])) >= form.force_range * (1 - 1e-9)) | reading.accelerometer_saturated
    gap = (one.t - state.window.last > form.gap) & (state.window.last > NEVER)
    doubt = (full | gap | one.watch.frozen).astype(np.float64)
    x = state.nominal
    bias = jnp.concatenate([x.gyro_bias, x.force_bias])
    window = lax.cond(one.usable, lambda: add_sample(state.window, one.t, one.value, bias, doubt), lambda: state.window)
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
    """A measurement as one vector, and those of its numbers that tell one from another."""
    if form.aiding == "fixes":
        whole = jnp.concatenate([value.position, value.velocity])
        return whole, tuple(whole[i] for i in range(FIX_NUMBERS))
    n = form.satellites
    parts = [value.pseudorange, value.range_rate, value.satellites, value.satellite_velocities]
    whole = jnp.concatenate([*parts, value.received.astype(np.float64)])
    return whole, tuple(whole[i] for i in range(2 * n))


def _follow(form: GnssInertial, state: GnssInertialState) -> GnssInertialState:
    """The filter one sample on, with what was measured up to there."""
    window, one = take_sample(state.window)
    gravity = jnp.asarray(form.gravity, float)
    x = propagate(state.nominal, one.felt[:3], one.felt[3:], one.dt, one.doubt, gravity)
    since = (state.since + 1).astype(np.int32)
    comes = (state.fixes.count > 0) & (state.fixes.t[state.fixes.head] <= one.t)
    carries = comes | (since >= form.carried)
    x = lax.cond(carries, lambda: catch_up(x, form.noise), lambda: x)
    since = jnp.where(carries, 0, since).astype(np.int32)
    state = replace(state, nominal=x, t=one.t, since=since, window=window)
    return lax.cond(comes, lambda: _correct(form, state, one.dt), lambda: state)


def _correct(form: GnssInertial, state: GnssInertialState, longest: Any) -> GnssInertialState:
    """With the oldest measurement that waits; one from more than `longest` (s) ago is late, and is not used."""
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
        given_in=increment(fix.given_in, taken & gives),
        late=increment(fix.late, ~usable),
    )
    after = tree_where(taken, put_error_in(x, fusion.error, fusion.P), x)
    return replace(state, nominal=after, fixes=fixes, gnss_fix=told)


def _estimate_error(y: Any, H: Any, wanted: Any) -> Any:
    """Variances (n,) of position and velocity as large as the innovations (m,) ask for: what giving in adds to P."""
    squares = jnp.where(wanted & jnp.isfinite(y), y * y, 0.0)
    largest_place = jnp.max(squares * (jnp.abs(H[:, POSITION.start]) + jnp.abs(H[:, POSITION.start + 2]) > 0.1))
    largest_speed = jnp.max(squares * (jnp.abs(H[:, VELOCITY.start]) + jnp.abs(H[:, VELOCITY.start + 2]) > 0.1))
    none = jnp.zeros(H.shape[1])
    return none.at[POSITION].set(largest_place).at[VELOCITY].set(largest_speed)


def _tell_sigmas(form: GnssInertial, state: GnssInertialState) -> GnssInertialState:
    """With standard deviations of what is told now: P carried to the last sample, and over the window after it."""
    x = state.nominal
    begin = quaternion.multiply(x.attitude, quaternion.conjugate(x.span.turn))
    whole = compose(x.span, correct_window(state.window, x.gyro_bias, x.force_bias))
    P = carry_covariance(x.P, quaternion.to_matrix(begin), whole, x.doubt, form.noise)
    variances = jnp.diagonal(P)[:ERRORS].at[POSITION].add(form.receiver.constant**2)
    return replace(state, sigma=jnp.sqrt(jnp.maximum(variances, 0.0)))


def _navigation(form: GnssInertial, state: GnssInertialState, silent: Any) -> SpatialNavigationState:
    """What is told: the filter's state, carried over the window."""
    x, window, sigma = state.nominal, state.window, state.sigma
    one = correct_window(window, x.gyro_bias, x.force_bias)
    now = move(kinematics_of(x), one, jnp.asarray(form.gravity, float))
    variances = jnp.diagonal(x.P)
    return SpatialNavigationState(
        position=now.position,
        velocity=now.velocity,
        attitude=now.attitude,
        angles=to_euler(quaternion.to_matrix(now.attitude)),
        angular_rate=window.felt[:3] - x.gyro_bias,
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
