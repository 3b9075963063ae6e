"""Particle filter on odometry and raw ranges, for a vehicle with an unknown initial pose.

Source: Kotecha, Djuric, "Gaussian sum particle filtering", IEEE Trans. Signal Processing 51 (2003); docs page, Odometry
and ranges.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, part, quantity, record, replace
from trimtab.core.rng import Key, normals, uniform2
from trimtab.core.rotation import wrap
from trimtab.core.signals import Estimate, Frame
from trimtab.core.time import to_seconds
from trimtab.estimators.inertial.sensor_watch import NEVER, increment
from trimtab.estimators.kalman import update
from trimtab.estimators.ranging.multilateration import intersect_circles
from trimtab.estimators.ranging.odometry import (
    EAST,
    NORTH,
    OdometryNoise,
    OdometryState,
    PlanarStart,
    RadioErrors,
    first_state,
    initial_belief,
    planar_estimate,
    predict_odometry,
    predict_range,
    read_odometry,
    read_ranges,
)
from trimtab.estimators.ranging.particle_cloud import Cloud, cloud_moments, effective_sample_size, resample
from trimtab.estimators.ranging.position import SQUARE

EVIDENCE = 20
"""Number of ranges over which the share of accepted ranges is averaged."""
ACCEPTED_MIN = 0.5
"""Smallest share of accepted ranges of a valid estimate."""
THROW, COMB = 1, 3
"""Streams of the random draws."""


@record
class OdometryParticleState:
    """State of the filter. Source: docs page."""

    key: Key = part("Key of the random draws.")
    cloud: Cloud = part("Particles at the newest odometry.")
    drive: OdometryState = part("Odometry, statistics of the ranges, and the cloud's mean and covariance.")
    newest_ranges: Any = quantity("m", "Newest range of each beacon (n,).")
    newest_at: Any = quantity("100 ns", "Arrival time of the newest range of each beacon (n,).", kind="time")
    effective: Scalar = quantity("1", "Effective sample size, from 1 to N; 0 before there are particles.")
    redrawn: Scalar = quantity("1", "Number of resamplings.", kind="count")
    accepted_share: Scalar = quantity("1", "Share of the recent ranges that most particles accept, smoothed.")


@record
class OdometryParticle:
    """Particles that are Gaussians in the state of `OdometryRanging`, each with its own initial heading.

    The particles are drawn when two beacons have been received within `pair_time`: around the two positions where their
    circles intersect, with all headings. A range that contradicts most particles changes their weights little. The
    estimate is valid only while most ranges are accepted.

    Frames:  beacons in W; level vehicle on a flat floor.
    Not modelled: as `OdometryRanging`; a vehicle carried elsewhere while the filter runs.
    Source:  docs page.
    """

    noise: OdometryNoise = part("Noise of the odometry.", default=OdometryNoise())
    errors: RadioErrors = part("Errors of the ranges.", default=RadioErrors())
    start: PlanarStart = part("Sigmas of turn bias and course. The initial pose is not used.", default=PlanarStart())
    beacons: Any = quantity("m", "Surveyed positions of the beacons (n, 3).", default=SQUARE, frame="W")
    down: Scalar = quantity("m", "Down coordinate of the vehicle's antenna.", default=0.0, frame="W")
    longest: Scalar = quantity("s", "Maximum time between a range and the newest odometry.", default=1.0, above=0)
    pair_time: Scalar = quantity(
        "s", "Maximum time between the two ranges that give the first position.", default=1.0, above=0
    )
    start_sigma: Scalar = quantity("m", "Standard deviation of the first position.", default=1.0, above=0)
    outlier_probability: Scalar = quantity(
        "1", "Probability that a range is an outlier.", default=0.02, above=0, high=0.9
    )
    outlier_width: Scalar = quantity("m", "Width of the uniform distribution of outliers.", default=50.0, above=0)
    share: Scalar = quantity(
        "1",
        "Share of each particle's heading variance that resampling turns into spread.",
        default=0.5,
        low=0,
        high=0.99,
    )
    sigma_valid: Scalar = quantity("m", "Position sigma below which the estimate may be valid.", default=1.0, above=0)
    N: int = option("Number of particles.", default=200)
    odometry: str = option("Name of the odometry sensor; its samples have `distance` and `turn`.", default="odometry")
    ranging: str = option("Name of the ranging sensor; its samples have `range` and `arrived`.", default="ranging")

    @property
    def listens(self) -> tuple[str, ...]:
        """Return the names of the odometry and the ranging."""
        return (self.odometry, self.ranging)

    def check(self) -> None:
        """Raise InputError if the beacons are not a list of at least two positions, or there are too few particles."""
        shape = np.shape(self.beacons)
        if len(shape) != 2 or shape[1] != 3 or shape[0] < 2:
            problem = f"the shape must be (n, 3) with n at least 2, got {shape}"
            raise InputError("OdometryParticle.beacons", problem, fix="give north, east and down of each beacon")
        if self.N < 2:
            raise InputError("OdometryParticle.N", f"N must be at least 2, got {self.N}", fix="take 100 or more")

    def init(self, key: Key) -> OdometryParticleState:
        """Return the initial state, before any measurement."""
        n = np.shape(self.beacons)[0]
        x, P = initial_belief(self.start, self.errors, n)
        k = x.shape[0]
        return OdometryParticleState(
            key=key,
            cloud=Cloud(np.zeros((self.N, k)), np.zeros((self.N, k, k)), np.full(self.N, 1.0 / self.N)),
            drive=first_state(self, (x, P)),
            newest_ranges=np.zeros(n),
            newest_at=np.full(n, NEVER, np.int64),
            effective=np.float64(0),
            redrawn=np.int32(0),
            accepted_share=np.float64(1),
        )

    def step(self, t: Any, state: OdometryParticleState, frame: Frame) -> tuple[OdometryParticleState, Estimate]:
        """Return the estimate at integer time t. Its state is a RobotNavigation with the heading in [-pi, pi)."""
        drive, came, motion = read_odometry(state.drive, frame.samples[self.odometry], t, self.noise.grip)
        s, running = replace(state, drive=drive), state.effective > 0

        def advance(particle: Any) -> Any:
            x, P = particle
            return predict_odometry(x, P, motion, self.noise)

        x, P = lax.cond(
            came & running, lambda: lax.map(advance, (s.cloud.x, s.cloud.P)), lambda: (s.cloud.x, s.cloud.P)
        )
        s = replace(s, cloud=replace(s.cloud, x=x, P=P))
        sample = frame.samples[self.ranging]
        ranges, ahead, fix = read_ranges(drive, sample, t, self.longest)
        s = replace(s, drive=replace(drive, fix=fix))

        def each(s: Any, row: Any) -> tuple[Any, Any]:
            i, z = row
            return lax.cond((z > 0) & running, lambda: weigh_range(self, s, i, z, ahead), lambda: s), ()

        s, _ = lax.scan(each, s, (jnp.arange(ranges.shape[0]), ranges))
        new = ranges > 0
        newest_ranges, at = jnp.where(new, ranges, s.newest_ranges), jnp.where(new, sample.t, s.newest_at)
        s = replace(s, newest_ranges=newest_ranges, newest_at=at)
        recent = (at > NEVER) & (to_seconds(sample.t - jnp.maximum(at, 0)) <= self.pair_time)
        starts = ~running & jnp.any(new) & (jnp.sum(recent) >= 2)
        s = lax.cond(starts, lambda: throw_particles(self, s, recent), lambda: s)
        mean, P = cloud_moments(s.cloud)
        s = replace(s, drive=replace(s.drive, x=mean, P=P))
        sure = (s.effective > 0) & (s.accepted_share >= ACCEPTED_MIN)
        sure = sure & (jnp.sqrt(P[NORTH, NORTH] + P[EAST, EAST]) <= self.sigma_valid)
        return s, planar_estimate(t, s.drive, mean, P, came | jnp.any(new), sure)


def throw_particles(form: OdometryParticle, s: OdometryParticleState, recent: Any) -> OdometryParticleState:
    """Return the first particles, at both places where the circles of two recent ranges (n,) intersect."""
    N, n = form.N, recent.shape[0]
    spin, side = uniform2(s.key, jnp.arange(N), THROW)
    heading = wrap(2 * np.pi * (jnp.arange(N) + spin) / N)
    plan, height = jnp.asarray(form.beacons)[:, :2], form.down - jnp.asarray(form.beacons)[:, 2]
    exact = s.newest_ranges / (1 + form.errors.scale)
    i = jnp.argmax(recent)
    j = jnp.argmax(recent & (jnp.arange(n) != i))
    line = plan[j] - plan[i]
    pair = (jnp.arange(n) == i) | (jnp.arange(n) == j)
    mean, P = initial_belief(form.start, form.errors, n)
    own = jnp.concatenate([jnp.ones(1) * (2 * np.pi / N) ** 2, jnp.ones(2) * form.start_sigma**2])
    P = P.at[np.arange(3), np.arange(3)].set(own)

    def one(particle: Any) -> Any:
        heading, side = particle
        far = jnp.where(side < 0.5, -1.0, 1.0) * jnp.stack([-line[1], line[0]])
        place = intersect_circles(plan, height, exact, pair, plan[i] + line / 2 + far).place
        place = jnp.where(jnp.isfinite(place), place, plan[i])
        return jnp.concatenate([heading[None], place, mean[3:]])

    x = lax.map(one, (heading, side))
    cloud = Cloud(x, jnp.broadcast_to(P, (N, *P.shape)), jnp.full(N, 1.0 / N))
    return replace(s, cloud=cloud, effective=jnp.asarray(float(N)))


def weigh_range(form: OdometryParticle, s: OdometryParticleState, i: Any, z: Any, ahead: Any) -> OdometryParticleState:
    """Update and weight every particle with a range z (m) to beacon i. Resample if few particles have weight.

    p(z) = (1 - w) N(innovation; 0, S) + w / outlier_width, where w is outlier_probability. A range outside a
    particle's gate does not correct it.
    """
    e, fix = form.errors, s.drive.fix
    R = jnp.reshape(e.noise**2, (1, 1))

    def one(particle: Any) -> Any:
        x, P = particle
        at = predict_range(x, i, form.beacons, form.down, s.drive, ahead)
        new = update(x, P, (z - at.range)[None], at.H[None], R, gate=e.gate)
        S = new.S[0, 0]
        right = (1 - form.outlier_probability) * jnp.exp(-jnp.minimum(new.nis, 700.0) / 2) / jnp.sqrt(2 * np.pi * S)
        return new.x, new.P, jnp.log(right + form.outlier_probability / form.outlier_width), at.range, S, new.accepted

    x, P, log, predicted, S, used = lax.map(one, (s.cloud.x, s.cloud.P))
    w = s.cloud.weight
    middle = w @ predicted
    spread = w @ S + w @ (predicted - middle) ** 2
    accepted = w @ used.astype(np.float64) > 0.5
    me = jnp.arange(fix.nis.shape[0]) == i
    refused = jnp.where(accepted, 0, fix.beacon_rejected_in_a_row + 1)
    fix = replace(
        fix,
        innovation=jnp.where(me, z - middle, fix.innovation),
        normalised=jnp.where(me, (z - middle) / jnp.sqrt(spread), fix.normalised),
        nis=jnp.where(me, (z - middle) ** 2 / spread, fix.nis),
        accepted=jnp.where(me, accepted, fix.accepted),
        beacon_rejected_in_a_row=jnp.where(me, refused, fix.beacon_rejected_in_a_row).astype(np.int32),
        used=increment(fix.used, accepted),
        rejected=increment(fix.rejected, ~accepted),
        rejected_in_a_row=jnp.where(accepted, 0, fix.rejected_in_a_row + 1).astype(np.int32),
    )
    weight = w * jnp.exp(log - jnp.max(log))
    total = jnp.sum(weight)
    weight = jnp.where(total > 0, weight / jnp.where(total > 0, total, 1.0), 1.0 / form.N)
    cloud, effective = Cloud(x, P, weight), effective_sample_size(weight)
    few, number = effective < form.N / 2, fix.used + fix.rejected
    z0 = normals(s.key.at("redrawn"), number * form.N + jnp.arange(form.N), 1)[0]
    comb, _ = uniform2(s.key, number, COMB)
    cloud = lax.cond(few, lambda: resample(cloud, comb, z0, form.share), lambda: cloud)
    return replace(
        s,
        cloud=cloud,
        drive=replace(s.drive, fix=fix),
        effective=effective,
        redrawn=increment(s.redrawn, few),
        accepted_share=s.accepted_share + (accepted - s.accepted_share) / EVIDENCE,
    )
