"""[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.imperfections import without
from trimtab.core.interfaces import Channel
from trimtab.core.rng import key
from trimtab.core.signals import PlanarForce, Sample, new_sample
from trimtab.core.time import ms
from trimtab.links.wire import DelayChain


@pytest.mark.thorough(
    "10000-60000-6",
    "10000-200000-2",
    "10000-10000-1",
    "10000-65536-3",
    "60000-60000-6",
    "60000-200000-2",
    "60000-10000-1",
    "60000-65536-3",
    "60000-60000-0",
    "150000-60000-6",
    "150000-200000-2",
    "150000-10000-1",
    "150000-65536-3",
    "150000-60000-0",
)
@pytest.mark.parametrize(("period", "steps"), [(ms(6), 6), (ms(20), 2), (ms(1), 1), (65536, 3), (ms(6), 0)])
@pytest.mark.parametrize("sensor_period", [ms(1), ms(6), ms(15)])
def test_the_delay_is_exact_for_any_input(drive, sent_at, period, steps, sensor_period):
    t, out, _ = drive(DelayChain(period, steps), key(0), 40, sensor_period)
    came = np.arange(40) >= steps
    sent = sent_at(t - steps * period, sensor_period)
    np.testing.assert_array_equal(out.valid, came)
    np.testing.assert_array_equal(out.t[came], sent.t[came])
    for name in ("surge_velocity", "sway_velocity", "yaw_rate", "heading"):
        got, want = getattr(out.value, name), np.where(came, getattr(sent.value, name), 0.0)
        np.testing.assert_allclose(got, want, rtol=0, atol=1e-15)
    np.testing.assert_allclose(out.age[came], (t - sent.t)[came] * 1e-7, rtol=0, atol=1e-12)
    new = came & np.append(True, np.diff(np.where(came, sent.t, -1)) != 0)  # the output changes at these instants
    np.testing.assert_array_equal(out.fresh, new)


def test_invalid_samples_stay_invalid_through_the_delay(drive):
    t, out, _ = drive(DelayChain(ms(2), 3), key(0), 30, first=ms(10))
    np.testing.assert_array_equal(out.valid, t >= ms(16))
    assert t[out.fresh][0] == ms(16)
    assert np.isfinite(out.age).all()


def test_loop_delay_is_76_ms():
    """[1] section 6.1: 6 unit delays of 6 ms and 2 of 20 ms, "nearly 80 ms" with the waits for sampling."""
    down, up = DelayChain(ms(6), 6), DelayChain(ms(20), 2)
    assert round((down.delay() + up.delay()) * 1e3, 9) == 76.0

    def due(t, channel, stepped, before):
        return jax.tree.map(lambda a, b: jnp.where(t % channel.period == 0, a, b), stepped, before)

    def body(carry, t):
        lower, upper = carry
        lower = due(t, down, down.step(t, lower[0], new_sample(t, PlanarForce(FX=t * 1e-7, FY=0.0))), lower)
        upper = due(t, up, up.step(t, upper[0], lower[1]), upper)
        return (lower, upper), t - upper[1].t

    nothing = jax.tree.map(jnp.asarray, Sample(PlanarForce(0.0, 0.0), 0, 0.0, False, False))
    start = tuple((c.init(key(0), nothing), nothing) for c in (down, up))
    _, ages = jax.jit(lambda: jax.lax.scan(body, start, jnp.arange(600) * ms(1)))()
    ages = np.asarray(ages)[120:]  # 480 ms: a whole number of the 60 ms cycle, after both chains have filled
    assert ages.min() == ms(76)
    # on top: 20 k mod 6 = 0, 2 or 4 ms until the upper chain looks, then 0..19 ms until its next look
    assert ages.mean() == ms(76 + 2) + ms("9.5")


def test_disabled_delay_keeps_the_sample_and_hold():
    channel = without(DelayChain(ms(20), 2), "delay")
    assert (channel.period, channel.steps, channel.delay()) == (ms(20), 0, 0.0)
    with pytest.raises(InputError, match=r"no imperfection 'loss'.*\n.*delay"):
        without(channel, "loss")


def test_rejects_invalid_number_of_delays():
    DelayChain(ms(6), 0).check()
    DelayChain(ms(6), 6).check()
    for steps in (-1, 1.5, "two", True):
        with pytest.raises(InputError, match="number of unit delays"):
            DelayChain(ms(6), steps).check()  # pyright: ignore[reportArgumentType]


def test_the_output_is_differentiable_in_the_input():
    chain = DelayChain(ms(1), 2)

    def last(gain):
        state = chain.init(key(0), new_sample(0, 0.0))
        out = new_sample(0, 0.0)
        for k in range(4):
            state, out = chain.step(k * ms(1), state, new_sample(k * ms(1), gain * (k + 1.0)))
        return out.value

    assert jax.jit(jax.grad(last))(1.7) == 2.0  # what went in at k = 1
    assert isinstance(chain, Channel)
