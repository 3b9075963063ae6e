"""Flights with an IMU and an ultrasonic network, and filters stepped through them ping by ping.

Truth is analytic. Filters are stepped with their own functions in order of measurement, many seeds at once; that the
whole estimator, which gets pings late, does the same is tested where it is.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from estimators.flights import TICK, Truth, fly, reading
from xla_settings import choose_emitters

from trimtab.core.record import part, quantity, record, replace
from trimtab.core.rng import Key, key, normals
from trimtab.core.signals import Frame, Motion, Sample
from trimtab.core.time import ms
from trimtab.environment.acoustics import Air
from trimtab.estimators.inertial.coupled import AidedInertialCoupled
from trimtab.estimators.inertial.dual_filter import InertialNoise
from trimtab.estimators.inertial.mechanisation import LeverArms, rotate_lever
from trimtab.estimators.ranging.position import RangingPosition
from trimtab.estimators.ranging.range_model import predict_range, unit_geometry
from trimtab.estimators.ranging.tightly_coupled import update_running
from trimtab.sensors.time_of_flight import Beacons, Medium, RangeErrors
from trimtab.sensors.ultrasonic_ranging import Ranges, UltrasonicRanging

SWIFT = {
    "xla_llvm_disable_expensive_passes": True,
    "xla_backend_optimization_level": 1,
    **choose_emitters(newer=False),
}
"""Options for programs that take far longer to compile than to run."""
SLOT = ms(100)
TWO_LEFT = np.array([True, False, False, True])
LEVERS = np.array([[0.2, 0.0, 0.0], [-0.2, 0.0, 0.0]])
IMU = InertialNoise(gyro=np.deg2rad(0.72) ** 2, gyro_walk=1e-8, forward=0.082**2, starboard=0.082**2, force_walk=1e-8)
"""The IMU's figures: 3.5 deg/sqrt(h) and 0.4 m/s/sqrt(h) of the maker's data sheet, a sample of 6.5536 ms."""
BIASES = np.array([np.deg2rad(0.7), 0.1, 0.1])
"""Their standard deviations."""
ARM, RATE = 0.3048, np.deg2rad(-115.0)
"""The rig: 12 in, -115 deg/s. Specification section 6."""


def platform(times: Any, rate: float = RATE) -> Truth:
    """The end of the rig's arm, x along the circle, about a point beside the middle of the beacons."""
    return fly(
        lambda t: rate * t + np.pi / 2,
        lambda t: jnp.stack([0.3 + ARM * jnp.cos(rate * t), -0.4 + ARM * jnp.sin(rate * t)]),
        times,
    )


def network(**settings: Any) -> UltrasonicRanging:
    """Two units that take turns; survey and air as a careful person leaves them, collisions as they come."""
    made = UltrasonicRanging(
        units=LEVERS,
        clients=2,
        beacons=Beacons(survey_error=0.005, moved=np.zeros((4, 3))),
        medium=Medium(actual=Air(temperature=295.15), assumed=Air(temperature=293.15)),
    )
    return replace(made, **settings)


def strays(probability: float = 0.1) -> UltrasonicRanging:
    """The same with ranges that mean nothing, wrong by up to 3 m."""
    return network(errors=RangeErrors(stray_probability=probability))


class Steps(NamedTuple):
    """Between pings, each with axes (pings, sub-steps): time steps (s) and what the IMU read at their ends."""

    dt: Any
    imu_reading: Any


class Flight(NamedTuple):
    """times (pings,) in 100 ns, truth there, IMU samples' times (n,) and truth there, which ping each step leads to."""

    times: Any
    at: Truth
    ticks: Any
    imu_reading: Truth
    index: Any
    share: Any
    dt: Any


