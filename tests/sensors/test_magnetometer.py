import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.imperfections import imperfections, without
from trimtab.core.interfaces import Sensor
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import key
from trimtab.core.rotation import from_euler, wrap
from trimtab.core.signals import Motion
from trimtab.core.time import ms, seconds
from trimtab.environment.magnetic import COLLEGE_PARK, magnetic_heading, strength_ratio
from trimtab.sensors.magnetometer import FloorSteel, Magnetometer, RunningMotor, dipole_field

FIELD = np.array(COLLEGE_PARK)


def motion(t=0, heading=0.0, place=(0.0, 0.0, 0.0), roll=0.0, pitch=0.0):
    o = np.zeros(3)
    return Motion(np.int64(t), np.asarray(place), jnp.array([roll, pitch, heading]), o, o, o, o)


@jax.jit
def _seen(sensor, m, k):
    return sensor.step(m.t, sensor.init(k), m)[1].value


def seen(sensor, m, seed=0):
    return _seen(to_arrays(sensor), m, key(seed))


@jax.jit
def _measured(sensor, m):
    return sensor.measure(m)


def measured(sensor, m):
    return _measured(to_arrays(sensor), m)


def test_measures_the_field_in_the_body_frame():
    m = motion(heading=0.7, roll=0.1, pitch=-0.2)
    wanted = from_euler(0.1, -0.2, 0.7).T @ FIELD
    np.testing.assert_allclose(measured(Magnetometer(), m).field, wanted, atol=1e-19)
    np.testing.assert_allclose(seen(Magnetometer(), m).field, wanted, atol=1e-19)
    mounted = measured(Magnetometer(mounting=(0.0, 0.0, 0.3)), m).field
    np.testing.assert_allclose(from_euler(0.0, 0.0, 0.3) @ mounted, wanted, atol=1e-19)
    assert isinstance(Magnetometer(), Sensor)


def test_noise_gives_the_published_heading_variance():
    """[1] R1 = 1.6e-4 rad² in the default field; 1000 samples: 4.5 % standard error of the variance."""
    sensor = Magnetometer.microstrain_3dm_gx1()

    def heading(k):
        value = sensor.step(k * ms("6.5536"), key(3), motion(heading=1.0))[1].value
        return magnetic_heading(value.field, FIELD)

    found = np.asarray(jax.jit(jax.vmap(heading))(jnp.arange(1000)))
    assert np.var(found) == pytest.approx(1.6e-4, rel=0.15)
    assert found.mean() == pytest.approx(1.0, abs=4 * 0.0126 / np.sqrt(1000))


def test_hard_and_soft_iron_give_first_and_second_harmonic():
    """The classic single- and semicircular deviation: harmonics 1 and 2 of the heading error."""
    headings = jnp.linspace(0, 2 * np.pi, 64, endpoint=False)
    level = np.hypot(*FIELD[:2])

    @jax.jit
    def errors(sensor):
        def one(psi):
            value = sensor.step(0, key(0), motion(heading=psi))[1].value
            return wrap(magnetic_heading(value.field, FIELD) - psi)

        return jax.vmap(one)(headings)

    def deviation(sensor):
        return np.abs(np.fft.rfft(np.asarray(errors(to_arrays(sensor))))) / 32

    hard = deviation(Magnetometer(hard_iron=(0.02 * level, 0.0, 0.0)))
    assert hard[1] == pytest.approx(0.02, rel=0.01)
    assert hard[2:].max() < 0.02 * hard[1]
    soft = deviation(Magnetometer(soft_iron=((1.02, 0, 0), (0, 0.98, 0), (0, 0, 1))))
    assert soft[2] == pytest.approx(0.02, rel=0.01)
    assert soft[1] < 0.02 * soft[2]


def test_dipole_field_matches_biot_savart():
    """Oracle: a ring of current, summed; ten radii away it is a dipole to 2 %; the size is tiny."""
    radius, current, n = 0.01, 5.0, 2000
    a = 2 * np.pi * np.arange(n) / n
    ring = radius * np.stack([np.cos(a), np.sin(a), 0 * a], 1)
    segment = 2 * np.pi * radius / n * np.stack([-np.sin(a), np.cos(a), 0 * a], 1)
    for away in ([0.15, 0.0, 0.05], [0.0, -0.1, 0.1], [0.0, 0.0, 0.2]):
        r = np.array(away) - ring
        field = 1e-7 * current * np.sum(np.cross(segment, r) / np.linalg.norm(r, axis=1)[:, None] ** 3, 0)
        got = dipole_field(jnp.array([0, 0, current * np.pi * radius**2]), jnp.asarray(away), 1e-6)
        np.testing.assert_allclose(got, field, atol=0.02 * np.linalg.norm(field))
    assert np.isfinite(dipole_field(jnp.array([0.0, 0.0, 1.0]), jnp.zeros(3), 0.01)).all()


