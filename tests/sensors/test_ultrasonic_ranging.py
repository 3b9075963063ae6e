import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.compiler.function import lower_function
from trimtab.core.errors import InputError
from trimtab.core.imperfections import imperfections, without
from trimtab.core.interfaces import Sensor
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import Key
from trimtab.core.signals import Motion
from trimtab.core.time import ms, seconds
from trimtab.environment.acoustics import Air
from trimtab.sensors.time_of_flight import CEILING_SQUARE, Beacons, Medium, RangeErrors
from trimtab.sensors.ultrasonic_ranging import UltrasonicRanging, UnitClock

ONE = UltrasonicRanging(units=np.array([[0.1, 0.0, 0.0]]))
TWO = replace(ONE, units=np.array([[0.15, 0, 0], [-0.15, 0, 0]]), clients=2)
SPEED = np.array([0.5, -0.2, 0.0])
PERFECT = replace(ONE, errors=RangeErrors(noise=0.0), clock=UnitClock(0.0, 0.0, 0.0), beacons=Beacons(crystal=0.0))


def motion(t):
    s = t * 1e-7
    o = jnp.zeros(3)
    return Motion(t, SPEED * s, o, jnp.asarray(SPEED), o, o, o)


@jax.jit
def _flown(sensor, run, times):
    def body(state, t):
        return sensor.step(t, state, motion(t))

    return jax.lax.scan(body, sensor.init(Key(np.uint32(1), run)), times)[1]


def flown(sensor, duration=20_000_000, run=0):
    """Every sample of a run, and the times of the steps."""
    times = np.arange(0, duration, sensor.period)
    return times, jax.tree.map(np.asarray, _flown(to_arrays(sensor), np.uint32(run), times))


@pytest.fixture(scope="module")
def run():
    return flown(TWO)


