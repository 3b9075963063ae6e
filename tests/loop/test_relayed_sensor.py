"""A sensor behind a bus: arrival times against slots counted here, and invalid configurations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.imperfections import without
from trimtab.core.record import Scalar, period, quantity, record, replace, to_arrays
from trimtab.core.rng import key
from trimtab.core.signals import Motion, new_sample
from trimtab.core.time import ms
from trimtab.links.slave_bus import SlaveBus
from trimtab.loop.relayed_sensor import RelayedSensor
from trimtab.sensors.flight_state import ActingInput

EVERY = 37
MESSAGE = 24


@record
class Place:
    """Source: this test."""

    north: Scalar = quantity("m", "Where.")


@record
class Odometer:
    """Measures north each 37 ms. Source: this test."""

    period: int = period("How often.", default=ms(1))

    def init(self, key):
        return new_sample(np.int64(0), Place(np.float64(0)), fresh=np.bool_(False))

    def measure(self, motion):
        return Place(motion.p_WB[0])

    def step(self, t, state, motion):
        due = t % ms(EVERY) == 0
        new = new_sample(t, self.measure(motion), fresh=True)
        old = replace(state, age=(t - state.t) * 1e-7, fresh=False)
        out = jax.tree.map(lambda a, b: jnp.where(due, a, b), new, old)
        return out, out


BUS = SlaveBus(size=MESSAGE, queue=ms(60), capacity=64)


def flown(sensor, n):
    """Return the samples at n milliseconds of a body that moves north at 1 m/s."""
    sensor, zero = to_arrays(sensor), jnp.zeros(3)

    def at(s, k):
        t = k * ms(1)
        motion = Motion(t, jnp.array([t * 1e-7, 0.0, 0.0]), zero, zero, zero, zero, zero)
        return sensor.step(t, s, motion)

    run = jax.jit(lambda: jax.lax.scan(at, sensor.init(key(0)), jnp.arange(n, dtype=np.int64))[1])
    return jax.tree.map(np.asarray, run())


def test_samples_arrive_in_bus_slots_with_original_timestamps():
    found = flown(RelayedSensor(inner=Odometer(), bus=BUS), 600)
    free, wanted = 0, []
    for made in range(0, 600, EVERY):
        first = max(-(-made // 10), free)  # slots of 10 ms, three for 24 bytes
        free = first + 3
        wanted.append((int(np.ceil((first + 2) * 10 + (4 + 1) * 9 / 100)), made))
    wanted = [one for one in wanted if one[0] < 600]
    fresh = np.flatnonzero(found.fresh)
    assert list(zip(fresh.tolist(), (found.t[fresh] // ms(1)).tolist(), strict=True)) == wanted
    np.testing.assert_allclose(found.value.north[fresh], found.t[fresh] * 1e-7, atol=1e-12)
    np.testing.assert_allclose(found.age[fresh], [(came - made) * 1e-3 for came, made in wanted], atol=1e-12)
    assert not found.valid[: wanted[0][0]].any()


def test_relayed_sensor_without_bus_delay_equals_the_sensor():
    alone, behind = (flown(s, 200) for s in (Odometer(), RelayedSensor(inner=Odometer(), bus=without(BUS, "delay"))))
    valid = behind.valid
    assert valid.all()
    for path in ("t", "age", "fresh"):
        np.testing.assert_array_equal(getattr(alone, path), getattr(behind, path))
    np.testing.assert_array_equal(alone.value.north, behind.value.north)


def test_rejects_mismatched_period_and_input_sensor():
    RelayedSensor(inner=Odometer(), bus=BUS).check()
    with pytest.raises(InputError, match="period must equal the sensor's period, 6 ms, got 1 ms") as refused:
        RelayedSensor(inner=Odometer(period=ms(6)), bus=BUS).check()
    assert refused.value.fix == "set bus.period to 6 ms"
    with pytest.raises(InputError, match="ActingInput measures 'input'"):
        RelayedSensor(inner=ActingInput(period=ms(1)), bus=BUS).check()
