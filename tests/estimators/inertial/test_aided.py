"""The four forms on one interface: they agree, take late measurements exactly, and survive faults with a flag."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest
from estimators.flights import DT, QUICK, TICK, draws, fly_frames, own_model, ride, ticks, weave

from trimtab.core.errors import InputError
from trimtab.core.record import replace, to_arrays
from trimtab.core.rotation import wrap
from trimtab.core.time import ms
from trimtab.estimators.inertial.aided import Intake, position_numbers, range_numbers
from trimtab.estimators.inertial.coupled import AidedInertialCoupled
from trimtab.estimators.inertial.direct import AidedInertialDirect
from trimtab.estimators.inertial.dual_filter import InertialNoise
from trimtab.estimators.inertial.feedback import AidedInertialFeedback
from trimtab.estimators.inertial.feedforward import AidedInertialFeedforward
from trimtab.estimators.inertial.mechanisation import InertialStart

N = 1000
NOISE = InertialNoise(gyro=1.6e-4, gyro_walk=1e-8, forward=6.7e-3, starboard=6.7e-3, force_walk=1e-8)
START = InertialStart(sigma_gyro_bias=0.02, sigma_force_bias=0.2)
BIASES = (0.012, 0.1, -0.08)
PARTS = {"noise": NOISE, "start": START, "intake": Intake(slots=48)}
FEEDBACK = to_arrays(AidedInertialFeedback(**PARTS))
TRUTH = weave(ticks(N))


def good():
    return ride(TRUTH, NOISE, biases=BIASES)


def flown(sent, form=FEEDBACK):
    told, belief = fly_frames(form, sent.frames(form))
    return jax.tree.map(np.asarray, told.state), jax.tree.map(np.asarray, (told, belief))


def sigmas_off(state, since=200, truth=TRUTH, stale=0):
    """Largest error in its own sigma of heading, north and east, from an instant on; stale: instants to leave out."""
    keep = ~np.isin(np.arange(N), stale) & (np.arange(N) >= since)
    errors = {
        "heading": wrap(state.heading - np.asarray(truth.heading)),
        "north": state.north - np.asarray(truth.position)[:, 0],
        "east": state.east - np.asarray(truth.position)[:, 1],
    }
    return max(np.abs(e / getattr(state, f"sigma_{name}"))[keep].max() for name, e in errors.items())


@pytest.fixture(scope="module")
def undisturbed():
    return flown(good())


@pytest.mark.thorough
def test_errors_stay_within_sigmas_without_faults(undisturbed):
    state, (told, _) = undisturbed
    assert sigmas_off(state) < 4.5
    assert state.sigma_heading[-1] < 0.01
    assert told.valid[1:].all()
    assert state.covariance.positive.all()
    assert (state.covariance.eigenvalue_bound > 0).all()
    assert state.gyro_bias[-1] == pytest.approx(BIASES[0], abs=5 * state.sigma_gyro_bias[-1])
    assert state.position_fix.used[-1] + state.position_fix.rejected[-1] == -(-N // 15)
    np.testing.assert_allclose(told.age, 0.0, atol=1e-12)


@pytest.mark.thorough
def test_all_forms_agree_on_a_linear_model():
    """To 1e-9: the three of the dual filter on any flight, the coupled one once its Jacobian's force is 0."""
    decoupled = AidedInertialCoupled(**PARTS, smoothing=1e15, rest="correct")
    forms = [AidedInertialFeedforward(**PARTS), AidedInertialDirect(**PARTS), decoupled, FEEDBACK]
    run = jax.jit(lambda form: own_model(form, TRUTH, draws(3, N), every=15), compiler_options=QUICK)
    *others, want = [run(to_arrays(form)) for form in forms]
    for form, got in zip(forms, others, strict=False):
        np.testing.assert_allclose(got.x, want.x, atol=1e-9, err_msg=type(form).__name__)
        np.testing.assert_allclose(got.P, want.P, atol=1e-9, err_msg=type(form).__name__)
        np.testing.assert_allclose(got.position_nis, want.position_nis, atol=1e-6)


FORMS = (AidedInertialFeedback, AidedInertialFeedforward, AidedInertialDirect, AidedInertialCoupled)


