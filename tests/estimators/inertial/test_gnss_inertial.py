"""GNSS and inertial navigation: equal to a dense filter that stores all samples, consistent over flights, robust."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from estimators.aerial_flights import BLOCKS, TICK, Setting, fly, pose_error, start_of, truth
from estimators.flights import QUICK
from scipy import stats

import trimtab
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core import quaternion
from trimtab.core.errors import InputError
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import key
from trimtab.core.rotation import DEG
from trimtab.core.signals import Frame, hold_sample, new_sample
from trimtab.core.time import ms, seconds, to_seconds
from trimtab.estimators.inertial.error_state import SpatialStart, first_nominal, process_noise, propagate
from trimtab.estimators.inertial.gnss_inertial import GnssInertial
from trimtab.estimators.inertial.gnss_measurements import expect_fix
from trimtab.estimators.inertial.strapdown import average_samples
from trimtab.loop.structure import strengthen_types
from trimtab.scenarios import catalogue
from trimtab.scenarios.navigation.aerial import LAP
from trimtab.sensors.gnss import Gnss, GnssReading, Outages
from trimtab.sensors.imu import InertialReading
from trimtab.sensors.late_fix import LateFix
from trimtab.vehicles.closed_path import ClosedPath

needs_compiler = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
OUTAGES = Outages(start=seconds(15), length=seconds(8), interval=seconds(20))


def setting(aiding="fixes", **changes):
    """The scenario's world without what the filter does not model; its own outages."""
    scenario, _ = catalogue.load_scenario("navigation/aerial", {"gnss": aiding})
    sensors, form = scenario.world.sensors, scenario.autopilot.estimator
    gnss = replace(sensors["gnss"], correlated=0.0, outages=OUTAGES, **changes)
    form = replace(form, receiver=replace(form.receiver, constant=0.0))
    return Setting(*to_arrays((scenario.world.vehicle, sensors["imu"], gnss, form)))


def band(n, flights):
    """95 % band of a mean NEES of n numbers."""
    return stats.chi2.ppf([0.025, 0.975], n * flights) / flights


# --- against a filter that keeps everything --------------------------------------------------------------------------


def dense_filter(form, samples, fixes, until):
    """State and P (15, 15) at the end of IMU sample `until`: dense, each sample, automatic derivatives, fixes in time.

    samples: (t, w, f) of each;  fixes: by the time at which each was made.
    """
    x = first_nominal(form.start, 15)
    P, noise, g = np.asarray(x.P), form.noise, jnp.asarray(form.gravity, float)

    def put(x, e):
        return replace(
            x,
            attitude=quaternion.retract(x.attitude, e[:3]),
            velocity=x.velocity + e[3:6],
            position=x.position + e[6:9],
            gyro_bias=x.gyro_bias + e[9:12],
            force_bias=x.force_bias + e[12:15],
        )

    def apart(x, y):
        turn = quaternion.local(x.attitude, y.attitude)
        rest = [getattr(y, n) - getattr(x, n) for n in ("velocity", "position", "gyro_bias", "force_bias")]
        return jnp.concatenate([turn, *rest])

    @jax.jit
    def predict(x, w, f, dt):
        after = propagate(x, w, f, dt, 0.0, g)
        F = jax.jacfwd(lambda e: apart(after, propagate(put(x, e), w, f, dt, 0.0, g)))(jnp.zeros(15))
        return after, F

    @jax.jit
    def turned(x, error):  # what is missing after the error was put in, by what was missing before
        after = put(x, error)
        return jax.jacfwd(lambda e: apart(after, put(x, error + e)))(jnp.zeros(15))

    @jax.jit
    def expected(x, value):
        return expect_fix(x, value, 0.0, form.lever_arm, form.receiver)

    def fuse(x, P, value):
        e = expected(x, value)
        H, R = np.asarray(e.H), np.diag(e.R)
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        error = jnp.asarray(K @ np.asarray(e.y))
        A, G = np.eye(15) - K @ H, np.asarray(turned(x, error))
        return put(x, error), G @ (A @ P @ A.T + K @ R @ K.T) @ G.T

    x, before = propagate(x, *samples[0][1:], 0.0, 0.0, g), samples[0]
    for k, sample in enumerate(samples[: until + 1]):
        (t0, w0, f0), (t, w1, f1) = before, sample
        before, dt = sample, to_seconds(t - t0)
        if k:
            x, F = predict(x, *average_samples(w0, f0, w1, f1, dt), dt)
            P = F @ P @ np.asarray(F).T + np.asarray(process_noise(noise, dt, 0.0, 15))
        if t in fixes:
            x, P = fuse(x, P, fixes[t])
    return x, P


