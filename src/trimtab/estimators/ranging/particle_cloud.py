"""Particles that each carry a Gaussian: initialisation, prediction, weighting and resampling.

A cloud of N Gaussians is a particle filter whose particles have a certain width, so that few particles suffice.
Resampling can turn a fraction of each particle's width in heading into spread between particles. The distribution of
the cloud stays the same.

Source: Kotecha, Djuric, "Gaussian sum particle filtering", IEEE Trans. Signal Processing 51 (2003); Arulampalam,
Maskell, Gordon, Clapp, "A tutorial on particle filters", IEEE Trans. Signal Processing 50 (2002), algorithm 2
(systematic resampling).
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.linalg import symmetric
from trimtab.core.record import quantity, record, replace
from trimtab.core.rng import Key, uniform2
from trimtab.core.rotation import planar, wrap
from trimtab.estimators.inertial.coupled import SIGNS, coupled_process_noise
from trimtab.estimators.inertial.dual_filter import InertialNoise
from trimtab.estimators.inertial.mechanisation import DIMENSION, PreintegratedMotion, rotate_lever
from trimtab.estimators.kalman import update
from trimtab.estimators.ranging.multilateration import intersect_circles
from trimtab.estimators.ranging.range_errors import RangeErrorModel
from trimtab.estimators.ranging.range_model import (
    Geometry,
    compensate_range,
    linearise_range,
    place_information,
    unit_geometry,
)

START = 1
"""Index of the first random number stream for the initialisation."""


@record
class Cloud:
    """Cloud of N particles, each a Gaussian with the state (9 + n,) of a tightly coupled filter.

    Source: docs page, Particle filter.
    """

    x: Any = quantity(
        "1",
        "States of the particles (N, 9 + n): values of Belief.x (pose, velocity, biases), scale error, beacon errors.",
    )
    P: Any = quantity("1", "Covariances of the particles (N, 9 + n, 9 + n).")
    weight: Any = quantity("1", "Weights of the particles (N,), which sum to 1.")


def initialise_cloud(form: Any, key: Key, number: Any, ranges: Any, unit: Any) -> Cloud:
    """Return particles drawn from the ranges (n,) of one ping. At least two ranges must be above 0.

    number: number of previous starts.
    """
    N, n = form.N, np.shape(form.beacons)[0]
    g = unit_geometry(form, unit)
    index = number * N + jnp.arange(N)
    spin, side = uniform2(key, index, START)
    lots = jnp.stack([uniform2(key, index * n + i, START + 8)[0] for i in range(n)], axis=1)
    heading = wrap(2 * np.pi * (jnp.arange(N) + spin) / N)
    plan, height = g.beacons[:, :2], g.down - g.beacons[:, 2]
    exact = compensate_range(jnp.where(ranges > 0, ranges, 1.0), height)[0] if form.cone else ranges
    s = form.start
    motion, width = s.motion_variances(), jnp.full(1, (2 * np.pi / N) ** 2)
    bias = jnp.reshape(s.sigma_gyro_bias**2, 1)
    variances = jnp.concatenate([width, motion[:4], bias, motion[4:], form.errors.variances(n)])

    def one(heading: Any, side: Any, lots: Any) -> tuple[Any, Any]:
        lots = jnp.where(ranges > 0, lots, 2.0)
        rank = jnp.sum(lots[None, :] < lots[:, None], axis=1)
        pair = (rank < 2) & (ranges > 0)
        i, j = jnp.argmax(pair), n - 1 - jnp.argmax(pair[::-1])
        line = plan[j] - plan[i]
        far = jnp.where(side < 0.5, -1.0, 1.0) * jnp.stack([-line[1], line[0]])
        place = intersect_circles(plan, height, exact, pair, plan[i] + line / 2 + far).place
        arm, _ = rotate_lever(heading, g.lever)
        W = place_information(place, pair, g, form.start_sigma) + jnp.eye(2) / s.sigma_position**2
        det = W[0, 0] * W[1, 1] - W[0, 1] * W[1, 0]
        own = jnp.stack([jnp.stack([W[1, 1], -W[0, 1]]), jnp.stack([-W[1, 0], W[0, 0]])]) / det
        x = jnp.concatenate([heading[None], s.velocity(), place - arm, jnp.zeros(4 + n)])
        return x, jnp.diag(variances).at[3:5, 3:5].set(own)

    x, P = jax.vmap(one)(heading, side, lots)
    return Cloud(x, P, jnp.full(N, 1.0 / N))


def predict_particle(x: Any, P: Any, m: PreintegratedMotion, Q: Any) -> tuple[Any, Any]:
    """Return a particle's state (9 + n,) and covariance after a motion. Q: process noise of Belief.x (8, 8)."""
    T, B = m.time, planar(x[0])
    dv, dr = B @ (m.velocity - m.D1 @ x[6:8]), B @ (m.position - m.D2 @ x[6:8])
    new = jnp.concatenate([(x[0] + m.turn - x[5] * T)[None], x[1:3] + dv, x[3:5] + x[1:3] * T + dr, x[5:]])
    eye, row, column, one = jnp.eye(2), jnp.zeros((1, 2)), jnp.zeros((2, 1)), jnp.ones((1, 1))
    v_turn, r_turn = (jnp.stack([-d[1], d[0]])[:, None] for d in (dv, dr))
    F = jnp.concatenate(
        [
            jnp.concatenate([one, row, row, -T * one, row], axis=1),
            jnp.concatenate([v_turn, eye, 0 * eye, column, -B @ m.D1], axis=1),
            jnp.concatenate([r_turn, T * eye, eye, column, -B @ m.D2], axis=1),
            jnp.concatenate([0 * one, row, row, one, row], axis=1),
            jnp.concatenate([column, 0 * eye, 0 * eye, column, eye], axis=1),
        ]
    )
    cross = F @ P[:DIMENSION, DIMENSION:]
    own = symmetric(F @ P[:DIMENSION, :DIMENSION] @ F.T + Q)
    below = jnp.concatenate([cross.T, P[DIMENSION:, DIMENSION:]], axis=1)
    return new, jnp.concatenate([jnp.concatenate([own, cross], axis=1), below])