@pytest.mark.parametrize("made", [FORMS[0], *(pytest.param(f, marks=pytest.mark.thorough) for f in FORMS[1:])])
def test_late_positions_are_fused_when_they_were_measured(made):
    """Delays of 20 to 22 ticks, two of them swapped in order; heading too comes 3 ticks late. Equal to 1e-9."""
    sent = good()
    due = np.flatnonzero(sent.fix_fresh)
    due = due[due + 22 < N - 10]
    last = due[-1] + 22
    comes = due + np.where(np.arange(len(due)) % 3 == 0, 22, 5)  # a third overtaken by the one after it
    fix_t, fix, fresh = sent.fix_t.copy(), sent.fix.copy(), np.zeros(N, bool)
    for k, at in zip(due, comes, strict=True):
        fix_t[at], fix[at], fresh[at] = sent.fix_t[k], sent.fix[k], True
    early = {k for k in np.flatnonzero(sent.fix_fresh) if k not in set(due)}
    in_time = sent._replace(fix_fresh=sent.fix_fresh & ~np.isin(np.arange(N), list(early)))
    late = sent._replace(fix_t=fix_t, fix=fix, fix_fresh=fresh)
    form = to_arrays(made(**PARTS))
    (state, (_, belief)), (_, (_, want)) = flown(late, form), flown(in_time, form)
    assert last < N
    assert form.ANY_ORDER, "so that a real line's late samples are given to it"
    assert state.position_sensor.disordered[-1] > 5
    assert state.position_sensor.late[-1] == 0
    np.testing.assert_allclose(belief.x, want.x, atol=1e-9)
    np.testing.assert_allclose(belief.P, want.P, atol=1e-9)


def test_measurements_too_late_are_counted_and_ignored():
    sent = good()
    sent.fix_t[600] = 10 * TICK
    state, _ = flown(sent)
    assert state.position_sensor.late[-1] == 1
    assert sigmas_off(state) < 4.5


def test_nan_samples_are_flagged_and_not_used():
    sent = good()
    sent.imu_reading[300:303, 1], sent.heading[400], sent.fix[450, 0] = np.nan, np.nan, np.nan
    state, _ = flown(sent)
    assert (state.imu.invalid[-1], state.heading_sensor.invalid[-1], state.position_sensor.invalid[-1]) == (3, 1, 1)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state))
    assert sigmas_off(state) < 4.5


def test_duplicate_samples_are_counted_and_ignored(undisturbed):
    sent = good()
    again = np.arange(N) % 15 == 1
    sent.fix[again], sent.fix_t[again] = sent.fix[np.flatnonzero(again) - 1], sent.fix_t[np.flatnonzero(again) - 1]
    state, (_, belief) = flown(sent._replace(fix_fresh=sent.fix_fresh | again))
    assert state.position_sensor.duplicates[-1] == again.sum()
    np.testing.assert_array_equal(belief.x, undisturbed[1][1].x)


def test_backwards_imu_time_is_flagged_and_grows_covariance():
    sent = good()
    sent.felt_t[700:] -= 400 * TICK
    state, (told, _) = flown(sent)
    assert state.imu.backwards[701:].all()
    assert state.imu.disordered[-1] == N - 700
    assert state.coasting[720:].all()
    assert told.age[-1] == pytest.approx((N - 700) * DT, abs=1e-9)
    assert (np.diff(state.sigma_north[720:]) > 0).all()
    assert (np.diff(state.sigma_heading[720:]) > 0).all()
    assert sigmas_off(state, stale=range(700, 707)) < 4.5  # before it coasts the estimate is of its own age


def test_backwards_autopilot_clock_is_counted():
    sent = good()
    now = sent.now.copy()
    now[500] = now[490]
    state, _ = flown(sent._replace(now=now))
    assert state.clock_backwards[-1] == 1
    assert state.imu.invalid[-1] == 1  # its sample is from the future of that clock
    assert sigmas_off(state) < 4.5


def test_frozen_imu_is_flagged_and_distrusted():
    sent = good()
    sent.imu_reading[600:] = sent.imu_reading[600]
    state, _ = flown(sent)
    assert state.imu.frozen[625:].all()
    assert not state.imu.frozen[:620].any()
    assert sigmas_off(state, 700) < 4.5
    trusting = replace(FEEDBACK, intake=replace(FEEDBACK.intake, frozen_imu=np.int32(0)))
    assert sigmas_off(flown(sent, trusting)[0], 700) > 10


def test_low_pass_lag_of_the_imu_is_compensated():
    """Three samples late in swings of 3 rad/s: without compensation the heading lags beyond its sigma."""
    late, sent = 3, good()
    swing = 3 * np.sin(6 * DT * np.arange(N))
    turned = np.cumsum((swing + np.append(0, swing[:-1])) / 2 * DT)
    sent.imu_reading[:, 0] += swing
    sent.imu_reading[late:] = sent.imu_reading[:-late].copy()
    sent.heading[:, 0] += turned
    heading = np.asarray(TRUTH.heading) + turned
    state, (told, _) = flown(sent, replace(FEEDBACK, intake=replace(FEEDBACK.intake, lag=np.int64(late * TICK))))
    np.testing.assert_allclose(told.age[1:], late * DT, atol=1e-9)
    error = wrap(state.heading - np.roll(heading, late))[200:]
    assert np.abs(error / state.sigma_heading[200:]).max() < 4.5
    behind = wrap(flown(sent)[0].heading - heading)[200:]
    assert np.abs(behind).max() > 4 * np.abs(error).max()