def recorded_flight(form, steps, latency):
    """A noisy flight through the estimator: its last state and estimate, all IMU samples, all fixes by their times."""
    path = ClosedPath(coordinated=LAP)
    imu = catalogue.load_scenario("navigation/aerial")[0].world.sensors["imu"]
    gnss = Gnss(timing=LateFix(latency=latency, interval=ms(200)), period=TICK, lever_arm=form.lever_arm)
    form = start_of(form, truth(path, LAP, np.int64(0)), jnp.asarray(np.linspace(-0.8, 0.9, 9)))
    k = key(3)

    def step(carry, i):
        t = i * TICK
        s_imu, s_gnss, s_form = carry
        motion = truth(path, LAP, t)
        s_imu, imu_reading = imu.step(t, s_imu, motion)
        s_gnss, fix = gnss.step(t, s_gnss, motion)
        s_form, estimate = form.step(t, s_form, Frame(t, {"imu": imu_reading, "gnss": fix}))
        return jax.tree.map(jnp.asarray, (s_imu, s_gnss, s_form), kinds), (t, imu_reading.value, fix, estimate)

    first = strengthen_types((imu.init(k.at("imu")), gnss.init(k.at("gnss")), form.init(k)))
    kinds = jax.tree.map(jnp.result_type, first)
    (_, _, state), (t, imu_reading, fix, estimate) = jax.jit(lambda: jax.lax.scan(step, first, jnp.arange(steps)))()
    samples = [(int(a), w, f) for a, w, f in zip(t, imu_reading.angular_rate, imu_reading.specific_force, strict=True)]
    fixes = {}
    for i in np.flatnonzero(fix.fresh):
        fixes[int(fix.t[i])] = jnp.concatenate([fix.value.position[i], fix.value.velocity[i]])
    return form, state, estimate, samples, fixes


@pytest.mark.thorough
def test_late_fixes_match_a_filter_without_latency():
    """0.8 s, four fixes that come 120 ms late: at the horizon the state and P of the dense filter, up to how often P
    is carried on; and now, 150 ms later, the state of one that went on from there."""
    form = GnssInertial(lever_arm=np.array([0.5, -0.2, -0.3]), samples_per_propagation=5)
    form, state, estimate, samples, fixes = recorded_flight(form, 801, 0.12)
    assert int(state.gnss_fix.used) == 4
    horizon = 800 - 150
    assert int(state.t) == samples[horizon][0]
    x, P = dense_filter(form, samples, fixes, horizon)
    sigma = np.sqrt(np.diag(P))
    mine = state.nominal
    apart = np.concatenate(
        [
            quaternion.local(mine.attitude, x.attitude),
            x.velocity - mine.velocity,
            x.position - mine.position,
            x.gyro_bias - mine.gyro_bias,
            x.force_bias - mine.force_bias,
        ]
    )
    print("apart, in sigmas:", np.abs(apart / sigma).max())
    assert np.abs(apart / sigma).max() < 1e-4
    relative = (np.asarray(mine.P) - P) / np.outer(sigma, sigma)
    print("P:", np.abs(relative).max())
    assert np.abs(relative).max() < 1e-4
    for k in range(horizon + 1, 801):  # what is told now
        (t0, w0, f0), (t, w1, f1) = samples[k - 1], samples[k]
        dt = to_seconds(t - t0)
        mine = propagate(mine, *average_samples(w0, f0, w1, f1, dt), dt, 0.0, jnp.asarray(form.gravity, float))
    now = jax.tree.map(lambda a: a[-1], estimate.state)
    np.testing.assert_allclose(now.position, mine.position, atol=1e-3)
    np.testing.assert_allclose(now.velocity, mine.velocity, atol=1e-3)
    np.testing.assert_allclose(quaternion.local(now.attitude, mine.attitude), 0, atol=1e-4)


