"""Slave bus: transmission times, and every arrival against a list of slots."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.imperfections import without
from trimtab.core.record import Scalar, quantity, record, replace, to_arrays
from trimtab.core.rng import key
from trimtab.core.signals import Sample
from trimtab.core.time import ms
from trimtab.links.slave_bus import SlaveBus
from trimtab.loop.structure import strengthen_types


@record
class Ranges:
    """Source: this test."""

    range: Scalar = quantity("m", "To beacons.", shape=(4,))
    arrived: Scalar = quantity("1", "Which replied.", kind="flag", shape=(4,))
    unit: Scalar = quantity("1", "Which unit.", kind="count")


BYTES = 5 + 2 * 4 + 1 + 1
"""Overhead, four ranges, one byte of flags, a unit."""


def flown(bus, made, n, grid=10_000):
    """State and received samples at n instants, for samples measured at the times `made` (ms)."""
    times = np.full(100, np.iinfo(np.int64).max)
    times[: len(made)] = np.array(made) * ms(1)
    return jax.tree.map(np.asarray, _flown(to_arrays(bus), times, np.int64(grid), n))


@functools.partial(jax.jit, static_argnames="n")
def _flown(bus, times, grid, n):
    def given(t):
        newest = jnp.sum(times <= t) - 1
        at = times[jnp.maximum(newest, 0)]
        value = Ranges(jnp.ones(4) * at * 1e-4, jnp.ones(4, bool), at.astype(np.int32))
        return Sample(value, at, (t - at) * 1e-7, at == t, newest >= 0)

    state = strengthen_types(bus.init(key(0), given(np.int64(0))))
    return jax.lax.scan(lambda s, t: bus.step(t, s, given(t)), state, jnp.arange(n, dtype=np.int64) * grid)


def slots(made, size=BYTES, queue=200.0):
    """Reference arrival (ms) of each message from a list of slots. None: dropped."""
    free, arrivals = 0, []
    for t in made:
        pieces = [10] * (size // 10) + ([size % 10] if size % 10 else [])
        first = free
        while first * 10 < t:
            first += 1
        arrives = (first + len(pieces) - 1) * 10 + (pieces[-1] + 1) * 9 / 100
        if arrives - t > queue:
            arrivals.append(None)
            continue
        free = first + len(pieces)
        arrivals.append(arrives)
    return arrivals


def test_10_bytes_and_an_address_take_0_99_ms():
    """99 bits at 100 kHz."""
    _, out = flown(SlaveBus(size=10, period=ms("0.01"), queue=ms(2)), [0], 110, ms("0.01"))
    assert int(np.argmax(out.valid)) == 99


def test_last_piece_duration_depends_on_its_bytes():
    """Two pieces of 10 and 5 bytes: the second starts 10 ms later and takes (5 + 1) 9 bits at 100 kHz."""
    _, out = flown(SlaveBus(period=ms("0.01"), queue=ms(20), capacity=2100), [0], 1100, ms("0.01"))
    assert int(np.argmax(out.valid)) == 1000 + 54


CASES = {
    "one": [3],
    "on the slot": [10],
    "every 50 ms": list(range(7, 400, 50)),
    "bursts": [100, 101, 102, 103, 250, 251, 400],
    "too many": list(range(0, 400, 5)),
}


@pytest.mark.parametrize("made", CASES.values(), ids=CASES)
@pytest.mark.parametrize("size", [0, pytest.param(10, marks=pytest.mark.thorough), 37])
def test_arrivals_match_a_list_of_slots(made, size):
    n = 700
    state, out = flown(SlaveBus(size=size), made, n)
    arrivals = slots(made, size or BYTES)
    fresh = np.nonzero(out.fresh)[0]
    wanted = [(int(np.ceil(a)), t) for a, t in zip(arrivals, made, strict=True) if a is not None]
    assert list(zip(fresh.tolist(), (out.t[fresh] // ms(1)).tolist(), strict=True)) == wanted
    assert int(state.fifo.lost) == sum(a is None for a in arrivals)
    np.testing.assert_allclose(out.age[out.valid], (np.arange(n) * ms(1) - out.t)[out.valid] * 1e-7, atol=1e-12)
    np.testing.assert_array_equal(out.value.unit[out.valid], out.t[out.valid])


def test_message_size_follows_from_the_sample():
    value = Ranges(np.zeros(4), np.zeros(4, bool), np.int32(0))
    assert SlaveBus().message_size(value) == BYTES
    assert SlaveBus(size=12).message_size(value) == 12


def test_without_delay_the_bus_is_a_wire():
    _, out = flown(without(SlaveBus(), "delay"), CASES["bursts"], 420)
    assert np.nonzero(out.fresh)[0].tolist() == CASES["bursts"]


def test_invalid_settings_are_rejected():
    with pytest.raises(InputError, match="takes 18"):
        replace(SlaveBus(), bit_rate=5.5e3).check()
    with pytest.raises(InputError, match="capacity"):
        replace(SlaveBus(), queue=ms(400)).check()
    with pytest.raises(InputError, match="a size is not valid"):
        replace(SlaveBus(), piece=0).check()
    with pytest.raises(InputError, match="no imperfection"):
        without(SlaveBus(), "loss")
    SlaveBus().check()