def test_frozen_position_sensor_is_ignored_and_covariance_grows():
    sent = good()
    sent.fix[300:] = sent.fix[300]
    state, _ = flown(sent._replace(fix_fresh=np.arange(N) % 5 == 0))
    assert state.position_sensor.frozen[-1]
    first = np.flatnonzero(state.position_sensor.frozen)[0]
    assert first <= 360
    assert (np.diff(state.sigma_north[first + 1 :]) > 0).all()
    assert sigmas_off(state, 700) < 6


def test_position_outage_grows_covariance_and_recovers():
    sent = good()
    gone = (np.arange(N) > 300) & (np.arange(N) < 900)
    state, _ = flown(sent._replace(fix_fresh=sent.fix_fresh & ~gone))
    assert (np.diff(state.sigma_north[320:890]) > 0).all()
    assert state.sigma_north[890] > 5 * state.sigma_north[300]
    assert sigmas_off(state) < 4.5
    assert abs(state.north[-1] - float(TRUTH.position[-1, 0])) < 0.06
    assert state.position_fix.rejected[-1] == 0


def test_saturated_gyro_is_flagged_without_corrupting_bias():
    """Turning at 1.5 rad/s beyond its range for 1 s; the source's filter put the difference into the bias."""
    sent, extra = good(), np.zeros(N)
    extra[500:650] = 7.0
    limit = float(FEEDBACK.intake.rate_range)
    sent.imu_reading[:, 0] = np.clip(sent.imu_reading[:, 0] + extra, -limit, limit)
    turned = np.cumsum((extra + np.append(0, extra[:-1])) / 2 * DT)
    sent.heading[:, 0] += turned
    truth = TRUTH._replace(heading=np.asarray(TRUTH.heading) + turned)
    sent.imu_reading[:, 1:] -= np.asarray(TRUTH.imu_reading)[:, 1:]
    c, s = np.cos(-turned), np.sin(-turned)
    fx, fy = np.asarray(TRUTH.imu_reading)[:, 1:].T
    sent.imu_reading[:, 1:] += np.stack([c * fx - s * fy, s * fx + c * fy], axis=1)
    state, _ = flown(sent)
    assert state.imu.saturated[505:645].mean() > 0.9
    assert not state.imu.saturated[:495].any()
    assert np.abs(state.gyro_bias[500:] - BIASES[0]).max() < 5 * state.sigma_gyro_bias[499]
    assert sigmas_off(state, truth=truth) < 5
    trusting = replace(FEEDBACK, intake=replace(FEEDBACK.intake, rate_range=np.float64(100.0)))
    naive, _ = flown(sent, trusting)
    assert np.abs(naive.heading - truth.heading)[500:].max() > 0.5  # the gate shuts the magnetometer out instead


def test_disturbed_compass_is_rejected_and_flagged():
    sent = good()
    sent.heading[500:800] += 0.6
    state, _ = flown(sent)
    assert state.heading_fix.rejected_in_a_row[799] > 290
    assert state.heading_fix.rejected_in_a_row[-1] == 0
    assert (np.diff(state.sigma_heading[505:799]) > 0).all()
    assert sigmas_off(state) < 4.5


def test_persistent_position_offset_is_finally_accepted_and_flagged():
    """A beacon moved by 0.5 m: five fixes are rejected, then the filter accepts them with a larger covariance."""
    sent = good()
    moved = np.arange(N) >= 400
    sent.fix[moved] += np.array([0.5, 0.0])
    state, _ = flown(sent)
    assert state.position_fix.rejected_in_a_row.max() == 5
    assert state.position_fix.forced[-1] == 1
    first = np.flatnonzero(state.position_fix.forced)[0]
    assert state.sigma_north[first] > state.sigma_north[399]
    truth = TRUTH._replace(position=np.asarray(TRUTH.position) + np.array([0.5, 0.0]))
    assert sigmas_off(state, first + 30, truth) < 4.5
    stubborn = replace(FEEDBACK, intake=replace(FEEDBACK.intake, patience_position=np.int32(0)))
    alone, _ = flown(sent, stubborn)
    assert alone.position_fix.rejected_in_a_row.max() > 5
    in_a_row = alone.position_fix.rejected_in_a_row[405:]
    until = 405 + int(np.argmax(in_a_row == 0))  # when the gate has opened by itself
    assert (np.diff(alone.sigma_north[405:until]) > 0).all()


