"""Flights with known truth, and filters flown on them sample by sample: what the tests of navigation stand on.

Truth is analytic; its derivatives are automatic. Runs here step a form's own functions in order of measurement, without
the ring of the estimator, whose equality with this is tested where the ring is.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, quantity, record, replace
from trimtab.core.rng import key, normals
from trimtab.core.rotation import planar
from trimtab.core.signals import Frame, hold_sample, new_sample
from trimtab.core.time import ms, to_seconds
from trimtab.estimators.inertial.dual_filter import InertialNoise
from trimtab.estimators.inertial.measurement_history import newest_node
from trimtab.estimators.inertial.mechanisation import InertialStart
from trimtab.estimators.kalman import nees
from trimtab.loop.structure import strengthen_types
from trimtab.sensors.imu import InertialReading

TICK = ms(6.5536)
DT = to_seconds(TICK)
QUICK = {"xla_llvm_disable_expensive_passes": True}
"""Options for programs that take longer to compile than to run."""


def reading(yaw_rate: Any, forward: Any, starboard: Any) -> InertialReading:
    """IMU reading of a planar motion, its numbers (n,)."""
    none = np.zeros_like(yaw_rate)
    force, rate = np.stack([forward, starboard, none], axis=-1), np.stack([none, none, yaw_rate], axis=-1)
    return InertialReading(force, rate, none > 0, none > 0)


@record
class Compass:
    """Reading of a heading sensor. Source: this test."""

    heading: Scalar = quantity("rad", "Heading.", kind="angle")


@record
class Fix:
    """Reading of a position sensor. Source: this test."""

    north: Scalar = quantity("m", "North.")
    east: Scalar = quantity("m", "East.")


class Truth(NamedTuple):
    """Along a flight, each with a leading axis of instants: felt (3,) without error, and Belief.x without biases."""

    imu_reading: Any
    heading: Any
    velocity: Any
    position: Any


def fly(heading: Any, position: Any, times: Any) -> Truth:
    """Truth at times (n,) in s of heading(t) (rad) and position(t) (2,), both traceable."""
    rate, v = jax.grad(heading), jax.jacfwd(position)
    a = jax.jacfwd(v)

    def one(t):
        force = planar(heading(t)).T @ a(t)
        return Truth(jnp.concatenate([rate(t)[None], force]), heading(t), v(t), position(t))

    return jax.jit(jax.vmap(one))(jnp.asarray(times))


def ticks(n: int) -> Any:
    """Times (s) of n samples, the first at 0."""
    return np.arange(n) * DT


def weave(times: Any) -> Truth:
    """A vehicle that accelerates all the time and turns slowly the while."""
    return fly(
        lambda t: 0.3 + 0.7 * jnp.sin(0.4 * t),
        lambda t: jnp.stack([2.0 * jnp.sin(0.9 * t), 1.5 * jnp.cos(0.7 * t)]),
        times,
    )


def turn(times: Any) -> Truth:
    """Constant velocity, and turning: no force acts, so heading errors do nothing to velocity."""
    return fly(lambda t: 0.3 + 2.9 * t, lambda t: jnp.stack([0.5 * t, 1.0 - 0.3 * t]), times)


def rest(times: Any) -> Truth:
    """Standing still."""
    return fly(lambda t: 0.3 + 0.0 * t, lambda t: jnp.stack([1.0 + 0.0 * t, -2.0 + 0.0 * t]), times)


class Draws(NamedTuple):
    """Random numbers of one run: first errors (8,), white (n, 3), walks (n, 3), heading (n,), position (n, 2)."""

    first: Any
    white: Any
    walks: Any
    heading: Any
    position: Any


def draws(run: Any, n: int) -> Draws:
    """Standard normals of a run for n samples."""
    k = key(20)
    k = replace(k, run=jnp.asarray(run, np.uint32))
    z = jax.vmap(lambda i: normals(k, i, 9))(jnp.arange(n))
    return Draws(normals(k.at("first"), 0, 8), z[:, :3], z[:, 3:6], z[:, 6], z[:, 7:])


class Flown(NamedTuple):
    """After each sample: belief x (n, 8), P (n, 8, 8), errors (n, 8), NIS and normalised innovations, flags of use."""

    x: Any
    P: Any
    error: Any
    heading_nis: Any
    heading_innovation: Any
    position_nis: Any
    position_innovation: Any
    fixed: Any


def own_model(form: Any, truth: Truth, z: Draws, *, every: int, reads: bool = True, sensors: Any = None) -> Flown:
    """A form flown on sensors with exactly the noise and the start errors that it assumes.

    every: samples between position fixes.  reads: whether it has the heading at every sample.
    sensors: what noise they have instead, an InertialNoise.
    """
    noise, s = form.noise if sensors is None else sensors, form.start
    sigmas = jnp.stack(
        [
            s.sigma_heading,
            *[s.sigma_velocity] * 2,
            *[s.sigma_position] * 2,
            s.sigma_gyro_bias,
            *[s.sigma_force_bias] * 2,
        ]
    )
    off = sigmas * z.first
    at = jnp.concatenate([truth.heading[0][None], truth.velocity[0], truth.position[0]]) + off[:5]
    begun = replace(s, heading=at[0], velocity_north=at[1], velocity_east=at[2], north=at[3], east=at[4])
    form = replace(form, start=begun)
    white = jnp.sqrt(jnp.stack([noise.gyro, noise.forward, noise.starboard]))
    walk = jnp.sqrt(DT * jnp.stack([noise.gyro_walk, noise.force_walk, noise.force_walk]))
    biases = -off[5:] + jnp.cumsum(walk * z.walks, axis=0) - walk * z.walks[0]
    imu_reading = truth.imu_reading + biases + white * z.white
    first = replace(form.first(), imu_reading=imu_reading[0])

    def step(node, row):
        i, imu_reading, phi, r, zh, zr, true = row
        node = form.propagate(node, jnp.where(i > 0, DT, 0.0), imu_reading, jnp.zeros(2))
        if reads:
            node = form.correct_heading(node, phi + jnp.sqrt(noise.heading) * zh)
        due = i % every == 0
        fixed = form.correct_position(node, r + jnp.sqrt(noise.position) * zr)
        node = jax.tree.map(lambda a, b: jnp.where(due, a, b), fixed, node)
        x, P = form.belief(node)
        h, p = node.heading_fix, node.position_fix
        return node, (x, P, x - true, h.nis, h.normalised[0], p.nis, p.normalised, due)

    n = truth.heading.shape[0]
    true = jnp.concatenate([truth.heading[:, None], truth.velocity, truth.position, biases], axis=1)
    rows = (jnp.arange(n), imu_reading, truth.heading, truth.position, z.heading, z.position, true)
    like = jax.tree.map(lambda leaf: jnp.asarray(leaf), first)
    return Flown(*jax.lax.scan(step, like, rows)[1])


def frames(form: Any, now: Any, imu_reading: Any, heading: Any = None, position: Any = None) -> Frame:
    """Frames with a leading axis of instants; each sensor's (t, values (n, k), fresh), t its time of measurement."""
    given = {
        form.intake.imu: (reading, imu_reading),
        form.intake.heading: (Compass, heading),
        form.intake.position: (Fix, position),
    }
    samples = {}
    for name, (made, one) in given.items():
        if name:
            t, values, fresh = (np.array(x) for x in one)
            sample = hold_sample(now, new_sample(t, made(*values.T)), fresh=fresh)
            samples[name] = replace(sample, valid=np.ones(len(t), bool))
    return Frame(now, samples)


