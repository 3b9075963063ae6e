"""Delivery of late fixes, against a list of the inputs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.time import ms
from trimtab.loop.structure import strengthen_types
from trimtab.sensors.late_fix import LateFix


def run(fix, n=500):
    """Samples at each millisecond of a value that is the time."""
    now = jnp.arange(n, dtype=np.int64) * ms(1)
    step = lambda s, t: fix.deliver(t, s, t * 1.0)  # noqa: E731
    return np.asarray(now), jax.tree.map(
        np.asarray, jax.lax.scan(step, strengthen_types(fix.initial_state(jnp.zeros(()))), now)[1]
    )


@pytest.mark.thorough("0-1", "0-87", "30-0", "30-100")
@pytest.mark.parametrize("latency", [0, 1, 87, 100])
@pytest.mark.parametrize("offset", [0, 30])
def test_each_fix_is_delivered_once_after_the_latency(latency, offset):
    now, out = run(LateFix(latency=latency * 1e-3, interval=ms(100), offset=ms(offset)))
    came = now[out.fresh] // ms(1)
    expected = list(range(offset + latency, 500, 100))
    assert came.tolist() == expected
    np.testing.assert_array_equal(out.value[out.fresh], now[out.fresh] - ms(latency))
    np.testing.assert_array_equal(out.t[out.valid], out.value[out.valid])
    np.testing.assert_allclose(out.age[out.valid], (now - out.t)[out.valid] * 1e-7, atol=1e-12)
    assert not out.valid[: expected[0]].any()
    assert out.valid[expected[0] :].all()


def test_arrival_stamp_hides_the_latency():
    now, out = run(LateFix(latency=0.087, stamped="arrival"))
    np.testing.assert_array_equal(out.t[out.fresh], now[out.fresh])
    assert (out.age[out.fresh] == 0).all()
    np.testing.assert_array_equal(out.value[out.fresh], now[out.fresh] - ms(87))


def test_rejects_latency_longer_than_the_interval():
    with pytest.raises(InputError, match="longer than the interval"):
        LateFix(latency=0.11, interval=ms(100)).check()
    with pytest.raises(InputError, match="must be less than the interval"):
        LateFix(offset=ms(100), interval=ms(100)).check()