def test_ten_percent_position_outliers_are_rejected():
    """Of 10 Hz fixes, by up to 3 m (here of positions)."""
    sent, g = good(), np.random.default_rng(5)
    due = np.flatnonzero(sent.fix_fresh)
    bad = due[g.random(len(due)) < 0.1]
    bad = bad[bad > 100]
    sent.fix[bad] += g.uniform(-3, 3, (len(bad), 2))
    state, _ = flown(sent)
    assert len(bad) > 3
    assert state.position_fix.rejected[-1] >= len(bad) - 1
    assert state.position_fix.forced[-1] == 0
    assert sigmas_off(state) < 4.5


def test_lever_arms_are_taken_into_account():
    """IMU and aided point away from the reference: the same errors as without; ignored, far larger ones."""
    arms = {"imu": np.array([0.2, -0.1]), "aiding": np.array([-0.3, 0.25])}
    phi, rate = np.asarray(TRUTH.heading), np.asarray(TRUTH.imu_reading)[:, 0]
    alpha = np.gradient(rate, DT)
    c, s = np.cos(phi), np.sin(phi)
    sent = good()
    lx, ly = arms["imu"]
    sent.imu_reading[:, 1] += -alpha * ly - rate**2 * lx
    sent.imu_reading[:, 2] += alpha * lx - rate**2 * ly
    ax, ay = arms["aiding"]
    sent.fix[:] += np.stack([c * ax - s * ay, s * ax + c * ay], axis=1)
    form = replace(FEEDBACK, arms=replace(FEEDBACK.arms, **arms))
    state, _ = flown(sent, form)
    assert sigmas_off(state) < 4.5
    assert sigmas_off(flown(sent)[0]) > 8


def test_estimate_is_invalid_before_all_sensors_arrive():
    sent = good()
    sent = sent._replace(heading_fresh=np.arange(N) >= 20, fix_fresh=sent.fix_fresh & (np.arange(N) >= 30))
    _, (told, _) = flown(sent)
    assert not told.valid[:30].any()
    assert told.valid[31:].all()


@pytest.mark.parametrize(
    ("intake", "match"),
    [
        (Intake(slots=2), "must be at least"),
        (Intake(imu=""), "a name of its own"),
        (Intake(heading="imu"), "a name of its own"),
    ],
)
def test_rejects_invalid_intake(intake, match):
    with pytest.raises(InputError, match=match):
        AidedInertialFeedback(intake=intake).check()
    AidedInertialFeedback(intake=Intake(heading="")).check()


def test_imu_gap_is_bridged_with_growing_covariance():
    sent = good()
    state, _ = flown(sent._replace(felt_fresh=(np.arange(N) < 600) | (np.arange(N) >= 640)))
    assert float(FEEDBACK.intake.gap) == ms(40)
    assert state.coasting[610:639].all()
    assert not state.coasting[641:].any()
    assert state.sigma_heading[638] > 10 * state.sigma_heading[599]
    assert sigmas_off(state, stale=range(600, 607)) < 4.5


def test_position_variance_defaults_to_the_noise_model():
    def numbers(**variance):
        return [float(x) for x in position_numbers(SimpleNamespace(north=1.0, east=2.0, **variance))]

    assert numbers() == [1.0, 2.0, 0.0, 0.0, 0.0]
    assert numbers(variance=0.5) == [1.0, 2.0, 0.5, 0.0, 0.5]
    assert numbers(variance=np.array([[0.5, 0.1], [0.1, 0.3]])) == [1.0, 2.0, 0.5, 0.1, 0.3]
    noise, R = InertialNoise(), np.array([[0.5, 0.1], [0.1, 0.3]])
    np.testing.assert_array_equal(noise.position_noise(R), R)
    np.testing.assert_array_equal(noise.position_noise(0.5), 0.5 * np.eye(2))
    for none in (0.0, np.zeros((2, 2))):
        np.testing.assert_array_equal(noise.position_noise(none), noise.position * np.eye(2))


def test_invalid_and_missing_ranges_are_distinguished():
    sent = SimpleNamespace(
        range=np.array([3.0, np.nan, 3.2, 0.0, np.inf]), arrived=np.array([True, True, False, True, True]), unit=1
    )
    assert [float(v) for v in range_numbers(sent)] == [3.0, -1.0, 0.0, -1.0, -1.0, 1.0]
