"""Particle filter of raw ultrasonic ranges and an IMU, for unknown initial pose, ambiguous ranges and wrong ranges.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, part, quantity, record, replace, tree_where
from trimtab.core.rng import Key, normals, uniform2
from trimtab.core.signals import Estimate, Frame
from trimtab.core.time import to_seconds
from trimtab.estimators.inertial.aided import Intake, listened_sensors, read_samples
from trimtab.estimators.inertial.dual_filter import InertialNoise
from trimtab.estimators.inertial.mechanisation import (
    DIMENSION,
    Belief,
    ImuHistory,
    InertialStart,
    LeverArms,
    PreintegratedMotion,
    append_sample,
    empty_imu_history,
    preintegrate,
)
from trimtab.estimators.inertial.navigation_state import NavigationState, reference_kinematics
from trimtab.estimators.inertial.sensor_watch import NEVER, SensorWatch, increment, initial_watch
from trimtab.estimators.ranging.particle_cloud import (
    Cloud,
    cloud_moments,
    effective_sample_size,
    initialise_cloud,
    motion_covariance,
    predict_cloud,
    predict_particle,
    resample,
    update_cloud,
)
from trimtab.estimators.ranging.position import PAIR, SQUARE, check_positions
from trimtab.estimators.ranging.range_errors import RangeErrorModel
from trimtab.estimators.ranging.range_model import unit_geometry

COMB = 3
"""Index of the random number stream for resampling."""


@record
class ParticleFix:
    """Statistics of the particles at the newest ping. Source: docs page, Particle filter."""

    effective: Scalar = quantity("1", "Effective number of particles, from 1 to N.")
    accepting_weight: Any = quantity(
        "1", "Total weight, 0 to 1, of the particles that accept each beacon's range (n,)."
    )
    used: Scalar = quantity("1", "Number of pings used so far.", kind="count")
    unit: Scalar = quantity("1", "Index of the vehicle's ultrasonic unit that sent the ping.", kind="count")
    redrawn: Scalar = quantity("1", "Number of times the particles were resampled.", kind="count")
    rejected_pings_in_a_row: Scalar = quantity(
        "1", "Number of consecutive pings whose ranges most particles rejected.", kind="count"
    )
    tracking: Scalar = quantity("1", "True while the filter has particles; False before a start.", kind="flag")
    starts: Scalar = quantity(
        "1", "Number of starts, i.e. of times the particles were drawn from scratch.", kind="count"
    )
    scale: Scalar = quantity("1", "Scale error common to all ranges, positive if they are too long.")


@record
class ParticleState:
    """State of the particle filter. Source: docs page, Particle filter."""

    key: Key = part("Key of the random number generator.")
    cloud: Cloud = part("Particles and their weights.")
    at: Scalar = quantity(
        "100 ns", "Time to which the particles are propagated: the time of the last used ping, or later.", kind="time"
    )
    history: ImuHistory = part(
        "Newest IMU samples. The oldest of these samples was measured before the last used ping."
    )
    fix: ParticleFix = part("Statistics of the particles.")
    imu: SensorWatch = part("Checks of the IMU's samples.")
    position: SensorWatch = part("Checks of the ranging sensor's samples.")
    heading: Any = part("Checks of a heading sensor; always None, because the filter reads none.", default=None)
    clock: Scalar = quantity("100 ns", "Latest time that the autopilot's clock has shown.", kind="time", default=NEVER)
    clock_backwards: Scalar = quantity(
        "1", "Number of times the autopilot's clock ran backwards.", kind="count", default=0
    )


@record
class Particle:
    """Particle filter whose particles are Gaussians, each updated to second order.

    The particles are drawn at the first ping with two or more ranges. Each particle starts with a random heading, at
    one of the two intersections of the range circles around a random pair of beacons. The filter is updated at pings.
    Between two pings, the IMU is integrated once for all particles. A ping is used at the time at which it was sent.
    From this time, the estimate is predicted to the newest IMU sample. A ping older than the last ping used is not
    used.

    Frames:  beacons in W, ultrasonic units in B; level vehicle on a flat floor.
    Not modelled: a heading sensor; moved beacons (their ranges count as wrong).
    Source:  [1] chapter 7 names such a filter as future work; docs page, Particle filter.
    """

    intake: Intake = part(
        "Sensors that the filter reads, and checks of the samples. The field `position` names the ranging sensor.",
        default=Intake(heading="", position="ranging", slots=64),
    )
    noise: InertialNoise = part("Noise of the IMU.", default=InertialNoise())
    errors: RangeErrorModel = part("Errors of the ranges. Errors of beacons are considered.", default=RangeErrorModel())
    start: InertialStart = part(
        "Initial velocity of the vehicle, and initial standard deviations.", default=InertialStart()
    )
    arms: LeverArms = part("Position of the IMU on the vehicle.", default=LeverArms())
    beacons: Any = quantity("m", "Surveyed positions of the beacons (n, 3).", default=SQUARE, frame="W")
    units: Any = quantity("m", "Positions of the vehicle's ultrasonic units (m, 3).", default=PAIR, frame="B")
    down: Scalar = quantity("m", "Down coordinate of the vehicle's reference point.", default=0.0, frame="W")
    outlier_probability: Scalar = quantity(
        "1", "Probability that a range is an outlier.", default=0.05, above=0, high=0.9
    )
    outlier_width: Scalar = quantity("m", "Width of the uniform distribution of outliers.", default=6.0, above=0)
    share: Scalar = quantity(
        "1",
        "Fraction of each particle's heading variance that resampling turns into spread between particles.",
        default=0.5,
        low=0,
        high=0.99,
    )
    start_sigma: Scalar = quantity(
        "m", "Standard deviation of the two ranges from which a particle is drawn.", default=0.03, above=0
    )
    sigma_valid: Scalar = quantity(
        "m", "Largest standard deviation of the position for which the estimate is valid.", default=0.3, above=0
    )
    sigma_heading_valid: Scalar = quantity(
        "rad", "Largest standard deviation of the heading for which the estimate is valid.", default=0.5, above=0
    )
    patience: Scalar = quantity(
        "1",
        "Number of consecutive pings rejected by most particles, after which the particles are drawn from scratch.",
        default=8,
        kind="count",
    )
    N: int = option("Number of particles.", default=300)
    cone: bool = option(
        "True to model the cone error, which makes ranges off a beacon's axis too long.",
        default=True,
        choices=(True, False),
    )

    listens = property(listened_sensors)

    def check(self) -> None:
        """Raise InputError if the sensors, the beacons, the ultrasonic units or the number of particles are invalid."""
        self.intake.check()
        if self.intake.heading or not self.intake.position:
            raise InputError(
                "Particle.intake",
                "this filter reads only an IMU and a ranging sensor",
                fix="set intake.heading to an empty name",
            )
        if self.N < 2:
            raise InputError("Particle.N", f"N must be at least 2, got {self.N}", fix="set N to 100 or more")
        check_positions("Particle", self)

    def init(self, key: Key) -> ParticleState:
        """Return the filter's initial state, before any measurement."""
        n, o, none = np.shape(self.beacons)[0], np.float64(0), np.int32(0)
        k = 9 + n
        cloud = Cloud(np.zeros((self.N, k)), np.zeros((self.N, k, k)), np.full(self.N, 1.0 / self.N))
        return ParticleState(
            key=key,
            cloud=cloud,
            at=np.int64(NEVER),
            history=empty_imu_history(self.intake.slots),
            fix=ParticleFix(o, np.zeros(n), none, none, none, none, np.bool_(False), none, o),
            imu=initial_watch(),
            position=initial_watch(max(n + 1, 3)),
            clock=np.int64(NEVER),
            clock_backwards=none,
        )

    def step(self, t: Any, state: ParticleState, frame: Frame) -> tuple[ParticleState, Estimate]:
        """Return the new state and the estimate, a NavigationState with a ParticleFix, at integer time t."""
        return _step_filter(self, t, state, frame)


