"""The filter on odometry and ranges, against a dense one written here and against drives whose errors it knows."""

import functools

import jax
import numpy as np
import pytest
from estimators.odometry_drives import BEACONS, DRIVE, drive, frames_of

from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.rng import key
from trimtab.core.time import seconds
from trimtab.estimators.ranging.odometry import (
    COURSE,
    ERRORS,
    SCALE,
    TURN_BIAS,
    OdometryMotion,
    OdometryNoise,
    OdometryRanging,
    PlanarStart,
    RadioErrors,
    initial_belief,
    predict_odometry,
)
from trimtab.logs.consistency import chi_square_bounds

FILTER = OdometryRanging(
    noise=OdometryNoise(slip=0.05, turn=3e-3, bias_walk=1e-4),
    errors=RadioErrors(noise=0.2, scale=0.05, sigma_scale=0.02, sigma_error=0.1),
    start=PlanarStart(heading=0.3, north=1.0, east=-2.0),
    beacons=BEACONS,
)


@functools.cache
def program():
    def fly(estimator, frames):
        return jax.lax.scan(lambda s, f: estimator.step(f.t, s, f), estimator.init(key(0)), frames)

    return jax.jit(fly)


def run(frames, estimator=FILTER):
    """Last state, and the estimates of every step."""
    return program()(estimator, frames)


def dense(frames, f):
    """The same filter, one reading after the other, in numpy; last state and covariance."""
    n = len(BEACONS)
    x = np.zeros(6 + n)
    x[:3], x[SCALE] = (f.start.heading, f.start.north, f.start.east), f.errors.scale
    sigmas = [f.start.sigma_heading, f.start.sigma_position, f.start.sigma_position, f.start.sigma_turn_bias]
    P = np.diag([*sigmas, f.start.sigma_course, f.errors.sigma_scale, *[f.errors.sigma_error] * n]) ** 2
    odometry, ranging = (frames.samples[name] for name in ("odometry", "ranging"))
    last, speed, rate = None, 0.0, 0.0
    for k in range(len(frames.t)):
        if odometry.fresh[k]:
            now = odometry.t[k] * 1e-7, odometry.value.distance[k], odometry.value.turn[k]
            if last is not None:
                dt, way, turn = np.subtract(now, last)
                speed, rate = way / dt, turn / dt

                def move(v, dt=dt, way=way, turn=turn):
                    angle = turn - v[TURN_BIAS] * dt
                    c = v[0] + v[COURSE] + angle / 2
                    return np.concatenate([[v[0] + angle, v[1] + way * np.cos(c), v[2] + way * np.sin(c)], v[3:]])

                F = np.stack([(move(x + h) - move(x - h)) / 2e-6 for h in 1e-6 * np.eye(len(x))], axis=1)
                q = np.zeros(len(x))
                q[:4] = f.noise.turn**2 * dt, f.noise.slip**2 * way, f.noise.slip**2 * way, f.noise.bias_walk**2 * dt
                x, P = move(x), F @ P @ F.T + np.diag(q)
            last = now
        if ranging.fresh[k] and last is not None:
            ahead = (ranging.t[k] - odometry.t[k]) * 1e-7
            for i in np.flatnonzero(ranging.value.arrived[k]):

                def predict(v, i=i, ahead=ahead, speed=speed, rate=rate):
                    c = v[0] + v[COURSE] + (rate - v[TURN_BIAS]) * ahead / 2
                    away = v[1:3] + speed * ahead * np.array([np.cos(c), np.sin(c)]) - BEACONS[i, :2]
                    return (1 + v[SCALE]) * np.sqrt(away @ away + BEACONS[i, 2] ** 2) + v[ERRORS + i]

                H = np.array([(predict(x + h) - predict(x - h)) / 2e-6 for h in 1e-6 * np.eye(len(x))])
                y, S = ranging.value.range[k, i] - predict(x), H @ P @ H + f.errors.noise**2
                if y * y <= f.errors.gate * S:
                    K = P @ H / S
                    x, P = x + K * y, P - np.outer(K, K) * S
    return x, P


