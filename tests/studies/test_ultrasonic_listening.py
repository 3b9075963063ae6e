import jax
import jax.numpy as jnp
import numpy as np
import pytest

from studies.hovercraft2006._ultrasonic_listening import UltrasonicListening
from trimtab.compiler.function import lower_function
from trimtab.core.errors import InputError
from trimtab.core.imperfections import imperfections, without
from trimtab.core.interfaces import Sensor
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import Key, key
from trimtab.core.signals import Motion
from trimtab.core.time import ms, seconds
from trimtab.sensors.time_of_flight import CEILING, CEILING_SQUARE, Beacons, RangeErrors

RUNS = 400
EVERYWHERE = Beacons(cone=1.5, reach=30.0, crystal=0.0)
SENSOR = UltrasonicListening(beacons=EVERYWHERE, cone_error=False, period=ms(10))
END = seconds(1)


AT_REST = 0.4 * np.sqrt(2) / (2 * 1.5 / np.sqrt(2 * 1.5**2 + CEILING**2))
"""Noise times dilution under the middle of the square (cm): 0.65, printed as 0.6."""


def motion(t, speed, course):
    """Straight through the middle of the square at the end of the first second."""
    s = (t - END) * 1e-7
    o = jnp.zeros(3)
    v = speed * jnp.stack([jnp.cos(course), jnp.sin(course), 0.0])
    return Motion(t, v * s, o, v, o, o, o)


@jax.jit
def _heard(sensor, speed, course, run):
    """All samples of a window and of the instant after it."""
    times = np.arange(0, END + 1, ms(10))

    def body(state, t):
        return sensor.step(t, state, motion(t, speed, course))

    return jax.lax.scan(body, sensor.init(Key(np.uint32(9), run)), times)[1]


_all = jax.jit(jax.vmap(_heard, in_axes=(None, None, 0, 0)))


def windows(speed, sensor=SENSOR, runs=RUNS):
    course = 2 * np.pi * np.arange(runs) / runs
    return course, jax.tree.map(np.asarray, _all(to_arrays(sensor), speed, course, np.arange(runs, dtype=np.uint32)))


def fix(ranges, used, start):
    """Gauss and Newton, with numpy: the position from ranges that are taken to be of one time."""
    x = np.array(start, float)
    for _ in range(10):
        away = x - CEILING_SQUARE[used, :2]
        distance = np.sqrt((away**2).sum(1) + CEILING**2)
        x = x + np.linalg.lstsq(away / distance[:, None], ranges[used] - distance, rcond=None)[0]
    return x


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("speed", "listening", "pinging"), [(0, AT_REST, AT_REST), (0.5, 27, 5), (1, 55, 10), (2, 114, 20)]
)
def test_error_grows_with_speed(speed, listening, pinging):
    """Root mean square error (cm) of a fix from the ranges of the 1 s window at its end, to 10 %; against pinging,
    whose ranges are of one time: 0.6 cm then, and 100 ms later what the vehicle moved.
    """
    _, samples = windows(float(speed))
    last = samples.value.range[:, -1]
    whole = (last > 0).all(1)  # collisions, not speed, take the others
    assert whole.mean() > 0.9
    error = [np.linalg.norm(fix(r, r > 0, (0, 0))) for r in last[whole]]
    assert 100 * np.sqrt(np.mean(np.square(error))) == pytest.approx(listening, rel=0.1)

    rng = np.random.default_rng(0)
    exact = np.linalg.norm(CEILING_SQUARE, axis=1)
    now = np.array([fix(exact + rng.normal(0, 0.004, 4), np.ones(4, bool), (0, 0)) for _ in range(RUNS)])
    assert 100 * np.sqrt(np.mean(np.sum(now**2, 1))) == pytest.approx(AT_REST, rel=0.1)
    later = 100 * np.sqrt(np.mean(np.sum((now - [0.1 * speed, 0]) ** 2, 1)))
    assert later == pytest.approx(pinging, rel=0.15)