def process_ping(form: Particle, s: ParticleState, t: Any, value: Any, m: PreintegratedMotion) -> ParticleState:
    """Return the state after a ping at time t.

    value: ranges and index of the unit (n + 1,).  m: motion since the previous ping.
    """
    n = np.shape(form.beacons)[0]
    unit = jnp.clip(value[n], 0, np.shape(form.units)[0] - 1).astype(np.int32)
    ranges, replies = jnp.maximum(value[:n], 0.0), value[:n] > 0
    number = s.fix.used + s.position.samples
    z = normals(s.key.at("redrawn"), number * form.N + jnp.arange(form.N), 1)[0]
    starts = ~s.fix.tracking & (jnp.sum(replies) >= 2)
    alive = s.fix.tracking | starts
    cloud = lax.cond(
        s.fix.tracking,
        lambda: predict_cloud(s.cloud, m, form.noise),
        lambda: initialise_cloud(form, s.key, s.fix.starts, ranges, unit),
    )
    learns = jnp.concatenate([jnp.ones(DIMENSION + 1), jnp.zeros(n)])
    geometry = unit_geometry(form, unit)
    updated_cloud, accepting_weight = update_cloud(
        cloud, ranges, geometry, form.errors, form.outlier_probability, form.outlier_width, learns
    )
    few = effective_sample_size(updated_cloud.weight) < form.N / 2
    comb, _ = uniform2(s.key, number, COMB)
    cloud = lax.cond(few, lambda: resample(updated_cloud, comb, z, form.share), lambda: updated_cloud)
    # the tolerance 0.01 keeps rounding errors from deciding the case in which exactly half is accepted
    mostly = jnp.sum(jnp.where(replies, accepting_weight, 0.0)) > jnp.sum(replies) / 2 - 0.01
    doubt = jnp.where(mostly, 0, s.fix.rejected_pings_in_a_row + 1)
    lost = (form.patience > 0) & (doubt >= form.patience)
    fix = ParticleFix(
        effective=effective_sample_size(updated_cloud.weight),
        accepting_weight=accepting_weight,
        used=increment(s.fix.used, alive),
        unit=unit,
        redrawn=increment(s.fix.redrawn, few & alive),
        rejected_pings_in_a_row=jnp.where(lost, 0, doubt).astype(np.int32),
        tracking=alive & ~lost,
        starts=increment(s.fix.starts, starts),
        scale=cloud.weight @ cloud.x[:, DIMENSION],
    )
    used = jnp.any(replies) & alive
    return tree_where(used, replace(s, cloud=cloud, at=t, fix=fix), s)