# --- consistent -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=["fixes", "ranges"])
def flights(request):
    """60 s, two outages of 8 s; compiled once for each kind of aiding: what changes numbers flies the same program."""
    world = setting(request.param)
    compiled = trimtab.compile(partial(fly, length=60.0, every=5.0), world, np.uint32(0), threads=2)
    return world, compiled


def outside(values, n, flights):
    """Which means (k,) lie outside their band."""
    low, high = band(n, flights)
    return (values < low) | (values > high)


@needs_compiler
@pytest.mark.thorough
def test_nees_over_200_flights_is_consistent(flights):
    """NEES of all 15 and of each block of three; a mean lies outside by chance one time in twenty."""
    world, compiled = flights
    runs = 200
    o = compiled.lanes(world, np.arange(runs, dtype=np.uint32))
    whole, blocks = o.nees.mean(0), o.blocks.mean(0)
    print("\nNEES of all 15:", np.round(whole, 2), "band", np.round(band(15, runs), 2))
    for name, of in zip(BLOCKS, blocks.T, strict=True):
        print(f"{name:>10}:", np.round(of, 2))
    print("band of three:", np.round(band(3, runs), 2))
    assert outside(whole, 15, runs).sum() <= 1
    assert outside(blocks, 3, runs).mean() <= 0.15
    now = np.sqrt((o.now**2).mean(0)) / np.sqrt((o.sigma_now**2).mean(0))
    print("errors now, in sigmas told:", np.round(now.min(), 2), "to", np.round(now.max(), 2))
    assert (now > 0.8).all()
    assert (now < 1.25).all()
    assert (o.rejected.sum(1) <= 2).mean() > 0.97


@needs_compiler
@pytest.mark.thorough
def test_nees_of_each_block_over_800_flights_is_consistent(flights):
    """Twelve instants of one flight are correlated, as a bias changes slowly. The sample is the mean over a flight.

    Flights 1000 to 1799, none of which the test above sees: in the mean 3, within three of its standard errors (5 %).
    """
    world, compiled = flights
    runs = 800
    blocks = [
        compiled.lanes(world, np.arange(k, k + 200, dtype=np.uint32)).blocks for k in range(1000, 1000 + runs, 200)
    ]
    for name, of in zip(BLOCKS, np.moveaxis(np.concatenate(blocks), 2, 0), strict=True):
        each = of.mean(1)
        mean, error = each.mean(), each.std() / np.sqrt(runs)
        parts = np.round(each.reshape(-1, 200).mean(1), 2)
        print(f"{name:>10}: {mean:.3f} ± {error:.3f}; by 200 flights {parts}, ± {error * np.sqrt(runs / 200):.2f}")
        assert abs(mean - 3) < 3 * error
        assert error < 0.06


@needs_compiler
@pytest.mark.thorough
def test_wrong_lever_arm_or_gyro_noise_breaks_consistency(flights):
    """0.5 m off, or gyros ten times noisier: NEES is far outside of the band, so the tests above can fail."""
    world, compiled = flights
    runs = 40
    wrong = world._replace(form=replace(world.form, lever_arm=world.form.lever_arm + np.array([0.0, 0.5, 0.0])))
    noisy = world._replace(imu=replace(world.imu, gyro=replace(world.imu.gyro, noise=np.float64(2e-3))))
    for other in (wrong, noisy):
        whole = compiled.lanes(other, np.arange(runs, dtype=np.uint32)).nees.mean(0)
        print(np.round(whole, 1))
        assert (whole[2:] > band(15, runs)[1]).all()