@pytest.mark.thorough
def test_filter_matches_dense_numpy_filter():
    """Derivatives by differences, covariance by its shortest formula: nothing is shared but the model."""
    frames = frames_of(drive(seed=1))
    state, _ = run(frames)
    x, P = dense(frames, FILTER)
    np.testing.assert_allclose(state.x, x, atol=2e-6)
    np.testing.assert_allclose(state.P, P, atol=1e-6 * np.max(P))


def nees(world, estimates):
    """e' P^-1 e of the place at every step (n,)."""
    s = estimates.state
    e = np.stack([s.north - world.north, s.east - world.east])
    a, b, c = s.sigma_north**2, s.covariance_north_east, s.sigma_east**2
    return np.asarray((c * e[0] ** 2 - 2 * b * e[0] * e[1] + a * e[1] ** 2) / (a * c - b * b))


@pytest.mark.thorough
def test_nees_is_consistent_over_50_drives():
    """Drives with the errors that the filter assumes, at four instants far from each other."""
    values = []
    for seed in range(50):
        world = drive(seed)
        values.append(nees(world, run(frames_of(world))[1])[DRIVE // 4 - 1 :: DRIVE // 4])
    mean, (low, high) = np.mean(values, axis=0), chi_square_bounds(2, len(values), 0.999)
    assert ((low < mean) & (mean < high)).all(), (low, mean, high)


@pytest.mark.thorough("slip-0.2", "scale-0.0")
@pytest.mark.parametrize(("what", "worse"), [("slip", 0.2), ("noise", 0.3), ("scale", 0.0)])
def test_optimistic_noise_model_breaks_consistency(what, worse):
    """NEES exceeds 3 for a filter that underestimates one error."""
    part = "noise" if what == "slip" else "errors"
    old = getattr(FILTER, part)
    new = (
        replace(old, scale=0.0, sigma_scale=1e-4)
        if what == "scale"
        else replace(old, **{what: worse * getattr(old, what)})
    )
    estimator = replace(FILTER, **{part: new})
    values = [nees(w, run(frames_of(w), estimator)[1])[DRIVE // 2 :].mean() for w in map(drive, range(10))]
    assert np.mean(values) > 3.0


def test_range_outliers_are_rejected():
    world = drive(3)
    wild = np.random.default_rng(0).random(world.range.shape) < 0.1
    spoilt = world._replace(range=np.where(world.arrived & wild, world.range + 5.0, world.range))
    state, estimates = run(frames_of(spoilt))
    assert int(state.fix.rejected) == pytest.approx(np.sum(world.arrived & wild), abs=3)
    error = np.hypot(estimates.state.north - world.north, estimates.state.east - world.east)
    assert np.max(error) < 1.5


def position_error(world, estimates):
    return np.hypot(np.asarray(estimates.state.north) - world.north, np.asarray(estimates.state.east) - world.east)


def with_ranges(world, change):
    """The drive with changed ranges (DRIVE, 4) where one came."""
    return world._replace(range=np.where(world.arrived, world.range + change, 0.0))


LATE = (np.arange(DRIVE) >= DRIVE // 2)[:, None]


@pytest.mark.parametrize(
    ("away", "turn"),
    [(14.0, 0.0), (10.0, 1.0), (10.0, 3.0)],
    ids=["14 m and 0 rad", "10 m and 1 rad", "10 m and 3 rad"],
)
def test_consistent_rejected_ranges_restart_the_filter(away, turn):
    """The vehicle stands elsewhere, with another heading."""
    start = replace(FILTER.start, north=FILTER.start.north + away, heading=FILTER.start.heading + turn)
    for seed in (4, 5):
        world = drive(seed)
        state, estimates = run(frames_of(world), replace(FILTER, start=start))
        assert int(state.fix.restarts) == 1
        assert position_error(world, estimates)[-1] < 1.0
        assert np.median(nees(world, estimates)[DRIVE // 2 :]) < 4.0
    never = replace(FILTER, start=start, errors=replace(FILTER.errors, patience=0))
    assert int(run(frames_of(world), never)[0].fix.restarts) == 0


@pytest.mark.parametrize("seed", range(8))
def test_ranges_through_walls_do_not_restart_the_filter(seed):
    """Half of the ranges are 2 to 8 m too long."""
    world, rng = drive(seed), np.random.default_rng(1000 + seed)
    wall = rng.random(world.range.shape) < 0.5
    spoilt = with_ranges(world, np.where(wall, rng.uniform(2, 8, wall.shape), 0.0))
    state, estimates = run(frames_of(spoilt))
    assert int(state.fix.rejected) > 100
    assert int(state.fix.restarts) == 0
    assert np.sqrt(np.mean(position_error(world, estimates) ** 2)) < 0.6


def test_outliers_of_all_beacons_in_a_row_do_not_restart_the_filter():
    world, rng = drive(3), np.random.default_rng(0)
    rows = np.flatnonzero(world.arrived.any(axis=1))[30:54]
    change = np.zeros(world.range.shape)
    change[rows] = 7.0 * rng.uniform(0.3, 1, (len(rows), 4))
    state, estimates = run(frames_of(with_ranges(world, change)))
    assert int(state.fix.restarts) == 0
    assert int(state.fix.rejected) >= 24
    assert position_error(world, estimates).max() < 1.5
    # While the newest twelve ranges were all rejected, the estimate is not valid. It is valid again afterwards.
    in_a_row = np.asarray(estimates.state.position_fix.rejected_in_a_row)
    known = np.maximum.accumulate(np.asarray(frames_of(world).samples["odometry"].fresh))
    np.testing.assert_array_equal(estimates.valid, known & (in_a_row < 12))
    assert 0 < np.sum(in_a_row >= 12) < 100
    assert estimates.valid[-1]


def test_without_restarts_sixteen_rejected_ranges_make_the_estimate_invalid():
    """The vehicle starts 14 m from where the filter starts, and the filter may not restart."""
    start = replace(FILTER.start, north=FILTER.start.north + 14.0)
    never = replace(FILTER, start=start, errors=replace(FILTER.errors, patience=0))
    _, estimates = run(frames_of(drive(4)), never)
    in_a_row = np.asarray(estimates.state.position_fix.rejected_in_a_row)
    assert in_a_row.max() > 16
    assert not np.any(np.asarray(estimates.valid) & (in_a_row >= 16))
    assert np.all(np.asarray(estimates.valid)[(in_a_row > 0) & (in_a_row < 16)])


def test_one_moved_beacon_does_not_restart_the_filter():
    world = drive(3)
    state, estimates = run(frames_of(with_ranges(world, 6.0 * LATE * (np.arange(4) == 1))))
    assert int(state.fix.restarts) == 0
    assert int(state.fix.beacon_rejected_in_a_row[1]) > 30
    assert position_error(world, estimates).max() < 1.5


def test_temporary_offset_of_all_beacons_is_survived():
    """5 m for 20 s: most ranges are rejected, and the position is right again after the offset."""
    world = drive(3)
    while_it_lasts = LATE & (np.arange(DRIVE) < DRIVE // 2 + 200)[:, None]
    state, estimates = run(frames_of(with_ranges(world, 5.0 * while_it_lasts)))
    assert int(state.fix.rejected) >= 20
    assert position_error(world, estimates)[-1] < 1.0


def test_two_beacons_do_not_restart_the_filter():
    """Two fall silent after a rejected range each; those of the other two fit a place 10 m beside the vehicle."""
    world, k = drive(3), np.arange(DRIVE)
    place = np.stack([world.north, world.east], axis=1)[:, None]
    beside = 10.0 / np.sqrt(2)

    def distance(p):
        return np.sqrt(np.sum((p - BEACONS[:, :2]) ** 2, axis=2) + BEACONS[:, 2] ** 2)

    silent = world.arrived & (k[:, None] >= DRIVE // 2 + 16) & (np.arange(4) >= 2)
    wrong = np.where(np.arange(4) < 2, 1.05 * (distance(place + beside) - distance(place)), -7.0)
    moved = with_ranges(world, wrong * LATE)
    state, _ = run(frames_of(moved._replace(arrived=world.arrived & ~silent)))
    assert (np.asarray(state.fix.beacon_rejected_in_a_row)[2:] > 0).all()
    assert int(state.fix.restarts) == 0


@pytest.mark.parametrize("patience", [1, 5, 17])
def test_rejects_invalid_restart_patience(patience):
    with pytest.raises(InputError, match=f"must be 0, or 6 to 16, got {patience}"):
        replace(FILTER, errors=replace(FILTER.errors, patience=patience)).check()


def test_nan_and_late_samples_are_not_used():
    frames = frames_of(drive(5))
    ranging, odometry = frames.samples["ranging"], frames.samples["odometry"]
    k = int(np.flatnonzero(ranging.fresh)[20])
    clean, _ = run(frames)

    def with_samples(**changes):
        return replace(frames, samples={**frames.samples, **changes})

    broken = ranging.value.range.copy()
    broken[k] = np.nan
    state, _ = run(with_samples(ranging=replace(ranging, value=replace(ranging.value, range=broken))))
    assert int(state.fix.used) == int(clean.fix.used) - 1
    assert np.isfinite(state.x).all()
    late = ranging.t.copy()
    late[k] -= seconds(5)
    state, _ = run(with_samples(ranging=replace(ranging, t=late)))
    assert int(state.fix.late) == 1
    j = int(np.flatnonzero(odometry.fresh)[30])
    distance = odometry.value.distance.copy()
    distance[j] = np.inf
    state, _ = run(with_samples(odometry=replace(odometry, value=replace(odometry.value, distance=distance))))
    assert np.isfinite(state.x).all()
    np.testing.assert_allclose(state.x[:3], clean.x[:3], atol=0.1)


def test_lost_odometry_readings_lose_no_distance():
    frames = frames_of(drive(6)._replace(arrived=np.zeros((DRIVE, 4), bool)))
    odometry = frames.samples["odometry"]
    fewer = odometry.fresh & (np.arange(DRIVE) % 3 == 2)
    fewer[[0, -1]] = True
    held = np.maximum.accumulate(np.where(fewer, np.arange(DRIVE), 0))
    thin = jax.tree.map(lambda v: v[held], replace(odometry, fresh=None))
    full, _ = run(frames)
    thinned, _ = run(replace(frames, samples={**frames.samples, "odometry": replace(thin, fresh=fewer)}))
    np.testing.assert_allclose(thinned.x[:3], full.x[:3], atol=0.02)


def test_rejects_beacons_of_wrong_shape():
    with pytest.raises(InputError, match="beacons"):
        OdometryRanging(beacons=np.zeros((4, 2))).check()


@pytest.mark.thorough
def test_implausible_odometry_jump_is_distrusted():
    """A counter jumps by 0.8 m in a tenth of a second: the filter says so, instead of being wrong and sure."""
    world = drive(7)
    jump = np.where(np.arange(DRIVE) >= DRIVE // 2, 0.8, 0.0)
    frames = frames_of(world._replace(distance=world.distance + jump))
    near = slice(DRIVE // 2, DRIVE // 2 + 40)
    honest = nees(world, run(frames)[1])[near]
    trusting = replace(FILTER, noise=replace(FILTER.noise, grip=np.float64(1e3)))
    blind = nees(world, run(frames, trusting)[1])[near]
    assert honest.max() < 16.0 < blind.max()


def test_driving_backwards_adds_same_noise_as_forwards():
    """Slip of 0.05 m/sqrt(m) over 4 m: 0.01 m^2 in each coordinate, either way."""
    x, P = initial_belief(FILTER.start, FILTER.errors, len(BEACONS))
    P = 0 * P
    predict = jax.jit(lambda distance: predict_odometry(x, P, OdometryMotion(distance, 0.0, 1.0, 0.0), FILTER.noise))
    for distance in (4.0, -4.0):
        _, after = predict(distance)
        np.testing.assert_allclose(np.diag(after)[1:3], 0.01, rtol=1e-12)