@pytest.mark.thorough
def test_pings_at_slots_and_delivers_after_last_reply(run):
    times, samples = run
    new = samples.fresh
    np.testing.assert_array_equal(samples.t[new], np.arange(new.sum()) * ms(100))
    late = (times - samples.t)[new] * 1e-7
    assert late.min() > 0.02
    assert late.max() <= 0.1
    assert late[samples.value.arrived[new].sum(1) == 4].mean() == pytest.approx(0.072, abs=0.009)
    np.testing.assert_allclose(samples.age[samples.valid], (times - samples.t)[samples.valid] * 1e-7, atol=1e-12)
    assert not samples.valid[: ms(20) // TWO.period].any()


@pytest.mark.thorough
def test_units_ping_in_alternation(run):
    _, samples = run
    new = samples.fresh
    np.testing.assert_array_equal(samples.value.unit[new], np.arange(new.sum()) % 2)


@pytest.mark.thorough
def test_slots_of_other_clients_are_left_free():
    _, samples = flown(replace(TWO, clients=10, period=ms(10)), ms(3000))
    np.testing.assert_array_equal(samples.t[samples.fresh], np.array([0, 1, 10, 11, 20, 21]) * ms(100))


@pytest.mark.thorough
def test_ideal_sample_equals_measure_at_ping_time():
    """At the time of the ping, not of the reply: the ranges that h(x) has there."""
    _, samples = flown(replace(PERFECT, collisions=False))
    assert samples.fresh.sum() >= 19
    for i in np.flatnonzero(samples.fresh):
        expected = PERFECT.measure(motion(samples.t[i]))
        np.testing.assert_allclose(samples.value.range[i], expected.range, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(samples.value.arrived[i], expected.arrived)
    straight = replace(PERFECT, cone_error=False).measure(motion(seconds(1)))
    at = SPEED + np.array([0.1, 0, 0])
    np.testing.assert_allclose(straight.range, np.linalg.norm(CEILING_SQUARE - at, axis=1), atol=1e-12)


@pytest.mark.thorough
def test_measure_has_a_finite_jacobian_along_the_lines():
    slope = jax.jacfwd(lambda p: PERFECT.measure(replace(motion(0), p_WB=p)).range)(jnp.zeros(3))
    assert np.isfinite(slope).all()
    line = np.array([0.1, 0, 0]) - CEILING_SQUARE
    beta = np.arccos(line[:, 2] / np.linalg.norm(line, axis=1))
    assert abs(np.asarray(slope) - line / np.linalg.norm(line, axis=1)[:, None]).max() < 0.08
    assert beta.max() < np.pi / 4


@jax.jit
def _pings(sensor, runs):
    def one(run):
        return sensor.ping(np.int64(0), Key(np.uint32(2), run), motion(np.int64(0)))

    return jax.vmap(one)(runs)


def pings(sensor, runs=4000):
    return jax.tree.map(np.asarray, _pings(to_arrays(sensor), np.arange(runs, dtype=np.uint32)))


@pytest.mark.thorough
def test_range_noise_has_the_given_deviation():
    replies, last = pings(replace(PERFECT, errors=RangeErrors(noise=0.01)))
    error = np.where(replies.arrived, replies.range - np.asarray(PERFECT.measure(motion(0)).range), np.nan)
    assert np.nanstd(error) == pytest.approx(0.01, rel=0.03)
    assert np.asarray(last).max() <= 0.1
    assert (replies.range[~replies.arrived] == 0).all()
    assert (replies.arrived.sum(1) >= 3).mean() == pytest.approx(0.85, abs=0.03)


@pytest.mark.thorough
def test_clock_error_shifts_the_ping_along_the_motion():
    """A ping 10 ms late is made 5 mm further on."""
    late = replace(PERFECT, clock=UnitClock(residual=0.0, drift=0.0, tick=0.02), collisions=False)
    replies, _ = pings(late)
    slope = jax.jacfwd(lambda p: PERFECT.measure(replace(motion(0), p_WB=p)).range)(jnp.zeros(3)) @ SPEED
    lateness = (replies.range - np.asarray(PERFECT.measure(motion(0)).range)) / np.asarray(slope)
    assert lateness.min() > -1e-4
    assert lateness.max() == pytest.approx(0.02, rel=0.01)
    assert lateness.mean() == pytest.approx(0.01, rel=0.05)


@pytest.mark.thorough
def test_clock_error_grows_between_synchronisations():
    """A microsecond after setting; a crystal that is 20 ppm off makes 18 us by the last slot of the second."""
    clock = UnitClock(tick=0.0)
    keys = Key(np.full(4000, 2, np.uint32), np.arange(4000, dtype=np.uint32))
    for t, expected in ((seconds(3), 1e-6), (seconds(3) + ms(900), np.hypot(1e-6, 18e-6))):
        errors = jax.vmap(lambda k, t=t: clock.error(k, t, 0))(keys)
        assert float(jnp.std(errors)) == pytest.approx(expected, rel=0.05)


@pytest.mark.thorough
def test_slot_without_replies_still_gives_a_sample():
    """All beacons dead: at the end of the slot comes a sample that says so."""
    silent = replace(ONE, beacons=Beacons(dead=True), period=ms(10))
    times, samples = flown(silent, ms(1000))
    new = samples.fresh
    assert new.sum() == 9
    np.testing.assert_array_equal((times - samples.t)[new], ms(100))
    assert not samples.value.arrived.any()


@pytest.mark.thorough
@pytest.mark.parametrize("name", imperfections(UltrasonicRanging()))
def test_each_imperfection_alone_changes_the_ranges(name):
    everything = replace(
        ONE,
        errors=RangeErrors(0.004, 0.3, 3.0, 0.3, 1.0),
        beacons=Beacons(survey_error=0.01, moved=0.1, fault_time=0),
        medium=replace(ONE.medium, assumed=replace(ONE.medium.assumed, temperature=288.15)),
    )
    less = without(everything, name)
    with_it, without_it = pings(everything, 200)[0], pings(less, 200)[0]
    assert not np.array_equal(with_it.range, without_it.range)
    less.check()
    less.beacons.check()
    with pytest.raises(InputError, match="no imperfection 'wind'"):
        without(ONE, "wind")


def test_rejects_invalid_units_clients_and_period():
    assert isinstance(ONE, Sensor)
    ONE.check()
    TWO.check()
    for changes, problem in (
        ({"units": np.zeros(3)}, "units"),
        ({"clients": 1}, "clients"),
        ({"clients": 11}, "clients"),
        ({"period": ms(7)}, "slot"),
    ):
        with pytest.raises(InputError, match=f"UltrasonicRanging.{problem}"):
            replace(TWO, **changes).check()


@pytest.mark.thorough
def test_step_lowers_to_generated_c():
    """Sensors fly in the compiled loop: one step lowers to C."""
    one = to_arrays(UltrasonicRanging())
    still = Motion(np.int64(0), *[np.zeros(3)] * 6)
    leaves, tree = jax.tree.flatten((one, np.int64(0), jax.tree.map(jnp.asarray, one.init(Key(0, 0))), still))

    def flat(*leaves):
        sensor, t, state, motion = jax.tree.unflatten(tree, leaves)
        return jax.tree.leaves(sensor.step(t, state, motion))

    assert lower_function(flat, leaves).outputs


def test_replies_arrive_at_the_actual_speed_of_sound():
    """Air of 0 degrees taken for 40: the last reply takes the longest distance over 331.5 m/s and its own bytes."""
    cold, warm = Air(temperature=273.15, humidity=0.0), Air(temperature=313.15, humidity=0.0)
    sensor = replace(PERFECT, collisions=False, cone_error=False, medium=Medium(actual=cold, assumed=warm))
    replies, last = sensor.ping(np.int64(0), Key(np.uint32(2), np.uint32(0)), motion(np.int64(0)))
    assert replies.arrived.all()
    distance = np.linalg.norm(CEILING_SQUARE - [0.1, 0, 0], axis=1).max()
    channel = sensor.channel
    sound = float(last) - channel.message_bytes * channel.byte_time
    assert distance / sound == pytest.approx(331.5, abs=0.3)