def turn_sigma(rate):
    """Sigma of the turn about z after 8 s along a straight line or round the path, and at first."""
    path = ClosedPath(
        coordinated=rate, width=0.0 if rate < 0.1 else 20.0, climb=0.0, length=2000.0 if rate < 0.1 else 60.0
    )
    world = setting()._replace(path=to_arrays(path))
    o = jax.jit(partial(fly, length=8.0, every=8.0, rate=rate))(world, np.uint32(3))
    return float(o.sigma[-1, 2])


@pytest.mark.thorough
def test_heading_is_observable_only_in_turns():
    first = SpatialStart().sigma_heading
    straight, turning = turn_sigma(0.01), turn_sigma(LAP)
    print(
        f"sigma of heading: {first / DEG:.1f} deg at first, {straight / DEG:.2f} straight, {turning / DEG:.2f} in turns"
    )
    assert straight > 0.8 * first
    assert turning < 0.15 * first


# --- in flight ------------------------------------------------------------------------------------------------------

STILL = GnssInertial(start=SpatialStart(sigma_heading=0.05), delay=ms(20), slots=32, samples_per_propagation=10)
AT_REST = InertialReading(np.array([0.0, 0.0, -9.80665]), np.zeros(3), np.bool_(False), np.bool_(False))


@partial(jax.jit, compiler_options=QUICK)
def _one(form, t, state, frame):
    return form.step(t, state, frame)


class Bench:
    """A filter at rest on a bench, fed with single samples."""

    def __init__(self, form=STILL):
        self.form, self.state, self.t = form, strengthen_types(form.init(key(0))), 0
        self.fix = replace(new_sample(np.int64(0), GnssReading(np.zeros(3), np.zeros(3))), valid=np.bool_(False))
        self.rng = np.random.default_rng(1)

    def step(self, ticks=1, fix=None, fix_age=0, imu=AT_REST):
        """So many ms; fix: position that comes with the first of them, made fix_age (ms) ago."""
        for i in range(ticks):
            t = np.int64(self.t)
            self.fix = hold_sample(t, self.fix)
            if fix is not None and i == 0:
                value = GnssReading(jnp.asarray(fix, float) + np.asarray(self.form.lever_arm), jnp.zeros(3))
                self.fix = hold_sample(t, new_sample(t - ms(fix_age), value), fresh=True)
            noisy = replace(imu, angular_rate=imu.angular_rate + 1e-4 * self.rng.normal(size=3))
            frame = strengthen_types(Frame(t, {"imu": new_sample(t, noisy), "gnss": self.fix}))
            state, self.estimate = _one(self.form, t, self.state, frame)
            self.state = jax.tree.map(lambda a, b: jnp.asarray(a, jnp.result_type(b)), state, self.state)
            self.t += ms(1)
        return self.estimate.state


@pytest.mark.thorough
def test_estimate_at_rest_follows_fixes_and_becomes_valid():
    bench = Bench()
    told = bench.step(10)
    assert not bench.estimate.valid
    for _ in range(5):
        told = bench.step(30, fix=(1.0, 2.0, 3.0))
    assert bench.estimate.valid
    np.testing.assert_allclose(told.position, [1, 2, 3], atol=0.2)
    assert int(told.gnss_fix.used) == 5
    assert float(told.horizon) == pytest.approx(0.02)
    assert told.healthy
    assert (np.asarray(told.sigma_position) < 0.5).all()


@pytest.mark.thorough
def test_fix_older_than_the_horizon_is_ignored():
    bench = Bench()
    bench.step(100)
    before = bench.step(1).position
    told = bench.step(30, fix=(5.0, 5.0, 5.0), fix_age=40)
    assert int(told.gnss_fix.late) == 1
    assert int(told.gnss_fix.used) == 0
    np.testing.assert_allclose(told.position, before, atol=0.05)