class Ride(NamedTuple):
    """Frames' worth of arrays that a test may spoil before they are flown: times int64 (n,), values, fresh flags."""

    now: Any
    felt_t: Any
    imu_reading: Any
    felt_fresh: Any
    heading_t: Any
    heading: Any
    heading_fresh: Any
    fix_t: Any
    fix: Any
    fix_fresh: Any

    def frames(self, form: Any) -> Frame:
        """For a form."""
        return frames(
            form,
            self.now,
            (self.felt_t, self.imu_reading, self.felt_fresh),
            (self.heading_t, self.heading, self.heading_fresh),
            (self.fix_t, self.fix, self.fix_fresh),
        )


def ride(truth: Truth, noise: Any, *, biases: Any = (0.0, 0.0, 0.0), every: int = 15, seed: int = 0) -> Ride:
    """Noisy samples of a truth at each tick, all in time; positions every so many ticks."""
    n = len(truth.heading)
    g = np.random.default_rng(seed)
    now = np.arange(n) * TICK
    white = np.sqrt([noise.gyro, noise.forward, noise.starboard])
    imu_reading = np.asarray(truth.imu_reading) + np.asarray(biases) + white * g.standard_normal((n, 3))
    heading = np.asarray(truth.heading)[:, None] + np.sqrt(noise.heading) * g.standard_normal((n, 1))
    fix = np.asarray(truth.position) + np.sqrt(noise.position) * g.standard_normal((n, 2))
    due = np.arange(n) % every == 0
    always = np.ones(n, bool)
    return Ride(now, now.copy(), imu_reading, always, now.copy(), heading, always.copy(), now.copy(), fix, due)


@partial(jax.jit, compiler_options=QUICK)
def fly_frames(form: Any, given: Frame) -> Any:
    """All estimates of a form over frames, and its last belief."""

    def step(state, frame):
        return form.step(frame.t, state, frame)

    state, told = jax.lax.scan(step, strengthen_types(form.init(key(0))), given)
    return told, form.belief(newest_node(state.history))


MEMS = InertialNoise(gyro=np.deg2rad(0.72) ** 2, gyro_walk=1e-8, forward=0.082**2, starboard=0.082**2, force_walk=1e-8)
"""The IMU's figures: 3.5 deg/sqrt(h) and 0.4 m/s/sqrt(h) of the maker's data sheet, a sample of 6.5536 ms."""
NEAR = InertialStart(
    sigma_heading=0.02,
    sigma_position=0.0237,
    sigma_velocity=0.05,
    sigma_gyro_bias=np.deg2rad(0.7),
    sigma_force_bias=0.1,
)
"""A start near the truth, biases as the maker says."""


@partial(jax.jit, static_argnames=("n", "every", "reads", "runs", "keep"), compiler_options=QUICK)
def monte_carlo(form: Any, truth: Truth, *, n: int, every: int, reads: bool, runs: int, keep: int = 25) -> Any:
    """NEES (runs, n / keep), Flown thinned to every keep-th sample, NIS of all position fixes (runs, fixes)."""

    def one(run):
        flown = own_model(form, truth, draws(run, n), every=every, reads=reads)
        thin = jax.tree.map(lambda a: a[::keep], flown)
        return jax.vmap(nees)(thin.error, thin.P), thin, flown.position_nis[::every]

    return jax.vmap(one)(jnp.arange(runs))