def motion_covariance(noise: InertialNoise, heading: Any, m: PreintegratedMotion) -> Any:
    """Return the process noise Q (8, 8) of the eight states in Belief.x over a motion."""
    Q = coupled_process_noise(noise.growth(m.time, m.untrusted), heading, noise.integration_time(m.time))
    return Q * SIGNS[:, None] * SIGNS[None, :]


def predict_cloud(cloud: Cloud, m: PreintegratedMotion, noise: InertialNoise) -> Cloud:
    """Return the cloud with all particles propagated over a motion."""

    def one(particle: Any) -> Any:
        x, P = particle
        return predict_particle(x, P, m, motion_covariance(noise, x[0], m))

    x, P = lax.map(one, (cloud.x, cloud.P))
    return replace(cloud, x=x, P=P)


def update_cloud(
    cloud: Cloud,
    ranges: Any,
    g: Geometry,
    errors: RangeErrorModel,
    outlier_probability: Any,
    outlier_width: Any,
    learns: Any,
) -> tuple[Cloud, Any]:
    """Return the cloud with all particles updated and weighted by the ranges of a ping.

    The second result is the total weight of the particles that accept each range (n,). Ranges (n,) that did not arrive
    are 0. The likelihood of a range is

        p(z) = (1 - outlier_probability) N(innovation; 0, S) + outlier_probability / outlier_width

    A range outside a particle's gate reduces the particle's weight, but does not correct its state. The particles are
    processed one after another, so that compiled code needs scratch memory for one particle only.
    """

    def one(particle: Any) -> Any:
        x, P = particle

        def each(carry: Any, row: Any) -> Any:
            x, P, log = carry
            i, z = row
            at = linearise_range(x, P, i, g)
            extra, mean = (at.variance, at.mean) if errors.second_order else (0.0, 0.0)
            R = jnp.reshape(errors.noise**2 + extra, (1, 1))
            correction = update(x, P, (z - at.range - mean)[None], at.H[None], R, gate=errors.gate, consider=learns)
            use = (z > 0) & correction.accepted
            S = correction.S[0, 0]
            right = (
                (1 - outlier_probability) * jnp.exp(-jnp.minimum(correction.nis, 700.0) / 2) / jnp.sqrt(2 * np.pi * S)
            )
            log = log + jnp.where(z > 0, jnp.log(right + outlier_probability / outlier_width), 0.0)
            return (jnp.where(use, correction.x, x), jnp.where(use, correction.P, P), log), use

        (x, P, log), used = lax.scan(each, (x, P, jnp.zeros(())), (jnp.arange(ranges.shape[0]), ranges))
        return x, P, log, used

    x, P, log, used = lax.map(one, (cloud.x, cloud.P))
    weight = cloud.weight * jnp.exp(log - jnp.max(log))
    total = jnp.sum(weight)
    fair = jnp.full(weight.shape, 1.0 / weight.shape[0])
    weight = jnp.where(total > 0, weight / jnp.where(total > 0, total, 1.0), fair)
    return Cloud(x, P, weight), weight @ used.astype(np.float64)