@pytest.mark.thorough
def test_each_range_is_measured_at_its_chirp_time():
    """Noise-free ranges are the distances at the time of the chirp, also between two steps."""
    course, samples = windows(1.0, replace(SENSOR, errors=RangeErrors(noise=0.0)), 100)
    t, r = samples.value.measured[:, -1], samples.value.range[:, -1]
    v = np.stack([np.cos(course), np.sin(course), 0 * course], axis=1)
    at = v[:, None] * ((t - END) * 1e-7)[..., None]
    distance = np.linalg.norm(at - CEILING_SQUARE, axis=2)
    np.testing.assert_allclose(r[r > 0], distance[r > 0], atol=2e-7)
    assert (t[r > 0] % ms(10) != 0).any()


@pytest.mark.thorough
def test_samples_appear_at_message_end_with_newest_time():
    _, samples = windows(0.0)
    fresh = samples.fresh
    np.testing.assert_array_equal(fresh, samples.value.arrived.any(2))
    now = np.arange(0, END + 1, ms(10))
    late = np.broadcast_to(now, fresh.shape)[fresh] - samples.t[fresh]
    assert late.min() >= ms(10)  # a message takes 10 ms
    assert late.max() < ms(20)
    counts = samples.value.arrived.sum(1)
    assert counts.max() == 1
    assert counts.mean() > 0.95


@pytest.mark.thorough
def test_chirps_are_spread_over_the_window_and_never_overlap():
    begins, ends = jax.vmap(lambda k: SENSOR.chirps(np.int64(0), Key(np.uint32(1), k)))(
        np.arange(3000, dtype=np.uint32)
    )
    begins, ends = np.asarray(begins) * 1e-7, np.asarray(ends) * 1e-7
    assert begins.mean() == pytest.approx(0.5 + 0.0135, abs=0.012)
    assert begins.std() == pytest.approx(1 / np.sqrt(12), rel=0.03)
    kept = ends < 10
    gaps = [np.diff(np.sort(b[k])) for b, k in zip(begins, kept, strict=True)]
    assert min(g.min() for g in gaps if len(g)) >= 0.01 - 1e-6


@pytest.mark.thorough
@pytest.mark.parametrize("name", imperfections(UltrasonicListening()))
def test_each_imperfection_alone_changes_the_ranges(name):
    everything = replace(
        UltrasonicListening(period=ms(10)),
        errors=RangeErrors(0.004, 0.3, 3.0, 0.3, 1.0),
        beacons=Beacons(survey_error=0.01, moved=0.1),
        medium=replace(SENSOR.medium, assumed=replace(SENSOR.medium.assumed, temperature=288.15)),
    )
    with_it = windows(0.0, everything, 30)[1].value.range
    assert not np.array_equal(with_it, windows(0.0, without(everything, name), 30)[1].value.range)


def test_implements_sensor_and_rejects_invalid_arguments():
    assert isinstance(SENSOR, Sensor)
    SENSOR.check()
    with pytest.raises(InputError, match="no imperfection 'collisions'"):
        without(SENSOR, "collisions")
    with pytest.raises(InputError, match=r"UltrasonicListening\.window"):
        replace(SENSOR, period=ms(7)).check()
    assert SENSOR.init(key(0)).held.range.shape == (4,)


@pytest.mark.thorough
def test_runs_as_generated_code():
    """One step of the sensor lowers to C."""
    one = to_arrays(UltrasonicListening())
    still = Motion(np.int64(0), *[np.zeros(3)] * 6)
    leaves, tree = jax.tree.flatten((one, np.int64(0), jax.tree.map(jnp.asarray, one.init(Key(0, 0))), still))

    def flat(*leaves):
        sensor, t, state, motion = jax.tree.unflatten(tree, leaves)
        return jax.tree.leaves(sensor.step(t, state, motion))

    assert lower_function(flat, leaves).outputs