def _advance_without_ping(form: Particle, s: ParticleState) -> ParticleState:
    """Propagate the particles to the middle of the IMU history, if the last ping is older than that."""
    h = s.history
    to = h.t[h.t.shape[0] // 2]
    due = s.fix.tracking & (to > s.at)

    def go() -> ParticleState:
        return replace(s, cloud=predict_cloud(s.cloud, preintegrate(h, s.at, to), form.noise), at=to)

    return lax.cond(due, go, lambda: s)


@jax.jit
def _step_filter(form: Particle, t: Any, state: ParticleState, frame: Frame) -> tuple[ParticleState, Estimate]:
    readings = read_samples(form.intake, "ranges", t, state, frame)
    (imu_reading, inertial), (ping, ranging) = readings["imu"], readings["position"]
    h = state.history
    history = lax.cond(
        inertial.usable, lambda: append_sample(h, imu_reading.t, imu_reading.value, imu_reading.untrusted), lambda: h
    )
    s = replace(state, history=history, imu=inertial.watch, position=ranging.watch)
    s = _advance_without_ping(form, s)
    begun = history.t[-1] > NEVER
    in_time = begun & (ping.t > s.at) & (ping.t <= history.t[-1])
    s = replace(s, position=replace(s.position, late=increment(s.position.late, ranging.usable & ~in_time)))
    m = preintegrate(history, s.at, jnp.minimum(ping.t, history.t[-1]))
    s = lax.cond(ranging.usable & in_time, lambda: process_ping(form, s, ping.t, ping.value, m), lambda: s)
    backwards = increment(state.clock_backwards, jnp.asarray(t < state.clock))
    s = replace(s, clock=jnp.maximum(state.clock, t), clock_backwards=backwards)
    return s, _cloud_estimate(form, t, s, inertial.usable | ranging.usable)


def _cloud_estimate(form: Particle, t: Any, s: ParticleState, fresh: Any) -> Estimate:
    """Return the estimate from the particles' mean and covariance, predicted to the newest IMU sample.

    If no IMU data arrive, the estimate is predicted to the present.
    """
    newest = s.history.t[-1]
    begun = newest > NEVER
    age = jnp.where(begun, to_seconds(t - newest), 0.0)
    silent = begun & (t - newest > form.intake.gap)
    mean, P = cloud_moments(s.cloud)
    m = preintegrate(s.history, s.at, newest)
    mean, P = predict_particle(mean, P, m, motion_covariance(form.noise, mean[0], m))
    dt = jnp.where(silent, age, 0.0)
    two, none = jnp.zeros(2), jnp.zeros((2, 2))
    still = PreintegratedMotion(
        dt, dt * mean[5], two, two, none, none, jnp.ones(2)
    )  # a gyro reading equal to the bias, i.e. no rotation
    mean, P = predict_particle(mean, P, still, motion_covariance(form.noise, mean[0], still))
    belief = Belief(mean[:DIMENSION], P[:DIMENSION, :DIMENSION])
    rate = jnp.where(silent, mean[5], s.history.imu_reading[-1, 0])
    variance = form.noise.gyro + jnp.where(silent, form.noise.untrusted_rate**2, 0.0)
    kinematics = reference_kinematics(belief, rate, variance, form.arms)
    sure = (jnp.sqrt(P[3, 3] + P[4, 4]) <= form.sigma_valid) & (jnp.sqrt(P[0, 0]) <= form.sigma_heading_valid)
    state = NavigationState(
        **kinematics,
        heading_fix=None,
        position_fix=s.fix,
        imu=s.imu,
        heading_sensor=None,
        position_sensor=s.position,
        coasting=silent,
        clock_backwards=s.clock_backwards,
    )
    return Estimate(t=t, age=age, fresh=fresh, valid=begun & s.fix.tracking & sure, state=state)