def effective_sample_size(weight: Any) -> Any:
    """Return the effective number of particles, from 1 to N."""
    return 1.0 / jnp.sum(weight * weight)


def systematic_indices(weight: Any, u: Any) -> Any:
    """Return the indices (N,) of the particles to copy in systematic resampling. u: random number in (0, 1)."""
    n = weight.shape[0]
    ends = jnp.cumsum(weight)
    _, index = lax.scan(lambda c, k: (c, jnp.sum(ends < (k + u) / n)), 0, jnp.arange(n, dtype=np.float64))
    return jnp.minimum(index, n - 1).astype(np.int32)


def resample(cloud: Cloud, u: Any, z: Any, share: Any) -> Cloud:
    """Resample systematically to equal weights, and turn a fraction of each heading variance into spread.

        d = sqrt(share P00) z,   x + P[:, 0] d / P00,   P - share P[:, 0] P[0, :] / P00

    This does not change the expected mean and covariance of the cloud.

    u: uniform random number.  z: standard normal random numbers (N,).  share: fraction of the heading variance, from 0
    (copies stay equal) to 1 (the heading of each copy is drawn).
    """
    n = cloud.weight.shape[0]
    index = systematic_indices(cloud.weight, u)
    x, P = cloud.x[index], cloud.P[index]
    column = P[:, :, 0]
    own = jnp.maximum(column[:, :1], 1e-12)
    x = x + column / own * (jnp.sqrt(share * own) * z[:, None])
    P = P - share * column[:, :, None] * column[:, None, :] / own[:, :, None]
    return Cloud(x, P, jnp.full(n, 1.0 / n))


def cloud_moments(cloud: Cloud) -> tuple[Any, Any]:
    """Return mean (9 + n,) and covariance of the cloud. The mean heading is the direction of the mean unit vector."""
    w, x = cloud.weight, cloud.x
    heading = jnp.arctan2(w @ jnp.sin(x[:, 0]), w @ jnp.cos(x[:, 0]))
    mean = jnp.concatenate([heading[None], w @ x[:, 1:]])
    away = jnp.concatenate([wrap(x[:, 0] - heading)[:, None], x[:, 1:] - mean[1:]], axis=1)
    within = jnp.sum(w[:, None, None] * cloud.P, axis=0)
    return mean, symmetric(within + (away * w[:, None]).T @ away)