def plan(path: Any, seconds: float) -> Flight:
    """Static order of events of a path (times -> Truth) for a time; the last sub-step of each row leads to its ping."""
    times = np.arange(1, int(seconds * 10)) * SLOT
    n = int(times[-1] // TICK) + 2
    ticks = np.arange(n) * TICK
    last, rows = 0, []
    for t in times:
        ends = [int(k) for k in ticks[(ticks > last) & (ticks < t)]] + [int(t)]
        rows.append((last, ends))
        last = int(t)
    most = max(len(ends) for _, ends in rows)
    dt, index, share = (np.zeros((len(times), most)) for _ in range(3))
    for i, (begin, ends) in enumerate(rows):
        padded = [begin] * (most - len(ends)) + ends
        dt[i] = np.diff([begin, *padded]) * 1e-7
        index[i] = [p // TICK for p in padded]
        share[i] = [(p % TICK) / TICK for p in padded]
    return Flight(times, path(times * 1e-7), ticks, path(ticks * 1e-7), index.astype(int), share, dt)


def motions(flight: Flight) -> Motion:
    """At each ping, for the network."""
    at, n = flight.at, len(flight.times)
    o = jnp.zeros(n)
    yaw = at.heading
    c, s = jnp.cos(yaw), jnp.sin(yaw)
    surge, sway = c * at.velocity[:, 0] + s * at.velocity[:, 1], c * at.velocity[:, 1] - s * at.velocity[:, 0]
    none = jnp.zeros((n, 3))
    return Motion(
        jnp.asarray(flight.times),
        jnp.concatenate([at.position, o[:, None]], axis=1),
        jnp.stack([o, o, yaw], axis=1),
        jnp.stack([surge, sway, o], axis=1),
        jnp.stack([o, o, at.imu_reading[:, 0]], axis=1),
        none,
        none,
    )


def root(run: Any) -> Key:
    """Key of a run of the simulated network."""
    return replace(key(7), run=jnp.asarray(run, np.uint32))


def pings(sensor: UltrasonicRanging, flight: Flight, run: Any) -> tuple[Ranges, Any]:
    """All replies of a run, and how long after its start (s) the last of each ping was in."""
    return jax.vmap(lambda m: sensor.ping(m.t, root(run), m))(motions(flight))


def inertial(flight: Flight, run: Any, noise: InertialNoise = IMU, biases: Any = BIASES) -> tuple[Any, Any]:
    """What an IMU reads (n, 3) with white noise and biases of a run, and these biases (3,)."""
    k = replace(key(8), run=jnp.asarray(run, np.uint32))
    off = biases * normals(k.at("bias"), 0, 3)
    n = len(flight.ticks)
    white = jnp.sqrt(jnp.stack([noise.gyro, noise.forward, noise.starboard]))
    return flight.imu_reading.imu_reading + off + white * normals(k, jnp.arange(n), 3).T, off


def between(flight: Flight, imu_reading: Any) -> Any:
    """IMU readings at the ends of all sub-steps (pings, sub-steps, 3), straight between samples."""
    a, b = imu_reading[flight.index], imu_reading[jnp.minimum(flight.index + 1, len(flight.ticks) - 1)]
    return a + flight.share[..., None] * (b - a)


def numbers(replies: Ranges) -> Any:
    """Events' values (pings, n + 1)."""
    return jnp.concatenate([jnp.where(replies.arrived, replies.range, 0.0), replies.unit[:, None]], axis=1)


def carried(form: Any, node: Any, dt: Any, imu_reading: Any) -> Any:
    """A node over the sub-steps of one row."""

    def one(node: Any, row: Any) -> Any:
        return form.propagate(node, row[0], row[1], jnp.zeros(2)), None

    return jax.lax.scan(one, node, (dt, imu_reading))[0]


class Flown(NamedTuple):
    """After each ping: node, errors of the belief (pings, 8)."""

    node: Any
    error: Any


def flown(
    form: Any, flight: Flight, imu_reading: Any, off: Any, values: Any, correct: Any = None, first: Any = None
) -> Flown:
    """A form over a flight with events' values (pings, n + 1)."""
    correct = form.correct_ranges if correct is None else correct

    def step(node: Any, row: Any) -> Any:
        dt, imu_reading, value, true = row
        node = correct(carried(form, node, dt, imu_reading), value)
        x, _ = form.belief(node)
        error = x - true
        error = error.at[0].set(jnp.arctan2(jnp.sin(error[0]), jnp.cos(error[0])))
        return node, Flown(node, error)

    at = flight.at
    n = len(flight.times)
    true = jnp.concatenate([at.heading[:, None], at.velocity, at.position, jnp.broadcast_to(off, (n, 3))], axis=1)
    first = form.first() if first is None else first
    node = jax.tree.map(jnp.asarray, replace(first, imu_reading=imu_reading[0], t=np.int64(0)))
    return jax.lax.scan(step, node, (flight.dt, between(flight, imu_reading), values, true))[1]


@partial(jax.jit, static_argnames=("path", "seconds", "runs"), compiler_options=SWIFT)
def monte_carlo(form: Any, sensor: Any, spoilt: Any, *, path: Any, seconds: float, runs: int) -> Flown:
    """A form on the simulated network: Flown with leading axes (runs, pings).

    spoilt: what is added to the ranges (pings, n); NaN: silent.
    """
    flight = plan(path, seconds)

    def one(run: Any) -> Flown:
        imu_reading, off = inertial(flight, run)
        values = numbers(pings(sensor, flight, run)[0])
        n = spoilt.shape[1]
        there = (values[:, :n] > 0) & ~jnp.isnan(spoilt)
        ranges = jnp.where(there, values[:, :n] + jnp.where(there, spoilt, 0.0), 0.0)
        return flown(form, flight, imu_reading, off, jnp.concatenate([ranges, values[:, n:]], axis=1))

    return jax.vmap(one)(jnp.arange(runs))


def spoil(seconds: float, begin: float = 99.0, end: float = 99.0, who: Any = True, by: float = np.nan) -> Any:
    """Added to the ranges (pings, 4) of some beacons after begin and until end (s)."""
    t = np.arange(1, int(seconds * 10))[:, None] / 10
    return np.where((t > begin + 1e-9) & (t <= end + 1e-9) & np.broadcast_to(who, 4), by, 0.0)


@record
class LooseNode:
    """An INS and what locates its units. Source: this test."""

    t: Any = quantity("100 ns", "The instant.", kind="time")
    imu_reading: Any = quantity("1", "What the IMU reads.", shape=(3,))
    inner: Any = part("Of the INS.")
    finder: Any = part("Of the ranging.")
    now: Any = quantity("100 ns", "Number of the ping.", kind="time")


@record
class Loose:
    """Loosely coupled: a fix of each ping aids the coupled form, which starts near the truth.

    Source: this test.
    """

    form: AidedInertialCoupled = part("The INS.")
    finder: RangingPosition = part("Locates units.")
    unit: Any = quantity(
        "1",
        "The located unit's place and lever are used, as good as it gets; else the vehicle's fix and heading.",
        kind="flag",
    )

    def first(self) -> LooseNode:
        node = self.form.first()
        return LooseNode(np.int64(0), np.zeros(3), node, self.finder.init(key(0)), np.int64(0))

    def propagate(self, node: LooseNode, dt: Any, imu_reading: Any, untrusted: Any) -> LooseNode:
        inner = self.form.propagate(replace(node.inner, imu_reading=node.imu_reading), dt, imu_reading, untrusted)
        return replace(node, imu_reading=imu_reading, inner=inner)

    def correct_ranges(self, node: LooseNode, value: Any) -> LooseNode:
        n = value.shape[0] - 1
        now = node.now + SLOT
        ranges = Ranges(value[:n], value[:n] > 0, value[n].astype(np.int32))
        finder = self.finder._update(node.finder, now, ranges)
        fix = finder.fix
        lever = jnp.where(self.unit, jnp.asarray(self.finder.units)[ranges.unit, :2], 0.0)
        place = jnp.where(self.unit, jnp.stack([fix.unit_north, fix.unit_east]), jnp.stack([fix.north, fix.east]))
        form = replace(self.form, arms=LeverArms(aiding=lever))
        fixed = form.correct_position(node.inner, place, 0.0)
        turned = form.correct_heading(fixed, fix.heading, 0.0)
        fixed = jax.tree.map(lambda a, b: jnp.where(fix.heading_valid & ~self.unit, a, b), turned, fixed)
        good = finder.measured == now
        inner = jax.tree.map(lambda a, b: jnp.where(good, a, b), fixed, node.inner)
        return replace(node, inner=inner, finder=finder, now=now)

    def belief(self, node: LooseNode) -> Any:
        return self.form.belief(node.inner)


@partial(jax.jit, static_argnames=("path", "seconds", "runs"), compiler_options=SWIFT)
def own_model(form: Any, *, path: Any, seconds: float, runs: int) -> Flown:
    """A form that begins as given, on ranges and an IMU with exactly the errors that it assumes."""
    flight = plan(path, seconds)
    s, e, n = form.start, form.errors, np.shape(form.beacons)[0]

    def one(run: Any) -> Flown:
        k = replace(key(9), run=jnp.asarray(run, np.uint32))
        imu_reading, off = inertial(flight, run, form.noise, jnp.stack([s.sigma_gyro_bias, *[s.sigma_force_bias] * 2]))
        constant = jnp.sqrt(e.variances(n)) * normals(k.at("constant"), 0, 1 + n)
        white = e.noise * normals(k, jnp.arange(len(flight.times)), n).T
        unit = jnp.arange(len(flight.times)) % np.shape(form.units)[0]

        def ideal(heading: Any, position: Any, unit: Any) -> Any:
            g = unit_geometry(form, unit)
            place = position + rotate_lever(heading, g.lever)[0]
            return jax.vmap(lambda b: predict_range(b, place, g.down, cone=g.cone).range)(g.beacons)

        ranges = jax.vmap(ideal)(flight.at.heading, flight.at.position, unit)
        values = jnp.concatenate([(1 + constant[0]) * ranges + constant[1:] + white, unit[:, None]], axis=1)
        begun = flight.imu_reading
        true = jnp.concatenate([begun.heading[0][None], begun.velocity[0], begun.position[0]])
        first = form.first()
        sigma = jnp.sqrt(form.start.variances()[:5])
        first = replace(first, x=first.x.at[:5].set(true + sigma * normals(k.at("first"), 0, 5)))
        hears = jnp.ones(n, bool)

        def correct(node: Any, value: Any) -> Any:
            return update_running(form, node, value[:n], value[n].astype(np.int32), hears)

        return flown(form, flight, imu_reading, off, values, correct, first)

    return jax.vmap(one)(jnp.arange(runs))


def late_frames(form: Any, flight: Flight, imu_reading: Any, replies: Ranges, last: Any) -> Frame:
    """Frames at the IMU's samples, each ping handed out at the first one after its last reply."""
    n = len(flight.ticks)
    ready = flight.times + np.ceil(np.asarray(last) * 1e7).astype(np.int64)
    newest = np.searchsorted(ready, flight.ticks, side="right") - 1
    shown = np.maximum(newest, 0)
    fresh = np.diff(newest, prepend=-1) > 0
    imu_reading, none = np.asarray(imu_reading), np.zeros(n)
    imu = Sample(reading(*imu_reading.T), flight.ticks, none, none == 0, none == 0)
    value = jax.tree.map(lambda leaf: np.array(leaf)[shown], replies)
    t = flight.times[shown]
    ping = Sample(value, t, (flight.ticks - t) * 1e-7, fresh, newest >= 0)
    return Frame(flight.ticks, {form.intake.imu: imu, form.intake.position: ping})


def nees_of(flown: Flown, states: Any = slice(0, 8)) -> Any:
    """NEES (runs, pings) of some states of the belief."""
    e = np.asarray(flown.error)[..., states]
    P = np.asarray(flown.node.P)[..., states, states]
    return np.einsum("...i,...ij,...j", e, np.linalg.inv(P), e)
