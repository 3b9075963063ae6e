"""Raw ranges in a particle filter: any start, two beacons, outliers, silence, faults."""

from functools import partial

import jax
import numpy as np
import pytest
from estimators import range_flights as rf

from trimtab.compiler.function import lower_function
from trimtab.core.errors import InputError
from trimtab.core.interfaces import Estimator
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import key
from trimtab.core.rotation import wrap
from trimtab.core.time import ms, seconds
from trimtab.estimators.inertial.aided import Intake
from trimtab.estimators.inertial.mechanisation import InertialStart
from trimtab.estimators.ranging.particle import Particle
from trimtab.loop.structure import strengthen_types

START = InertialStart(sigma_gyro_bias=np.deg2rad(0.7), sigma_force_bias=0.1)
FORM = to_arrays(Particle(noise=rf.IMU, start=START, units=rf.LEVERS, N=120))
FLIGHT = rf.plan(rf.platform, 6.0)


@partial(jax.jit, compiler_options=rf.SWIFT)
def _fly(frames, run):
    def step(state, frame):
        return FORM.step(frame.t, state, frame)

    return jax.lax.scan(step, strengthen_types(FORM.init(replace(key(1), run=run))), frames)[1]


def flown(run, sensor=None, spoil=None):
    sensor = to_arrays(rf.network() if sensor is None else sensor)
    imu_reading, _ = rf.inertial(FLIGHT, run)
    replies, last = _pings(sensor, run)
    replies = jax.tree.map(np.array, replies)
    frames = rf.late_frames(FORM, FLIGHT, imu_reading, replies, np.minimum(last, 0.09))
    frames = frames if spoil is None else spoil(frames)
    return jax.tree.map(np.asarray, _fly(frames, np.uint32(run)))


@partial(jax.jit, compiler_options=rf.SWIFT)
def _pings(sensor, run):
    return rf.pings(sensor, FLIGHT, run)


def errors(told, since):
    true, s = FLIGHT.imu_reading, told.state
    late = FLIGHT.ticks >= seconds(since)
    place = np.hypot(s.north - true.position[:, 0], s.east - true.position[:, 1])[late]
    return np.abs(wrap(s.heading - np.asarray(true.heading)))[late], place


def silent(begin, end, who=True):
    def spoil(frames):
        ping = frames.samples["ranging"]
        gone = ((ping.t > seconds(begin)) & (ping.t <= seconds(end)))[:, None] & np.broadcast_to(who, 4)
        value = replace(ping.value, arrived=ping.value.arrived & ~gone)
        return replace(frames, samples=frames.samples | {"ranging": replace(ping, value=value)})

    return spoil


@pytest.mark.thorough
@pytest.mark.parametrize("run", range(2))
def test_filter_converges_from_any_heading(run):
    told = flown(run)
    heading, place = errors(told, 2)
    assert np.argmax(told.valid) < 153
    assert told.valid[300:].all()
    assert np.rad2deg(heading.max()) < 2
    assert place.max() < 0.03
    fix = told.state.position_fix
    assert fix.starts[-1] == 1
    assert fix.redrawn[-1] > 0
    assert (fix.effective[300:] > 10).all()
    assert told.state.covariance.positive[100:].all()


@pytest.mark.thorough
@pytest.mark.parametrize("run", range(2))
def test_two_beacons_suffice_for_a_start(run):
    """Two ranges allow two places; the gyro decides between them. No position fix is possible here."""
    told = flown(run, spoil=silent(-1, 99, ~rf.TWO_LEFT))
    heading, place = errors(told, 3)
    assert not told.valid[:100].any()
    assert told.valid[-300:].all()
    assert np.rad2deg(heading.max()) < 3
    assert place.max() < 0.08


@pytest.mark.thorough
def test_error_stays_small_with_range_outliers():
    """10 % of the ranges wrong by up to 3 m."""
    for run in (0, 1):
        heading, place = errors(flown(run, sensor=rf.strays()), 3)
        assert np.rad2deg(heading.max()) < 2
        assert place.max() < 0.04


@pytest.mark.thorough
def test_range_outage_grows_sigma_and_recovers():
    """2.5 s without ranges: the cloud follows the IMU, also where that is longer than what is remembered of it."""
    told = flown(0, spoil=silent(2.0, 4.5))
    wide = told.state.sigma_north
    t = FLIGHT.ticks
    assert wide[np.searchsorted(t, seconds(4.4))] > 3 * wide[np.searchsorted(t, seconds(2.0))]
    assert errors(told, 5)[1].max() < 0.03
    gap = (t > seconds(2.2)) & (t < seconds(4.4))
    off = np.hypot(*(np.stack([told.state.north, told.state.east], 1) - np.asarray(FLIGHT.imu_reading.position)).T)
    assert (off[gap] < 4 * np.hypot(wide, told.state.sigma_east)[gap]).all()


@pytest.mark.thorough
def test_nan_duplicate_and_backwards_samples_are_flagged():
    def spoil(frames):
        ping = frames.samples["ranging"]
        at = np.flatnonzero(ping.fresh)
        twice, t = ping.fresh.copy(), ping.t.copy()
        twice[at[10:20] + 1] = True
        spoilt = np.array(ping.value.range)
        spoilt[at[30] : at[31], 2] = np.nan
        twice[at[40] + 2] = True
        t[at[40] + 2] -= ms(400)
        now = frames.t.copy()
        now[500] = now[400]
        bad = replace(ping, fresh=twice, t=t, value=replace(ping.value, range=spoilt))
        return replace(frames, t=now, samples=frames.samples | {"ranging": bad})

    told = flown(0, spoil=spoil)
    state = told.state
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state))
    assert state.position_sensor.duplicates[-1] == 10
    assert state.position_sensor.late[-1] == 1
    assert state.clock_backwards[-1] == 1
    assert errors(told, 2)[1].max() < 0.03


@pytest.mark.thorough
def test_step_lowers_to_generated_c():
    form = to_arrays(replace(FORM, N=8, intake=replace(FORM.intake, slots=8)))
    frame = jax.tree.map(
        lambda leaf: leaf[0],
        rf.late_frames(
            form, FLIGHT, np.zeros((len(FLIGHT.ticks), 3)), _pings(to_arrays(rf.network()), 0)[0], np.full(59, 0.05)
        ),
    )
    assert lower_function(lambda s, f: form.step(f.t, s, f), (strengthen_types(form.init(key(0))), frame)).text("f")


def test_rejects_invalid_parameters():
    form = Particle()
    form.check()
    assert isinstance(form, Estimator)
    assert form.listens == ("imu", "ranging")
    for changes, problem in (
        ({"N": 1}, "N"),
        ({"beacons": np.zeros(3)}, "beacons"),
        ({"intake": Intake(position="ranging")}, "intake"),
    ):
        with pytest.raises(InputError, match=problem):
            replace(form, **changes).check()
