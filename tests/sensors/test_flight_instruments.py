"""Flight instruments: measurements of known motions, and errors of the declared sizes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import Key, key
from trimtab.core.rotation import DEG, from_euler
from trimtab.core.signals import Motion
from trimtab.environment.geodetic import STANDARD
from trimtab.sensors.flight_instruments import CHANNELS, FlightInstruments

ANGLES = np.array([0.3, -0.2, 1.0])


def motion(v=(100.0, 5.0, 8.0), w=(0.0, 0.0, 0.0), a=(0.0, 0.0, 0.0), alpha=(0.0, 0.0, 0.0), angles=ANGLES):
    p = np.array([1.0, 2.0, -300.0])
    return Motion(np.int64(0), p, np.asarray(angles), *(np.asarray(x, float) for x in (v, w, a, alpha)))


def test_measures_airspeed_flow_angles_and_altitude():
    seen = FlightInstruments().measure(motion())
    assert float(seen.speed) == pytest.approx(np.sqrt(100**2 + 25 + 64))
    assert float(jnp.tan(seen.alpha)) == pytest.approx(0.08)
    assert float(jnp.sin(seen.beta) * seen.speed) == pytest.approx(5.0)
    assert float(seen.altitude) == 300.0
    assert np.isfinite(np.asarray(FlightInstruments().measure(motion(v=(0, 0, 0))).alpha))


def test_coordinated_turn_at_sixty_degrees_gives_two_g():
    """A level coordinated turn at 60 degrees of bank feels 2 g and nothing aside."""
    turning = np.array([0.0, 0.0, STANDARD * np.tan(60 * DEG) / 100])  # yaw rate in W
    R = np.asarray(from_euler(60 * DEG, 0.0, 0.0))
    inwards = np.cross(turning, [100.0, 0.0, 0.0])
    seen = FlightInstruments().measure(
        motion(v=(100, 0, 0), w=R.T @ turning, a=R.T @ inwards, angles=(60 * DEG, 0.0, 0.0))
    )
    assert float(seen.normal_load) == pytest.approx(2.0)
    assert float(seen.side_load) == pytest.approx(0.0, abs=1e-12)


def test_lever_arm_adds_angular_acceleration_to_load_factors():
    """Pitching up faster lifts what sits before the centre of mass; yawing right pushes it to starboard."""
    sensor = FlightInstruments(lever_arm=(4.0, 0.0, 0.0))
    still = sensor.measure(motion())
    up = sensor.measure(motion(alpha=(0, 1.0, 0)))
    right = sensor.measure(motion(alpha=(0, 0, 1.0)))
    assert float(up.normal_load - still.normal_load) == pytest.approx(4 / STANDARD)
    assert float(right.side_load - still.side_load) == pytest.approx(4 / STANDARD)
    spun = sensor.measure(motion(w=(0.5, 0.0, 0.4)))
    assert float(spun.normal_load - still.normal_load) == pytest.approx(-0.2 * 4 / STANDARD)


GROUPS = {
    "speed": ("speed",),
    "vane": ("alpha", "beta"),
    "altitude": ("altitude",),
    "attitude": ("roll", "pitch"),
    "rate": ("roll_rate", "pitch_rate", "yaw_rate"),
    "load": ("normal_load", "side_load"),
}


@jax.jit
def samples(sensor):
    """Return two samples of each of 400 runs of a vehicle that does not move, and the true values."""
    still = motion()

    def sample(run):
        state = sensor.init(Key(np.uint32(0), run))
        return [sensor.step(k * sensor.period, state, still)[1].value for k in (3, 4)]

    return *jax.vmap(sample)(jnp.arange(400, dtype=np.uint32)), sensor.measure(still)


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("kind", ["noise", "bias"])
def test_each_error_affects_only_its_own_channels(group, kind):
    first, second, true = samples(to_arrays(FlightInstruments(**{f"{group}_{kind}": 0.5})))
    for name in (n for names in GROUPS.values() for n in names):
        off = np.asarray(getattr(first, name)) - float(getattr(true, name))
        if name not in GROUPS[group]:
            assert np.max(np.abs(off)) < 1e-12
            continue
        assert np.std(off) == pytest.approx(0.5, rel=0.15)  # four sigma of 400 draws
        same = np.asarray(getattr(second, name)) - float(getattr(true, name))
        assert np.allclose(same, off) == (kind == "bias"), "a bias stays, noise does not"


def test_biases_are_drawn_independently_per_channel():
    every = FlightInstruments(**{f"{group}_bias": 1.0 for group in GROUPS})
    assert len(set(np.asarray(every.init(key(3)).bias).tolist())) == len(CHANNELS)
    assert replace(every, speed_bias=0.0).init(key(3)).bias.shape == (len(CHANNELS),)