@pytest.mark.thorough
def test_outlier_is_rejected_but_repeated_offset_accepted():
    bench = Bench(replace(STILL, patience=3))
    for _ in range(5):
        bench.step(30, fix=(0, 0, 0))
    told = bench.step(30, fix=(60, 0, 0))
    assert int(told.gnss_fix.rejected) == 1
    assert abs(float(told.position[0])) < 1
    assert float(told.gnss_fix.nis) > STILL.gate
    for _ in range(3):
        told = bench.step(30, fix=(60, 0, 0))
    assert int(told.gnss_fix.forced) == 1
    assert int(told.gnss_fix.rejected) == 3
    assert int(told.gnss_fix.rejected_in_a_row) == 0
    assert abs(float(told.position[0]) - 60) < 3
    assert told.healthy


@pytest.mark.thorough
def test_saturated_gyro_increases_attitude_sigma():
    """The attitude sigma grows at `untrusted_rate` while the gyro is at its limit."""
    sure, unsure = Bench(), Bench()
    full = replace(AT_REST, gyro_saturated=np.bool_(True))
    for bench, imu in ((sure, AT_REST), (unsure, full)):
        bench.step(20)
        bench.step(40, imu=imu)
    a, b = sure.estimate.state, unsure.estimate.state
    assert b.imu.saturated
    grown = np.sqrt(np.asarray(b.sigma_attitude) ** 2 - np.asarray(a.sigma_attitude) ** 2)
    assert (grown > 0.004).all()


@pytest.mark.thorough
def test_imu_outage_invalidates_estimate_and_is_distrusted():
    bench = Bench()
    bench.step(30, fix=(0, 0, 0))
    told = bench.step(30)
    held = bench.estimate.valid
    t = np.int64(bench.t + ms(100))
    frame = strengthen_types(
        Frame(
            t,
            {
                "imu": replace(new_sample(np.int64(bench.t - ms(1)), AT_REST), fresh=False),
                "gnss": hold_sample(t, bench.fix),
            },
        )
    )
    _, estimate = _one(bench.form, t, bench.state, frame)
    assert held
    assert estimate.state.silent
    assert not estimate.valid
    bench.t += ms(100)
    bench.step(1)
    assert float(np.max(bench.state.window.untrusted)) == 1.0
    assert bench.estimate.valid
    assert (np.asarray(told.sigma_velocity) > 0).all()


def test_nan_and_infinite_samples_are_rejected():
    bench = Bench()
    bench.step(30, fix=(0, 0, 0))
    told = bench.step(30, fix=(np.nan, 0, 0))
    assert int(told.gnss.invalid) == 1
    assert int(told.gnss_fix.used) == 1
    told = bench.step(2, imu=replace(AT_REST, specific_force=np.array([np.inf, 0, 0])))
    assert int(told.imu.invalid) == 2
    assert np.isfinite(np.asarray(told.position)).all()


@pytest.mark.parametrize(
    ("changes", "part"),
    [({"slots": 1}, "slots"), ({"samples_per_propagation": 0}, "samples_per_propagation"), ({"gnss": "imu"}, "gnss")],
)
def test_rejects_invalid_parameters(changes, part):
    with pytest.raises(InputError) as e:
        GnssInertial(**changes).check()
    assert e.value.part == part


@pytest.mark.thorough
def test_start_error_of_flights_has_the_drawn_sigmas():
    """The truth of the statistics: its start is off by the sigmas that are drawn, and nothing else."""
    motion = truth(ClosedPath(coordinated=LAP), LAP, ms(1234))
    form = start_of(GnssInertial(), motion, jnp.asarray(np.arange(9.0)) / 10)
    x = first_nominal(form.start, 15)
    e = pose_error(x.attitude, x.velocity, x.position, motion)
    np.testing.assert_allclose(e, np.arange(9.0) / 10 * form.start.sigmas(9), atol=1e-9)