@pytest.mark.thorough
def test_running_motor_disturbs_the_field():
    motor = RunningMotor(instants=(seconds(1), seconds(2)), duty=(1.0, 0.0))
    sensor = Magnetometer(disturbances=(motor,))
    off = [seen(sensor, motion(t=seconds(s), heading=0.4)).field for s in (0.5, 2.0)]
    on = seen(sensor, motion(t=seconds(1), heading=0.4)).field
    for field in off:
        np.testing.assert_allclose(field, sensor.measure(motion(heading=0.4)).field, atol=1e-20)
    size = np.linalg.norm(on - off[0])
    assert size == pytest.approx(1e-7 * 0.3 / 0.25**3, rel=0.02), "across the axis: mu0 m/(4 pi r³)"
    turned = seen(sensor, motion(t=seconds(1), heading=2.0)).field - sensor.measure(motion(heading=2.0)).field
    np.testing.assert_allclose(turned, on - off[0], atol=1e-18, err_msg="it is fixed in the body")


def test_motor_field_is_proportional_to_duty():
    sensor = Magnetometer()
    course = RunningMotor(instants=(seconds(1), seconds(2), seconds(4)), duty=(0.3, -0.7, 0.1))
    full = RunningMotor().field(motion(), sensor.position)
    at = jax.jit(lambda m: course.field(m, sensor.position))
    for t, duty in ((0.0, 0.0), (0.9, 0.0), (1.0, 0.3), (1.9, 0.3), (2.0, -0.7), (3.9, -0.7), (4.0, 0.1), (99.0, 0.1)):
        field = at(motion(t=seconds(t)))
        np.testing.assert_allclose(field, duty * full, rtol=1e-12, atol=1e-20)


@pytest.mark.parametrize("course", [{"duty": (1.0, 0.0)}, {"instants": (2, 1), "duty": (1.0, 0.0)}])
def test_rejects_motor_duties_without_increasing_instants(course):
    with pytest.raises(InputError, match=r"RunningMotor\.(duty|instants)"):
        RunningMotor(**course).check()


def test_floor_steel_disturbs_the_field_nearby():
    steel = FloorSteel(position=(2.0, 1.0, 0.3))
    sensor = Magnetometer(disturbances=(steel,))
    near, far = seen(sensor, motion(place=(2.0, 1.0, 0.0))).field, seen(sensor, motion(place=(-3.0, 1.0, 0.0))).field
    assert abs(float(strength_ratio(near, FIELD)) - 1) > 0.2
    assert abs(float(strength_ratio(far, FIELD)) - 1) < 1e-3
    turned = seen(sensor, motion(place=(2.0, 1.0, 0.0), heading=1.1)).field
    np.testing.assert_allclose(from_euler(0.0, 0.0, 1.1) @ turned, near, atol=1e-18, err_msg="it is fixed in the world")


def test_field_is_clipped_and_rounded_to_the_resolution():
    sensor = Magnetometer(range=4e-5, resolution=1e-6)
    value = seen(sensor, motion(heading=0.3))
    assert float(value.field[2]) == pytest.approx(4e-5, abs=1e-18)
    assert bool(value.saturated)
    assert not bool(seen(replace(sensor, range=1e-4), motion(heading=0.3)).saturated)
    np.testing.assert_allclose(np.asarray(value.field) / 1e-6, np.round(np.asarray(value.field) / 1e-6), atol=1e-9)


def test_every_imperfection_can_be_switched_off():
    sensor = Magnetometer.microstrain_3dm_gx1(
        hard_iron=(1e-6, 0.0, 0.0),
        soft_iron=np.diag([1.1, 1.0, 1.0]),
        disturbances=(RunningMotor(),),
        mounting=(0.1, 0, 0),
    )
    m = motion(heading=0.5)
    assert np.abs(seen(sensor, m).field - measured(sensor, m).field).max() > 1e-7
    for name in imperfections(Magnetometer()):
        sensor = without(sensor, name)
    np.testing.assert_allclose(seen(sensor, m).field, measured(Magnetometer(), m).field, atol=1e-19)
    with pytest.raises(InputError, match="no imperfection"):
        without(sensor, "rust")
